// Two replays side by side, with one time bar.

import { Bar } from "./bar.js";
import { clockText, controls, fail, find, loading, moments, stageOf, watch } from "./controls.js";
import { load } from "./data.js";
import { Panel, titleOf } from "./panel.js";
import { Player } from "./player.js";
import { seconds } from "./words.js";

const SIDES = ["a", "b"];

find("late").remove();

async function start() {
  const addresses = SIDES.map((side) => find("pair").dataset[side]);
  const replays = await Promise.all(addresses.map((address) => load(address, loading)));
  const [{ doc }] = replays;
  const tracks = replays.map(({ track }) => track);
  // The longer one gives the time; the other one stands still at its end.
  const span = {
    first: Math.min(...tracks.map(({ first }) => first)),
    last: Math.max(...tracks.map(({ last }) => last)),
    dt: tracks[0].dt,
  };
  let player = null;
  // Whose camera moved last.
  let turned = 0;
  const stages = replays.map((replay, index) =>
    stageOf(find(`view-${SIDES[index]}`), replay, () => {
      turned = index;
      player?.ask();
    }),
  );
  const seek = (step) => player.seek(step);
  const bars = replays.map(
    (replay, index) => new Bar(find(`strip-${SIDES[index]}`), replay.doc, replay.track, seek, span),
  );
  const panels = replays.map(
    (replay, index) => new Panel(find(`panel-${SIDES[index]}`), replay, seek, { address: addresses[index], isOneOfTwo: true }),
  );
  replays.forEach((replay, index) => {
    find(`name-${SIDES[index]}`).textContent = `${SIDES[index].toUpperCase()}: ${replay.doc.episode.policy || "without a name"}`;
  });
  find("title").textContent = `${titleOf(doc.episode)}, seed ${doc.episode.seed}`;
  const isShown = stages.every((stage) => stage !== null);
  let isTogether = isShown;
  const [time, clock, together] = ["time", "clock", "together"].map(find);
  player = new Player(span, (step) => {
    const rows = panels.map((panel) => panel.show(step));
    if (isTogether) stages[1 - turned].copyView(stages[turned]);
    stages.forEach((stage, index) => stage?.draw(step, rows[index], player.playing));
    for (const bar of bars) bar.draw(step);
    time.value = Math.round(step);
    time.setAttribute("aria-valuetext", seconds(step, span.dt));
    clock.textContent = clockText(player, step, span);
  });
  together.addEventListener("click", () => {
    if (!isShown) return;
    isTogether = !isTogether;
    together.setAttribute("aria-pressed", String(isTogether));
    player.ask();
  });
  const shown = stages.filter((stage) => stage !== null);
  controls(player, shown, span);
  watch(player, shown, bars);
  moments(player, span);
  document.documentElement.dataset.ready = "true";
}

start().catch((error) => fail(`The replays cannot be shown: ${error.message}`));
