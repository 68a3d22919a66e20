// Shared by all players of replays: messages, colours, buttons and keys.

import { SPEEDS } from "./player.js";
import { Stage } from "./stage.js";
import { seconds } from "./words.js";

// Fewer frames a second are worth saying.
const SMOOTH = 15;

export const find = (id) => document.getElementById(id);

export function fail(message) {
  const box = find("message");
  box.textContent = message;
  box.hidden = false;
}

// Fills the bar while a replay loads: `share` goes from 0 to 1, and the bar leaves at 1.
export function loading(share) {
  const bar = find("loading");
  bar.hidden = share >= 1;
  bar.value = share;
}

// The time, and how fast it really goes where that is not what was asked for.
export function clockText(player, step, { last, dt }) {
  const rate = player.rate();
  const isSlow = rate && (rate.frames < SMOOTH || rate.speed < 0.9 * player.speed);
  const said = isSlow ? `, ${rate.speed.toFixed(1)}\u00d7 at ${rate.frames.toFixed(0)} frames/s` : "";
  return `${seconds(step, dt)} of ${seconds(last, dt)}${said}`;
}

// `#t=3.5` is a moment in seconds: in the address that opened the page, in one that is typed into it, and in the one that
// the button copies.
export function moments(player, { dt }) {
  const go = () => {
    const asked = new URLSearchParams(location.hash.slice(1)).get("t");
    if (asked !== null && asked !== "" && Number.isFinite(Number(asked))) player.seek(Number(asked) / dt);
  };
  const copy = find("copy");
  copy.addEventListener("click", async () => {
    const moment = `#t=${Number((player.step * dt).toFixed(2))}`;
    try {
      history.replaceState(null, "", moment);
    } catch {
      // Browsers refuse it to some files, and when it is done too often.
      location.hash = moment;
    }
    const copied = await navigator.clipboard?.writeText(location.href).then(() => true, () => false);
    copy.textContent = copied ? "Copied" : "In the address";
    setTimeout(() => {
      copy.textContent = "Copy link";
    }, 2000);
  });
  addEventListener("hashchange", go);
  go();
}

function themeNow() {
  const style = getComputedStyle(document.documentElement);
  const colour = (name) => style.getPropertyValue(`--${name}`).trim();
  return Object.fromEntries(["page", "ink", "track", "held", "accent", "alarm", "soft"].map((name) => [name, colour(name)]));
}

// The picture of a replay; none in a browser without WebGL.
export function stageOf(canvas, replay, changed) {
  try {
    return new Stage(canvas, replay.doc, replay.meshes, replay.track, changed);
  } catch (error) {
    fail(`The 3D view cannot be shown: ${error.message}`);
    return null;
  }
}

// Draws again when sizes or colours change.
export function watch(player, stages, bars) {
  const theme = () => {
    const colours = themeNow();
    for (const bar of bars) bar.setTheme(colours);
    player.ask();
  };
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", theme);
  for (const { canvas } of [...stages, ...bars]) new ResizeObserver(() => player.ask()).observe(canvas);
  theme();
}

// Buttons, keys and the time bar of a player; they act on all of its pictures.
export function controls(player, stages, track) {
  const [play, speed, follow, forces, time] = ["play", "speed", "follow", "forces", "time"].map(find);
  [time.min, time.max, time.step] = [track.first, track.last, 1];
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
  let [isFollowing, hasForces] = [true, true];
  const toggleFollow = () => {
    if (stages.length === 0) return;
    isFollowing = !isFollowing;
    for (const stage of stages) stage.follow(isFollowing);
    press(follow, isFollowing);
  };
  const toggleForces = () => {
    if (stages.length === 0) return;
    hasForces = !hasForces;
    for (const stage of stages) stage.arrows.group.visible = hasForces;
    press(forces, hasForces);
  };
  const reset = () => {
    for (const stage of stages) stage.resetView(player.step);
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
