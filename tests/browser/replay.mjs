// Looks at replays with a real browser: a served folder, and a file of its own.
//
//   node replay.mjs ADDRESS FILE.html REPORT.html SCREENSHOTS
//
// REPORT.html is a report; ADDRESS is that of `fiatlux view DIR --no-open`, where DIR has two bags or more and the first has rows; FILE.html is what
// `fiatlux view BAG --out FILE.html` wrote. Exit code 0 when every check holds.

import { mkdir } from "node:fs/promises";
import { resolve } from "node:path";
import { pathToFileURL } from "node:url";

import {
  KINDS,
  PATIENCE_MS,
  accessible,
  check,
  clock,
  close,
  drawn,
  end,
  everywhere,
  fits,
  open,
  picture,
  seek,
} from "./common.mjs";

const [address, file, reportFile, screenshots] = process.argv.slice(2);

async function replay(name, url, settings) {
  const opened = await open(name, url, settings, address);
  const { page } = opened;
  const shots = [];
  for (const share of [0, 0.5, 1]) {
    await seek(page, share);
    shots.push(await picture(page));
  }
  check(!shots[0].equals(shots[1]) && !shots[1].equals(shots[2]), `${name}: the picture changes as time moves`);
  check((await picture(page)).equals(shots[2]), `${name}: the picture is still while nothing moves`);

  const names = await page.locator(".lanes li").allTextContents();
  const lamps = await page.locator(".lamp").count();
  check(names.length === lamps + 2 && names.every((text) => text.length > 3), `${name}: each lane has its name`, names.join(", "));
  check((await page.locator("#loading").isHidden()) === true, `${name}: the bar of loading leaves`);

  await page.evaluate(() => {
    location.hash = "t=1.5";
  });
  await page.waitForFunction(() => document.getElementById("clock").textContent.startsWith("1.50 s"));
  await seek(page, 0.25);
  await page.locator("#copy").click();
  const moment = Number.parseFloat(new URL(page.url()).hash.replace("#t=", ""));
  check(Math.abs(moment - Number.parseFloat(await clock(page))) < 0.011, `${name}: the address has the moment`, page.url());

  const seen = () => page.locator(".seen canvas").evaluate((canvas) => canvas.toDataURL());
  const sees = (text) => page.waitForFunction((at) => document.querySelector(".seen figcaption").textContent === at, `Head camera at ${text}`);
  await seek(page, 0);
  await sees("0.00 s");
  const first = await seen();
  await page.evaluate(() => {
    location.hash = "t=1.5";
  });
  await sees("1.40 s");
  check(first.length > 2000 && (await seen()) !== first, `${name}: the head camera's picture of the moment`);

  await page.locator(".joints summary").click();
  await page.waitForFunction(() => document.querySelector(".plot-name span").textContent.includes("rad"));
  const plots = await page.locator(".plot").evaluateAll((list) => list.map((plot) => plot.getAttribute("aria-label")));
  check(plots.length === 3 && plots[2].includes("N m of"), `${name}: angle, tracking and effort of a joint`, plots.join("; "));
  await page.screenshot({ path: `${screenshots}/${name}-joints.png`, fullPage: true });
  await page.locator(".joints summary").click();
  await page.evaluate(() => {
    scrollTo(0, 0);
    document.getElementById("panel").scrollTop = 0;
  });

  await seek(page, 0.5);
  const lit = await page.locator(".lamp.on").count();
  const all = await page.locator(".lamp").count();
  check(all > 0 && lit > 0, `${name}: ${lit} of ${all} conditions are lit in the middle`);
  await page.screenshot({ path: `${screenshots}/${name}.png` });
  check((await page.locator("dd", { hasText: "in the right hand" }).count()) === 1, `${name}: says which hand has the bulb`);

  // At the end it stands: both feet bear.
  await seek(page, 1);
  await page.locator("#forces").click();
  check(!(await picture(page)).equals(shots[2]), `${name}: the picture has fewer arrows without forces`);
  await page.locator("#forces").click();
  check((await picture(page)).equals(shots[2]), `${name}: and the same ones again with them`);

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
  // The picture that was asked for while it played comes once more, and tells of no rate.
  await drawn(page);
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
await everywhere(async (kind, settings) => {
  const list = await open(`list-${kind}`, address, settings, address);
  check((await list.page.locator("tbody tr").count()) > 1, `${list.name}: has the episodes`);
  await list.page.screenshot({ path: `${screenshots}/${list.name}.png` });
  await accessible(list);
  await fits(list, true);
  await close(list);
  await replay(`replay-${kind}`, new URL("episode/0", address).href, settings);
  const report = await open(`report-${kind}`, pathToFileURL(resolve(reportFile)).href, settings, address, false);
  await report.page.screenshot({ path: `${screenshots}/${report.name}.png`, fullPage: true, scale: "css" });
  await accessible(report);
  await fits(report, true);
  await close(report);
});
await replay("file-desktop-light", pathToFileURL(resolve(file)).href, { ...KINDS.desktop, colorScheme: "light" });
await end();
