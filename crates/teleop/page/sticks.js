// Two thumb sticks on a touch screen. They send what a gamepad does.

// What takes a thumb away without an end of its touch.
const TAKERS = ["blur", "pagehide", "freeze", "visibilitychange"];

export class Sticks {
  // The elements of the left and the right stick, each with its knob in it.
  constructor(elements) {
    this.axes = [0, 0, 0, 0];
    this.holding = elements.map(() => null);
    const release = elements.map((stick, index) => {
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
      const letGo = () => {
        this.holding[index] = null;
        put(0, 0);
      };
      stick.addEventListener("pointerdown", (event) => {
        if (this.holding[index] !== null) return;
        try {
          stick.setPointerCapture(event.pointerId);
        } catch {
          // It is lifted already: nothing would tell when to stop.
          return;
        }
        this.holding[index] = event.pointerId;
        follow(event);
      });
      stick.addEventListener("pointermove", (event) => {
        if (event.pointerId === this.holding[index]) follow(event);
      });
      // A thumb that is lifted, or that the system takes for a gesture of its own.
      for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) {
        stick.addEventListener(kind, (event) => {
          if (event.pointerId === this.holding[index]) letGo();
        });
      }
      stick.addEventListener("contextmenu", (event) => event.preventDefault());
      return letGo;
    });
    for (const kind of TAKERS) for (const target of [globalThis, document]) target.addEventListener(kind, () => release.forEach((one) => one()));
  }

  isHeld() {
    return this.holding.some((pointer) => pointer !== null);
  }

  read(running) {
    return { axes: this.axes, buttons: [], connected: document.visibilityState === "visible", running };
  }
}
