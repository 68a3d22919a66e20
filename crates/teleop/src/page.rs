//! The files of the page.

use fiatlux_replay::site;

/// Files by name, with their media types. What is not here is of the page of replays.
const FILES: [(&str, &str, &str); 15] = [
    ("board.js", JAVASCRIPT, include_str!("../page/board.js")),
    ("card.js", JAVASCRIPT, include_str!("../page/card.js")),
    ("door.js", JAVASCRIPT, include_str!("../page/door.js")),
    ("gamepad.js", JAVASCRIPT, include_str!("../page/gamepad.js")),
    ("goal.js", JAVASCRIPT, include_str!("../page/goal.js")),
    ("hands.js", JAVASCRIPT, include_str!("../page/hands.js")),
    ("keyboard.js", JAVASCRIPT, include_str!("../page/keyboard.js")),
    ("live.js", JAVASCRIPT, include_str!("../page/live.js")),
    ("measures.js", JAVASCRIPT, include_str!("../page/measures.js")),
    ("socket.js", JAVASCRIPT, include_str!("../page/socket.js")),
    ("sticks.js", JAVASCRIPT, include_str!("../page/sticks.js")),
    ("teleop.js", JAVASCRIPT, include_str!("../page/teleop.js")),
    ("token.js", JAVASCRIPT, include_str!("../page/token.js")),
    ("webxr.js", JAVASCRIPT, include_str!("../page/webxr.js")),
    ("teleop.css", "text/css; charset=utf-8", include_str!("../page/teleop.css")),
];
const JAVASCRIPT: &str = "text/javascript; charset=utf-8";

const HOME: &str = include_str!("../page/teleop.html");
const DOOR: &str = include_str!("../page/door.html");

/// The page, and its Content-Security-Policy.
pub(crate) fn home() -> (String, String) {
    let (head, script) = site::head_of("teleop.js");
    let policy = format!(
        "default-src 'none'; script-src 'self' {script}; style-src 'self'; connect-src 'self'; img-src data:; base-uri 'none'; \
         form-action 'none'; frame-ancestors 'none'"
    );
    (HOME.replace("<!--head-->", &head), policy)
}

/// The page for whoever does not show the token: it looks whether this tab was shown it before. Nothing of the robot is in it.
pub(crate) fn door() -> (String, String) {
    let policy = "default-src 'none'; script-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
    (DOOR.to_owned(), policy.to_owned())
}

/// Media type and text of a file of the page.
pub(crate) fn part(name: &str) -> Option<(&'static str, &'static str)> {
    let own = FILES.iter().find(|(known, ..)| *known == name).map(|(_, kind, text)| (*kind, *text));
    own.or_else(|| site::page_part(name))
}
