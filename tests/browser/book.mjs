// Looks at every page of the book with a real browser.
//
//   node book.mjs FOLDER SCREENSHOTS
//
// FOLDER is what `mkdocs build` made. Exit code 0 when every check holds.

import { createReadStream } from "node:fs";
import { mkdir, readdir } from "node:fs/promises";
import { createServer } from "node:http";
import path from "node:path";

import { PATIENCE_MS, accessible, check, close, end, everywhere, fits, open } from "./common.mjs";

const [folder, screenshots] = process.argv.slice(2);
const TYPES = { ".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".json": "application/json", ".svg": "image/svg+xml" };

const server = createServer((request, response) => {
  const file = path.join(folder, path.normalize(decodeURIComponent(new URL(request.url, "http://book").pathname)));
  const sent = createReadStream(file.endsWith("/") ? `${file}index.html` : file);
  sent.on("error", () => response.writeHead(404).end());
  sent.once("open", () => response.writeHead(200, { "content-type": TYPES[path.extname(file)] ?? "application/octet-stream" }));
  sent.pipe(response);
});
await new Promise((ready) => server.listen(0, "127.0.0.1", ready));
const address = `http://127.0.0.1:${server.address().port}/`;

const pages = (await readdir(folder, { recursive: true })).filter((name) => name.endsWith(".html") && name !== "404.html").sort();
check(pages.length > 30, "the book has its pages", `${pages.length}`);
await mkdir(screenshots, { recursive: true });

// A find in the search names the page that it is on.
async function search(kind, settings) {
  const opened = await open(`book-search-${kind}`, `${address}index.html`, settings, address, false);
  if (kind.includes("telephone")) await opened.page.locator("label[for=__search]").first().click();
  const find = opened.page.locator(".md-search-result__article h1").first();
  // The theme listens to keys, not to a text that is there at once.
  await opened.page.locator("input[name=query]").pressSequentially("strict success", { delay: 30 });
  await find.waitFor({ timeout: PATIENCE_MS });
  check((await find.textContent()).trim() !== "", `book-search-${kind}: a find names its page`);
  const links = await opened.page.locator(".md-search-result__link").evaluateAll((all) => all.map((link) => link.href));
  check(links.every((link) => !link.includes("/notes/")), `book-search-${kind}: notes are not among the finds`, links.join(" "));
  await close(opened);
}

await everywhere(async (kind, settings) => {
  for (const name of pages) {
    // Each page on a desktop in light; the first one and the longest ones everywhere.
    if (kind !== "desktop-light" && !["index.html", "tasks.html", "hands.html", "bridges.html"].includes(name)) continue;
    const opened = await open(`book-${kind} ${name}`, address + name, settings, address, false);
    await accessible(opened);
    await fits(opened);
    if (["index.html", "hands.html", "errand.html"].includes(name)) {
      await opened.page.screenshot({ path: `${screenshots}/book-${kind}-${name.replace(".html", "")}.png` });
    }
    await close(opened);
  }
  await search(kind, settings);
});
server.close();
await end();
