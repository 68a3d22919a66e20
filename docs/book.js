// Two things that the theme leaves out: a name for its search, and the keyboard's way into tables and code that scroll.
document.querySelector(".md-search")?.setAttribute("aria-label", "Search");
const scrolls = ".md-typeset__scrollwrap:not([tabindex]), .md-typeset pre > code:not([tabindex])";
const reach = () => document.querySelectorAll(scrolls).forEach((region) => (region.tabIndex = 0));
new MutationObserver(reach).observe(document.querySelector("article") ?? document.body, { childList: true, subtree: true });
reach();
