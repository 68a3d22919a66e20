// Two thumb sticks on a touch screen. They send what a gamepad does.

export class Sticks {
  // The elements of the left and the right stick, each with its knob in it.
  constructor(elements) {
    this.axes = [0, 0, 0, 0];
    this.holding = elements.map(() => null);
    elements.forEach((stick, index) => {
      const knob = stick.firstElementChild;
      const put = (x, y) => {
        [this.axes[2 * index], this.axes[2 * index + 1]] = [x, y];
        const way = (stick.clientWidth - knob.clientWidth) / 2;
        knob.style.transform = `translate(${x * way}px, ${y * way}px)`;
      };
      const follow = ({ clientX, clientY }) => {
        const { left, top, width, height } = stick.getBoundingClientRect();
        const [x, y] = [(2 * (clientX - left)) / width - 1, (2 * (clientY - top)) / height - 1];
        const size = Math.max(Math.hypot(x, y), 1);
        put(x / size, y / size);
      };
      stick.addEventListener("pointerdown", (event) => {
        if (this.holding[index] !== null) return;
        this.holding[index] = event.pointerId;
        stick.setPointerCapture(event.pointerId);
        follow(event);
      });
      stick.addEventListener("pointermove", (event) => {
        if (event.pointerId === this.holding[index]) follow(event);
      });
      // A thumb that is lifted, or that the system takes for a gesture of its own.
      for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) {
        stick.addEventListener(kind, (event) => {
          if (event.pointerId !== this.holding[index]) return;
          this.holding[index] = null;
          put(0, 0);
        });
      }
      stick.addEventListener("contextmenu", (event) => event.preventDefault());
    });
  }

  isHeld() {
    return this.holding.some((pointer) => pointer !== null);
  }

  read(running) {
    return { axes: this.axes, buttons: [], connected: document.visibilityState === "visible", running };
  }
}
