// Curves of one joint over time: angle and target, their difference, and effort with its limits.

import { bytesOf, unplaned } from "./data.js";
import { element, words } from "./words.js";

const HEIGHT = 74;

// The plots: for each its name, its unit, and its curves out of a reading function.
const PLOTS = [
  { name: "Angle and target", unit: "rad", curves: [["soft", (of) => of("target")], ["accent", (of) => of("angle")]] },
  { name: "Tracking error", unit: "rad", curves: [["accent", (of) => of("target") - of("angle")]] },
  { name: "Effort", unit: "N m", curves: [["held", (of) => of("effort")]], limit: ({ effort_limit: limit }) => limit },
];

export class Plots {
  // Nothing is fetched before the fold is opened.
  constructor(root, { doc, track }, address, seek) {
    this.track = track;
    this.joints = doc.track.joints ?? [];
    this.grid = doc.track.grid;
    this.step = track.first;
    if (this.joints.length === 0) return;
    this.select = element("select", { ariaLabel: "Joint" }, ...this.joints.map(({ name }, index) => new Option(words(name), String(index))));
    this.select.value = String(Math.max(this.joints.findIndex(({ name }) => name.includes("knee")), 0));
    this.select.addEventListener("change", () => this.draw());
    this.plots = PLOTS.map((plot) => {
      const canvas = element("canvas", { className: "plot" });
      canvas.setAttribute("role", "img");
      canvas.addEventListener("pointerdown", (event) => {
        const { left, width } = canvas.getBoundingClientRect();
        seek(track.first + ((event.clientX - left) / Math.max(width, 1)) * (track.last - track.first));
      });
      return { ...plot, canvas, said: element("span", {}, "") };
    });
    this.fold = element(
      "details",
      { className: "joints" },
      element("summary", {}, "Joints: angle, tracking, effort"),
      this.select,
      ...this.plots.flatMap(({ name, canvas, said }) => [element("p", { className: "small soft plot-name" }, name, said), canvas]),
    );
    this.fold.addEventListener("toggle", async () => {
      if (!this.fold.open || this.numbers) return this.draw();
      try {
        const buffer = await bytesOf(address, "joints.bin");
        if (buffer.byteLength !== 4 * 2 * this.joints.length * track.keptSteps.length) throw new Error("they have another length than announced");
        this.numbers = unplaned(new Uint8Array(buffer), 2 * this.joints.length);
        this.draw();
      } catch (error) {
        this.fold.append(element("p", { className: "small" }, `The joints cannot be shown: ${error.message}`));
      }
    });
    root.append(this.fold);
  }

  // A number of the chosen joint in a kept row.
  read(row) {
    const [joint, count] = [Number(this.select.value), this.joints.length];
    return (part) => {
      if (part === "angle") return this.track.angles[row * count + joint];
      if (part === "target") return this.numbers[2 * row * count + joint] * this.grid.pose;
      return this.numbers[(2 * row + 1) * count + joint] * this.grid.effort;
    };
  }

  show(step) {
    this.step = step;
    if (this.fold?.open && this.numbers) this.draw();
  }

  draw() {
    if (!this.numbers) return;
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(`--${name}`).trim();
    for (const plot of this.plots) this.drawPlot(plot, colour);
  }

  drawPlot({ name, unit, curves, limit, canvas, said }, colour) {
    const { first, last, keptSteps } = this.track;
    const scale = Math.min(devicePixelRatio, 2);
    const width = canvas.clientWidth;
    [canvas.width, canvas.height] = [Math.round(width * scale), HEIGHT * scale];
    const pen = canvas.getContext("2d");
    pen.scale(scale, scale);
    const lines = curves.map(([shade, value]) => [shade, Array.from(keptSteps, (_, row) => value(this.read(row)))]);
    const bound = limit?.(this.joints[Number(this.select.value)]);
    let [low, high] = [Infinity, -Infinity];
    for (const [, values] of lines) for (const value of values) [low, high] = [Math.min(low, value), Math.max(high, value)];
    if (bound && high > 0.5 * bound) high = Math.max(high, bound);
    if (bound && low < -0.5 * bound) low = Math.min(low, -bound);
    const margin = Math.max(0.06 * (high - low), 1e-3);
    const x = (step) => ((step - first) / Math.max(last - first, 1)) * width;
    const y = (value) => HEIGHT - ((value - low + margin) / (high - low + 2 * margin)) * HEIGHT;
    const rule = (at, shade, dash) => {
      pen.strokeStyle = colour(shade);
      pen.setLineDash(dash);
      pen.beginPath();
      pen.moveTo(0, y(at));
      pen.lineTo(width, y(at));
      pen.stroke();
      pen.setLineDash([]);
    };
    if (low < 0 && high > 0) rule(0, "line", []);
    for (const at of bound ? [bound, -bound] : []) if (at >= low && at <= high) rule(at, "alarm", [5, 4]);
    pen.lineWidth = 1.4;
    for (const [shade, values] of lines) {
      pen.strokeStyle = colour(shade);
      pen.beginPath();
      values.forEach((value, row) => pen.lineTo(x(keptSteps[row]), y(value)));
      pen.stroke();
    }
    pen.fillStyle = colour("ink");
    pen.fillRect(x(this.step) - 0.75, 0, 1.5, HEIGHT);
    const { from } = this.track.around(this.step);
    const now = lines.map(([, values]) => values[from].toFixed(unit === "rad" ? 3 : 1)).reverse().join(", target ");
    const text = `${now} ${unit}${bound ? ` of ${bound}` : ""}`;
    said.textContent = text;
    canvas.setAttribute("aria-label", `${name}: ${text}; from ${low.toFixed(2)} to ${high.toFixed(2)} ${unit}`);
  }
}
