// Puts the replay together.

import { Bar } from "./bar.js";
import { controls, fail, find, stageOf, watch } from "./controls.js";
import { load } from "./data.js";
import { Panel } from "./panel.js";
import { Player } from "./player.js";

async function start() {
  const replay = await load();
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
    stage?.draw(step, row);
    bar.draw(step);
    time.value = Math.round(step);
    const now = `${(step * track.dt).toFixed(2)} s`;
    time.setAttribute("aria-valuetext", now);
    clock.textContent = `${now} of ${(track.last * track.dt).toFixed(2)} s`;
  });
  controls(player, stage ? [stage] : [], track);
  watch(player, stage ? [stage] : [], [bar]);
  const asked = Number(new URLSearchParams(location.hash.slice(1)).get("t"));
  if (Number.isFinite(asked) && asked > 0) player.seek(asked / track.dt);
  document.documentElement.dataset.ready = "true";
}

start().catch((error) => fail(`The replay cannot be shown: ${error.message}`));
