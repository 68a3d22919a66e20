// Two things that the theme leaves out: a name for its search, and the keyboard's way into tables that scroll.
document.querySelector(".md-search")?.setAttribute("aria-label", "Search");
const reach = () => document.querySelectorAll(".md-typeset__scrollwrap:not([tabindex])").forEach((wrap) => (wrap.tabIndex = 0));
new MutationObserver(reach).observe(document.querySelector("article") ?? document.body, { childList: true, subtree: true });
reach();
