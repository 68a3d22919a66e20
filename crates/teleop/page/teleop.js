// Puts the page of an operator together.

import * as THREE from "three";

import { showCard } from "./card.js";
import { fail, find, loading } from "./controls.js";
import { Gamepad } from "./gamepad.js";
import { Goal } from "./goal.js";
import { Keyboard } from "./keyboard.js";
import { Live, loadRoom } from "./live.js";
import { numberOf } from "./measures.js";
import { Socket } from "./socket.js";
import { Stage } from "./stage.js";
import { Sticks } from "./sticks.js";
import { takeToken } from "./token.js";
import { Headset } from "./webxr.js";
import { element, seconds, words } from "./words.js";

const INPUT_MS = 20;
// The view from behind: its turn to the robot's right, rad, its rise for each metre away, its distance, m; and the share by which it
// turns with the robot in a picture.
const BEHIND = { turn: 0.6, rise: 0.55, away: 3.2 };
const FOLLOWS = 0.08;
// The view's steps where less motion is wanted, rad.
const STEP = 0.6;
// How far the look through the robot's eye can be turned to the sides, and down and up, rad; and by a key.
const EYE = { turn: [-1.2, 1.2], rise: [-0.5, 1.8], key: 0.15 };
const still = matchMedia("(prefers-reduced-motion: reduce)");
const touch = matchMedia("(pointer: coarse)");
const WORDS = { opening: "Building the room", ready: "Ready", running: "Running", ended: "Ended" };
const token = takeToken();
find("late").remove();

const keyboard = new Keyboard();
const gamepad = new Gamepad();
const sticks = new Sticks([find("stick-left"), find("stick-right")]);
// For tests and the curious.
const seen = { status: { phase: "opening", room: 0 }, drives: false, isOpen: false, reason: "Connecting", roundTrips: [], parts: [], pictures: [] };
const KEPT = 50;
function keep(list, value) {
  list.push(value);
  if (list.length > KEPT) list.shift();
}
// The newest state, which may come before its room, and when it came.
let newest = null;
let arrived = 0;
// Since when this page drives, in its own time.
let since = Infinity;
let [live, stage, headset, shownRoom, usesEye, room] = [null, null, null, 0, false, Promise.resolve()];
// The device that drives: keys, a gamepad, or thumb sticks.
let device = "keyboard";

const socket = new Socket(token, {
  open: (isOpen, reason = "") => {
    [seen.isOpen, seen.reason] = [isOpen, reason];
    tell();
  },
  drives: (drives) => {
    seen.drives = drives;
    // States that answer another page have its clock.
    seen.roundTrips.length = 0;
    since = performance.now();
    tell();
  },
  problem: (problem) => fail(problem),
  status: (status) => {
    seen.status = status;
    if (status.problem) fail(status.problem);
    if (status.room !== shownRoom && status.room > 0) {
      shownRoom = status.room;
      room = room.then(show).catch((error) => fail(`The room cannot be shown: ${error.message}`));
    }
    tell();
  },
  state: (buffer) => {
    newest = buffer;
    arrived = performance.now();
    if (!live?.take(buffer)) return;
    const { echo, age, answer } = live.state;
    if (seen.drives && echo >= since) {
      const trip = arrived - echo;
      keep(seen.roundTrips, trip);
      // Waiting for an observation, the answer to it, and the ways there and back.
      keep(seen.parts, [age, answer, trip - age - answer]);
    }
    ask();
    attempt(panel);
    attempt(numbers);
  },
});

// A fault of one part of the page is said, and the others go on: the robot is driven all the same.
function attempt(part) {
  try {
    part();
  } catch (error) {
    fail(`A part of the page does not work in this browser: ${error.message}`);
  }
}

// Shows the room that the server has.
async function show() {
  loading(0);
  const { doc, meshes } = await loadRoom(token);
  live = new Live(doc);
  find("title").textContent = `${doc.task} ${doc.name}`;
  document.title = `${doc.task}, seed ${doc.seed}: Fiatlux teleoperation`;
  find("said").textContent = `\u201c${doc.instruction}\u201d`;
  find("lamps").replaceChildren(...doc.criteria.map((name) => element("div", { className: "lamp" }, element("i"), words(name), element("em"))));
  for (const side of ["left", "right"]) find(`force-${side}`).max = doc.fragility_n;
  if (stage) {
    stage.renderer.dispose();
    // A canvas keeps the context of its first renderer.
    const canvas = stage.canvas.cloneNode();
    stage.canvas.replaceWith(canvas);
    await headset?.session?.end();
  }
  const canvas = find("view");
  stage = null;
  // A browser without WebGL still drives, and shows the conditions.
  attempt(() => {
    stage = new Stage(canvas, doc, meshes, live, ask);
    addGhosts();
    goal = new Goal(doc.goal, stage.scene);
  });
  if (stage) {
    new ResizeObserver(ask).observe(canvas);
    headset = new Headset(stage);
    find("headset").hidden = !(await Headset.isThere());
  }
  loading(1);
  if (newest && live.take(newest)) {
    attempt(panel);
    attempt(numbers);
  }
  ask();
  seen.live = live;
  seen.needsView = true;
  tell();
  document.documentElement.dataset.ready = "true";
}

let goal = null;
// Where the hands are wanted, as frames of three axes.
let ghosts = [];
function addGhosts() {
  ghosts = [0, 1].map(() => {
    const axes = new THREE.AxesHelper(0.09);
    axes.visible = false;
    axes.material.depthTest = false;
    axes.renderOrder = 11;
    stage.scene.add(axes);
    return axes;
  });
}

let asked = false;
function ask() {
  if (asked || !stage || headset?.session) return;
  asked = true;
  requestAnimationFrame(() => {
    asked = false;
    draw(null);
    keep(seen.pictures, performance.now() - arrived);
  });
}

const position = [0, 0, 0];
const quaternion = [0, 0, 0, 1];
// How far the look through the robot's eye is turned from its own, rad.
const eyeLook = { turn: 0, rise: 0 };
function turnEye(turn, rise) {
  const within = (angle, [low, high]) => Math.min(Math.max(angle, low), high);
  eyeLook.turn = within(eyeLook.turn + turn, EYE.turn);
  eyeLook.rise = within(eyeLook.rise + rise, EYE.rise);
  ask();
}

// The place of the robot's eye, and how it is turned: it looks along its x axis.
function eyePose() {
  const { eye } = live.doc;
  live.poseAt(0, eye?.frame ?? 0, position, quaternion);
  const turn = new THREE.Quaternion(...quaternion);
  const at = new THREE.Vector3(...position);
  if (eye) {
    const [x, y, z, w, i, j, k] = eye.pose;
    at.add(new THREE.Vector3(x, y, z).applyQuaternion(turn));
    turn.multiply(new THREE.Quaternion(i, j, k, w));
  }
  return { at, turn };
}

// The place of the eye, and where its user looks from there.
function eyeView() {
  const { at, turn } = eyePose();
  const ahead = new THREE.Vector3(1, 0, 0).applyAxisAngle(new THREE.Vector3(0, 1, 0), -eyeLook.rise).applyQuaternion(turn);
  return { at, ahead: ahead.applyAxisAngle(new THREE.Vector3(0, 0, 1), eyeLook.turn) };
}

// Bearing of the robot that the view has turned to, rad.
let turned = 0;
function heading() {
  live.poseAt(0, 0, position, quaternion);
  const ahead = new THREE.Vector3(1, 0, 0).applyQuaternion(new THREE.Quaternion(...quaternion));
  return Math.atan2(ahead.y, ahead.x);
}

// Looks from behind the robot and its right, so that forwards is ahead and the right hand is seen.
function lookFromBehind() {
  stage.resetView();
  turned = heading();
  const bearing = turned + Math.PI + BEHIND.turn;
  const away = new THREE.Vector3(Math.cos(bearing), Math.sin(bearing), BEHIND.rise).normalize();
  stage.camera.position.copy(stage.controls.target).addScaledVector(away, BEHIND.away);
  stage.controls.update();
}

// Turns with the robot, and not with its sway.
function turnWithRobot() {
  const rest = heading() - turned;
  let angle = FOLLOWS * Math.atan2(Math.sin(rest), Math.cos(rest));
  // Without motion that follows by itself the view turns in steps.
  if (still.matches) {
    if (Math.abs(angle) < FOLLOWS * STEP) return;
    angle /= FOLLOWS;
  }
  turned += angle;
  const { camera, controls } = stage;
  camera.position.sub(controls.target).applyAxisAngle(camera.up, angle).add(controls.target);
  camera.lookAt(controls.target);
}

function draw(frame) {
  if (!stage || !live.state) return;
  if (seen.needsView) {
    seen.needsView = false;
    lookFromBehind();
  }
  ghosts.forEach((axes, side) => {
    axes.visible = live.state.wanted[side] && !usesEye;
    live.goalAt(side, position, quaternion);
    axes.position.fromArray(position);
    axes.quaternion.fromArray(quaternion);
  });
  const isNear = live.doc.measures.every((measure, index) => measure === null || live.state.criteria[index]);
  goal.show(live, ["ready", "running"].includes(seen.status.phase) && !(isNear && live.doc.measures.some((measure) => measure !== null)));
  if (headset?.session && !frame) return;
  if (frame) {
    headset.place(frame, eyePose().at, heading());
    socket.input("webxr", headset.read(frame, seen.status.phase === "running", live.state.follows));
    headset.board.write(find("state").textContent, board(), headset.usesHands() ? boardButtons() : []);
  } else if (usesEye) {
    const { at, ahead } = eyeView();
    stage.resize();
    stage.camera.position.copy(at).addScaledVector(ahead, 0.05);
    stage.camera.lookAt(at.add(ahead));
    const wide = live.doc.eye?.horizontal_fov ?? 1.2;
    stage.camera.fov = (360 / Math.PI) * Math.atan(Math.tan(wide / 2) / Math.max(stage.camera.aspect, 1));
    stage.camera.updateProjectionMatrix();
  } else {
    turnWithRobot();
  }
  stage.draw(live.state.step, live.state, !still.matches);
}

// The lines of a headset's board.
function board() {
  const { doc, state } = live;
  const gate = doc.criteria.map((name, index) => ({ text: words(name), holds: state.criteria[index] }));
  const [left, right] = state.force.map((force) => force.toFixed(1));
  const facts = [`Bulb: left ${left} N, right ${right} N`, `Hands: ${hands(state)}`, `${doc.task}, ${seconds(state.step, doc.control_dt)}`];
  return [...gate, ...facts.map((text) => ({ text }))];
}

// The keys that begin, or go on after a take; empty while one runs.
function hint({ phase }) {
  const usesPad = device === "gamepad";
  if (phase === "ready") return usesPad ? "Press A to begin" : touch.matches ? "Press Start to begin" : "Press Enter to begin";
  if (phase !== "ended") return "";
  return usesPad ? "X: save, B: discard, Y: next room" : touch.matches ? "Save it, or discard it" : "P: save, Del: discard, N: next room";
}

const hands = ({ follows, closes, chosen }) =>
  ["left", "right"].map((side, index) => `${side} ${follows[index] ? "follows" : closes[index] ? "closed" : "open"}${chosen === index ? " (keys)" : ""}`).join(", ");

// The board's buttons: those of the page.
function boardButtons() {
  return ["start", "save", "discard", "next"].map((name) => {
    const { textContent, disabled } = find(name);
    return { name, label: textContent, disabled };
  });
}

// How far each condition that does not hold is from holding.
function numbers() {
  const said = live.doc.measures.map((measure, index) => (measure && !live.state.criteria[index] ? numberOf(measure, live) : ""));
  document.querySelectorAll(".lamp em").forEach((text, index) => {
    text.textContent = said[index];
  });
}

function panel() {
  const { state, doc } = live;
  document.querySelectorAll(".lamp").forEach((lamp, index) => lamp.classList.toggle("on", state.criteria[index] === true));
  ["left", "right"].forEach((side, index) => {
    find(`force-${side}`).value = state.force[index];
    find(`newtons-${side}`).textContent = `${state.force[index].toFixed(1)} N`;
  });
  const [vx, vy, wz] = state.velocity.map((part) => part.toFixed(2));
  find("velocity").textContent = `${vx}, ${vy} m/s, ${wz} rad/s`;
  find("hands").textContent = hands(state);
  find("clock").textContent = seconds(state.step, doc.control_dt);
  const sorted = [...seen.roundTrips].sort((a, b) => a - b);
  find("latency").textContent = sorted.length > 0 ? `${sorted[sorted.length >> 1].toFixed(0)} ms (answer ${state.answer.toFixed(1)} ms)` : "";
  const frozen = seen.status.phase === "running" && state.frozen;
  if (find("state").dataset.frozen !== String(frozen)) tell();
}

function tell() {
  const { status, drives, isOpen } = seen;
  const badge = find("state");
  const frozen = isOpen && status.phase === "running" && live?.state?.frozen === true;
  let text = WORDS[status.phase] ?? status.phase;
  if (status.phase === "ended") text = `Ended: ${words(status.end)}`;
  if (frozen) text = "No input: the robot stands";
  if (isOpen && !drives) text = "Another page drives";
  if (!isOpen) text = seen.reason;
  badge.textContent = text;
  badge.dataset.phase = isOpen ? status.phase : "gone";
  badge.dataset.frozen = String(frozen);
  const next = isOpen && drives && live ? hint(status) : "";
  find("hint").textContent = next;
  find("hint").hidden = next === "";
  find("start").textContent = status.phase === "running" ? "Stop" : "Start";
  find("start").disabled = !(isOpen && ["ready", "running"].includes(status.phase));
  for (const id of ["save", "discard"]) find(id).disabled = !(isOpen && ["running", "ended"].includes(status.phase));
  find("next").disabled = !(isOpen && status.phase !== "opening");
  const facts = [`Seed ${live?.doc.seed ?? "?"}`, `take ${status.episode ?? "?"}`, `${status.kept ?? 0} kept`];
  if (status.bag) facts.push(`last: ${status.bag}`);
  find("facts").textContent = facts.join(", ");
  find("input").textContent = headset?.session ? "headset" : device;
}

const order = (name) => () => {
  if (!seen.drives) socket.send({ drive: true });
  socket.send({ order: name });
};
// A button that has the focus would take the keys that start, stop and close a hand.
for (const id of ["start", "save", "discard", "next", "eye", "reset", "headset"]) find(id).addEventListener("click", () => find("view").focus());
find("start").addEventListener("click", () => order(seen.status.phase === "running" ? "stop" : "start")());
for (const id of ["save", "discard", "next"]) find(id).addEventListener("click", order(id));
find("reset").addEventListener("click", () => {
  Object.assign(eyeLook, { turn: 0, rise: 0 });
  if (stage) lookFromBehind();
  ask();
});
find("eye").addEventListener("click", () => {
  usesEye = !usesEye;
  find("eye").setAttribute("aria-pressed", String(usesEye));
  if (!stage) return;
  stage.follow(!usesEye);
  stage.controls.enabled = !usesEye;
  if (!usesEye) {
    stage.camera.fov = 38;
    stage.camera.updateProjectionMatrix();
    lookFromBehind();
  }
  ask();
});
find("headset").addEventListener("click", () => {
  const ended = () => {
    tell();
    ask();
  };
  headset.enter(draw, (button) => find(button).click(), ended).then(tell, (error) => fail(`The headset cannot be entered: ${error.message}`));
});
addEventListener("keydown", (event) => {
  device = "keyboard";
  const up = { PageUp: 1, PageDown: -1 }[event.code];
  if (!usesEye || !up || event.target.closest?.("aside")) return;
  event.preventDefault();
  turnEye(0, up * EYE.key);
});
// The picture's element is another one in each room, and its surroundings stay.
const picture = find("view").parentElement;
let dragged = null;
picture.addEventListener("pointerdown", (event) => {
  // A page that is clicked drives again.
  if (!seen.drives) socket.send({ drive: true });
  if (usesEye && event.target.id === "view") dragged = event.pointerId;
});
picture.addEventListener("pointermove", ({ pointerId, movementX, movementY }) => {
  if (!usesEye || !stage || pointerId !== dragged) return;
  const pixel = ((Math.PI / 180) * stage.camera.fov) / stage.canvas.clientHeight;
  turnEye(movementX * pixel, movementY * pixel);
});
for (const kind of ["pointerup", "pointercancel"]) {
  addEventListener(kind, ({ pointerId }) => {
    if (pointerId === dragged) dragged = null;
  });
}

function deviceNow() {
  if (gamepad.isMoved()) return "gamepad";
  if (sticks.isHeld()) return "thumb sticks";
  return device === "gamepad" && !gamepad.pad() ? "keyboard" : device;
}

setInterval(() => {
  if (headset?.session) return;
  const was = device;
  device = deviceNow();
  if (was !== device) tell();
  // The press by which a pad comes into use counts as one.
  if (device === "gamepad" && was !== device) socket.input("gamepad", gamepad.atRest());
  const running = seen.status.phase === "running";
  if (device === "thumb sticks") socket.input("gamepad", sticks.read(running));
  else if (device === "gamepad" || was === "gamepad") socket.input("gamepad", gamepad.read(running));
  else socket.input("keyboard", keyboard.read(running));
}, INPUT_MS);

showCard(find("card"));
tell();
// For tests: what the page knows.
globalThis.fiatlux = {
  seen,
  headset: () => headset,
  goal: () => goal,
  // Bearing and rise of where the picture's camera looks, rad.
  look: () => {
    const { x, y, z } = stage.camera.getWorldDirection(new THREE.Vector3());
    return { bearing: Math.atan2(y, x), rise: Math.asin(z) };
  },
  pose: (frame) => (live.poseAt(0, frame, position, quaternion), [...position, ...quaternion]),
};
