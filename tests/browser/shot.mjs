// Takes a picture of a page for the book: node shot.mjs URL OUT.png KIND [SHARE]
//
// KIND is desktop or telephone, with -dark for dark colours. SHARE is the part of a replay's time to show.

import { KINDS, close, drawn, end, open, seek } from "./common.mjs";

const [url, out, kind, share] = process.argv.slice(2);
const [device, dark] = kind.split("-");
const colorScheme = dark === undefined ? "light" : "dark";
const height = { viewport: { width: 1280, height: 1120 } };
const settings = { ...KINDS[device], ...(share === undefined ? height : {}), colorScheme };
const opened = await open(kind, url, settings, new URL(url).origin, share !== undefined);
if (share === undefined) await opened.page.waitForLoadState("networkidle");
else await seek(opened.page, Number(share));
await drawn(opened.page);
await opened.page.screenshot({ path: out, scale: "css" });
await close(opened);
await end();
