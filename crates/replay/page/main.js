// Puts the replay together.

import { Bar } from "./bar.js";
import { clockText, controls, fail, find, loading, moments, stageOf, watch } from "./controls.js";
import { load } from "./data.js";
import { Panel } from "./panel.js";
import { Player } from "./player.js";
import { seconds } from "./words.js";

find("late").remove();

async function start() {
  const replay = await load(undefined, loading);
  const { track, doc } = replay;
  let player = null;
  // A browser without WebGL still gets the conditions.
  const stage = stageOf(find("view"), replay, () => player?.ask());
  const bar = new Bar(find("strip"), doc, track, (step) => player.seek(step));
  const panel = new Panel(find("panel"), replay, (step) => player.seek(step));
  const time = find("time");
  const clock = find("clock");
  player = new Player(track, (step) => {
    const row = panel.show(step);
    stage?.draw(step, row, player.playing);
    bar.draw(step);
    time.value = Math.round(step);
    time.setAttribute("aria-valuetext", seconds(step, track.dt));
    clock.textContent = clockText(player, step, track);
  });
  controls(player, stage ? [stage] : [], track);
  watch(player, stage ? [stage] : [], [bar]);
  moments(player, track);
  document.documentElement.dataset.ready = "true";
}

start().catch((error) => fail(`The replay cannot be shown: ${error.message}`));
