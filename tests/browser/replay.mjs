// Looks at replays with a real browser: a served folder, and a file of its own.
//
//   node replay.mjs ADDRESS FILE.html SCREENSHOTS
//
// ADDRESS is that of `fiatlux view DIR --no-open`, where DIR has two bags or more and the first has rows; FILE.html is what
// `fiatlux view BAG --out FILE.html` wrote. Exit code 0 when every check holds.

import { mkdir, readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { resolve } from "node:path";
import { pathToFileURL } from "node:url";

import { chromium, devices } from "playwright-core";

const [address, file, screenshots] = process.argv.slice(2);
const browserPath = process.env.CHROMIUM ?? "/usr/bin/chromium";
const axeSource = await readFile(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
const { defaultBrowserType, ...phone } = devices["Pixel 7"];
const KINDS = { desktop: { viewport: { width: 1440, height: 900 } }, telephone: phone };
const PATIENCE_MS = 60_000;

let failures = 0;
function check(holds, what, found = "") {
  if (!holds) failures += 1;
  console.log(`${holds ? "ok    " : "FAILED"} ${what}${holds || found === "" ? "" : `: ${found}`}`);
}

const browser = await chromium.launch({
  executablePath: browserPath,
  args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"],
});

// A page of which every message and every request is noted.
async function open(name, url, settings) {
  const context = await browser.newContext({ ...settings, bypassCSP: false });
  const page = await context.newPage();
  const noted = { errors: [], strangers: [] };
  page.on("console", (message) => {
    // What a software renderer says of its speed is not about the page.
    const isDriver = message.text().includes("GL Driver Message");
    if (["error", "warning"].includes(message.type()) && !isDriver) noted.errors.push(message.text());
  });
  page.on("pageerror", (error) => noted.errors.push(error.message));
  page.on("request", (request) => {
    const isOwn =
      ["data:", "blob:", "file:"].some((kind) => request.url().startsWith(kind)) || request.url().startsWith(address);
    if (!isOwn) noted.strangers.push(request.url());
  });
  await page.goto(url);
  await page.waitForSelector("html[data-ready=true]", { state: "attached", timeout: PATIENCE_MS });
  return { name, page, noted, context };
}

async function close({ name, noted, context }) {
  check(noted.errors.length === 0, `${name}: nothing on the console`, noted.errors.join(" | "));
  check(noted.strangers.length === 0, `${name}: no request to another host`, noted.strangers.join(" "));
  await context.close();
}

// Until the page has drawn.
const drawn = (page) => page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));

async function picture(page) {
  await drawn(page);
  return page.locator("#view").screenshot();
}

async function seek(page, share) {
  await page.locator("#time").evaluate((time, part) => {
    time.value = Math.round(Number(time.min) + part * (time.max - time.min));
    time.dispatchEvent(new Event("input", { bubbles: true }));
  }, share);
  await drawn(page);
}

const clock = (page) => page.locator("#clock").textContent();

async function accessible({ name, page }) {
  // Not in the page's own world: its policy lets no script in.
  await page.evaluate(axeSource);
  const { violations } = await page.evaluate(() =>
    globalThis.axe.run({ runOnly: ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"] }),
  );
  const serious = violations.filter(({ impact }) => ["serious", "critical"].includes(impact));
  const say = (list) =>
    list.map(({ id, nodes }) => `${id} (${nodes.map((node) => node.target.join(" ")).join(", ")})`).join("; ");
  check(serious.length === 0, `${name}: axe has no serious finding`, say(serious));
  const others = violations.filter((violation) => !serious.includes(violation));
  if (others.length > 0) console.log(`       ${name}: axe also says ${say(others)}`);
}

// Whether every pair of things that stand next to each other keeps off the other, and nothing is wider than the page.
async function fits({ name, page }) {
  const wide = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
  check(wide <= 0, `${name}: nothing is wider than the page`, `${wide} pixels`);
}

async function replay(name, url, settings) {
  const opened = await open(name, url, settings);
  const { page } = opened;
  const shots = [];
  for (const share of [0, 0.5, 1]) {
    await seek(page, share);
    shots.push(await picture(page));
  }
  check(!shots[0].equals(shots[1]) && !shots[1].equals(shots[2]), `${name}: the picture changes as time moves`);
  check((await picture(page)).equals(shots[2]), `${name}: the picture is still while nothing moves`);

  await seek(page, 0.5);
  const lit = await page.locator(".lamp.on").count();
  const all = await page.locator(".lamp").count();
  check(all > 0 && lit > 0, `${name}: ${lit} of ${all} conditions are lit in the middle`);
  await page.screenshot({ path: `${screenshots}/${name}.png` });

  await page.locator("#forces").click();
  check(!(await picture(page)).equals(shots[1]), `${name}: the picture has fewer arrows without forces`);
  await page.locator("#forces").click();
  check((await picture(page)).equals(shots[1]), `${name}: and the same ones again with them`);

  await page.locator("body").click({ position: { x: 2, y: 2 } });
  await page.keyboard.press("Home");
  await drawn(page);
  const start = await clock(page);
  await page.keyboard.press("Shift+ArrowRight");
  await page.keyboard.press("Shift+ArrowRight");
  await page.waitForFunction(() => document.getElementById("clock").textContent.startsWith("0.04 s"));
  check(start.startsWith("0.00 s"), `${name}: keys move by steps`);
  await page.keyboard.press("+");
  check((await page.locator("#speed").inputValue()) === "2", `${name}: + is faster`);
  await page.keyboard.press("-");
  await page.keyboard.press("Space");
  await page.waitForFunction(() => Number.parseFloat(document.getElementById("clock").textContent) > 0.3, null, {
    timeout: PATIENCE_MS,
  });
  await page.keyboard.press("Space");
  const paused = await clock(page);
  await page.waitForTimeout(300);
  check((await clock(page)) === paused, `${name}: the space bar plays and pauses`);

  const box = await page.locator("#view").boundingBox();
  const before = await picture(page);
  await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
  await page.mouse.down();
  await page.mouse.move(box.x + box.width / 2 + 90, box.y + box.height / 2 + 20, { steps: 4 });
  await page.mouse.up();
  check(!(await picture(page)).equals(before), `${name}: a drag turns the camera`);

  await accessible(opened);
  await fits(opened);
  await close(opened);
}

await mkdir(screenshots, { recursive: true });
for (const [kind, device] of Object.entries(KINDS)) {
  for (const colorScheme of ["light", "dark"]) {
    const settings = { ...device, colorScheme };
    const list = await open(`list-${kind}-${colorScheme}`, address, settings);
    check((await list.page.locator("tbody tr").count()) > 1, `${list.name}: has the episodes`);
    await list.page.screenshot({ path: `${screenshots}/${list.name}.png` });
    await accessible(list);
    await fits(list);
    await close(list);
    await replay(`replay-${kind}-${colorScheme}`, new URL("episode/0", address).href, settings);
  }
}
await replay("file-desktop-light", pathToFileURL(resolve(file)).href, { ...KINDS.desktop, colorScheme: "light" });
await browser.close();
console.log(failures === 0 ? "all checks hold" : `${failures} checks failed`);
process.exit(failures === 0 ? 0 : 1);
