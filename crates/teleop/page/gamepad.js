// The first gamepad of the standard mapping. It drives from its first press on, until a key is pressed.

// Pads differ: a button may be a number or an object, and what is not connected may say anything.
const number = (value) => (Number.isFinite(value) ? Math.max(-1, Math.min(1, value)) : 0);
const valueOf = (button) => number(typeof button === "number" ? button : button?.value ?? (button?.pressed ? 1 : 0));

export class Gamepad {
  pad() {
    let pads = [];
    try {
      // Without a secure context, or where the page may not, browsers lack it or throw.
      pads = navigator.getGamepads?.() ?? [];
    } catch {
      return null;
    }
    // One that was unplugged may stay in its place, with what it said last.
    const usable = Array.from(pads).filter((pad) => pad?.mapping === "standard" && pad.axes && pad.buttons);
    return usable.find((pad) => pad.connected !== false) ?? null;
  }

  // True while it is moved.
  isMoved() {
    const pad = this.pad();
    return pad !== null && (Array.from(pad.buttons).some((button) => valueOf(button) > 0.1) || Array.from(pad.axes).some((axis) => Math.abs(number(axis)) > 0.2));
  }

  atRest() {
    return { axes: [], buttons: [], connected: true, running: false };
  }

  read(running) {
    const pad = this.pad();
    const axes = pad ? Array.from(pad.axes, number).slice(0, 4) : [];
    const buttons = pad ? Array.from(pad.buttons, valueOf).slice(0, 17) : [];
    return { axes, buttons, connected: pad !== null && document.visibilityState === "visible", running };
  }
}
