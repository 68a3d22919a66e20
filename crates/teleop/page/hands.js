// Tracked hands of a headset: their joints for the server, their bones for the user, and what they point at on the board.

import * as THREE from "three";

const VERSION = 1;
const JOINTS = 25;
// Tips of thumb and index finger, which touch when they are closer than this, m.
const [THUMB, INDEX, TOUCH] = [4, 9, 0.04];
// Bones go from one joint to the next one; those of the fingers begin at the wrist.
const ROOTS = [1, 5, 10, 15, 20];
const BONES = Array.from({ length: JOINTS - 1 }, (_, bone) => [ROOTS.includes(bone + 1) ? 0 : bone, bone + 1]);
const THICK = 0.0045;
const COLOURS = { rests: 0xe6eaf0, touches: 0x6ca6e8, follows: 0x5fd0a3 };
// After the room and the board: the operator's hands are seen through everything.
const LAST = 21;

function bones() {
  const shape = new THREE.CapsuleGeometry(THICK, 1, 3, 8);
  const mesh = new THREE.InstancedMesh(shape, new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.75, depthTest: false }), BONES.length);
  mesh.renderOrder = LAST;
  mesh.frustumCulled = false;
  mesh.visible = false;
  return mesh;
}

// True for what points by a pinch: hands, and eyes on a headset that hides its hands. Controllers have buttons.
const pinches = ({ hand, targetRayMode }) => Boolean(hand) || targetRayMode === "transient-pointer";

export class Hands {
  constructor(rig, board) {
    this.board = board;
    this.bones = { left: bones(), right: bones() };
    rig.add(this.bones.left, this.bones.right);
    this.matrices = new Float32Array(16 * JOINTS);
    this.touches = { left: false, right: false };
    // Hands that point at the board: what they do is meant for it.
    this.aims = { left: false, right: false };
  }

  // Once in a picture, before `read`.
  begin() {
    this.board.cursors = [];
    for (const mesh of Object.values(this.bones)) mesh.visible = false;
  }

  // The wrist's pose and the joints of a hand; null where it is not tracked, or points at the board.
  read(frame, source, space, follows) {
    const { hand, handedness } = source;
    const other = handedness === "left" ? "right" : "left";
    const wrist = hand.get("wrist");
    const pose = frame.getPose(wrist, space);
    const isTracked = pose && !pose.emulatedPosition && this.fill(frame, hand, wrist);
    const place = (joint) => [12, 13, 14].map((at) => this.matrices[16 * joint + at]);
    const places = Array.from({ length: JOINTS }, (_, joint) => place(joint)).flat();
    if (!isTracked || !places.every(Number.isFinite)) {
      this.touches[handedness] = false;
      return null;
    }
    const [thumb, index] = [place(THUMB), place(INDEX)];
    const touches = Math.hypot(...thumb.map((at, axis) => at - index[axis])) < TOUCH;
    const aim = this.aim(frame, source, space);
    // A pinch belongs to what the hand pointed at when it began.
    if (!touches) this.aims[handedness] = aim !== null && !this.touches[other];
    this.touches[handedness] = touches;
    if (aim && this.aims[handedness]) this.board.cursors.push(aim);
    this.draw(handedness, pose, follows);
    if (this.aims[handedness]) return null;
    const { position: p, orientation: q } = pose.transform;
    const rounded = places.map((at) => Math.round(1e4 * at) / 1e4);
    return { pose: [p.x, p.y, p.z, q.x, q.y, q.z, q.w], buttons: [], axes: [], hand: { version: VERSION, places: rounded } };
  }

  // Takes the joints' poses in the frame of the wrist; false where one is not tracked.
  fill(frame, hand, wrist) {
    if (frame.fillPoses) return frame.fillPoses(hand.values(), wrist, this.matrices);
    // Not all browsers give all of them at once.
    const poses = [...hand.values()].map((joint) => frame.getPose(joint, wrist));
    if (poses.length !== JOINTS || poses.some((joint) => !joint)) return false;
    poses.forEach((joint, index) => this.matrices.set(joint.transform.matrix, 16 * index));
    return true;
  }

  draw(handedness, pose, follows) {
    const mesh = this.bones[handedness];
    const wrist = new THREE.Matrix4().fromArray(pose.transform.matrix);
    const at = (joint) => new THREE.Vector3().fromArray(this.matrices, 16 * joint + 12).applyMatrix4(wrist);
    const up = new THREE.Vector3(0, 1, 0);
    BONES.forEach(([from, to], index) => {
      const [start, end] = [at(from), at(to)];
      const way = end.clone().sub(start);
      const length = way.length();
      const turn = new THREE.Quaternion().setFromUnitVectors(up, way.normalize());
      mesh.setMatrixAt(index, new THREE.Matrix4().compose(start.lerp(end, 0.5), turn, new THREE.Vector3(1, length, 1)));
    });
    mesh.instanceMatrix.needsUpdate = true;
    mesh.material.color.setHex(follows ? COLOURS.follows : this.touches[handedness] ? COLOURS.touches : COLOURS.rests);
    mesh.visible = true;
  }

  // Where on the board a source points, in pixels of it; null beside it.
  aim(frame, source, space) {
    const ray = frame.getPose(source.targetRaySpace, space);
    if (!ray) return null;
    const { position, orientation } = ray.transform;
    const ahead = new THREE.Vector3(0, 0, -1).applyQuaternion(orientation);
    return this.board.hit(new THREE.Vector3(position.x, position.y, position.z), ahead);
  }

  // The button of the board that a pinch presses; null for none.
  pressed(frame, source, space) {
    if (!pinches(source) || (source.hand && !this.aims[source.handedness])) return null;
    return this.board.buttonAt(this.aim(frame, source, space));
  }
}
