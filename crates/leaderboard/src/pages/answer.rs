//! Responses: pages with their Content-Security-Policy, files, and error pages.

use std::error::Error;
use std::net::{Ipv4Addr, Ipv6Addr};

use askama::Template;
use axum::body::Body;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use data_encoding::HEXLOWER;
use fiatlux_replay::site::{host_of, name_of};
use sha2::{Digest, Sha256};

use crate::StoreError;

/// Content-Security-Policy of a page without scripts.
const POLICY: &str = "default-src 'none'; style-src 'self'; img-src 'self'; form-action 'self'; base-uri 'none'; \
                      frame-ancestors 'none'";

#[derive(Debug)]
pub(super) enum Problem {
    Nothing,
    /// The submission was refused; only its submitter may read the reason.
    Refused,
    /// The address asks for something impossible; the text is the remedy.
    Asked(String),
    /// The bag cannot be shown, for this reason.
    Unshowable(String),
    Busy,
    /// The service itself failed; the reason is in its log.
    Failed,
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        tracing::error!("cannot make a page: {}", fiatlux_cli::in_full(&error));
        Self::Failed
    }
}

#[derive(Template)]
#[template(path = "problem.html")]
struct ProblemPage<'a> {
    title: &'a str,
    text: &'a str,
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let (status, title, text) = match &self {
            Self::Nothing => (
                StatusCode::NOT_FOUND,
                "Not found",
                "There is no page, run or episode at this address. Runs appear once they are graded.",
            ),
            Self::Refused => (
                StatusCode::NOT_FOUND,
                "Refused",
                "This submission was refused. Its submitter sees the reason with scorer submit --wait.",
            ),
            Self::Asked(text) => (StatusCode::BAD_REQUEST, "Bad request", text.as_str()),
            Self::Unshowable(text) => (StatusCode::UNPROCESSABLE_ENTITY, "This bag cannot be shown", text.as_str()),
            Self::Busy => (
                StatusCode::SERVICE_UNAVAILABLE,
                "Busy",
                "Many replays are being read right now. Try again in a moment.",
            ),
            Self::Failed => {
                (StatusCode::INTERNAL_SERVER_ERROR, "Internal error", "The service failed. Its log says why.")
            }
        };
        let mut answer = page(&ProblemPage { title, text });
        *answer.status_mut() = status;
        if status == StatusCode::SERVICE_UNAVAILABLE {
            answer.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from_static("2"));
        }
        answer
    }
}

pub(super) fn page(template: &impl Template) -> Response {
    page_with(template, POLICY.to_owned())
}

/// A page with replays; `script` is the source that the policy allows for its inline script.
pub(super) fn replay_page(template: &impl Template, script: &str) -> Response {
    page_with(template, format!("{POLICY}; script-src 'self' {script}; connect-src 'self'"))
}

fn page_with(template: &impl Template, policy: String) -> Response {
    let Ok(html) = template.render() else {
        tracing::error!("cannot render a template");
        return StatusCode::INTERNAL_SERVER_ERROR.into_response();
    };
    let mut answer = content("text/html; charset=utf-8", html);
    let headers = answer.headers_mut();
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
    if let Ok(policy) = HeaderValue::try_from(policy) {
        headers.insert(header::CONTENT_SECURITY_POLICY, policy);
    }
    answer
}

/// Where this site is, such as `https://board.example.org`, by the request: a name, an address or `localhost`, with a port or without.
/// Anything else in `Host` is not shown.
pub(super) fn site_of(asked: &HeaderMap) -> String {
    let host = host_of(asked).trim();
    let is_name = |name: &str| match host.starts_with('[') {
        true => name.parse::<Ipv6Addr>().is_ok(),
        false => !name.is_empty() && name.bytes().all(|c| c.is_ascii_alphanumeric() || b"-.".contains(&c)),
    };
    if !name_of(host).is_some_and(|name| is_name(name) && name.len() <= 253) || host.ends_with(':') {
        return "https://ADDRESS-OF-THIS-SITE".into();
    }
    let scheme = match asked.get("x-forwarded-proto").and_then(|value| value.to_str().ok()).map(str::trim) {
        Some(scheme @ ("http" | "https")) => scheme,
        // A name without a port is behind a proxy, which has TLS.
        _ if host.contains(':') || host == "localhost" || host.parse::<Ipv4Addr>().is_ok() => "http",
        _ => "https",
    };
    format!("{scheme}://{host}")
}

pub(super) fn content(kind: &'static str, body: impl Into<Body>) -> Response {
    ([(header::CONTENT_TYPE, kind)], body.into()).into_response()
}

/// A file that is compiled in. Browsers ask if it has changed, and get it only then.
pub(super) fn unchanging(asked: &HeaderMap, kind: &'static str, text: &'static str) -> Response {
    let digest: String = HEXLOWER.encode(&Sha256::digest(text)[..8]);
    let tag = format!("\"{digest}\"");
    let is_known = asked.get(header::IF_NONE_MATCH).is_some_and(|known| known.as_bytes() == tag.as_bytes());
    let mut answer = match is_known {
        true => StatusCode::NOT_MODIFIED.into_response(),
        false => content(kind, text),
    };
    let headers = answer.headers_mut();
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
    if let Ok(tag) = HeaderValue::try_from(tag) {
        headers.insert(header::ETAG, tag);
    }
    answer
}

/// The text of a replay's error, with `name` in place of the file's path, which visitors must not see.
pub(super) fn without_path(error: &dyn Error, path: &std::path::Path, name: &str) -> String {
    fiatlux_cli::in_full(error).replace(&path.display().to_string(), name)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Guards the commands on the pages: they name the site as the visitor reached it, and nothing that was smuggled into a header.
    #[test]
    fn the_site_is_named_as_it_was_asked_for() {
        let nowhere = "https://ADDRESS-OF-THIS-SITE";
        let cases = [
            ("board.example.org", "", "https://board.example.org"),
            ("board.example.org", "http", "http://board.example.org"),
            ("board.example.org:8443", "https", "https://board.example.org:8443"),
            ("127.0.0.1:8080", "", "http://127.0.0.1:8080"),
            ("192.0.2.7", "", "http://192.0.2.7"),
            ("localhost", "ftp", "http://localhost"),
            ("[::1]:8080", "", "http://[::1]:8080"),
            ("[::1;x]", "", nowhere),
            ("a b", "", nowhere),
            ("a$(rm)", "", nowhere),
            ("<b>", "", nowhere),
            ("a:99999", "", nowhere),
            ("a:", "", nowhere),
            ("[board]", "", nowhere),
            ("", "", nowhere),
        ];
        for (host, scheme, expected) in cases {
            let mut asked = HeaderMap::new();
            asked.insert(header::HOST, HeaderValue::from_str(host).expect("a value"));
            asked.insert("x-forwarded-proto", HeaderValue::from_str(scheme).expect("a value"));
            assert_eq!(site_of(&asked), expected, "{host}");
        }
        assert_eq!(site_of(&HeaderMap::new()), nowhere);
        let mut twice = HeaderMap::new();
        for host in ["board.example.org", "evil.example"] {
            twice.append(header::HOST, HeaderValue::from_static(host));
        }
        assert_eq!(site_of(&twice), nowhere);
    }
}
