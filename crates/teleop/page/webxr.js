// A headset: two eyes in the robot's place, and the poses of both controllers or tracked hands.

import * as THREE from "three";

import { Board } from "./board.js";
import { Hands } from "./hands.js";

// Axes of a headset (x right, y up, z backwards) in those of the room for a robot that looks along x.
const ROOM_FROM_HEADSET = new THREE.Quaternion().setFromRotationMatrix(new THREE.Matrix4().set(0, 0, -1, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1));
// Share by which the view follows the robot's head in a picture: its sway makes people ill.
const FOLLOWS = 0.08;
const CLICK = 3;
// Frames over which the rate is looked at, and the least one, frames/s: below it shadows are left out.
const LOOKED_AT = 10;
const MIN_RATE = 45;

const finite = (value) => (Number.isFinite(value) ? value : 0);

export class Headset {
  constructor(stage) {
    this.stage = stage;
    this.renderer = stage.renderer;
    this.rig = new THREE.Group();
    this.board = new Board();
    this.rig.add(this.board.mesh);
    this.hands = new Hands(this.rig, this.board);
    this.session = null;
    this.space = 0;
    this.heading = 0;
    this.centred = null;
    this.wasClicked = false;
    this.eye = new THREE.Vector3();
    this.turn = 0;
    this.times = [];
  }

  // Inputs come with pictures, so a slow picture is a slow input.
  hasTime(now) {
    this.times.push(now);
    if (this.times.length <= LOOKED_AT) return true;
    const rate = (1000 * LOOKED_AT) / (now - this.times.shift());
    return rate >= MIN_RATE;
  }

  static async isThere() {
    try {
      return (await navigator.xr?.isSessionSupported?.("immersive-vr")) === true;
    } catch {
      // Such as a page that may not ask.
      return false;
    }
  }

  // Must be called from a click. `picture` draws one; `press` is called with the name of a button of the board; `ended` when the
  // session is over.
  async enter(picture, press, ended) {
    const session = await navigator.xr.requestSession("immersive-vr", { optionalFeatures: ["local-floor", "hand-tracking"] });
    // Where the floor is not known, the eyes are: all poses count from where the user is.
    const isOnFloor = await session.requestReferenceSpace("local-floor").then(() => true, () => false);
    const { stage, renderer } = this;
    this.flat = { position: stage.camera.position.clone(), quaternion: stage.camera.quaternion.clone(), following: stage.following };
    stage.following = false;
    stage.controls.enabled = false;
    stage.scene.add(this.rig);
    this.rig.add(stage.camera);
    renderer.xr.enabled = true;
    renderer.xr.setReferenceSpaceType(isOnFloor ? "local-floor" : "local");
    this.session = session;
    this.centred = null;
    this.eye.set(0, 0, 0);
    session.addEventListener("end", () => {
      this.session = null;
      renderer.setAnimationLoop(null);
      renderer.xr.enabled = false;
      this.rig.remove(stage.camera);
      stage.scene.remove(this.rig);
      stage.camera.position.copy(this.flat.position);
      stage.camera.quaternion.copy(this.flat.quaternion);
      stage.following = this.flat.following;
      stage.controls.enabled = true;
      stage.key.castShadow = true;
      ended();
    });
    await renderer.xr.setSession(session).catch(async (error) => {
      await session.end();
      throw error;
    });
    renderer.xr.getReferenceSpace()?.addEventListener?.("reset", () => {
      this.space += 1;
      this.centred = null;
    });
    session.addEventListener("select", ({ frame, inputSource }) => {
      const button = this.hands.pressed(frame, inputSource, renderer.xr.getReferenceSpace());
      if (button) press(button);
    });
    this.times = [];
    renderer.setAnimationLoop((now, frame) => {
      if (!this.hasTime(now)) stage.key.castShadow = false;
      picture(frame);
    });
  }

  // Puts the user's head where the robot's is. `eye` is the robot's, `turn` the bearing of its pelvis.
  place(frame, eye, turn) {
    const viewer = frame?.getViewerPose(this.renderer.xr.getReferenceSpace());
    if (viewer && !this.centred) {
      const { position, orientation } = viewer.transform;
      const ahead = new THREE.Vector3(0, 0, -1).applyQuaternion(orientation);
      this.heading = Math.atan2(-ahead.x, -ahead.z);
      this.centred = new THREE.Vector3(position.x, position.y, position.z);
      this.board.put(this.centred, this.heading);
      this.eye.copy(eye);
      this.turn = turn;
    }
    if (!this.centred) return;
    this.eye.lerp(eye, FOLLOWS);
    this.turn += FOLLOWS * Math.atan2(Math.sin(turn - this.turn), Math.cos(turn - this.turn));
    const up = new THREE.Vector3(0, 0, 1);
    this.rig.quaternion.setFromAxisAngle(up, this.turn - this.heading).multiply(ROOM_FROM_HEADSET);
    this.rig.position.copy(this.eye).sub(this.centred.clone().applyQuaternion(this.rig.quaternion));
    this.rig.updateMatrixWorld(true);
  }

  // True where a hand is tracked instead of a controller.
  usesHands() {
    return [...this.session.inputSources].some(({ hand, targetRayMode }) => hand || targetRayMode === "transient-pointer");
  }

  // What both hands do; `follows` has the robot's hands that follow, left first.
  read(frame, running, follows) {
    const space = this.renderer.xr.getReferenceSpace();
    const hands = { left: null, right: null };
    this.hands.begin();
    for (const source of this.session.inputSources) {
      const { handedness, hand, targetRayMode } = source;
      if (!(handedness in hands) || targetRayMode === "transient-pointer") continue;
      hands[handedness] = hand ? this.hands.read(frame, source, space, follows[handedness === "left" ? 0 : 1]) : this.controller(frame, source, space);
    }
    const isClicked = (hands.left?.buttons[CLICK] ?? 0) > 0.5;
    if (isClicked && !this.wasClicked) {
      this.space += 1;
      this.centred = null;
    }
    this.wasClicked = isClicked;
    return { space: this.space, visible: (this.session.visibilityState ?? "visible") === "visible", ...hands, heading: this.heading, running };
  }

  controller(frame, { gripSpace, gamepad }, space) {
    const grip = gripSpace && frame.getPose(gripSpace, space);
    // A position that is only guessed is none.
    const isTracked = grip && !grip.emulatedPosition;
    const { position: p, orientation: q } = grip?.transform ?? {};
    return {
      pose: isTracked ? [p.x, p.y, p.z, q.x, q.y, q.z, q.w] : null,
      buttons: [...(gamepad?.buttons ?? [])].slice(0, 8).map((button) => finite(button?.value)),
      // Inputs that a controller lacks are 0.
      axes: [...(gamepad?.axes ?? [])].slice(0, 4).map(finite),
    };
  }
}
