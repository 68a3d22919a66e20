// A board in the room of a headset: the state of the take, the gate's conditions, the force on each hand, and buttons for those who
// have none in their hands.

import * as THREE from "three";

// Pixels, and pixels for a metre.
const [WIDTH, HEIGHT, PER_METRE] = [640, 600, 1100];
const [MARGIN, LINE, MAX_LINES] = [30, 44, 9];
const BUTTON = { top: 508, height: 66, gap: 12 };
// Where it is from the user's head: to the left, a little up, ahead, m; and its turn towards the user, rad.
const PLACE = [-0.52, 0.14, -1.0];
const TURN = 0.45;
// Drawn after the room: nothing in it hides the board.
const LAST = 20;
const EVERY_MS = 200;

// A rounded rectangle, or one with corners in browsers that round none.
function box(pen, x, y, width, height, radius) {
  pen.beginPath();
  if (pen.roundRect) pen.roundRect(x, y, width, height, radius);
  else pen.rect(x, y, width, height);
  pen.fill();
}

export class Board {
  constructor() {
    this.canvas = document.createElement("canvas");
    [this.canvas.width, this.canvas.height] = [WIDTH, HEIGHT];
    this.texture = new THREE.CanvasTexture(this.canvas);
    this.texture.colorSpace = THREE.SRGBColorSpace;
    const material = new THREE.MeshBasicMaterial({ map: this.texture, transparent: true, toneMapped: false, depthTest: false });
    this.mesh = new THREE.Mesh(new THREE.PlaneGeometry(WIDTH / PER_METRE, HEIGHT / PER_METRE), material);
    this.mesh.renderOrder = LAST;
    this.written = 0;
    this.buttons = [];
    // Where hands point at it, in its pixels.
    this.cursors = [];
  }

  // `head` is where the user's head is, `heading` where it looks, in the axes of the headset.
  put(head, heading) {
    const turn = new THREE.Quaternion().setFromAxisAngle(new THREE.Vector3(0, 1, 0), heading);
    this.mesh.position.set(...PLACE).applyQuaternion(turn).add(head);
    this.mesh.quaternion.setFromAxisAngle(new THREE.Vector3(0, 1, 0), heading + TURN);
  }

  // Where a ray, in the axes of the headset, meets it; null beside it.
  hit(from, ahead) {
    const back = this.mesh.quaternion.clone().invert();
    const start = from.clone().sub(this.mesh.position).applyQuaternion(back);
    const way = ahead.clone().applyQuaternion(back);
    const share = -start.z / way.z;
    if (!(share > 0 && start.z > 0)) return null;
    const { x, y } = start.addScaledVector(way, share).multiplyScalar(PER_METRE);
    return Math.abs(x) <= WIDTH / 2 && Math.abs(y) <= HEIGHT / 2 ? { x: x + WIDTH / 2, y: HEIGHT / 2 - y } : null;
  }

  // Its buttons with their places.
  placed() {
    const { top, height, gap } = BUTTON;
    const letters = this.buttons.map(({ label }) => label.length + 3);
    const all = letters.reduce((sum, count) => sum + count, 0);
    const scale = (WIDTH - 2 * MARGIN - gap * (this.buttons.length - 1)) / all;
    let x = MARGIN;
    return this.buttons.map((button, index) => {
      const width = scale * letters[index];
      x += width + gap;
      return { ...button, x: x - width - gap, y: top, width, height };
    });
  }

  // The name of the button at a place of `hit`; null where there is none that can be pressed.
  buttonAt(at) {
    const isIn = ({ x, y, width, height }) => at.x >= x && at.x <= x + width && at.y >= y && at.y <= y + height;
    return (at && this.placed().find((button) => !button.disabled && isIn(button))?.name) ?? null;
  }

  // `lines` have a text, and true or false where it is a condition; `buttons` a name, a label, and whether they are disabled.
  write(title, lines, buttons) {
    this.buttons = buttons;
    const now = performance.now();
    if (now - this.written < (this.cursors.length > 0 ? 0 : EVERY_MS)) return;
    this.written = now;
    const pen = this.canvas.getContext("2d");
    pen.clearRect(0, 0, WIDTH, HEIGHT);
    pen.fillStyle = "rgba(15, 19, 24, 0.82)";
    box(pen, 0, 0, WIDTH, HEIGHT, 24);
    pen.textAlign = "left";
    pen.fillStyle = "#e6eaf0";
    pen.font = "600 38px system-ui, sans-serif";
    pen.fillText(title, MARGIN, 58, WIDTH - 2 * MARGIN);
    pen.font = "32px system-ui, sans-serif";
    lines.slice(0, MAX_LINES).forEach(({ text, holds }, index) => {
      const y = 112 + LINE * index;
      if (holds !== undefined) {
        pen.fillStyle = holds ? "#5fd0a3" : "#4c5663";
        pen.beginPath();
        pen.arc(MARGIN + 14, y - 11, 12, 0, 2 * Math.PI);
        pen.fill();
      }
      pen.fillStyle = holds === false ? "#9aa6b5" : "#e6eaf0";
      pen.fillText(text, holds === undefined ? MARGIN : MARGIN + 40, y, WIDTH - 100);
    });
    this.writeButtons(pen);
    this.texture.needsUpdate = true;
  }

  writeButtons(pen) {
    const aimed = this.cursors.map((cursor) => this.buttonAt(cursor));
    pen.font = "600 25px system-ui, sans-serif";
    pen.textAlign = "center";
    for (const { name, label, disabled, x, y, width, height } of this.placed()) {
      pen.globalAlpha = disabled ? 0.4 : 1;
      pen.fillStyle = aimed.includes(name) ? "#6ca6e8" : "#2b3440";
      box(pen, x, y, width, height, 12);
      pen.fillStyle = aimed.includes(name) ? "#10151b" : "#e6eaf0";
      pen.fillText(label, x + width / 2, y + height / 2 + 8, width - 8);
    }
    pen.globalAlpha = 1;
    pen.fillStyle = "#ffffff";
    for (const { x, y } of this.cursors) {
      pen.beginPath();
      pen.arc(x, y, 9, 0, 2 * Math.PI);
      pen.fill();
    }
  }
}
