// The card of keys and buttons; `docs/teleoperation.md` has the same.

import { element } from "./words.js";

export const CARD = {
  Keyboard: [
    ["W S", "walk forwards, backwards"],
    ["A D", "step to the left, right"],
    ["Q E", "turn left, right"],
    ["R F", "rise, crouch"],
    ["G T", "lean forwards, back"],
    ["Y H", "turn the torso left, right"],
    ["1 2", "choose the left, right hand"],
    ["I K J L O U", "move it forwards, back, left, right, up, down"],
    ["↓ ↑ ← → . ,", "pitch, yaw, roll it"],
    ["Space", "close or open it"],
    ["PgUp PgDn", "look up, down by the robot's eye"],
    ["Enter", "start, stop"],
    ["P Del N", "save, discard, next room"],
  ],
  "Thumb sticks on a touch screen": [
    ["Left", "walk, step sideways"],
    ["Right", "turn; rise, crouch"],
  ],
  Gamepad: [
    ["Left stick", "walk, step sideways"],
    ["Right stick", "turn; rise, crouch"],
    ["LB RB held", "sticks move the left, right hand"],
    ["LT RT", "close the left, right hand"],
    ["Cross", "lean; turn the torso"],
    ["A", "start, stop"],
    ["X B Y", "save, discard, next room"],
  ],
  Headset: [
    ["Squeeze held", "the hand repeats your hand's motion"],
    ["Trigger", "close the hand"],
    ["Left stick", "walk, step sideways"],
    ["Right stick", "turn; rise, crouch"],
    ["Left stick click", "centre the view and where forwards is"],
    ["A", "start, stop"],
    ["X Y B", "save, discard, next room"],
  ],
  "Hands without controllers": [
    ["Thumb on index finger, held", "the other hand and its fingers repeat yours"],
    ["Thumb on left middle finger, held", "drag to walk, step sideways"],
    ["Thumb on right middle finger, held", "drag sideways to turn; up, down to rise, crouch"],
    ["Point at the board and pinch", "start, stop, save, discard, next room"],
  ],
};

export function showCard(root) {
  for (const [name, rows] of Object.entries(CARD)) {
    const keys = (text) => text.split(" ").flatMap((key, index) => [...(index > 0 ? [" "] : []), element("kbd", {}, key)]);
    const line = ([key, does]) =>
      element("tr", {}, element("th", { scope: "row" }, ...(name === "Keyboard" ? keys(key) : [key])), element("td", {}, does));
    root.append(element("table", {}, element("caption", {}, name), element("tbody", {}, ...rows.map(line))));
  }
}
