// What the tests in a browser share: the browser, its kinds of screens, and what is asked of every page.

import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";

import { chromium, devices } from "playwright-core";

const browserPath = process.env.CHROMIUM ?? "/usr/bin/chromium";
const axeSource = await readFile(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
const { defaultBrowserType, ...phone } = devices["Pixel 7"];
export const KINDS = {
  desktop: { viewport: { width: 1280, height: 860 } },
  telephone: { ...phone, viewport: { width: 390, height: 844 } },
};
export const PATIENCE_MS = 60_000;

let failures = 0;
export function check(holds, what, found = "") {
  if (!holds) failures += 1;
  console.log(`${holds ? "ok    " : "FAILED"} ${what}${holds || found === "" ? "" : `: ${found}`}`);
}

const browser = await chromium.launch({
  executablePath: browserPath,
  args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"],
});

// Says whether all checks hold, and ends the program.
export async function end() {
  await browser.close();
  console.log(failures === 0 ? "all checks hold" : `${failures} checks failed`);
  process.exit(failures === 0 ? 0 : 1);
}

// Runs the test on every kind of screen, in light and dark.
export async function everywhere(test) {
  for (const [kind, device] of Object.entries(KINDS)) {
    for (const colorScheme of ["light", "dark"]) await test(`${kind}-${colorScheme}`, { ...device, colorScheme });
  }
}

// A page of which every message and every request is noted.
// `address` is the only host that it may ask for anything. A page with a replay says itself when it is ready. `before` runs before the
// page's own scripts.
export async function open(name, url, settings, address, isReplay = true, ...before) {
  const context = await browser.newContext({ ...settings, bypassCSP: false });
  const page = await context.newPage();
  for (const script of before) await page.addInitScript(script);
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
  if (isReplay) await page.waitForSelector("html[data-ready=true]", { state: "attached", timeout: PATIENCE_MS });
  return { name, page, noted, context };
}

export async function close({ name, noted, context }) {
  check(noted.errors.length === 0, `${name}: nothing on the console`, noted.errors.join(" | "));
  check(noted.strangers.length === 0, `${name}: no request to another host`, noted.strangers.join(" "));
  await context.close();
}

// Until the page has drawn.
export const drawn = (page) => page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));

export async function picture(page, view = "#view") {
  await drawn(page);
  return page.locator(view).screenshot();
}

export async function seek(page, share) {
  await page.locator("#time").evaluate((time, part) => {
    time.value = Math.round(Number(time.min) + part * (time.max - time.min));
    time.dispatchEvent(new Event("input", { bubbles: true }));
  }, share);
  await drawn(page);
}

export const clock = (page) => page.locator("#clock").textContent();

export async function accessible({ name, page }) {
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

// Whether nothing is wider than the page, and nothing has to be scrolled sideways: not on a telephone, and where `isWhole` says
// so not on a desktop either. A block of code may be.
export async function fits({ name, page }, isWhole = false) {
  const wide = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
  check(wide <= 0, `${name}: nothing is wider than the page`, `${wide} pixels`);
  if (!isWhole && !name.includes("telephone")) return;
  const cut = await page.evaluate(() =>
    [...document.querySelectorAll(".scroll")]
      .filter((region) => region.scrollWidth > region.clientWidth + 1)
      .map((region) => `${region.getAttribute("aria-label")}: ${region.scrollWidth} in ${region.clientWidth}`),
  );
  check(cut.length === 0, `${name}: no table is cut`, cut.join("; "));
}
