// Starts a replay that is a file of its own: its modules are compressed blocks of the page, and become addresses of data.

(async () => {
  if (typeof DecompressionStream === "undefined") {
    document.getElementById("late").textContent =
      "This browser cannot unpack the file. Open it with Chromium 89, Firefox 113, Safari 16.4 or newer, or its bag with fiatlux view BAG.";
    return;
  }
  const imports = {};
  for (const block of document.querySelectorAll("script[data-names]")) {
    const bytes = Uint8Array.from(atob(block.textContent), (letter) => letter.charCodeAt(0));
    const text = await new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
    for (const name of block.dataset.names.split(" ")) imports[name] = `data:text/javascript,${encodeURIComponent(text)}`;
  }
  const map = document.createElement("script");
  Object.assign(map, { type: "importmap", nonce: "fiatlux", textContent: JSON.stringify({ imports }) });
  document.head.append(map);
  await import("fiatlux/main.js");
})();
