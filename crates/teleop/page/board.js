// A board in the room of a headset: the state of the take, the gate's conditions, the force on each hand.

import * as THREE from "three";

// Pixels, and pixels for a metre.
const [WIDTH, HEIGHT, PER_METRE] = [640, 512, 1100];
const LINE = 46;
// Where it is from the user's head: to the left, a little down, ahead, m; and its turn towards the user, rad.
const PLACE = [-0.62, -0.12, -1.0];
const TURN = 0.5;
const EVERY_MS = 200;

export class Board {
  constructor() {
    this.canvas = document.createElement("canvas");
    [this.canvas.width, this.canvas.height] = [WIDTH, HEIGHT];
    this.texture = new THREE.CanvasTexture(this.canvas);
    this.texture.colorSpace = THREE.SRGBColorSpace;
    const material = new THREE.MeshBasicMaterial({ map: this.texture, transparent: true, toneMapped: false });
    this.mesh = new THREE.Mesh(new THREE.PlaneGeometry(WIDTH / PER_METRE, HEIGHT / PER_METRE), material);
    this.written = 0;
  }

  // `head` is where the user's head is, `heading` where it looks, in the axes of the headset.
  put(head, heading) {
    const turn = new THREE.Quaternion().setFromAxisAngle(new THREE.Vector3(0, 1, 0), heading);
    this.mesh.position.set(...PLACE).applyQuaternion(turn).add(head);
    this.mesh.quaternion.setFromAxisAngle(new THREE.Vector3(0, 1, 0), heading + TURN);
  }

  // `lines` have a text, and true or false where it is a condition.
  write(title, lines) {
    const now = performance.now();
    if (now - this.written < EVERY_MS) return;
    this.written = now;
    const pen = this.canvas.getContext("2d");
    pen.clearRect(0, 0, WIDTH, HEIGHT);
    pen.fillStyle = "rgba(15, 19, 24, 0.82)";
    pen.beginPath();
    pen.roundRect(0, 0, WIDTH, HEIGHT, 24);
    pen.fill();
    pen.fillStyle = "#e6eaf0";
    pen.font = "600 38px system-ui, sans-serif";
    pen.fillText(title, 30, 58, WIDTH - 60);
    pen.font = "32px system-ui, sans-serif";
    lines.slice(0, 9).forEach(({ text, holds }, index) => {
      const y = 112 + LINE * index;
      if (holds !== undefined) {
        pen.fillStyle = holds ? "#5fd0a3" : "#4c5663";
        pen.beginPath();
        pen.arc(44, y - 11, 12, 0, 2 * Math.PI);
        pen.fill();
      }
      pen.fillStyle = holds === false ? "#9aa6b5" : "#e6eaf0";
      pen.fillText(text, holds === undefined ? 30 : 70, y, WIDTH - 100);
    });
    this.texture.needsUpdate = true;
  }
}
