//! Answers: pages with their policy, files, and what is said where there is none.

use std::error::Error;

use askama::Template;
use axum::body::Body;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use sha2::{Digest, Sha256};

use crate::StoreError;

/// Policy of a page without scripts.
const POLICY: &str = "default-src 'none'; style-src 'self'; img-src 'self'; form-action 'self'; base-uri 'none'; \
                      frame-ancestors 'none'";

/// Why there is no page.
#[derive(Debug)]
pub(super) enum Problem {
    /// No such address, run or episode.
    Nothing,
    /// The address asks for something that does not go.
    Asked(String),
    /// The bag cannot be shown.
    Unshowable(String),
    /// Too many such requests at once.
    Busy,
    /// The service itself failed; what happened is in its log.
    Failed,
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        tracing::error!("a page cannot be made: {}", fiatlux_link::in_full(&error));
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
                "Nothing here",
                "There is no page, run or episode at this address. Runs appear once they are graded.",
            ),
            Self::Asked(text) => (StatusCode::BAD_REQUEST, "That does not go", text.as_str()),
            Self::Unshowable(text) => (StatusCode::UNPROCESSABLE_ENTITY, "This bag cannot be shown", text.as_str()),
            Self::Busy => (
                StatusCode::SERVICE_UNAVAILABLE,
                "Busy",
                "Many replays are being read right now. Try again in a moment.",
            ),
            Self::Failed => {
                (StatusCode::INTERNAL_SERVER_ERROR, "This did not work", "The service failed. Its log says why.")
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

/// A page without scripts.
pub(super) fn page(template: &impl Template) -> Response {
    page_with(template, POLICY.to_owned())
}

/// A page with replays; `script` is the source of its inline script.
pub(super) fn replay_page(template: &impl Template, script: &str) -> Response {
    page_with(template, format!("{POLICY}; script-src 'self' {script}; connect-src 'self'"))
}

fn page_with(template: &impl Template, policy: String) -> Response {
    let Ok(html) = template.render() else {
        tracing::error!("a template cannot be rendered");
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

/// A body of some kind.
pub(super) fn content(kind: &'static str, body: impl Into<Body>) -> Response {
    ([(header::CONTENT_TYPE, kind)], body.into()).into_response()
}

/// A file that is compiled in: a browser asks whether it has changed, and gets it only then.
pub(super) fn unchanging(asked: &HeaderMap, kind: &'static str, text: &'static str) -> Response {
    let digest: String = Sha256::digest(text).iter().take(8).map(|byte| format!("{byte:02x}")).collect();
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

/// An error of a replay without the path of the file, which is nobody's business.
pub(super) fn without_path(error: &dyn Error, path: &std::path::Path, name: &str) -> String {
    fiatlux_link::in_full(error).replace(&path.display().to_string(), name)
}
