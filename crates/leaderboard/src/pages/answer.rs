//! Responses: pages with their Content-Security-Policy, files, and error pages.

use std::error::Error;

use askama::Template;
use axum::body::Body;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use data_encoding::HEXLOWER;
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
