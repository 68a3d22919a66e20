//! Answers: JSON, and what is wrong with a request.

use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use serde_json::json;

use crate::store::Account;
use crate::{Service, StoreError};

/// Longest token with what stands before it, bytes.
const MAX_AUTHORIZATION: usize = 256;

/// Why a request is not done: `{"error": {"code", "message"}}`, and more fields where they help.
#[derive(Debug)]
pub(crate) struct Problem {
    status: StatusCode,
    code: &'static str,
    message: String,
    /// Bytes of a file that are there.
    received: Option<u64>,
}

impl Problem {
    pub fn new(status: StatusCode, code: &'static str, message: impl Into<String>) -> Self {
        Self { status, code, message: message.into(), received: None }
    }

    /// Something in the request is wrong.
    pub fn request(message: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, "request", message)
    }

    /// There is no such thing, or it is none of the sender's business.
    pub fn missing(message: impl Into<String>) -> Self {
        Self::new(StatusCode::NOT_FOUND, "missing", message)
    }

    /// It does not go with what is there.
    pub fn conflict(code: &'static str, message: impl Into<String>) -> Self {
        Self::new(StatusCode::CONFLICT, code, message)
    }

    /// It is too much.
    pub fn too_large(message: impl Into<String>) -> Self {
        Self::new(StatusCode::PAYLOAD_TOO_LARGE, "size", message)
    }

    /// It came too slowly.
    pub fn slow(message: impl Into<String>) -> Self {
        Self::new(StatusCode::REQUEST_TIMEOUT, "slow", message)
    }

    /// It may work later.
    pub fn busy(message: impl Into<String>) -> Self {
        Self::new(StatusCode::SERVICE_UNAVAILABLE, "busy", message)
    }

    /// With how much of the file is there.
    pub fn with_received(mut self, received: u64) -> Self {
        self.received = Some(received);
        self
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let mut body = json!({ "error": { "code": self.code, "message": self.message } });
        if let Some(received) = self.received {
            body["received"] = json!(received);
        }
        let mut answer = (self.status, json_text(body.to_string())).into_response();
        // What is left of a body that nobody reads would be taken for the next request.
        let headers = answer.headers_mut();
        if self.status == StatusCode::UNAUTHORIZED {
            headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
        }
        answer
    }
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        // A caller cannot help it, and need not know where the store is.
        tracing::error!(error = fiatlux_link::in_full(&error), "a request failed");
        Self::new(StatusCode::INTERNAL_SERVER_ERROR, "store", "the service cannot reach its store; try again later")
    }
}

/// JSON, which nothing on the way may keep.
pub(super) fn json_text(text: String) -> Response {
    let headers = [
        (header::CONTENT_TYPE, "application/json"),
        (header::CACHE_CONTROL, "no-store"),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    ];
    (headers, text).into_response()
}

/// A value as JSON.
pub(super) fn json_of(value: &impl Serialize) -> Result<Response, Problem> {
    let text = serde_json::to_string(value).map_err(|error| StoreError::corrupt("an answer", error))?;
    Ok(json_text(text))
}

/// Whose token a request has.
pub(super) async fn account_of(service: &Service, headers: &HeaderMap) -> Result<Account, Problem> {
    let text = headers.get(header::AUTHORIZATION).filter(|value| value.len() <= MAX_AUTHORIZATION);
    let text = text.and_then(|value| value.to_str().ok());
    let token = text.and_then(|text| text.strip_prefix("Bearer ")).map(str::trim);
    let found = service.store.account_by(token).await?;
    found.map_err(|denied| Problem::new(StatusCode::UNAUTHORIZED, "token", denied.to_string()))
}
