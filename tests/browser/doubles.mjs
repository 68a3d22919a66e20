// The pages' use of browsers, headsets and gamepads, each interface with a double: one that is missing, one that is optional, and one
// that answers otherwise. `docs/browsers.md` has the list. Needs Node 20 alone.
//
//   node tests/browser/doubles.mjs

import { existsSync, readFileSync, readdirSync } from "node:fs";
import { register } from "node:module";
import { dirname, join } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";
import { gzipSync } from "node:zlib";

const ROOT = join(dirname(fileURLToPath(import.meta.url)), "../../crates");
const FOLDERS = ["teleop/page", "replay/page", "leaderboard/style"].map((folder) => join(ROOT, folder)).filter(existsSync);
const THREE = pathToFileURL(join(ROOT, "replay/vendor/three/")).href;
// The server puts both folders behind one address, and an import map names three.js.
register(
  `data:text/javascript,${encodeURIComponent(`
    import { existsSync } from "node:fs";
    import { pathToFileURL } from "node:url";
    export function resolve(name, context, next) {
      const three = { three: "three.module.min.js", "three/addons/controls/OrbitControls.js": "OrbitControls.js" }[name];
      if (three) return { url: new URL(three, ${JSON.stringify(THREE)}).href, shortCircuit: true, format: "module" };
      const near = ${JSON.stringify(FOLDERS)}.map((folder) => folder + "/" + name.slice(2)).find((file) => name.startsWith("./") && existsSync(file));
      return near ? { url: pathToFileURL(near).href, shortCircuit: true, format: "module" } : next(name, context);
    }
    export async function load(url, context, next) {
      return next(url, url.includes("/page/") || url.includes("/vendor/") ? { ...context, format: "module" } : context);
    }
  `)}`,
);

let failures = 0;
function check(holds, what, found = "") {
  if (!holds) failures += 1;
  console.log(`${holds ? "ok    " : "FAILED"} ${what}${holds || found === "" ? "" : `: ${found}`}`);
}
function throwing() {
  throw new DOMException("not allowed", "SecurityError");
}
const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);

// A small browser.
const on = {};
const listen = (kind, act) => (on[kind] ??= []).push(act);
const fire = (kind, event = {}) => (on[kind] ?? []).forEach((act) => act({ type: kind, preventDefault() {}, ...event }));
const kept = new Map();
const pen = () => new Proxy({}, { get: (own, name) => own[name] ?? (name === "roundRect" ? undefined : () => {}), set: (own, name, value) => ((own[name] = value), true) });
const define = (name, value) => Object.defineProperty(globalThis, name, { value, configurable: true, writable: true });
define("addEventListener", listen);
define("document", {
  addEventListener: listen,
  hasFocus: () => true,
  visibilityState: "visible",
  createElement: () => ({ style: {}, getContext: pen, addEventListener() {} }),
  createElementNS: () => ({ style: {}, addEventListener() {} }),
});
define("window", globalThis);
define("self", globalThis);
define("navigator", {});
define("location", { search: "", pathname: "/", host: "localhost:9000", protocol: "http:", replace() {} });
define("history", { replaceState: (_, __, address) => (globalThis.address = address) });
define("sessionStorage", { getItem: (name) => kept.get(name) ?? null, setItem: (name, value) => kept.set(name, value) });
const page = (name) => import(pathToFileURL(join(ROOT, "teleop/page", name)).href);

// Keys whose release never comes.
{
  const { Keyboard } = await page("keyboard.js");
  const keyboard = new Keyboard();
  const target = { closest: () => null };
  const key = (kind, code, more = {}) => fire(kind, { code, key: more.key ?? code, target, ctrlKey: false, metaKey: false, altKey: false, repeat: false, ...more });
  const held = () => (keyboard.read(true), keyboard.read(true).keys);
  const lost = (what, happens) => {
    key("keydown", "KeyW");
    check(same(held(), ["KeyW"]), `W is held, before ${what}`, held());
    happens();
    check(held().length === 0, `no key stays pressed after ${what}`, held());
    keyboard.held.clear();
  };
  lost("Cmd went down, and W up without an event", () => key("keydown", "MetaLeft", { key: "Meta", metaKey: true }));
  lost("Cmd went up", () => key("keyup", "MetaRight", { key: "Meta" }));
  lost("Firefox's older name for it", () => key("keydown", "OSLeft", { key: "OS", metaKey: true }));
  lost("Control", () => key("keydown", "ControlLeft", { key: "Control", ctrlKey: true }));
  lost("Alt, which opens a menu", () => key("keydown", "AltLeft", { key: "Alt", altKey: true }));
  lost("AltGr", () => key("keydown", "AltRight", { key: "AltGraph", altKey: true }));
  lost("a shortcut", () => key("keydown", "KeyF", { ctrlKey: true }));
  for (const kind of ["contextmenu", "blur", "visibilitychange", "dragstart", "pagehide", "freeze", "beforeprint", "fullscreenchange", "compositionstart"]) lost(kind, () => fire(kind));
  key("keydown", "KeyW");
  key("keyup", "KeyW");
  check(held().length === 0, "a key goes up");
  key("keydown", "KeyW");
  key("keydown", "ShiftLeft", { key: "Shift" });
  check(same(held(), ["KeyW"]), "Shift takes no key away", held());
  keyboard.held.clear();
  // A key that is held down repeats itself: what was taken away stays away until it is pressed again.
  key("keydown", "KeyW", { repeat: true });
  check(held().length === 0, "a repetition is no press", held());
  key("keydown", "", { key: "w" });
  check(held().length === 0, "a keyboard without codes drives nothing", held());
  key("keydown", "Enter", { target: { closest: () => ({}) } });
  check(held().length === 0, "a button keeps its own keys", held());
  key("keydown", "KeyW", { target: { closest: (selector) => (selector.includes("textarea") ? {} : null) } });
  check(held().length === 0, "a field keeps what is typed into it", held());
  key("keydown", "KeyW", { key: "Process", isComposing: true });
  check(held().length === 0, "text that is composed drives nothing", held());
  key("keydown", "KeyW", { target: {} });
  check(same(held(), ["KeyW"]), "a target without `closest`", held());
  keyboard.held.clear();
}

// Gamepads.
{
  const { Gamepad } = await page("gamepad.js");
  const gamepad = new Gamepad();
  const with_ = (pads) => (navigator.getGamepads = pads);
  const rest = { axes: [], buttons: [], connected: false, running: true };
  with_(undefined);
  check(gamepad.pad() === null && same(gamepad.read(true), rest) && !gamepad.isMoved(), "no gamepad interface");
  with_(throwing);
  check(gamepad.pad() === null && !gamepad.isMoved(), "a page that may not ask for gamepads");
  with_(() => null);
  check(gamepad.pad() === null, "no list of gamepads");
  with_(() => [null, undefined, { mapping: "", axes: [1], buttons: [{ value: 1 }] }]);
  check(gamepad.pad() === null && !gamepad.isMoved(), "empty places, and a pad of no standard mapping");
  with_(() => ({ 0: { mapping: "standard", connected: true, axes: new Float64Array([0.5, NaN, 3]), buttons: [1, { value: 0.25 }, { pressed: true }, {}, null] }, length: 1 }));
  check(same(gamepad.read(true), { axes: [0.5, 0, 1], buttons: [1, 0.25, 1, 0, 0], connected: true, running: true }), "buttons as numbers, axes that are none", JSON.stringify(gamepad.read(true)));
  with_(() => [{ mapping: "standard", axes: [0], buttons: [] }]);
  check(gamepad.read(true).connected, "a pad that does not say that it is connected");
  with_(() => [{ mapping: "standard", connected: false, axes: [0.5], buttons: [] }]);
  check(!gamepad.read(true).connected && !gamepad.isMoved(), "a pad that was unplugged");
  with_(() => [{ mapping: "standard", connected: false, axes: [1], buttons: [1] }, { mapping: "standard", connected: true, axes: [0.5], buttons: [] }]);
  check(same(gamepad.read(true), { ...rest, axes: [0.5], connected: true }), "one that was unplugged in the place before another");
  with_(() => [{ mapping: "standard" }]);
  check(same(gamepad.read(true), rest) && !gamepad.isMoved(), "a pad without axes and buttons");
}

// Thumb sticks: touches that end without an event, or before the page hears of them.
{
  const { Sticks } = await page("sticks.js");
  const stick = () => {
    const heard = {};
    const element = { heard, clientWidth: 100, firstElementChild: { style: {}, clientWidth: 20 }, setPointerCapture() {} };
    element.addEventListener = (kind, act) => (heard[kind] = act);
    element.getBoundingClientRect = () => ({ left: 0, top: 0, width: 100, height: 100 });
    return element;
  };
  const [left, right] = [stick(), stick()];
  const sticks = new Sticks([left, right]);
  const touch = (element, kind, pointerId, clientX = 100, clientY = 50) => element.heard[kind]({ pointerId, clientX, clientY, preventDefault() {} });
  touch(left, "pointerdown", 1);
  touch(right, "pointerdown", 2, 50, 0);
  check(same(sticks.read(true).axes, [1, 0, 0, -1]) && sticks.isHeld(), "two thumbs at once", sticks.read(true).axes);
  touch(left, "pointerup", 2);
  touch(left, "pointerdown", 3, 0);
  check(same(sticks.read(true).axes, [1, 0, 0, -1]), "a second finger on a stick changes nothing", sticks.read(true).axes);
  touch(left, "pointercancel", 1);
  touch(right, "lostpointercapture", 2);
  check(same(sticks.read(true).axes, [0, 0, 0, 0]) && !sticks.isHeld(), "a touch that the system takes stops");
  for (const kind of ["blur", "visibilitychange", "pagehide", "freeze"]) {
    touch(left, "pointerdown", 4);
    fire(kind);
    check(same(sticks.read(true).axes, [0, 0, 0, 0]) && !sticks.isHeld(), `no stick stays held after ${kind}`, sticks.read(true).axes);
  }
  left.setPointerCapture = throwing;
  touch(left, "pointerdown", 5);
  check(!sticks.isHeld() && sticks.read(true).axes[0] === 0, "a finger that is lifted before the page hears of it");
  left.setPointerCapture = () => {};
  touch(left, "pointerdown", 6);
  check(sticks.isHeld() && sticks.read(true).axes[0] === 1, "and the next one drives");
  fire("blur");
}

// The token: the address bar, and what a tab keeps.
{
  const { takeToken, rememberedToken } = await page("token.js");
  location.search = "?token=abc";
  check(takeToken() === "abc" && globalThis.address === "/" && rememberedToken() === "abc", "the token leaves the address bar");
  globalThis.address = undefined;
  const storage = globalThis.sessionStorage;
  define("sessionStorage", { getItem: throwing, setItem: throwing });
  check(takeToken() === "abc" && globalThis.address === undefined && rememberedToken() === null, "a tab that may keep nothing keeps its address");
  define("sessionStorage", { getItem: () => null, setItem: () => {} });
  check(takeToken() === "abc" && globalThis.address === undefined, "and so does one that forgets");
  define("sessionStorage", storage);
  const { history } = globalThis;
  define("history", { replaceState: throwing });
  check(takeToken() === "abc", "an address bar that cannot be changed");
  define("history", history);
  location.search = "";
  check(takeToken() === "", "no token");
}

// The connection.
{
  const { Socket } = await page("socket.js");
  const sockets = [];
  define("WebSocket", class {
    static OPEN = 1;
    constructor(url) {
      Object.assign(this, { url, readyState: 0, sent: [] });
      sockets.push(this);
    }
    send(text) {
      this.sent.push(text);
    }
  });
  const waiting = [];
  const later = globalThis.setTimeout;
  define("setTimeout", (act) => waiting.push(act));
  let now = 0;
  define("performance", { now: () => now });
  const told = [];
  const socket = new Socket("a&b", { open: (is, why) => told.push([is, why]), state() {}, status() {}, drives() {}, problem() {} });
  check(sockets[0].url === "ws://localhost:9000/drive?token=a%26b", "the socket has the page's own host and port", sockets[0].url);
  socket.input("keyboard", {});
  check(sockets[0].sent.length === 0, "nothing is sent before it is open");
  sockets[0].readyState = 1;
  sockets[0].onopen();
  Object.assign(sockets[0], { bufferedAmount: 5000 });
  socket.input("keyboard", {});
  check(sockets[0].sent.length === 0, "an input that cannot leave at once is dropped");
  sockets[0].bufferedAmount = 0;
  socket.input("keyboard", {});
  check(sockets[0].sent.length === 1, "others are sent");
  sockets[0].onclose({ code: 1006 });
  check(same(told.at(-1), [false, "No connection: the robot stands"]), "a broken connection is said", told.at(-1));
  waiting.pop()();
  now = 4000;
  sockets[1].onclose({ code: 1006 });
  check(same(told.at(-1), [false, "The program has ended"]), "one that does not come back has ended", told.at(-1));
  waiting.pop()();
  sockets[2].onopen();
  sockets[2].onclose({ code: 1001 });
  check(same(told.at(-1), [false, "The program has ended"]), "a program that says that it ends has ended", told.at(-1));
  waiting.pop()();
  sockets[3].onopen();
  sockets[3].onclose({ code: 4000 });
  check(told.at(-1)[1].startsWith("Too many pages") && waiting.length === 0, "a page that was one too many does not come back", told.at(-1));
  define("setTimeout", later);
}

// The headset.
{
  const { Headset } = await page("webxr.js");
  const { Board } = await page("board.js");
  const { Hands } = await page("hands.js");
  for (const [xr, is, what] of [
    [undefined, false, "no WebXR"],
    [{}, false, "WebXR of 2018, which asks otherwise"],
    [{ isSessionSupported: throwing }, false, "a page that may not use headsets"],
    [{ isSessionSupported: () => Promise.reject(new Error("no")) }, false, "a headset that refuses"],
    [{ isSessionSupported: async () => undefined }, false, "one that does not say"],
    [{ isSessionSupported: async () => true }, true, "a headset"],
  ]) {
    navigator.xr = xr;
    check((await Headset.isThere().catch(() => "threw")) === is, what);
  }
  const board = new Board();
  board.write("Ready", [{ text: "near", holds: true }], [{ name: "start", label: "Start" }]);
  check(board.placed().length === 1, "a canvas that rounds no corners");

  const THREE_ = await import("three");
  // A session, with what it lacks.
  const enter = async ({ spaces = ["local-floor", "local"], fails = false }) => {
    const asked = [];
    const session = Object.assign(new EventTarget(), {
      inputSources: [],
      requestReferenceSpace: async (kind) => (spaces.includes(kind) ? {} : Promise.reject(new DOMException("no", "NotSupportedError"))),
      end: async () => session.dispatchEvent(new Event("end")),
    });
    navigator.xr = { requestSession: async () => session };
    const xr = {
      setReferenceSpaceType: (kind) => asked.push(kind),
      setSession: async () => (fails ? Promise.reject(new Error("no layer")) : undefined),
      getReferenceSpace: () => ({}),
    };
    const stage = {
      renderer: { xr, setAnimationLoop: (loop) => asked.push(loop ? "loop" : "none") },
      scene: new THREE_.Scene(),
      camera: new THREE_.PerspectiveCamera(),
      controls: {},
      key: {},
      following: true,
    };
    const headset = new Headset(stage);
    let ended = 0;
    const error = await headset.enter(() => {}, () => {}, () => (ended += 1)).then(() => "", ({ message }) => message);
    return { headset, stage, session, asked, error, ended: () => ended };
  };
  const whole = await enter({});
  check(same(whole.asked, ["local-floor", "loop"]) && whole.headset.session === whole.session, "a headset is entered", JSON.stringify(whole.asked));
  const seated = await enter({ spaces: ["local"] });
  check(same(seated.asked, ["local", "loop"]) && seated.error === "", "one that does not know the floor", JSON.stringify(seated.asked));
  const broken = await enter({ fails: true });
  check(broken.error === "no layer" && broken.headset.session === null && broken.ended() === 1 && broken.stage.controls.enabled, "one that fails gives the page back", broken.error);

  // What it says of the user's hands.
  const same16 = Array.from(new THREE_.Matrix4().elements);
  const pose = { transform: { position: { x: 0, y: 1, z: 0 }, orientation: { x: 0, y: 0, z: 0, w: 1 }, matrix: same16 } };
  const { headset, session } = whole;
  const read = (source, frame = { getPose: () => pose }) => {
    session.inputSources = [{ handedness: "left", targetRayMode: "tracked-pointer", ...source }];
    return headset.read(frame, true, [false, false]);
  };
  check(read({ gripSpace: {}, gamepad: { buttons: [{ value: 0.5 }], axes: [0, 0, 0.1, 0.2] } }).left.buttons[0] === 0.5, "a controller");
  check(read({ gripSpace: {} }).left.axes.length === 0, "a controller without buttons");
  const odd = read({ gripSpace: {}, gamepad: { buttons: [{ value: NaN }, null], axes: [NaN, undefined] } }).left;
  check(same([odd.buttons, odd.axes], [[0, 0], [0, 0]]), "a controller with numbers that are none");
  check(read({ gripSpace: undefined }).left.pose === null, "a controller without a grip");
  check(read({ gripSpace: {} }, { getPose: () => null }).left.pose === null, "a controller that is not tracked");
  check(read({ gripSpace: {} }, { getPose: () => ({ ...pose, emulatedPosition: true }) }).left.pose === null, "a position that is only guessed");
  check(read({ handedness: "none", gripSpace: {} }).left === null, "a controller of no hand");
  check(read({ gripSpace: {} }).visible === true, "a session that does not say whether it is seen");
  session.visibilityState = "visible-blurred";
  check(read({ gripSpace: {} }).visible === false, "a session behind the headset's menu");
  session.visibilityState = "visible";
  const joints = new Map(Array.from({ length: 25 }, (_, joint) => [joint === 0 ? "wrist" : `joint-${joint}`, {}]));
  const filled = { getPose: () => pose, fillPoses: (_, __, into) => (into.set(Array.from({ length: 25 }, () => same16).flat()), true) };
  const all = read({ hand: joints }, filled).left;
  const one = read({ hand: joints }).left;
  check(all?.hand.places.length === 75 && same(all, one), "joints one by one, where a browser does not give all at once", JSON.stringify(one));
  check(read({ hand: joints }, { getPose: (joint) => (joint === [...joints.values()][7] ? null : pose) }).left === null, "a joint that is not seen");
  check(read({ hand: joints }, { ...filled, fillPoses: () => false }).left === null, "joints that are not seen");
  check(read({ hand: joints }, { ...filled, fillPoses: (_, __, into) => (into.fill(NaN), true) }).left === null, "joints that are no numbers");
  check(typeof Hands === "function", "tracked hands");
}

// The replay: its loading, the camera's pictures, the address that is copied, and a browser without WebGL.
{
  const replay = (name) => import(pathToFileURL(join(ROOT, "replay/page", name)).href);
  const { Track, bytesOf, woven } = await replay("data.js");
  const { Pictures } = await replay("pictures.js");
  const { moments, stageOf } = await replay("controls.js");
  const elements = new Map();
  const made = (tag) => ({ tag, style: {}, dataset: {}, on: {}, inner: [], setAttribute() {}, append(...inner) { this.inner.push(...inner); }, addEventListener(kind, act) { this.on[kind] = act; }, getContext: () => null });
  document.createElement = made;
  document.getElementById = (id) => elements.get(id) ?? null;

  const bytes = new Uint8Array(3000).fill(7);
  let answer;
  define("fetch", async () => answer);
  const heard = [];
  const read = async () => (heard.splice(0), new Uint8Array(await bytesOf("/e", "track.bin", (count) => heard.push(count))));
  const parts = [bytes.slice(0, 1000), bytes.slice(1000)];
  answer = { ok: true, body: { getReader: () => ({ read: async () => ({ done: parts.length === 0, value: parts.shift() }) }) } };
  check(same([...(await read())], [...bytes]) && same(heard, [1000, 2000]), "a file that comes in parts, each of which is told", heard);
  answer = { ok: true, body: undefined, arrayBuffer: async () => bytes.buffer };
  check(same([...(await read())], [...bytes]) && heard.length === 0, "a browser without streams: the file comes, and no share of it is told", heard);
  answer = { ok: false, text: async () => "gone" };
  check((await read().catch(({ message }) => message)) === "gone", "an answer that is no file");

  // A file of its own: its data are compressed.
  elements.set("block-track.bin", { textContent: `${gzipSync(bytes).toString("base64")}\n` });
  check(same([...(await read())], [...bytes]), "a block of a file is unpacked");
  const { DecompressionStream } = globalThis;
  define("DecompressionStream", undefined);
  elements.set("late", {});
  await Promise.resolve(new Function(readFileSync(join(ROOT, "replay/page/unpack.js"), "utf8"))());
  const said = elements.get("late").textContent ?? "";
  check(said.includes("Firefox 113") && said.includes("fiatlux view BAG"), "a browser that cannot unpack says what to do", said);
  check(same([...new Uint8Array(woven(new Uint8Array([1, 5, 9, 2, 6, 10, 3, 7, 11, 4, 8, 12]).buffer))], [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12]), "shapes are woven together");
  define("DecompressionStream", DecompressionStream);
  elements.delete("block-track.bin");

  // Rows of a pelvis, a link that turns a quarter about z 1 m ahead of it, one fixed to that, a bulb, and one force.
  {
    const grid = { pose: 1 / 131072, force: 1 / 256, effort: 1 / 512 };
    const pose = (...numbers) => numbers.map((number) => Math.round(number / grid.pose));
    const forces = [{ by: "floor", frame: 0 }];
    const turns = [[Math.SQRT1_2, 0, 0, Math.SQRT1_2], [0.5, 0.5, 0.5, 0.5]];
    const rows = [0, 1].map((row) => [...pose(row, 0, 1, ...turns[row]), ...pose((row * Math.PI) / 2), ...pose(5, 6, -7, 1, 0, 0, 0), -256, 512, 128 + row]);
    const width = rows[0].length;
    const zigzag = rows[0].flatMap((_, column) => rows.map((numbers, row) => numbers[column] - (row > 0 ? rows[0][column] : 0))).map((change) => ((change << 1) ^ (change >> 31)) >>> 0);
    const planes = [0, 8, 16, 24].flatMap((bits) => zigzag.map((number) => (number >>> bits) & 255));
    const head = [0x52544c46, 2, 2, 2, width, 0, 1, 0, 0, 0, 0, 0, 1];
    const buffer = new Uint8Array([...new Uint8Array(new Uint32Array(head).buffer), ...planes]).buffer;
    const links = [
      { parent: null, at: [0, 0, 0, 1, 0, 0, 0], joint: null, axis: [0, 0, 0] },
      { parent: 0, at: [1, 0, 0, 1, 0, 0, 0], joint: 0, axis: [0, 0, 1] },
      { parent: 1, at: [1, 2, 3, 1, 0, 0, 0], joint: null, axis: [0, 0, 0] },
    ];
    const track = new Track({ rows: 2, kept: 2, width, pose: 7, stride: 1, span: [0, 1], control_dt: 0.02, forces, joints: [{}], grid, links }, buffer);
    const at = (row, frame) => {
      const position = [];
      track.poseAt({ from: row, to: row, blend: 0 }, frame, position, []);
      return position.map((number) => Number(number.toFixed(4)));
    };
    // The pelvis turns x to y; then x to y, y to z and z to x, after the link's quarter.
    check(same([at(0, 0), at(0, 1), at(0, 2), at(0, 3)], [[0, 0, 1], [0, 1, 1], [-2, 2, 4], [5, 6, -7]]), "links follow from the pelvis and the joints", at(0, 2));
    check(same([at(1, 0), at(1, 1), at(1, 2), at(1, 3)], [[1, 0, 1], [1, 1, 1], [4, -1, 2], [5, 6, -7]]), "and turn with their joint", at(1, 2));
    check(same([...track.force({ from: 1 }, 0)], [-1, 2, 129 / 256]) && Math.abs(track.angles[1] - Math.PI / 2) < 1e-5, "forces and angles of a row");
  }

  // Two pictures, at steps 0 and 5.
  const blob = (step, text) => [...new Uint8Array(new Uint32Array([step, text.length]).buffer), ...new TextEncoder().encode(text)];
  const file = new Uint8Array([...blob(0, "one"), ...blob(5, "two")]).buffer;
  const show = async () => {
    answer = { ok: true, body: null, arrayBuffer: async () => file };
    const root = made("main");
    const pictures = new Pictures(root, { first: 0, dt: 0.02 }, "/e", [{ sensor: "camera", count: 2 }]);
    const drawn = [];
    const [view] = pictures.views;
    view.canvas.getContext = () => ({ drawImage: (picture) => drawn.push(picture.name) });
    for (let turn = 0; turn < 20; turn += 1) await Promise.resolve();
    await new Promise((go) => setImmediate(go));
    await pictures.show(7);
    return { drawn, said: view.said.textContent };
  };
  define("createImageBitmap", async (one) => ({ name: await one.text(), width: 2, height: 1 }));
  const shown = await show();
  check(same(shown.drawn, ["one", "two"]) && shown.said === "Head camera at 0.10 s", "the camera's pictures", JSON.stringify(shown));
  // An image element in its place; the blob's own text stands for what it unpacks.
  let reads = true;
  define(
    "FileReader",
    class {
      readAsDataURL(one) {
        one.text().then((text) => (this.result = `data:${text}`) && this.onload());
      }
    },
  );
  define(
    "Image",
    class {
      set src(address) {
        Object.assign(this, { name: address.replace("data:", ""), width: 2, height: 1 });
        setImmediate(() => (reads ? this.onload() : this.onerror(new Error("not a picture"))));
      }
    },
  );
  define("createImageBitmap", undefined);
  const without = await show();
  check(same(without.drawn, ["one", "two"]) && without.said === "Head camera at 0.10 s", "no createImageBitmap", JSON.stringify(without));
  for (const [broken, what] of [[undefined, "an element that cannot read it"], [async () => throwing(), "a picture that it cannot read"]]) {
    define("createImageBitmap", broken);
    reads = false;
    const { drawn, said } = await show();
    check(drawn.length === 0 && said === "Head camera: the picture at 0.10 s is damaged", what, said);
  }

  // The button that copies the address.
  location.hash = "";
  location.href = "http://localhost:9000/#t=1.5";
  const later = globalThis.setTimeout;
  define("setTimeout", () => {});
  for (const [clipboard, said, what] of [
    [{ writeText: async (text) => (globalThis.copied = text) }, "Copied", "a clipboard"],
    [undefined, "In the address", "no clipboard"],
    [{ writeText: async () => throwing() }, "In the address", "a clipboard that refuses"],
  ]) {
    navigator.clipboard = clipboard;
    const button = made("button");
    elements.set("copy", button);
    globalThis.address = undefined;
    moments({ step: 75, seek() {} }, { dt: 0.02 });
    await button.on.click();
    check(button.textContent === said && globalThis.address === "#t=1.5", `${what}: the moment is in the address`, button.textContent);
  }
  check(globalThis.copied === location.href, "the clipboard has the address", globalThis.copied);
  define("setTimeout", later);

  // Three.js says itself, at length, that there is none.
  const [message, { error }] = [made("p"), console];
  elements.set("message", message);
  console.error = () => {};
  const stage = stageOf(made("canvas"), { doc: {}, meshes: {}, track: {} }, () => {});
  console.error = error;
  check(stage === null && message.textContent.startsWith("The 3D view cannot be shown: ") && message.hidden === false, "no WebGL: a sentence", message.textContent);
}

// A graphics card that is taken away and comes back: the picture is asked for again.
{
  const { Stage } = await import(pathToFileURL(join(ROOT, "replay/page/stage.js")).href);
  const answers = {
    getParameter: (name) => (name === "VERSION" ? "WebGL 2.0" : [0, 0, 4, 4]),
    getShaderPrecisionFormat: () => ({ precision: 23, rangeMin: 1, rangeMax: 1 }),
    getContextAttributes: () => ({}),
    getSupportedExtensions: () => [],
    isContextLost: () => false,
  };
  const gl = new Proxy({}, { get: (_, name) => answers[name] ?? (/^[A-Z0-9_]+$/.test(name) ? name : () => ({})) });
  const heard = {};
  const canvas = {
    style: {},
    ownerDocument: document,
    getRootNode: () => ({ ...document, addEventListener() {}, removeEventListener() {} }),
    getContext: () => gl,
    setAttribute() {},
    removeEventListener() {},
    addEventListener: (kind, act) => (heard[kind] ??= []).push(act),
  };
  define("devicePixelRatio", 1);
  document.removeEventListener = () => {};
  let asked = 0;
  // Whatever it is asked for: a direction, or a colour.
  const light = new Proxy({}, { get: () => [0.1, 0.2, -0.9] });
  const none = { positions: new Float32Array(), normals: new Float32Array(), indices: new Uint32Array() };
  new Stage(canvas, { stage: { light, frames: [{ name: "pelvis" }], materials: [], meshes: [] } }, none, { forces: [], around() {}, poseAt() {} }, () => (asked += 1));
  const before = asked;
  const { log, warn } = console;
  const say = (kind) => heard[kind].forEach((act) => act({ type: kind, preventDefault() {} }));
  Object.assign(console, { log() {}, warn() {} });
  say("webglcontextlost");
  const lost = asked;
  say("webglcontextrestored");
  Object.assign(console, { log, warn });
  check(lost === before && asked === before + 1, "a graphics card that was taken away: the picture comes back with it", `${asked - before}`);
}

// Reduced motion: the view of teleoperation turns with the robot in steps.
{
  const text = readFileSync(join(ROOT, "teleop/page/teleop.js"), "utf8");
  const [turn] = text.match(/function turnWithRobot\(\) \{[\s\S]*?\n\}/);
  const constant = (name) => text.match(new RegExp(`const ${name} = [^;]*;`))[0];
  const view = (reduced) => {
    const point = { sub: () => point, applyAxisAngle: () => point, add: () => point };
    const stage = { camera: { position: point, lookAt() {} }, controls: { target: {} } };
    let heading = 0;
    const turned = new Function("still", "stage", "heading", `${constant("FOLLOWS")} ${constant("STEP")} let turned = 0; ${turn} return () => (turnWithRobot(), turned);`)({ matches: reduced }, stage, () => heading);
    // The robot turns by 0.01 rad a frame, up to 2 rad.
    return Array.from({ length: 400 }, () => ((heading = Math.min(heading + 0.01, 2)), turned()));
  };
  const turns = (views) => views.filter((angle, frame) => frame > 0 && angle !== views[frame - 1]).length;
  const [moving, still] = [view(false), view(true)];
  check(turns(moving) > 300 && Math.abs(moving.at(-1) - 2) < 0.05, "the view follows the robot", `${turns(moving)} turns`);
  check(turns(still) > 1 && turns(still) < 20 && Math.abs(still.at(-1) - 2) < 0.6, "reduced motion: it follows in steps", `${turns(still)} turns, to ${still.at(-1)}`);
}

// What the oldest supported browsers lack: Chromium 89, Firefox 108, Safari 16.4.
{
  const NEWER = /\.(toSorted|toReversed|toSpliced|with|findLast|findLastIndex|at|groupBy|isWellFormed|withResolvers|hasOwn|checkVisibility|showPopover|getOrInsert)\(|\b(structuredClone|Object\.groupBy|Array\.fromAsync|Float16Array|Iterator\.from|scheduler\.)\b|\bstatic \{|\/[dgimsuy]*v[dgimsuy]*\.(test|exec)/g;
  const files = FOLDERS.flatMap((folder) => readdirSync(folder).map((file) => join(folder, file)));
  const found = [];
  for (const file of files.filter((file) => file.endsWith(".js"))) {
    readFileSync(file, "utf8").split("\n").forEach((line, index) => {
      for (const [call] of line.matchAll(NEWER)) found.push(`${file.slice(ROOT.length + 1)}:${index + 1} ${call}`);
    });
  }
  check(found.length === 0, "no call that the oldest supported browsers lack", found.join(", "));
  check([..."[1].toSorted(); a.at(-1)".matchAll(NEWER)].length === 2, "the search finds such calls");
  // A rule inside another one is unknown to them, and all in it is lost.
  const nested = (text) => {
    let depth = 0;
    let blocks = [];
    for (const [mark, kind] of text.replace(/\/\*[\s\S]*?\*\//g, "").matchAll(/(@(?:media|supports|keyframes)[^{]*)\{|\{|\}/g)) {
      if (mark === "}") depth -= blocks.pop() ?? 0;
      else blocks.push(kind ? 0 : 1);
      if (mark !== "}" && !kind && (depth += 1) > 1) return true;
    }
    return false;
  };
  for (const file of files.filter((file) => file.endsWith(".css"))) check(!nested(readFileSync(file, "utf8")), `${file.slice(ROOT.length + 1)}: no rule inside another one`);
  const tall = (text) => [...text.matchAll(/([\w-]+):[^;{}]*\ddvh/g)].every(({ 1: name, index }) => new RegExp(`[{;]\\s*${name}:[^;{}]*\\dvh[^;{}]*;\\s*$`).test(text.slice(0, index)));
  for (const file of files.filter((file) => file.endsWith(".css"))) check(tall(readFileSync(file, "utf8")), `${file.slice(ROOT.length + 1)}: vh stands before dvh`);
  check(tall("a { height: 50vh; height: 50dvh; }") && !tall("a { height: 50dvh; }"), "the search finds a dvh alone");
  check(nested("a { b { c: d } }") && !nested("@media x { a { c: d } } b { c: d }"), "the search finds such rules");
}

// A state is drawn though a part of the panel fails.
{
  const text = readFileSync(join(ROOT, "teleop/page/teleop.js"), "utf8");
  check(/ask\(\);\s*attempt\(panel\);/.test(text), "the picture does not wait for the panel");
}

console.log(failures === 0 ? "all checks hold" : `${failures} checks failed`);
process.exit(failures === 0 ? 0 : 1);
