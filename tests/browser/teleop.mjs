// Drives the robot from the page of `fiatlux teleop`, by keys, by a scripted gamepad, and by an emulated headset.
//
//   node teleop.mjs first|walk|older|headset|grab ADDRESS SCREENSHOTS
//
// ADDRESS is what `fiatlux teleop --no-open` printed: of task S07 for `first` (in its first room), `walk` and `older`, of S08 for `headset` and `grab`. Exit code 0 when every
// check holds. `grab` steers in real time by what a software renderer shows, so that it depends on the machine: it has some attempts.

import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";

import { KINDS, PATIENCE_MS, accessible, check, close, drawn, end, fits, open } from "./common.mjs";

const [what, address, screenshots] = process.argv.slice(2);
const { origin, host } = new URL(address);
const POLL_MS = 40;
const MAX_ATTEMPTS = 4;
// The end of an attempt: after this much simulated time (the quickest take of the bulb is over after 20 s) or real time, or when
// the bulb has left its place on the bench by more than this.
const ATTEMPT = { seconds: 50, maxMs: 90_000, maxWay: 0.15 };

const phase = (page) => page.evaluate(() => globalThis.fiatlux.seen.status.phase);
const status = (page) => page.evaluate(() => globalThis.fiatlux.seen.status);
const becomes = (page, phase, timeout = PATIENCE_MS) =>
  page.waitForFunction((phase) => globalThis.fiatlux.seen.status.phase === phase, phase, { timeout });

// How far the fresh bulb is from the pelvis, and its bearing from where the robot looks.
const bulb = (page) =>
  page.evaluate(() => {
    const { seen, pose } = globalThis.fiatlux;
    const frame = (name) => seen.live.doc.stage.frames.findIndex((frame) => frame.name === name);
    const [x, y, , i, j, k, w] = pose(0);
    const [bx, by] = pose(frame("fresh_bulb"));
    const heading = Math.atan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k));
    const bearing = Math.atan2(by - y, bx - x) - heading;
    return { away: Math.hypot(bx - x, by - y), bearing: Math.atan2(Math.sin(bearing), Math.cos(bearing)), state: seen.live.state };
  });

// Whoever does not have the token sees and drives nothing.
async function strangers({ context }) {
  for (const path of ["/", "/document.json", "/meshes.bin", "/drive", "/?token=", "/drive?token=0123456789abcdef0123456789abcdef"]) {
    const { status } = await fetch(`${origin}${path}`);
    check(status === 403, `a stranger gets nothing at ${path}`, status);
  }
  const page = await context.newPage();
  for (const query of ["", "?token=", "?token=0123456789abcdef0123456789abcdef"]) {
    const got = await page.evaluate(
      (address) =>
        new Promise((done) => {
          const socket = new WebSocket(address);
          socket.onopen = () => done("open");
          socket.onerror = () => done("refused");
        }),
      `ws://${host}/drive${query}`,
    );
    check(got === "refused", `a stranger's WebSocket with '${query}' is refused`, got);
  }
  await page.close();
}

// Presses the keys that bring the robot to the bulb, until the take ends.
async function byKeys(page) {
  const held = new Set();
  const hold = async (key, is) => {
    if (is === held.has(key)) return;
    await (is ? page.keyboard.down(key) : page.keyboard.up(key));
    is ? held.add(key) : held.delete(key);
  };
  const until = Date.now() + 2 * PATIENCE_MS;
  while ((await phase(page)) === "running" && Date.now() < until) {
    const { away, bearing } = await bulb(page);
    await hold("KeyW", away > 0.6);
    await hold("KeyQ", bearing > (held.has("KeyQ") ? 0.03 : 0.12));
    await hold("KeyE", bearing < (held.has("KeyE") ? -0.03 : -0.12));
    await page.waitForTimeout(POLL_MS);
  }
  for (const key of [...held]) await hold(key, false);
}

// The same with sticks.
async function byPad(page) {
  const until = Date.now() + 2 * PATIENCE_MS;
  while ((await phase(page)) === "running" && Date.now() < until) {
    const { away, bearing } = await bulb(page);
    const turn = Math.abs(bearing) > 0.05 ? -Math.max(-1, Math.min(1, bearing * 2)) : 0;
    await page.evaluate(({ forwards, turn }) => globalThis.pad.set({ axes: [0, -forwards, turn, 0] }), { forwards: away > 0.6 ? 1 : 0, turn });
    await page.waitForTimeout(POLL_MS);
  }
  await page.evaluate(() => globalThis.pad.set({ axes: [0, 0, 0, 0] }));
}

function scriptedPad() {
  const button = (value) => ({ value, pressed: value > 0.5, touched: value > 0 });
  let pad = null;
  globalThis.pad = {
    set({ axes = [0, 0, 0, 0], pressed = [] }) {
      const buttons = Array.from({ length: 17 }, (_, index) => button(pressed.includes(index) ? 1 : 0));
      pad = { id: "scripted", index: 0, mapping: "standard", connected: true, axes, buttons };
    },
  };
  Object.defineProperty(navigator, "getGamepads", { value: () => [pad] });
}

// Says how long the last inputs took, by part: medians, and the worst.
async function latency(page) {
  const { roundTrips, parts, pictures } = await page.evaluate(() => globalThis.fiatlux.seen);
  const say = (what, list) => {
    if (list.length === 0) return;
    const sorted = list.toSorted((a, b) => a - b);
    console.log(`       ${what}: ${sorted[sorted.length >> 1].toFixed(2)} ms, at most ${sorted.at(-1).toFixed(2)} ms`);
  };
  say("from an input to the state that follows it", roundTrips);
  ["waiting for an observation", "answer", "network, there and back"].forEach((what, part) => say(what, parts.map((all) => all[part])));
  say("from a state to its picture", pictures);
}

async function walk() {
  const opened = await open("walk", address, { ...KINDS.desktop, colorScheme: "light" }, origin, true, scriptedPad);
  const { page } = opened;
  await strangers(opened);
  await becomes(page, "ready");
  await page.waitForFunction(() => globalThis.fiatlux.seen.live.state !== null);
  await page.screenshot({ path: `${screenshots}/teleop-ready.png` });
  await accessible(opened);
  await fits(opened, true);

  // A take that is discarded: it starts and stops by a key, and its robot stands without input.
  await page.keyboard.press("Enter");
  await becomes(page, "running");
  await page.keyboard.down("KeyS");
  await page.waitForFunction(() => globalThis.fiatlux.seen.live.state.velocity[0] < -0.3, null, { timeout: PATIENCE_MS });
  const other = await opened.context.newPage();
  await other.goto(address);
  await other.waitForFunction(() => globalThis.fiatlux?.seen.drives === true);
  await page.waitForFunction(() => document.getElementById("state").textContent === "Another page drives");
  check(true, "the newest page drives, and the older one says so");
  await other.close();
  await page.waitForFunction(() => globalThis.fiatlux.seen.live.state.frozen, null, { timeout: PATIENCE_MS });
  const frozen = await page.evaluate(() => globalThis.fiatlux.seen.live.state.velocity);
  check(frozen.every((part) => part === 0), "without the page that drives the robot stands", frozen);
  await page.keyboard.up("KeyS");
  await page.locator("#view").click();
  await page.waitForFunction(() => !globalThis.fiatlux.seen.live.state.frozen && globalThis.fiatlux.seen.drives);
  check(true, "a click on the picture drives again");
  await page.keyboard.press("Enter");
  await becomes(page, "ended");
  check((await status(page)).end === "stopped", "a key stops the take");
  await page.locator("#discard").click();
  await becomes(page, "ready");
  check((await status(page)).kept === 0, "a take is discarded");

  await page.keyboard.press("Enter");
  await becomes(page, "running");
  await byKeys(page);
  await becomes(page, "ended");
  check((await status(page)).end === "success", "keys walk S07 to its gate", JSON.stringify(await status(page)));
  await latency(page);
  await page.screenshot({ path: `${screenshots}/teleop-ended.png` });
  await page.keyboard.press("KeyP");
  await becomes(page, "ready");
  check((await status(page)).kept === 1, "the take is kept");

  await page.evaluate(() => globalThis.pad.set({ pressed: [0] }));
  await becomes(page, "running");
  await page.evaluate(() => globalThis.pad.set({}));
  await byPad(page);
  await becomes(page, "ended");
  check((await status(page)).end === "success", "a gamepad walks S07 to its gate", JSON.stringify(await status(page)));
  check((await page.locator("#input").textContent()) === "gamepad", "the page says that the gamepad drives");
  const room = (await status(page)).room;
  await page.evaluate(() => globalThis.pad.set({ pressed: [3] }));
  await page.waitForFunction((room) => globalThis.fiatlux.seen.status.room > room, room, { timeout: PATIENCE_MS });
  await becomes(page, "ready");
  check((await status(page)).kept === 2, "Y keeps the take and shows the next room");
  await page.evaluate(() => globalThis.pad.set({}));
  await page.locator("#eye").click();
  await page.waitForTimeout(500);
  await page.screenshot({ path: `${screenshots}/teleop-eye.png` });
  await close(opened);

  const telephone = await open("telephone", address, { ...KINDS.telephone, colorScheme: "dark" }, origin);
  await telephone.page.waitForFunction(() => globalThis.fiatlux.seen.live.state !== null);
  await telephone.page.waitForTimeout(300);
  await telephone.page.screenshot({ path: `${screenshots}/teleop-telephone.png` });
  await fits(telephone);
  await close(telephone);
}

const GOAL_MS = 60_000;

// The first room, by keys that are held; the arrow to the goal, the look through the robot's eye, a view without motion of its own,
// and thumb sticks.
async function first() {
  const opened = await open("first", address, { ...KINDS.desktop, colorScheme: "light", reducedMotion: "reduce" }, origin);
  const { page } = opened;
  const until = (holds) => page.waitForFunction(holds, null, { timeout: PATIENCE_MS });
  const look = () => page.evaluate(() => globalThis.fiatlux.look());
  await becomes(page, "ready");
  await until(() => globalThis.fiatlux.seen.live.state !== null && globalThis.fiatlux.goal()?.group.visible);
  const off = await page.evaluate(() => {
    const { goal, pose, seen } = globalThis.fiatlux;
    const [x, y] = pose(0);
    const [bx, by, bz] = pose(seen.live.doc.stage.frames.findIndex(({ name }) => name === "fresh_bulb"));
    const { arrow, tip } = goal();
    return { turn: Math.abs(Math.atan2(by - y, bx - x) - arrow.rotation.z), beside: Math.hypot(tip.position.x - bx, tip.position.y - by), above: tip.position.z - bz };
  });
  check(off.turn < 0.02 && off.beside < 0.01 && off.above > 0.2, "an arrow points to the bulb, and a tip stands above it", JSON.stringify(off));
  await page.screenshot({ path: `${screenshots}/teleop-first.png` });

  await page.locator("#eye").click();
  await drawn(page);
  const ahead = (await look()).rise;
  await page.mouse.move(400, 300);
  await page.mouse.down();
  await page.mouse.move(400, 500, { steps: 8 });
  await page.mouse.up();
  await drawn(page);
  const up = (await look()).rise;
  check(up > ahead + 0.15, "a drag looks up through the robot's eye", `${ahead} to ${up}`);
  await page.screenshot({ path: `${screenshots}/teleop-eye-up.png` });
  for (let press = 0; press < 3; press += 1) await page.keyboard.press("PageDown");
  await drawn(page);
  check((await look()).rise < up - 0.3, "a key looks down", (await look()).rise);
  await page.locator("#reset").click();
  await page.locator("#eye").click();

  await page.keyboard.press("Enter");
  await becomes(page, "running");
  const began = Date.now();
  await byKeys(page);
  await becomes(page, "ended");
  const { end } = await status(page);
  check(end === "success" && Date.now() - began < GOAL_MS, "keys that are held reach the goal of the first room in a minute", end);
  console.log(`       the goal is reached after ${((Date.now() - began) / 1000).toFixed(1)} s`);
  await drawn(page);
  check(await page.evaluate(() => !globalThis.fiatlux.goal().group.visible), "the arrow is gone at the goal");
  await page.keyboard.press("KeyP");
  await becomes(page, "ready");

  await page.keyboard.press("Enter");
  await becomes(page, "running");
  await page.keyboard.down("KeyQ");
  const bearings = await page.evaluate(async () => {
    const list = [];
    for (const end = performance.now() + 5000; performance.now() < end; ) {
      await new Promise(requestAnimationFrame);
      list.push(globalThis.fiatlux.look().bearing);
    }
    return list;
  });
  await page.keyboard.up("KeyQ");
  const turns = bearings.slice(1).map((bearing, index) => Math.abs(Math.atan2(Math.sin(bearing - bearings[index]), Math.cos(bearing - bearings[index]))));
  const [jumps, drifts] = [turns.filter((turn) => turn > 0.3).length, turns.filter((turn) => turn > 0.005 && turn <= 0.3).length];
  check(jumps > 0 && drifts === 0, "where less motion is wanted the view turns in steps", `${jumps} steps, ${drifts} slow turns`);
  await page.keyboard.press("Enter");
  await becomes(page, "ended");
  await page.locator("#discard").click();
  await becomes(page, "ready");
  await close(opened);

  const telephone = await open("thumbs", address, { ...KINDS.telephone, colorScheme: "dark" }, origin);
  await thumbs(telephone);
  await close(telephone);
}

// Two thumbs on the sticks of a telephone.
async function thumbs({ page, context }) {
  const touches = await context.newCDPSession(page);
  const at = async (id, [x, y]) => {
    const box = await page.locator(`#stick-${id}`).boundingBox();
    return { x: box.x + box.width * (0.5 + 0.45 * x), y: box.y + box.height * (0.5 + 0.45 * y), id: id === "left" ? 1 : 2 };
  };
  const send = (type, touchPoints) => touches.send("Input.dispatchTouchEvent", { type, touchPoints });
  const until = (holds) => page.waitForFunction(holds, null, { timeout: PATIENCE_MS });
  await becomes(page, "ready");
  await until(() => globalThis.fiatlux.seen.live.state !== null && globalThis.fiatlux.seen.drives);
  await page.locator("#start").tap();
  await becomes(page, "running");
  await send("touchStart", [await at("left", [0, 0.9])]);
  await until(() => globalThis.fiatlux.seen.live.state.velocity[0] < -0.2);
  check(true, "the left thumb walks");
  await send("touchStart", [await at("left", [0, 0.9]), await at("right", [-0.9, 0])]);
  await until(() => globalThis.fiatlux.seen.live.state.velocity[2] > 0.3 && globalThis.fiatlux.seen.live.state.velocity[0] < -0.2);
  check((await page.locator("#input").textContent()) === "thumb sticks", "both thumbs at once turn and walk, and the page says so");
  await page.screenshot({ path: `${screenshots}/teleop-thumbs.png` });
  await send("touchEnd", []);
  await until(() => globalThis.fiatlux.seen.live.state.velocity.every((part) => part === 0));
  check(await page.evaluate(() => !globalThis.fiatlux.seen.live.state.frozen), "a robot whose sticks are let go stands, and is driven still");
  await page.locator("#start").tap();
  await becomes(page, "ended");
  await page.locator("#discard").tap();
  await becomes(page, "ready");
}

// Browsers that lack something, each by a script that takes it away: the page drives all the same.
const LACKING = {
  "calls of the last years": () => {
    for (const name of ["toSorted", "toReversed", "toSpliced", "with", "at", "findLast", "findLastIndex"]) delete Array.prototype[name];
    for (const name of ["structuredClone", "scheduler"]) delete globalThis[name];
    for (const name of ["groupBy", "hasOwn"]) delete Object[name];
    delete CanvasRenderingContext2D.prototype.roundRect;
    delete Element.prototype.checkVisibility;
  },
  "gamepads, headsets and a clipboard": () => {
    for (const name of ["getGamepads", "xr", "clipboard"]) {
      delete Navigator.prototype[name];
      delete navigator[name];
    }
  },
  "gamepads that it may not ask for, and a headset that it may not use": () => {
    const refused = () => {
      throw new DOMException("not allowed", "SecurityError");
    };
    Object.defineProperty(navigator, "getGamepads", { value: refused });
    Object.defineProperty(navigator, "xr", { value: { isSessionSupported: refused } });
  },
  "storage for a tab": () => {
    Object.defineProperty(globalThis, "sessionStorage", {
      get() {
        throw new DOMException("not allowed", "SecurityError");
      },
    });
  },
  "pictures in 3D": () => {
    const { getContext } = HTMLCanvasElement.prototype;
    HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
      return kind.startsWith("webgl") ? null : getContext.call(this, kind, ...rest);
    };
  },
};

async function older() {
  for (const [what, takeAway] of Object.entries(LACKING)) {
    const { page, context } = await open("older", address, { ...KINDS.desktop, colorScheme: "light" }, origin, true, takeAway);
    await becomes(page, "ready");
    await page.waitForFunction(() => globalThis.fiatlux.seen.live?.state && globalThis.fiatlux.seen.drives, null, { timeout: PATIENCE_MS });
    await page.keyboard.press("Enter");
    await becomes(page, "running");
    await page.keyboard.down("KeyS");
    const walks = () => globalThis.fiatlux.seen.live.state.velocity[0] < -0.2;
    await page.waitForFunction(walks, null, { timeout: PATIENCE_MS });
    await page.waitForFunction(() => /-0\.\d/.test(document.getElementById("velocity").textContent), null, { timeout: PATIENCE_MS });
    check(true, `a browser without ${what} drives, and says how fast`);
    await page.keyboard.up("KeyS");
    await page.keyboard.press("Enter");
    await becomes(page, "ended");
    await page.keyboard.press("Delete");
    await becomes(page, "ready");
    if (what === "storage for a tab") check(page.url().includes("token="), "without storage the address keeps its token", page.url());
    await context.close();
  }

  const { page, context } = await open("reloaded", address, { ...KINDS.desktop, colorScheme: "light" }, origin);
  await becomes(page, "ready");
  check(page.url() === `${origin}/`, "the token is not in the address bar", page.url());
  await page.reload();
  await becomes(page, "ready");
  check(page.url() === `${origin}/`, "the page can be loaded again", page.url());
  const hint = page.locator("#hint");
  check((await hint.textContent()) === "Press Enter to begin", "the picture says how to begin", await hint.textContent());
  await page.locator("#eye").click();
  check((await page.evaluate(() => document.activeElement.id)) === "view", "a button gives the focus back");
  await page.locator("#eye").click();
  await page.waitForFunction(() => /\d of \d/.test(document.querySelector(".lamp em").textContent), null, { timeout: PATIENCE_MS });
  check(true, "a condition says how far it is from holding");
  // Cmd is pressed while the robot walks, and the system keeps the release of W to itself.
  await page.keyboard.press("Enter");
  await becomes(page, "running");
  await page.keyboard.down("KeyW");
  await page.waitForFunction(() => globalThis.fiatlux.seen.live.state.velocity[0] > 0.1, null, { timeout: PATIENCE_MS });
  await page.keyboard.down("Meta");
  await page.waitForFunction(() => globalThis.fiatlux.seen.live.state.velocity.every((part) => part === 0), null, { timeout: PATIENCE_MS });
  check(true, "Cmd stops the robot: a key that is let go under it would walk on");
  await page.keyboard.up("Meta");
  await page.keyboard.up("KeyW");
  await page.keyboard.press("Enter");
  await becomes(page, "ended");
  await page.keyboard.press("KeyP");
  await becomes(page, "ready");
  await context.close();
}

// Installs an emulated headset whose grips are where its controllers are.
async function emulator() {
  const source = await readFile(createRequire(import.meta.url).resolve("iwer/build/iwer.min.js"), "utf8");
  const install = () => {
    const { XRDevice, metaQuest3 } = globalThis.IWER;
    const { layout, ...controllers } = metaQuest3.controllerConfig;
    const same = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
    const bare = (controller) => ({ ...controller, gripOffsetMatrix: same });
    const controllerConfig = { ...controllers, layout: { left: bare(layout.left), right: bare(layout.right) } };
    globalThis.headset = new XRDevice({ ...metaQuest3, controllerConfig }, { stereoEnabled: true });
    globalThis.headset.installRuntime({ forceInstall: true });
    // It calls all that it emulates a guess.
    Object.defineProperty(globalThis.XRPose.prototype, "emulatedPosition", { get: () => false });
    // It has an open hand, a pinch and one that points; a fist is the latter with its index finger as its middle finger, and a pinch of
    // the middle finger an open hand whose thumb is there.
    for (const hand of Object.values(globalThis.headset.hands)) {
      const own = Object.getOwnPropertySymbols(hand).find(({ description }) => description === "@iwer/xr-hand-input");
      const { poses } = hand[own];
      const change = (pose, at) => {
        const move = ([joint, { offsetMatrix, radius }]) => [joint, { offsetMatrix: at(joint, Float32Array.from(offsetMatrix)), radius }];
        return { ...pose, jointTransforms: Object.fromEntries(Object.entries(pose.jointTransforms).map(move)) };
      };
      const place = (pose, joint) => pose.jointTransforms[joint].offsetMatrix.slice(12, 15);
      const put = (matrix, at) => {
        matrix.set(at, 12);
        return matrix;
      };
      const knuckle = (finger) => place(poses.point, `${finger}-finger-phalanx-proximal`);
      const shift = knuckle("index").map((at, axis) => at - knuckle("middle")[axis]);
      poses.fist = change(poses.point, (joint, matrix) =>
        joint.startsWith("index-finger") && !joint.endsWith("metacarpal")
          ? put(matrix, place(poses.point, joint.replace("index", "middle")).map((at, axis) => at + shift[axis]))
          : matrix,
      );
      poses.middlePinch = change(poses.default, (joint, matrix) =>
        joint === "thumb-tip" ? put(matrix, place(poses.default, "middle-finger-tip")) : matrix,
      );
    }
  };
  return `${source};(${install})();`;
}

// An operator in the page, who sees the room and moves the right controller so that the robot's hand goes where the expert's plan has
// it (crates/policies/src/hands/grab.toml, as crates/teleop/tests/it/grab.rs plays it in lockstep).
// Ends with the take, or gives it up; says what it did.
async function operate({ seconds, maxMs, maxWay }) {
  const { Matrix4, Vector3, Quaternion, Euler } = await import("three");
  const { seen, pose } = globalThis.fiatlux;
  const { left: leftHand, right: rightHand } = globalThis.headset.controllers;
  const frames = seen.live.doc.stage.frames;
  const frame = (name) => frames.findIndex((frame) => frame.name === name);
  const [HAND, PALM, BULB] = ["right_hand_base_link", "right_palm", "fresh_bulb"].map(frame);
  // Share of an error of the palm's wanted place that is corrected with each state.
  const CORRECTS = 0.04;
  // Where the right hand is wanted comes after the frames.
  const GOAL = frames.length + 1;
  const place = (at, turn) => ({ at, turn });
  const get = (index) => {
    const [x, y, z, i, j, k, w] = pose(index);
    return place(new Vector3(x, y, z), new Quaternion(i, j, k, w));
  };
  const times = (a, b) => place(b.at.clone().applyQuaternion(a.turn).add(a.at), a.turn.clone().multiply(b.turn));
  const inverse = ({ at, turn }) => {
    const back = turn.clone().invert();
    return place(at.clone().negate().applyQuaternion(back), back);
  };
  const shift = (x, y, z) => place(new Vector3(x, y, z), new Quaternion());
  const matrix = new Matrix4().makeRotationZ(0).premultiply(new Matrix4().makeRotationY(-0.1539)).multiply(new Matrix4().makeRotationX(Math.PI + 0.2863));
  const handFromGlass = place(new Vector3(-0.0596, -0.1225, -0.0339), new Quaternion().setFromRotationMatrix(matrix));
  const heading = (pelvis) => {
    const ahead = new Vector3(1, 0, 0).applyQuaternion(pelvis.turn);
    return Math.atan2(ahead.y, ahead.x);
  };
  const graspOf = (bulb, heading) => {
    const glass = times(bulb, shift(0, 0, 0.1531)).at;
    const turn = new Quaternion().setFromEuler(new Euler(0, 0, heading + 0.6 - Math.PI / 2));
    return times(place(glass, turn), inverse(handFromGlass));
  };
  const stick = (share) => (Math.abs(share) < 0.02 ? 0 : Math.sign(share) * (0.15 + 0.85 * Math.min(Math.abs(share), 1)));

  const start = seen.live.state.step;
  const began = performance.now();
  const first = heading(get(0));
  let [phase, since, way, goal, taken, trigger, rests] = ["raise", start, null, null, null, 0, 0];
  let device = place(new Vector3(0.2, -0.2, 1.2), new Quaternion());
  rightHand.position.set(0.2, 1.2, -0.2); // as `device`, in the axes of a headset
  rightHand.quaternion.set(0, 0, 0, 1);
  const log = [];
  rightHand.updateButtonValue("squeeze", 1);
  let last = start;
  let [strongest, given, closing] = [0, "", 0];
  const bench = get(BULB).at;
  const isDone = () => seen.status.phase !== "running";
  while (!isDone() && !given) {
    await new Promise((done) => setTimeout(done, 5));
    const { step, force, follows } = seen.live.state;
    strongest = Math.max(strongest, ...force);
    const shifted = get(BULB).at.sub(bench);
    if (strongest > seen.live.doc.fragility_n) given = `it pressed the bulb with ${strongest.toFixed(0)} N`;
    else if (shifted.z < -maxWay || Math.hypot(shifted.x, shifted.y) > maxWay)
      given = `the bulb left its place by ${shifted.toArray().map((part) => part.toFixed(2))} m`;
    else if (0.02 * (step - start) > seconds || performance.now() - began > maxMs) given = "it took too long";
    if (step === last) continue;
    const dt = 0.02 * Math.min(step - last, 5);
    last = step;
    const elapsed = 0.02 * (step - since);
    const pelvis = get(0);
    const hand = times(inverse(pelvis), get(HAND));
    const bulb = get(BULB);
    const grasp = graspOf(bulb, heading(pelvis));
    const away = times(inverse(pelvis), bulb).at;
    const left = new Vector3(away.x - 0.38, away.y + 0.08, 0);
    const reached = (most) => goal.at.distanceTo(hand.at) < most;
    let [walk, speed, next] = [[0, 0, 0], 0.12, null];
    if (phase === "raise") {
      if (!goal) {
        const stood = place(grasp.at.clone().sub(left.clone().applyQuaternion(pelvis.turn)), grasp.turn);
        goal = times(inverse(pelvis), times(stood, shift(0.16, 0.1, 0)));
      }
      speed = 0.2;
      if ((elapsed > 1 && reached(0.035)) || elapsed > 6) next = "step up";
    } else if (phase === "step up") {
      const pace = Math.min(Math.max(1.5 * left.length(), 0.12), 0.2) / Math.max(left.length(), 1e-6);
      const turn = first - heading(pelvis);
      walk = [(pace * left.x) / 0.5, (pace * left.y) / 0.3, (1.5 * Math.atan2(Math.sin(turn), Math.cos(turn))) / 0.7];
      if (left.length() < 0.04) next = "settle";
    } else if (phase === "settle") {
      if (elapsed > 2) next = left.length() < 0.06 ? "before" : "step up";
    } else if (phase === "before" || phase === "around") {
      if (phase === "before" || elapsed <= 0.1) goal = times(inverse(pelvis), phase === "before" ? times(grasp, shift(0.07, 0, 0)) : grasp);
      speed = phase === "before" ? 0.12 : 0.06;
      if ((elapsed > 2 && reached(0.012)) || elapsed > 6) next = phase === "before" ? "around" : "close";
    } else if (phase === "close") {
      trigger = 1;
      closing += dt;
      if (closing > 2.4 || elapsed > 8) {
        closing = 0;
        goal = place(goal.at.clone().add(new Vector3(0, 0, 0.08)), goal.turn);
        rests = bulb.at.z;
        next = "lift";
      }
    } else if (phase === "lift") {
      speed = 0.1;
      // It did not follow: once more.
      if (elapsed > 4 && bulb.at.z < rests + 0.03) next = "open";
    } else if (phase === "open") {
      trigger = 0;
      if (elapsed > 1.5) next = "settle";
    }
    if (next) {
      log.push(`${phase} ${elapsed.toFixed(1)} s, ${(1000 * goal.at.distanceTo(hand.at)).toFixed(0)} mm, ${force[1].toFixed(0)} N`);
      [phase, since] = [next, step];
    }
    leftHand.updateAxes("thumbstick", stick(-walk[1]), stick(-walk[0]));
    rightHand.updateAxes("thumbstick", stick(-walk[2]), 0);
    rightHand.updateButtonValue("trigger", trigger);
    // After a gap in the pictures the clutch is taken anew, with the controller held still.
    if (!follows[1]) {
      [taken, way] = [null, null];
      continue;
    }
    const palmFromHand = times(inverse(get(PALM)), get(HAND));
    if (!taken) {
      const [x, y, z, i, j, k, w] = pose(GOAL);
      const palm = times(inverse(pelvis), place(new Vector3(x, y, z), new Quaternion(i, j, k, w)));
      taken = { palm, device, shift: new Vector3(), twist: new Quaternion() };
      way = times(palm, palmFromHand);
    }
    const from = way;
    const rest = Math.max(goal.at.distanceTo(from.at), 0.3 * from.turn.angleTo(goal.turn));
    const share = Math.min((speed * dt) / Math.max(rest, 1e-9), 1);
    way = place(from.at.clone().lerp(goal.at, share), from.turn.clone().slerp(goal.turn, share));
    // What happens to the controller from when it is taken is what happens to the palm.
    const palm = times(way, inverse(palmFromHand));
    // A clutch that was lost and taken between two states leaves the palm elsewhere: as an operator would, go by what is seen.
    const seenPalm = times(inverse(pelvis), get(GOAL));
    taken.shift.add(palm.at.clone().sub(seenPalm.at).multiplyScalar(CORRECTS));
    const twist = palm.turn.clone().multiply(seenPalm.turn.clone().invert());
    taken.twist.premultiply(new Quaternion().slerp(twist, CORRECTS));
    const moved = palm.at.clone().sub(taken.palm.at).add(taken.device.at).add(taken.shift);
    const turned = taken.twist.clone().multiply(palm.turn).multiply(taken.palm.turn.clone().invert()).multiply(taken.device.turn);
    device = place(moved, turned);
    rightHand.position.set(-moved.y, moved.z, -moved.x);
    rightHand.quaternion.set(-turned.y, turned.z, -turned.x, turned.w);
  }
  for (const hand of [leftHand, rightHand]) hand.updateAxes("thumbstick", 0, 0);
  for (const button of ["squeeze", "trigger"]) rightHand.updateButtonValue(button, 0);
  return { given, said: `${log.join("; ")}; ${phase}: ${given || "the take ended"} after ${(0.02 * (last - start)).toFixed(0)} s` };
}

// Draws nothing, or draws again. Inputs come with pictures, and a processor that draws them has little left for the simulation.
function drawNothing(nothing) {
  const { prototype } = WebGL2RenderingContext;
  globalThis.drawing ??= Object.fromEntries(
    ["drawElements", "drawArrays", "drawElementsInstanced", "drawArraysInstanced"].map((name) => [name, prototype[name]]),
  );
  for (const [name, draw] of Object.entries(globalThis.drawing)) prototype[name] = nothing ? () => {} : draw;
}

// What both eyes see has the size that the page had as it entered the headset. Inputs come with pictures, and without a graphics card
// only small ones are quick; deploy/pictures.py asks for larger ones.
const [width, height] = (process.env.EYES ?? "480x270").split("x").map(Number);
const SEEN = { width, height };
const QUICK = { width: 240, height: 136 };

// A picture of what both eyes see, with the head a little down, to the hands.
async function eyes(page, name) {
  const look = (down) => page.evaluate((down) => globalThis.headset.quaternion.set(-Math.sin(down / 2), 0, 0, Math.cos(down / 2)), down);
  if (process.env.EYES) await page.setViewportSize(SEEN);
  await look(0.3);
  await drawn(page);
  await page.screenshot({ path: `${screenshots}/${name}.png` });
  await look(0);
  await page.setViewportSize(QUICK);
  await drawn(page);
}

// Opens the page on an emulated headset, and enters it.
async function worn(name) {
  const opened = await open(name, address, { viewport: SEEN, colorScheme: "light" }, origin, true, await emulator());
  const { page } = opened;
  await becomes(page, "ready");
  await page.locator("#headset").click();
  await page.waitForFunction(() => document.getElementById("input").textContent === "headset", null, { timeout: PATIENCE_MS });
  check(true, "the page enters the headset");
  await page.setViewportSize(QUICK);
  await page.evaluate(() => {
    globalThis.headset.position.set(0, 1.6, 0);
  });
  await page.waitForTimeout(500);
  // Holds a button until the take is in a phase. What is down in the first picture counts as held before: then once more.
  const press = async (hand, button, phase) => {
    const set = async (value) => {
      await page.evaluate(([hand, button, value]) => globalThis.headset.controllers[hand].updateButtonValue(button, value), [hand, button, value]);
      await drawn(page);
      await page.waitForTimeout(400);
    };
    for (let trial = 1; ; trial += 1) {
      await set(1);
      const is = await becomes(page, phase, PATIENCE_MS / 4).catch((error) => {
        if (trial === 4) throw error;
      });
      await set(0);
      if (is) break;
    }
  };
  return { ...opened, press };
}

// Where the right palm is, and where it is wanted: its goal comes after the scene's frames.
const palm = (page) =>
  page.evaluate(() => {
    const { seen, pose } = globalThis.fiatlux;
    const { frames } = seen.live.doc.stage;
    const at = (index) => pose(index).slice(0, 3);
    return { is: at(frames.findIndex((frame) => frame.name === "right_palm")), wanted: at(frames.length + 1) };
  });

// Raises a right controller or hand until the robot's hand is wanted 6 cm higher than `from`; how far each of them rose, m. What it does
// while no picture comes is lost, and the robot's hands sway with its pelvis.
async function raise(page, kind, from) {
  let [moved, raised] = [0, 0];
  while (raised < 0.06 && moved < 0.4) {
    moved += 0.005;
    await page.evaluate((kind) => {
      globalThis.headset[kind].right.position.y += 0.005;
    }, kind);
    await page.waitForTimeout(50);
    raised = (await palm(page)).wanted[2] - from[2];
  }
  return { moved, raised };
}

const rises = ({ moved, raised }) => raised >= 0.06 && raised < moved + 0.04;

async function headset() {
  const opened = await worn("headset");
  const { page, press } = opened;
  await press("right", "a-button", "running");
  check(true, "A starts the take");
  await eyes(page, "teleop-eyes");
  await page.evaluate(drawNothing, true);

  // While the clutch is held the hand is wanted where the controller goes, from where it was.
  await page.evaluate(() => globalThis.headset.controllers.right.updateButtonValue("squeeze", 1));
  await page.waitForFunction(() => globalThis.fiatlux.seen.live.state.follows[1], null, { timeout: PATIENCE_MS });
  const { is, wanted } = await palm(page);
  check(Math.hypot(...wanted.map((at, axis) => at - is[axis])) < 0.03, "the clutch does not jump", JSON.stringify({ is, wanted }));
  const raised = await raise(page, "controllers", wanted);
  check(rises(raised), "the hand is wanted higher, as the controller is", JSON.stringify(raised));
  await latency(page);
  await page.evaluate(() => globalThis.headset.controllers.right.updateButtonValue("squeeze", 0));

  // Taken off, the headset drives no more.
  await page.evaluate(() => globalThis.headset.controllers.left.updateAxes("thumbstick", 0, 1));
  await page.waitForFunction(() => globalThis.fiatlux.seen.live.state.velocity[0] < -0.2, null, { timeout: PATIENCE_MS });
  await page.evaluate(() => globalThis.headset.updateVisibilityState("hidden"));
  await page.waitForFunction(() => globalThis.fiatlux.seen.live.state.frozen, null, { timeout: PATIENCE_MS });
  const velocity = await page.evaluate(() => globalThis.fiatlux.seen.live.state.velocity);
  check(velocity.every((part) => part === 0), "a headset that is taken off leaves the robot standing", velocity);
  await page.evaluate(() => globalThis.headset.updateVisibilityState("visible"));
  await page.evaluate(() => globalThis.headset.controllers.left.updateAxes("thumbstick", 0, 0));

  await press("right", "a-button", "ended");
  await press("left", "x-button", "ready");
  await press("right", "a-button", "running");
  await press("left", "y-button", "ready");
  check((await status(page)).kept === 1, "X keeps a take, Y discards one");
  await bareHands(page);
  await close(opened);
}

// The same headset without its controllers.
async function bareHands(page) {
  const until = (holds, argument = null) => page.waitForFunction(holds, argument, { timeout: PATIENCE_MS });
  const set = (side, pose, at = null) =>
    page.evaluate(
      ([side, pose, at]) => {
        const hand = globalThis.headset.hands[side];
        hand.poseId = pose;
        if (at) hand.position.set(...at);
      },
      [side, pose, at],
    );
  const shoot = async (name) => {
    await page.evaluate(drawNothing, false);
    await eyes(page, name);
    await page.evaluate(drawNothing, true);
  };
  const rest = async () => {
    await set("left", "default", [-0.2, 1.3, -0.4]);
    await set("right", "default", [0.2, 1.3, -0.4]);
  };
  // Points the left hand at a button of the board, and pinches until the take is in a phase.
  const press = async (button, phase) => {
    const { hits } = await page.evaluate(async (button) => {
      const { Quaternion, Vector3 } = await import("three");
      const { board } = globalThis.fiatlux.headset();
      const hand = globalThis.headset.hands.left;
      const { x, y, width, height } = board.placed().find(({ name }) => name === button);
      const { canvas, mesh } = board;
      const scale = mesh.geometry.parameters.width / canvas.width;
      const on = new Vector3((x + width / 2 - canvas.width / 2) * scale, (canvas.height / 2 - y - height / 2) * scale, 0);
      const ahead = on.applyQuaternion(mesh.quaternion).add(mesh.position).sub(new Vector3(hand.position.x, hand.position.y, hand.position.z));
      const turn = new Quaternion().setFromUnitVectors(new Vector3(0, 0, -1), ahead.normalize());
      hand.quaternion.set(turn.x, turn.y, turn.z, turn.w);
      await new Promise((done) => setTimeout(done, 500));
      return { hits: board.cursors.map((cursor) => board.buttonAt(cursor)) };
    }, button);
    check(hits.includes(button), `the hand points at '${button}'`, hits.join());
    if (phase === "running") await shoot("teleop-board");
    await page.evaluate(() => globalThis.headset.hands.left.updatePinchValue(1));
    await becomes(page, phase);
    await page.evaluate(() => {
      const { left } = globalThis.headset.hands;
      left.updatePinchValue(0);
      left.quaternion.set(0, 0, 0, 1);
    });
    await page.waitForTimeout(200);
  };
  // How far the right index finger is bent, by its first and its last link, rad.
  const bent = () =>
    page.evaluate(async () => {
      const { Quaternion } = await import("three");
      const { seen, pose } = globalThis.fiatlux;
      const turn = (name) => new Quaternion(...pose(seen.live.doc.stage.frames.findIndex((frame) => frame.name === name)).slice(3));
      return turn("right_hand_base_link").invert().multiply(turn("R_index_intermediate")).toArray();
    });
  const angle = (a, b) => 2 * Math.acos(Math.min(1, Math.abs(a.reduce((sum, part, index) => sum + part * b[index], 0))));
  // The same once it has closed from where it was, and rests.
  const settled = async (from) => {
    let last = from;
    for (const end = Date.now() + PATIENCE_MS; Date.now() < end; ) {
      await page.waitForTimeout(300);
      const now = await bent();
      if (angle(from, now) > 1 && angle(last, now) < 0.05) return now;
      last = now;
    }
    return last;
  };

  await page.evaluate(() => {
    globalThis.headset.primaryInputMode = "hand";
  });
  await rest();
  await until(() => globalThis.fiatlux.headset().board.buttons.length > 0);
  await press("start", "running");
  check(true, "a pinch on the board starts the take");
  await until(() => !globalThis.fiatlux.seen.live.state.frozen);

  // A pinch of the left hand is a clutch for the right one, and for its fingers.
  await set("left", "pinch");
  await until(() => globalThis.fiatlux.seen.live.state.follows[1]);
  const { wanted } = await palm(page);
  const open = await bent();
  await set("right", "fist");
  const raised = await raise(page, "hands", wanted);
  check(rises(raised), "the robot's hand rises as the operator's does", JSON.stringify(raised));
  const closed = await settled(open);
  check(angle(open, closed) > 1, "its index finger closes with the operator's", angle(open, closed));
  await shoot("teleop-hands");
  await set("left", "default");
  await until(() => !globalThis.fiatlux.seen.live.state.follows[1]);
  await rest();
  await page.waitForTimeout(700);
  const letGo = await bent();
  check(angle(closed, letGo) < 0.2, "without the clutch it stays as it is", angle(closed, letGo));

  // A pinch of the left middle finger is a stick.
  await set("left", "middlePinch");
  await page.waitForTimeout(300);
  await set("left", "middlePinch", [-0.2, 1.3, -0.3]);
  await until(() => globalThis.fiatlux.seen.live.state.velocity[0] < -0.2);
  await page.evaluate(() => {
    globalThis.headset.hands.left.connected = false;
  });
  await until(() => globalThis.fiatlux.seen.live.state.velocity.every((part) => part === 0));
  check(true, "a middle finger's pinch walks until the hand is lost");
  await page.evaluate(() => {
    globalThis.headset.hands.left.connected = true;
  });
  await rest();
  await press("start", "ended");
  await press("discard", "ready");
  check((await status(page)).kept === 1, "the board's buttons stop and discard a take");
}

async function grab() {
  const opened = await worn("grab");
  const { page, press } = opened;
  await page.evaluate(drawNothing, true);
  let failure = "";
  for (let attempt = 1; attempt <= MAX_ATTEMPTS; attempt += 1) {
    await press("right", "a-button", "running");
    const { given, said } = await page.evaluate(operate, ATTEMPT);
    console.log(`       attempt ${attempt}: ${said}`);
    failure = given;
    if (!given) break;
    if (attempt < MAX_ATTEMPTS) await press("left", "y-button", "ready");
  }
  const { end } = await status(page);
  check(!failure && end === "success", "a headset takes the bulb of S08", failure || end);
  await page.evaluate(drawNothing, false);
  await drawn(page);
  await page.screenshot({ path: `${screenshots}/teleop-eyes-ended.png` });
  await press("left", "x-button", "ready");
  check((await status(page)).kept === 1, "X keeps the take");
  await close(opened);
}

const tests = { first, walk, older, headset, grab };
if (!(what in tests)) throw new Error(`${what} is not a test; use one of ${Object.keys(tests).join(", ")}`);
await tests[what]();
await end();
