// An arrow to the goal: on the floor ahead of the robot while the goal is far, and a tip that points down at it.

import * as THREE from "three";

const COLOUR = 0xe25c26;
// Where the arrow begins and ends, from the pelvis, and the least distance of a goal that it points to, m.
const FROM = 0.45;
const TO = 1.0;
const FAR = 1.1;
const ABOVE_FLOOR = 0.015;

export class Goal {
  constructor(goal, scene) {
    this.goal = goal;
    this.group = new THREE.Group();
    const material = new THREE.MeshBasicMaterial({ color: COLOUR, transparent: true, opacity: 0.9, side: THREE.DoubleSide });
    const outline = [[FROM, -0.05], [TO - 0.2, -0.05], [TO - 0.2, -0.14], [TO, 0], [TO - 0.2, 0.14], [TO - 0.2, 0.05], [FROM, 0.05]];
    const shape = new THREE.Shape(outline.map(([x, y]) => new THREE.Vector2(x, y)));
    this.arrow = new THREE.Mesh(new THREE.ShapeGeometry(shape), material);
    // Nothing hides the tip.
    this.tip = new THREE.Mesh(new THREE.ConeGeometry(0.06, 0.16, 24), material.clone());
    this.tip.material.depthTest = false;
    this.tip.rotation.x = -Math.PI / 2;
    this.tip.renderOrder = 10;
    this.group.add(this.arrow, this.tip);
    this.group.visible = false;
    scene.add(this.group);
  }

  // Points from the robot of a state to where the goal is in it.
  show(live, isWanted) {
    this.group.visible = isWanted && this.goal !== null;
    if (!this.group.visible) return;
    const { frame, fixed, above } = this.goal;
    const [pelvis, turn] = [[0, 0, 0], [0, 0, 0, 1]];
    let at = fixed;
    if (frame !== null) {
      at = [0, 0, 0];
      live.poseAt(0, frame, at, turn);
    }
    live.poseAt(0, 0, pelvis, turn);
    const [dx, dy] = [at[0] - pelvis[0], at[1] - pelvis[1]];
    this.arrow.visible = Math.hypot(dx, dy) > FAR;
    this.arrow.position.set(pelvis[0], pelvis[1], ABOVE_FLOOR);
    this.arrow.rotation.z = Math.atan2(dy, dx);
    this.tip.position.set(at[0], at[1], at[2] + above);
  }
}
