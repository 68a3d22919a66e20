//! The files of the page.

use fiatlux_replay::site;

/// Files by name, with their media types. What is not here is of the page of replays.
const FILES: [(&str, &str, &str); 10] = [
    ("board.js", JAVASCRIPT, include_str!("../page/board.js")),
    ("card.js", JAVASCRIPT, include_str!("../page/card.js")),
    ("gamepad.js", JAVASCRIPT, include_str!("../page/gamepad.js")),
    ("hands.js", JAVASCRIPT, include_str!("../page/hands.js")),
    ("keyboard.js", JAVASCRIPT, include_str!("../page/keyboard.js")),
    ("live.js", JAVASCRIPT, include_str!("../page/live.js")),
    ("socket.js", JAVASCRIPT, include_str!("../page/socket.js")),
    ("teleop.js", JAVASCRIPT, include_str!("../page/teleop.js")),
    ("webxr.js", JAVASCRIPT, include_str!("../page/webxr.js")),
    ("teleop.css", "text/css; charset=utf-8", include_str!("../page/teleop.css")),
];
const JAVASCRIPT: &str = "text/javascript; charset=utf-8";

const HOME: &str = include_str!("../page/teleop.html");

/// The page, and its Content-Security-Policy.
pub(crate) fn home() -> (String, String) {
    let (head, script) = site::head_of("teleop.js");
    let policy = format!(
        "default-src 'none'; script-src 'self' {script}; style-src 'self'; connect-src 'self'; img-src data:; base-uri 'none'; \
         form-action 'none'; frame-ancestors 'none'"
    );
    (HOME.replace("<!--head-->", &head), policy)
}

/// Media type and text of a file of the page.
pub(crate) fn part(name: &str) -> Option<(&'static str, &'static str)> {
    let own = FILES.iter().find(|(known, ..)| *known == name).map(|(_, kind, text)| (*kind, *text));
    own.or_else(|| site::page_part(name))
}
