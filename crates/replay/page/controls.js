// What every player of replays has: messages, colours, buttons and keys.

import { SPEEDS } from "./player.js";
import { Stage } from "./stage.js";

export const find = (id) => document.getElementById(id);

export function fail(message) {
  const box = find("message");
  box.textContent = message;
  box.hidden = false;
}

function themeNow() {
  const style = getComputedStyle(document.documentElement);
  const colour = (name) => style.getPropertyValue(`--${name}`).trim();
  return Object.fromEntries(["page", "ink", "track", "held", "accent", "alarm", "sky"].map((name) => [name, colour(name)]));
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
    for (const stage of stages) stage.setTheme({ page: colours.sky });
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
    for (const stage of stages) stage.following = isFollowing;
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
