// The first gamepad of the standard mapping. It drives from its first press on, until a key is pressed.

export class Gamepad {
  pad() {
    return [...(navigator.getGamepads?.() ?? [])].find((pad) => pad?.mapping === "standard") ?? null;
  }

  // True while it is moved.
  isMoved() {
    const pad = this.pad();
    return pad !== null && (pad.buttons.some(({ value }) => value > 0.1) || pad.axes.some((axis) => Math.abs(axis) > 0.2));
  }

  atRest() {
    return { axes: [], buttons: [], connected: true, running: false };
  }

  read(running) {
    const pad = this.pad();
    const axes = pad ? [...pad.axes].slice(0, 4) : [];
    const buttons = pad ? [...pad.buttons].slice(0, 17).map(({ value }) => value) : [];
    return { axes, buttons, connected: pad?.connected === true && document.visibilityState === "visible", running };
  }
}
