// The episodes of a folder.

import { chip } from "./panel.js";
import { element } from "./words.js";

function row(entry) {
  const name = element(
    "td",
    {},
    entry.error ? element("span", {}, entry.name) : element("a", { href: `episode/${entry.index}` }, entry.title),
  );
  if (entry.error) {
    return element("tr", {}, name, element("td", { className: "problem", colSpan: 5 }, entry.error));
  }
  const verdict = (label, ruling) => {
    const cell = element("td", { dataset: { label } });
    if (!ruling) return element("td", { className: "soft", dataset: { label } }, "\u2013");
    cell.append(
      chip(ruling.cause === "" ? "cut" : ruling.cause),
      element("span", { className: "soft progress" }, `progress ${ruling.progress.toFixed(2)}`),
    );
    return cell;
  };
  return element(
    "tr",
    {},
    name,
    verdict("Strict", entry.strict),
    verdict("Published", entry.published),
    element("td", { dataset: { label: "Length" } }, entry.seconds === null ? entry.note : `${entry.seconds.toFixed(2)} s`),
    element("td", { dataset: { label: "Policy" } }, entry.policy),
    element("td", { dataset: { label: "Seed" } }, entry.seed),
  );
}

document.getElementById("late").remove();

async function start() {
  const answer = await fetch("episodes.json");
  if (!answer.ok) throw new Error(await answer.text());
  const { folder, entries, left_out: leftOut } = await answer.json();
  document.getElementById("folder").textContent = `${entries.length} episodes in ${folder}.`;
  const heads = ["Episode", "Strict", "Published", "Length", "Policy", "Seed"].map((head) =>
    element("th", { scope: "col" }, head),
  );
  const table = element(
    "table",
    {},
    element("thead", {}, element("tr", {}, ...heads)),
    element("tbody", {}, ...entries.map(row)),
  );
  document.getElementById("episodes").append(table);
  if (leftOut > 0)
    document
      .getElementById("episodes")
      .append(element("p", { className: "soft" }, `${leftOut} more bags are not listed; open a folder with fewer.`));
  document.documentElement.dataset.ready = "true";
}

start().catch((error) => {
  const box = document.getElementById("message");
  box.textContent = `The episodes cannot be listed: ${error.message}`;
  box.hidden = false;
});
