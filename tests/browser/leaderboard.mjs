// Looks at the leaderboard with a real browser.
//
//   node leaderboard.mjs ADDRESS SCREENSHOTS
//
// ADDRESS is that of `scorer serve`, which has two runs with a place in the same rooms, and one without, or will once they are
// graded.
// Exit code 0 when every check holds.

import { mkdir } from "node:fs/promises";

import { PATIENCE_MS, accessible, check, clock, close, drawn, end, everywhere, fits, open, picture, seek } from "./common.mjs";

const [address, screenshots] = process.argv.slice(2);

// Whether the server's pages say the same to a browser without JavaScript.
async function without(settings) {
  const plain = { ...settings, javaScriptEnabled: false };
  const opened = await open("no-script", address, plain, address, false);
  check((await opened.page.locator(".board tbody tr").count()) > 1, "no-script: the table is there");
  await opened.page.locator(".board a.policy").first().click();
  await opened.page.locator(".sq").first().click();
  check((await opened.page.locator("noscript").count()) === 1, "no-script: an episode says what is missing");
  check(await opened.page.locator(".below .figure").isVisible(), "no-script: its figure is there");
  await close(opened);
}

async function look(name, page, settings, full = true) {
  // A browser cannot make a picture of more pixels at once.
  const isTall = await page.page.evaluate(() => document.documentElement.scrollHeight * devicePixelRatio > 16000);
  const scale = isTall ? "css" : "device";
  await page.page.screenshot({ path: `${screenshots}/${name}.png`, fullPage: full, scale });
  await accessible(page);
  await fits(page, true);
  await close(page);
}

const pictureOf = async (page, views) => {
  const shots = [];
  for (const view of views) shots.push(await picture(page, view));
  return shots;
};

// What each view shows at the start, in the middle and at the end, where it stays. Side by side, the shorter one stands at its
// end while the longer one goes on.
async function moves(name, page, views) {
  const shots = [];
  for (const share of [0, 0.5, 1]) {
    await seek(page, share);
    shots.push(await pictureOf(page, views));
  }
  const goesOn = views.length > 1 || !shots[1][0].equals(shots[2][0]);
  for (const [index, view] of views.entries()) {
    check(!shots[0][index].equals(shots[1][index]) && goesOn, `${name} ${view}: the picture changes as time moves`);
  }
  return shots[2];
}

// All pictures of a page, which are asked for as they come into sight.
async function pictures({ name, page }) {
  await page.evaluate(async () => {
    const folds = [...document.querySelectorAll("details:not([open])")];
    for (const fold of folds) fold.open = true;
    for (const image of document.images) image.loading = "eager";
    await Promise.all([...document.images].map((image) => image.decode().catch(() => {})));
    // As a reader finds it; a picture of all that is folded would be longer than a browser can make one.
    for (const fold of folds) fold.open = false;
  });
  const [all, broken] = await page.evaluate(() => {
    const images = [...document.images];
    return [images.length, images.filter((image) => image.naturalWidth === 0).map((image) => image.src)];
  });
  check(all > 1 && broken.length === 0, `${name}: all ${all} pictures are shown`, broken.join(" "));
}

// The clip of a card: under a pointer on a desktop, by its button everywhere, and only by its button with reduced motion.
async function clips({ name, page }, card, kind) {
  const clip = card.locator(".clip-of");
  const plays = () => clip.evaluate((image) => image.checkVisibility() && image.complete && image.naturalWidth > 100);
  check(!(await clip.isVisible()), `${name}: clips do not play by themselves`);
  const button = card.locator(".play");
  await button.check();
  await page.waitForFunction((image) => image.complete && image.naturalWidth > 100, await clip.elementHandle());
  check(await plays(), `${name}: a button plays the clip`);
  await button.uncheck();
  await page.mouse.move(0, 0);
  check(!(await clip.isVisible()), `${name}: and stops it`);
  if (!kind.includes("desktop")) return;
  await card.locator("img").first().hover();
  check(await plays(), `${name}: a pointer plays the clip`);
  await page.emulateMedia({ reducedMotion: "reduce" });
  check(!(await clip.isVisible()), `${name}: not with reduced motion`);
  await page.emulateMedia({ reducedMotion: null });
  await page.mouse.move(0, 0);
}

// Until three submissions are graded, and the success of one is drawn.
async function graded() {
  const until = Date.now() + 4 * PATIENCE_MS;
  while (Date.now() < until) {
    const shown = await (await fetch(address)).text();
    if (shown.split('class="policy"').length > 3 && shown.includes("still.png")) return;
    await new Promise((done) => setTimeout(done, 500));
  }
  check(false, "three submissions are graded, and one is drawn");
  await end();
}

await mkdir(screenshots, { recursive: true });
await graded();
await everywhere(async (kind, settings) => {
  const at = (path, name, isReplay = false) => open(`${name}-${kind}`, new URL(path, address).href, settings, address, isReplay);

  const board = await at("/", "board");
  const rows = board.page.locator(".board tbody tr");
  check((await rows.count()) > 1, `${board.name}: has rows`);
  check((await rows.first().locator(".cell").count()) === 12, `${board.name}: a cell for each subtask`);
  const ranks = await board.page.locator(".board .rank").allTextContents();
  const zero = await board.page.locator(".board tr", { has: board.page.locator(".policy", { hasText: "zero" }) }).locator(".rank").allTextContents();
  check(ranks.length > 1 && zero.every((rank) => rank.trim() === "\u2013"), `${board.name}: no rank at zero`, zero.join(" "));
  check((await board.page.locator(".paper tr").count()) === 3, `${board.name}: the paper's rows, marked`);
  const named = await board.page.locator(".task-card h3 a, .open-tasks a").count();
  check(named === 12, `${board.name}: each subtask has its best, or is said to have none`, `${named}`);
  const best = board.page.locator(".task-card", { hasText: "S05" });
  check((await best.locator(".best").textContent()).includes("walk"), `${board.name}: S05 names the policy that succeeds`);
  const runs = await board.page.locator(".board a.policy").evaluateAll((links) => links.map((link) => link.getAttribute("href")));
  const winner = (await best.locator(".best a").getAttribute("href")).replace(/\/tasks.*/, "");
  const offers = await board.page.locator('.board a[href^="/compare?run="]').count();
  check(offers === runs.length, `${board.name}: runs in the same rooms can be compared`, `${offers}`);
  const order = await board.page.evaluate(() => {
    const [card, table] = [".task-card", ".board"].map((selector) => document.querySelector(selector));
    return (card.compareDocumentPosition(table) & Node.DOCUMENT_POSITION_FOLLOWING) !== 0;
  });
  check(order, `${board.name}: the gallery comes first`);
  check((await board.page.locator(".open-tasks").count()) === 1, `${board.name}: subtasks without a success are named`);
  await clips(board, best, kind);
  await board.page.keyboard.press("Tab");
  await look(board.name, board, settings);

  const run = await at(runs[0], "run");
  const squares = await run.page.locator(".sq").evaluateAll((links) => links.map((link) => link.getAttribute("href")));
  check(squares.length >= 12, `${run.name}: a square for each episode`, `${squares.length}`);
  const cards = await run.page.locator(".task-card").count();
  check(cards === 12 && (await run.page.locator(".episode").count()) === 0, `${run.name}: each subtask once`, `${cards}`);
  check((await run.page.locator("pre").last().textContent()).includes(`${address.replace(/\/$/, "")}/runs/`), `${run.name}: commands name this site`);
  await look(run.name, run, settings);
  const won = await at(winner, "run-won");
  await pictures(won);
  await look(won.name, won, settings);

  const subtask = await at("/tasks/S05", "subtask");
  const first = await subtask.page.locator(".of-task tr", { hasText: "walk" }).locator(".rank").textContent();
  check(first === "1", `${subtask.name}: the policy that succeeds is first of its division`, first);
  const clip = await subtask.page.locator(".clip img").evaluate((image) => image.decode().then(() => [image.naturalWidth, image.currentSrc]));
  check(clip[0] > 100 && clip[1].endsWith("clip.png"), `${subtask.name}: a clip of the best success`, clip.join(" "));
  await look(subtask.name, subtask, settings);

  const task = await at(`${runs[0]}/tasks/S05`, "task");
  await pictures(task);
  await look(task.name, task, settings);

  const carried = squares.find((href) => href.includes("S05")) ?? squares[0];
  const episode = await at(carried, "episode", true);
  await moves(episode.name, episode.page, ["#view"]);
  await episode.page.keyboard.press("Home");
  await drawn(episode.page);
  check((await clock(episode.page)).startsWith("0.00 s"), `${episode.name}: keys move it`);
  await seek(episode.page, 0.5);
  await episode.page.screenshot({ path: `${screenshots}/episode-top-${kind}.png` });
  await look(episode.name, episode, settings);

  const ids = runs.map((href) => href.split("/").pop());
  const start = await at("/compare", "compare-start");
  check((await start.page.locator(".partners a").count()) >= runs.length, `${start.name}: leads to a choice`);
  await look(start.name, start, settings);
  const choose = await at(`/compare?run=${ids[0]}`, "choose");
  check((await choose.page.locator(".partners a").count()) > 0, `${choose.name}: offers those that share episodes`);
  await look(choose.name, choose, settings);
  const compare = await at(`/compare?run=${ids[0]}&run=${ids[1]}`, "compare");
  check((await compare.page.locator(".ends tbody tr").count()) === 13, `${compare.name}: says how episodes ended`);
  const sides = compare.page.locator("a", { hasText: "side by side" });
  check((await sides.count()) > 1, `${compare.name}: episodes of both`);
  const side = await sides.nth((await sides.count()) > 15 ? 14 : 0).getAttribute("href");
  await look(compare.name, compare, settings);

  // Each kind of screen once, and each scheme: two replays are much to draw without a graphics card.
  if (["desktop-light", "telephone-dark"].includes(kind)) {
    const pair = await at(side, "pair", true);
    const views = ["#view-a", "#view-b"];
    const before = await moves(pair.name, pair.page, views);
    const box = await pair.page.locator("#view-a").boundingBox();
    await pair.page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
    await pair.page.mouse.down();
    await pair.page.mouse.move(box.x + box.width / 2 + 60, box.y + box.height / 2 + 15, { steps: 4 });
    await pair.page.mouse.up();
    const after = await pictureOf(pair.page, views);
    check(!after[0].equals(before[0]) && !after[1].equals(before[1]), `${pair.name}: a drag in one turns both`);
    await pair.page.locator("#reset").click();
    // It plays to the end, of which at most two seconds are left, and stops there.
    await seek(pair.page, 0.99);
    await pair.page.locator("#play").click();
    await pair.page.waitForFunction(() => document.getElementById("play").dataset.playing === "false", null, {
      timeout: PATIENCE_MS,
    });
    await seek(pair.page, 0.4);
    await pair.page.screenshot({ path: `${screenshots}/pair-top-${kind}.png` });
    await look(pair.name, pair, settings);
  }

  const about = await at("/about", "about");
  await look(about.name, about, settings);
  const nothing = await at("/runs/0000000000000000", "nothing");
  // The answer 404 is on the console, and should be.
  nothing.noted.errors.length = 0;
  await look(nothing.name, nothing, settings);
  if (kind === "desktop-light") await without(settings);
});
await end();
