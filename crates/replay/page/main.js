// Puts the replay together.

import { Bar } from "./bar.js";
import { load } from "./data.js";
import { Panel } from "./panel.js";
import { Player, SPEEDS } from "./player.js";
import { Stage } from "./stage.js";

const find = (id) => document.getElementById(id);

function fail(message) {
  const box = find("message");
  box.textContent = message;
  box.hidden = false;
}

function themeNow() {
  const style = getComputedStyle(document.documentElement);
  const colour = (name) => style.getPropertyValue(`--${name}`).trim();
  return Object.fromEntries(["page", "ink", "track", "held", "accent", "alarm", "sky"].map((name) => [name, colour(name)]));
}

// A browser without WebGL still gets the conditions.
function stageOf(replay, changed) {
  try {
    return new Stage(find("view"), replay.doc, replay.meshes, replay.track, changed);
  } catch (error) {
    fail(`The 3D view cannot be shown: ${error.message}`);
    return null;
  }
}

async function start() {
  const replay = await load();
  const { track, doc } = replay;
  let player = null;
  const stage = stageOf(replay, () => player?.ask());
  const bar = new Bar(find("strip"), doc, track, (step) => player.seek(step));
  const panel = new Panel(find("panel"), replay, (step) => player.seek(step));
  const time = find("time");
  [time.min, time.max, time.step] = [track.first, track.last, 1];
  const clock = find("clock");
  player = new Player(track, (step) => {
    const row = panel.show(step);
    stage?.draw(step, row);
    bar.draw(step);
    time.value = Math.round(step);
    const now = `${(step * track.dt).toFixed(2)} s`;
    time.setAttribute("aria-valuetext", now);
    clock.textContent = `${now} of ${(track.last * track.dt).toFixed(2)} s`;
  });
  controls(player, stage, time, track);
  const theme = () => {
    const colours = themeNow();
    stage?.setTheme({ page: colours.sky });
    bar.setTheme(colours);
    player.ask();
  };
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", theme);
  new ResizeObserver(() => player.ask()).observe(find("view"));
  new ResizeObserver(() => player.ask()).observe(find("strip"));
  theme();
  const asked = Number(new URLSearchParams(location.hash.slice(1)).get("t"));
  if (Number.isFinite(asked) && asked > 0) player.seek(asked / track.dt);
  document.documentElement.dataset.ready = "true";
}

function controls(player, stage, time, track) {
  const [play, speed, follow, forces] = ["play", "speed", "follow", "forces"].map(find);
  speed.append(...SPEEDS.map((value) => new Option(`${value}\u00d7`, String(value), value === 1, value === 1)));
  player.onChange(() => {
    play.textContent = player.playing ? "Pause" : "Play";
    play.dataset.playing = String(player.playing);
    speed.value = String(player.speed);
  });
  const press = (button, value) => {
    button.setAttribute("aria-pressed", String(value));
    player.ask();
  };
  const toggleFollow = () => {
    if (!stage) return;
    stage.following = !stage.following;
    press(follow, stage.following);
  };
  const toggleForces = () => {
    if (!stage) return;
    stage.arrows.group.visible = !stage.arrows.group.visible;
    press(forces, stage.arrows.group.visible);
  };
  const reset = () => {
    stage?.resetView(player.step);
    player.ask();
  };
  play.addEventListener("click", () => player.toggle());
  speed.addEventListener("change", () => player.setSpeed(Number(speed.value)));
  time.addEventListener("input", () => player.seek(Number(time.value)));
  follow.addEventListener("click", toggleFollow);
  forces.addEventListener("click", toggleForces);
  find("reset").addEventListener("click", reset);
  const move = (event, sign) => (event.shiftKey ? player.seek(Math.round(player.step) + sign) : player.move(sign));
  const keys = {
    " ": () => player.toggle(),
    ArrowLeft: (event) => move(event, -1),
    ArrowRight: (event) => move(event, 1),
    Home: () => player.seek(track.first),
    End: () => player.seek(track.last),
    "+": () => player.faster(1),
    "=": () => player.faster(1),
    "-": () => player.faster(-1),
    f: toggleFollow,
    c: toggleForces,
    v: reset,
  };
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const tag = event.target.tagName;
    // A list of choices and a fold have keys of their own; a button has the space bar.
    if (tag === "SELECT" || ((tag === "BUTTON" || tag === "SUMMARY" || tag === "A") && event.key === " ")) return;
    const act = keys[event.key] ?? keys[event.key.toLowerCase()];
    if (!act) return;
    event.preventDefault();
    act(event);
  });
}

start().catch((error) => fail(`The replay cannot be shown: ${error.message}`));
