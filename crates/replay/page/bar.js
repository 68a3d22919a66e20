// The strip above the time bar: when each condition held, what happened, and where we are.

import { element, words } from "./words.js";

const LANE = 11;
const GAP = 4;
const MARKS = 9;
// A foot or hand that is pressed with less touches nothing, N.
const TOUCH = 5;

export class Bar {
  // `span` is the time that the strip stands for, where that is not the track's own.
  constructor(canvas, doc, track, seek, span = track) {
    this.span = span;
    this.canvas = canvas;
    this.doc = doc;
    this.track = track;
    this.lanes = [...conditionLanes(doc, track), ...footLanes(doc, track)];
    this.nameLanes();
    this.height = MARKS + this.lanes.length * (LANE + GAP);
    canvas.style.height = `${this.height}px`;
    // On a telephone the lanes go under the picture when the page is scrolled, and the buttons stay.
    document.documentElement.style.setProperty("--lanes", `${this.height}px`);
    this.strip = document.createElement("canvas");
    this.dirty = true;
    const at = (event) => {
      const box = canvas.getBoundingClientRect();
      seek(this.stepAt(event.clientX - box.left, box.width));
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      at(event);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (event.buttons > 0) at(event);
    });
  }

  // The names stand to the left of the lanes, as text.
  nameLanes() {
    const names = this.lanes.map(({ name, colour }) => element("li", { className: `of-${colour}` }, name));
    this.canvas.previousElementSibling.append(...names);
  }

  setTheme(theme) {
    this.theme = theme;
    this.dirty = true;
  }

  stepAt(x, width) {
    const { first, last } = this.span;
    return first + ((last - first) * x) / Math.max(width, 1);
  }

  xOf(step, width) {
    const { first, last } = this.span;
    return ((step - first) / Math.max(last - first, 1)) * width;
  }

  draw(step) {
    const width = this.canvas.clientWidth;
    const scale = Math.min(devicePixelRatio, 2);
    const size = [Math.round(width * scale), Math.round(this.height * scale)];
    if (this.dirty || this.strip.width !== size[0] || this.strip.height !== size[1]) {
      for (const canvas of [this.strip, this.canvas]) [canvas.width, canvas.height] = size;
      this.paintStrip(width, scale);
      this.dirty = false;
    }
    const pen = this.canvas.getContext("2d");
    pen.clearRect(0, 0, ...size);
    pen.drawImage(this.strip, 0, 0);
    pen.fillStyle = this.theme.ink;
    pen.fillRect(Math.round(this.xOf(step, size[0] - 2 * scale)), 0, 2 * scale, size[1]);
  }

  paintStrip(width, scale) {
    const pen = this.strip.getContext("2d");
    pen.setTransform(scale, 0, 0, scale, 0, 0);
    pen.clearRect(0, 0, width, this.height);
    this.lanes.forEach((lane, index) => {
      const y = MARKS + index * (LANE + GAP);
      pen.fillStyle = this.theme.track;
      pen.fillRect(0, y, Math.max(this.xOf(this.track.last, width), 0.75), LANE);
      pen.fillStyle = this.theme[lane.colour];
      this.spans(lane, (from, to) => {
        const x = this.xOf(from, width);
        pen.fillRect(x, y, Math.max(this.xOf(to, width) - x, 0.75), LANE);
      });
    });
    for (const { step, kind } of this.doc.events) {
      if (kind === "start") continue;
      pen.fillStyle = kind === "attachment" ? this.theme.accent : this.theme.alarm;
      const x = Math.min(Math.max(this.xOf(step, width), 4), width - 4);
      pen.beginPath();
      pen.moveTo(x - 4, 0);
      pen.lineTo(x + 4, 0);
      pen.lineTo(x, MARKS - 2);
      pen.fill();
    }
  }

  // Steps from which to which a lane holds.
  spans({ steps, holds }, each) {
    let from = null;
    for (let row = 0; row < steps.length; row += 1) {
      const held = holds(row);
      if (held && from === null) from = steps[row];
      if (!held && from !== null) {
        each(from, steps[row]);
        from = null;
      }
    }
    if (from !== null) each(from, this.track.last);
  }
}

// A lane for each condition of the gates.
function conditionLanes({ conditions }, { steps, flags }) {
  const criteria = conditions ? conditions.criteria : [];
  return criteria.map(({ name, published }, index) => ({
    name: words(name),
    colour: published ? "held" : "accent",
    steps,
    holds: (row) => (flags[row] & (1 << index)) !== 0,
  }));
}

// A lane for each foot: when it stands on floor or ladder.
function footLanes({ stage }, track) {
  const sides = ["left", "right"].map((side) => {
    const isFoot = ({ by, frame }) => ["floor", "ladder"].includes(by) && stage.frames[frame].name.startsWith(`${side}_ankle`);
    return [side, track.forces.flatMap((force, index) => (isFoot(force) ? [index] : []))];
  });
  return sides
    .filter(([, forces]) => forces.length > 0)
    .map(([side, forces]) => ({
      name: `${side} foot bears`,
      colour: "soft",
      steps: track.keptSteps,
      holds: (row) => forces.some((force) => Math.hypot(...track.force({ from: row }, force)) > TOUCH),
    }));
}
