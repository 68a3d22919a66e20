// Keys that are held. The server knows what they do.

const OURS = new Set(
  "KeyW KeyS KeyA KeyD KeyQ KeyE KeyR KeyF KeyT KeyG KeyH KeyY KeyI KeyK KeyJ KeyL KeyU KeyO Comma Period ArrowUp ArrowDown ArrowLeft ArrowRight Digit1 Digit2 Space Enter KeyP Delete KeyN".split(" "),
);

export class Keyboard {
  constructor() {
    this.held = new Set();
    // Down since the last message, if only for a moment.
    this.tapped = new Set();
    addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || !OURS.has(event.code)) return;
      // A button with the focus has its own keys.
      if (event.target.closest?.("button, a, summary") && ["Space", "Enter"].includes(event.code)) return;
      event.preventDefault();
      this.held.add(event.code);
      this.tapped.add(event.code);
    });
    addEventListener("keyup", (event) => this.held.delete(event.code));
    addEventListener("blur", () => this.held.clear());
  }

  read(running) {
    const keys = [...new Set([...this.held, ...this.tapped])];
    this.tapped.clear();
    return { keys, focused: document.hasFocus() && document.visibilityState === "visible", running };
  }
}
