//! Replays inside the pages of another server, and what the servers of pages share.
//!
//! Such a page has [`SitePage::head`] in its head and [`SitePage::body`] in its body, and its policy allows
//! [`SitePage::script`]. [`one`] requests `document.json`, `meshes.bin`, `track.bin` and `bag` below the page's own
//! address. [`pair`] requests the same from two addresses, given by the attributes `data-a` and `data-b` of an element
//! with the id `pair`. Modules and style are requested as `/page/NAME`: see [`page_part`].

use axum::http::{HeaderName, HeaderValue, header};
use axum::response::Response;

pub use crate::connections::{Connection, connection_of, serve};
pub use crate::download::download;
pub use crate::hosts::{host_of, is_own, is_same_origin, name_of};
use crate::page::{Head, MODULES, ONE, PAIR, STYLE};

/// Headers of every answer.
const HEADERS: [(HeaderName, &str); 5] = [
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::REFERRER_POLICY, "no-referrer"),
    (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    (HeaderName::from_static("permissions-policy"), "camera=(), geolocation=(), microphone=()"),
];

/// The Content-Security-Policy of answers that are not pages.
const NO_PAGE: &str = "default-src 'none'; sandbox";

/// The parts of a page with replays.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SitePage {
    /// Links to the style and the modules, for the page's head.
    pub head: String,
    /// A source for `script-src` that allows the page's only inline script; `'self'` allows the others.
    pub script: String,
    /// A `main` element. The element around it needs [`SitePage::class`] for the style to apply.
    pub body: &'static str,
    /// Class for the element around `body`.
    pub class: &'static str,
}

/// The parts of a page with one replay.
pub fn one() -> SitePage {
    of("main.js", ONE, "replay")
}

/// The parts of a page with two replays side by side and one time bar.
pub fn pair() -> SitePage {
    of("pair.js", PAIR, "pair")
}

fn of(module: &str, body: &'static str, class: &'static str) -> SitePage {
    let Head { html: head, script } = Head::of(module);
    SitePage { head, script, body, class }
}

/// The links of a page that starts with another module and uses these ones: its head, and a source for `script-src` that allows
/// the inline script in it.
pub fn head_of(module: &str) -> (String, String) {
    let Head { html, script } = Head::of(module);
    (html, script)
}

/// Media type and text of a file of the page, by its name; `None` if there is no such file.
pub fn page_part(name: &str) -> Option<(&'static str, &'static str)> {
    if name == STYLE.name {
        return Some(("text/css; charset=utf-8", STYLE.text));
    }
    let module = MODULES.iter().find(|module| module.name == name)?;
    Some(("text/javascript; charset=utf-8", module.text))
}

/// An answer with the headers that keep a browser from interpreting it as another type, or giving it to other sites.
/// One without a Content-Security-Policy gets one that allows nothing.
pub fn guarded(mut answer: Response) -> Response {
    let headers = answer.headers_mut();
    for (name, value) in HEADERS {
        headers.insert(name, HeaderValue::from_static(value));
    }
    headers.entry(header::CONTENT_SECURITY_POLICY).or_insert(HeaderValue::from_static(NO_PAGE));
    answer
}

/// An answer whose address contains its digest: a browser may cache it for ever.
pub fn for_ever(mut answer: Response) -> Response {
    let kept = HeaderValue::from_static("public, max-age=31536000, immutable");
    answer.headers_mut().insert(header::CACHE_CONTROL, kept);
    answer
}
