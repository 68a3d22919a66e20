// Keys that are held. The server knows what they do.

const OURS = new Set(
  "KeyW KeyS KeyA KeyD KeyQ KeyE KeyR KeyF KeyT KeyG KeyH KeyY KeyI KeyK KeyJ KeyL KeyU KeyO Comma Period ArrowUp ArrowDown ArrowLeft ArrowRight Digit1 Digit2 Space Enter KeyP Delete KeyN".split(" "),
);

// Keys by which a person asks the browser or the system for something. While one is down, systems keep to themselves that others go up.
const MODIFIERS = new Set(["Meta", "OS", "Control", "Alt", "AltGraph"]);
// What else takes the keys away without saying which are let go: another window, a menu, a dialogue, a dragged picture, another tab.
const TAKERS = ["blur", "contextmenu", "dragstart", "pagehide", "freeze", "beforeprint", "fullscreenchange", "visibilitychange", "compositionstart"];

export class Keyboard {
  constructor() {
    this.held = new Set();
    // Down since the last message, if only for a moment.
    this.tapped = new Set();
    addEventListener("keydown", (event) => {
      // Rather a robot that stops than one that walks on by itself: keys that are still down count when they are pressed again.
      if (MODIFIERS.has(event.key) || event.ctrlKey || event.metaKey || event.altKey) {
        this.held.clear();
        return;
      }
      if (!OURS.has(event.code)) return;
      // Text that is being written, which belongs to its field and to the system's editor of it.
      if (event.isComposing || event.target.closest?.("input, textarea, select, [contenteditable]")) return;
      // A button with the focus has its own keys.
      if (event.target.closest?.("button, a, summary") && ["Space", "Enter"].includes(event.code)) return;
      event.preventDefault();
      // A repetition is no press: what was taken away stays away.
      if (event.repeat) return;
      this.held.add(event.code);
      this.tapped.add(event.code);
    });
    addEventListener("keyup", (event) => {
      if (MODIFIERS.has(event.key)) this.held.clear();
      this.held.delete(event.code);
    });
    for (const kind of TAKERS) for (const target of [globalThis, document]) target.addEventListener(kind, () => this.held.clear());
  }

  read(running) {
    const keys = [...this.held, ...this.tapped].filter((key, index, all) => all.indexOf(key) === index);
    this.tapped.clear();
    return { keys, focused: document.hasFocus() && document.visibilityState === "visible", running };
  }
}
