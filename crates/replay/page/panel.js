// The panel next to the picture: the episode, its verdicts, conditions that light up, forces, events, notes.

import { isFile } from "./data.js";
import { Pictures } from "./pictures.js";
import { Plots } from "./plots.js";
import { element, seconds, words } from "./words.js";

// A bulb that a hand presses with less is not in it, N.
const TOUCH = 0.05;

const FLAG = {
  oldSeated: 1 << 16,
  freshSeated: 1 << 17,
  published: 1 << 18,
  strict: 1 << 19,
  broken: 1 << 20,
  dropped: 1 << 21,
};

const CAUSES = ["success", "fall", "tip", "crush", "drop", "unseated", "impact", "diverged"];
export const chip = (cause) =>
  element("span", { className: `chip c-${CAUSES.includes(cause) ? cause : "other"}` }, words(cause));

// A task whose name says it all needs no number.
export const titleOf = ({ task, name }) =>
  name.toLowerCase() === task.toLowerCase() || name === "" ? name || task : `${task} ${name}`;

export class Panel {
  // `address` is that of the episode, where that is not this page.
  constructor(root, { doc, track }, seek, { address = location.pathname.replace(/\/$/, ""), isOneOfTwo = false } = {}) {
    this.address = address;
    this.isOneOfTwo = isOneOfTwo;
    this.doc = doc;
    this.track = track;
    this.lamps = [];
    this.gates = [];
    root.append(this.head());
    this.pictures = doc.pictures.length > 0 ? new Pictures(root, track, address, doc.pictures) : null;
    root.append(this.verdicts(seek));
    if (doc.notes.length > 0)
      root.append(section("Notes", element("ul", { className: "notes" }, ...doc.notes.map((note) => element("li", {}, note)))));
    if (doc.conditions) root.append(this.conditions());
    root.append(this.state());
    this.plots = new Plots(root, { doc, track }, address, seek);
    root.append(this.events(seek), keys());
  }

  head() {
    const { episode } = this.doc;
    if (!this.isOneOfTwo) document.title = `${episode.task}, seed ${episode.seed}: Fiatlux replay`;
    const facts = [`Policy ${episode.policy || "without a name"}`, `seed ${episode.seed}`];
    if (episode.episode !== "0") facts.push(`episode ${episode.episode}`);
    facts.push(episode.robot, `benchmark version ${episode.benchmark_version}`);
    const bag = isFile()
      ? element("p", { className: "soft small" }, `Recorded in ${episode.bag}.`)
      : element(
          "p",
          { className: "small" },
          element("a", { href: `${this.address}/bag`, download: episode.bag }, `Download the bag`),
          element("span", { className: "soft" }, ` ${episode.bag}`),
        );
    return element(
      "header",
      {},
      ...this.isOneOfTwo
        ? []
        : [
            element("h1", {}, titleOf(episode)),
            element("p", { className: "said" }, `\u201c${episode.instruction}\u201d`),
          ],
      element("p", { className: "soft small" }, `${facts.join(", ")}.`),
      bag,
    );
  }

  verdicts(seek) {
    const { rulings, recorded_end: recorded } = this.doc;
    const lines = rulings.map((ruling) => {
      const line = element(
        "li",
        {},
        element("b", {}, ruling.protocol),
        // A take that its operator stopped has all its rows.
        chip(ruling.end ?? (recorded === "stopped" ? recorded : "cut")),
        element("span", {}, seconds(ruling.steps, this.track.dt)),
        element("span", { className: "soft" }, `progress ${ruling.progress.toFixed(2)}`),
      );
      for (const [is, name] of [
        [ruling.broken, "broken"],
        [ruling.dropped, "dropped"],
      ]) {
        if (is) line.append(element("span", { className: "flag" }, name));
      }
      return line;
    });
    const failed = rulings.find(({ end }) => end && end !== "success");
    if (failed) {
      const jump = element("button", { type: "button", id: this.isOneOfTwo ? "" : "failure" }, `Jump to the ${words(failed.end)}`);
      // A second before, to see it come.
      jump.addEventListener("click", () => seek(failed.steps - 1 / this.track.dt));
      lines.push(element("li", {}, jump));
    }
    if (rulings.length === 0) lines.push(element("li", {}, recorded ? chip(recorded) : "not known"));
    return section("Verdict", element("ul", { className: "verdicts" }, ...lines));
  }

  conditions() {
    const { criteria, published_window: published, strict_window: strict } = this.doc.conditions;
    const count = criteria.filter((criterion) => criterion.published).length;
    const list = (from, to) =>
      element(
        "ul",
        { className: "lamps" },
        ...criteria.slice(from, to).map((criterion) => {
          const lamp = element(
            "li",
            { className: "lamp" },
            element("i"),
            element("span", {}, words(criterion.name)),
            element("em", {}, ""),
          );
          this.lamps.push({ lamp, said: lamp.lastChild, held: null });
          return lamp;
        }),
      );
    const gate = (name, window, mask, fired) => {
      const meter = element("progress", { max: window, value: 0, ariaLabel: `${name}: rows in which all hold` });
      const text = element("span", { className: "small soft" }, "");
      this.gates.push({ meter, text, mask, fired, window, runs: this.runs(mask), last: null });
      return element("div", { className: "gate" }, meter, text);
    };
    const all = (1 << criteria.length) - 1;
    const first = (1 << count) - 1;
    return section(
      "Conditions",
      element("h3", {}, element("i", { className: "k-published" }), "Published gate"),
      list(0, count),
      gate("Published gate", published, first, FLAG.published),
      element("h3", {}, element("i", { className: "k-strict" }), "Strict also asks for"),
      list(count, criteria.length),
      gate("Strict gate", strict, all, FLAG.strict),
    );
  }

  // For how many rows, up to each, all of a mask have held.
  runs(mask) {
    const { flags, steps } = this.track;
    const runs = new Uint32Array(flags.length);
    for (let row = 1; row < flags.length; row += 1) {
      const follows = steps[row] === steps[row - 1] + 1;
      runs[row] = (flags[row] & mask) === mask ? (follows ? runs[row - 1] : 0) + 1 : 0;
    }
    return runs;
  }

  state() {
    this.readings = ["Force on hands", "Old bulb", "Fresh bulb"].map((name) => {
      return { name: element("dt", {}, name), value: element("dd", {}, "") };
    });
    const list = element("dl", {}, ...this.readings.flatMap(({ name, value }) => [name, value]));
    return section(
      "Now",
      list,
      element(
        "p",
        { className: "small soft legend" },
        element("span", {}, element("i", { className: "k-floor" }), "floor"),
        element("span", {}, element("i", { className: "k-ladder" }), "ladder (0.16 m for 100 N)"),
        element("span", {}, element("i", { className: "k-bulb" }), "bulb on a hand (0.10 m for 10 N)"),
      ),
    );
  }

  events(seek) {
    const items = this.doc.events.map(({ step, kind, subject, change, detail }) => {
      const what = [kind, subject, change]
        .filter((part) => part !== "")
        .map(words)
        .join(" ");
      const button = element(
        "button",
        { type: "button", className: "event" },
        element("span", { className: "time" }, seconds(step, this.track.dt)),
        element("span", {}, detail === "" ? what : `${what} (${words(detail)})`),
      );
      button.addEventListener("click", () => seek(step));
      return element("li", {}, button);
    });
    return section(
      "Events",
      items.length === 0 ? element("p", { className: "soft" }, "None.") : element("ul", { className: "events" }, ...items),
    );
  }

  // Where a bulb is: which hands press on it; else how high it is.
  whereIs(name, step) {
    const { frames } = this.doc.stage;
    const around = this.track.around(step);
    const sides = ["left", "right"].filter((side) =>
      this.track.forces.some(
        ({ by, frame }, index) =>
          by === name && frames[frame].name.startsWith(side) && Math.hypot(...this.track.force(around, index)) > TOUCH,
      ),
    );
    if (sides.length > 0) return sides.length === 2 ? "in both hands" : `in the ${sides[0]} hand`;
    const position = [0, 0, 0];
    this.track.poseAt(around, frames.findIndex((frame) => frame.name === name), position, [0, 0, 0, 1]);
    return `free, ${Math.max(position[2], 0).toFixed(2)} m above the floor`;
  }

  show(step) {
    const row = this.track.row(step);
    const flags = this.track.flags[row];
    this.lamps.forEach((entry, index) => {
      const held = (flags & (1 << index)) !== 0;
      if (held === entry.held) return;
      entry.held = held;
      entry.lamp.classList.toggle("on", held);
      entry.said.textContent = held ? "holds" : "does not hold";
    });
    for (const gate of this.gates) {
      const text =
        (flags & gate.fired) !== 0
          ? "The gate has fired."
          : `All hold for ${seconds(gate.runs[row], this.track.dt)} of ${seconds(gate.window, this.track.dt)}.`;
      if (text === gate.last) continue;
      gate.last = text;
      gate.text.textContent = text;
      gate.meter.value = (flags & gate.fired) !== 0 ? gate.window : Math.min(gate.runs[row], gate.window);
    }
    const bulb = (name, flag) => ((flags & flag) !== 0 ? "in the socket" : this.whereIs(name, step));
    const limit = this.doc.conditions ? ` of ${this.doc.conditions.fragility_n} N` : "";
    const hurt = [
      [FLAG.broken, "broken"],
      [FLAG.dropped, "dropped"],
    ]
      .filter(([flag]) => (flags & flag) !== 0)
      .map(([, name]) => `, a bulb is ${name}`)
      .join("");
    const values = [`${this.track.handForce[row].toFixed(1)} N${limit}${hurt}`, bulb("old_bulb", FLAG.oldSeated), bulb("fresh_bulb", FLAG.freshSeated)];
    values.forEach((value, index) => {
      const reading = this.readings[index].value;
      if (reading.textContent !== value) reading.textContent = value;
    });
    this.plots.show(step);
    this.pictures?.show(step);
    return { freshSeated: (flags & FLAG.freshSeated) !== 0 };
  }
}

function section(title, ...content) {
  return element("section", {}, element("h2", {}, title), ...content);
}

function keys() {
  const rows = [
    ["Space", "play or pause"],
    ["\u2190 \u2192", "one second; with Shift one step"],
    ["Home End", "first and last row"],
    ["+ \u2212", "speed"],
    ["F", "follow the robot"],
    ["C", "contact forces"],
    ["V", "reset the view"],
  ];
  const list = element(
    "dl",
    { className: "keys" },
    ...rows.flatMap(([key, what]) => [element("dt", {}, key), element("dd", {}, what)]),
  );
  return element("details", {}, element("summary", {}, "Keys"), list);
}
