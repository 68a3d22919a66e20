//! Responses: JSON, and the errors of requests.

use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use serde_json::json;

use crate::store::Account;
use crate::{Service, StoreError};

/// Maximum length of the header Authorization, bytes.
const MAX_AUTHORIZATION: usize = 256;

/// The error of a request, sent as `{"error": {"code", "message"}}`, with more fields if they help.
#[derive(Debug)]
pub(crate) struct Problem {
    status: StatusCode,
    code: &'static str,
    message: String,
    /// Bytes of the file that have arrived, for errors of an upload.
    received: Option<u64>,
}

impl Problem {
    pub fn new(status: StatusCode, code: &'static str, message: impl Into<String>) -> Self {
        Self { status, code, message: message.into(), received: None }
    }

    /// 400: the request is malformed.
    pub fn request(message: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, "request", message)
    }

    /// 404: it does not exist, or the sender may not know if it does.
    pub fn missing(message: impl Into<String>) -> Self {
        Self::new(StatusCode::NOT_FOUND, "missing", message)
    }

    /// 409: the request conflicts with the present state.
    pub fn conflict(code: &'static str, message: impl Into<String>) -> Self {
        Self::new(StatusCode::CONFLICT, code, message)
    }

    /// 413: the request or a file is larger than allowed.
    pub fn too_large(message: impl Into<String>) -> Self {
        Self::new(StatusCode::PAYLOAD_TOO_LARGE, "size", message)
    }

    /// 408: the data arrived too slowly; the client may resume.
    pub fn slow(message: impl Into<String>) -> Self {
        Self::new(StatusCode::REQUEST_TIMEOUT, "slow", message)
    }

    /// 503: the service cannot do this now; the client should try again later.
    pub fn busy(message: impl Into<String>) -> Self {
        Self::new(StatusCode::SERVICE_UNAVAILABLE, "busy", message)
    }

    /// Adds the number of bytes of the file that have arrived, where the client should resume.
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
        // Tells clients how to authenticate.
        let headers = answer.headers_mut();
        if self.status == StatusCode::UNAUTHORIZED {
            headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
        }
        answer
    }
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        // The client cannot correct it, and must not learn where the store is.
        tracing::error!(error = fiatlux_cli::in_full(&error), "a request failed");
        Self::new(StatusCode::INTERNAL_SERVER_ERROR, "store", "the service cannot reach its store; try again later")
    }
}

/// A JSON response that no cache may store.
pub(super) fn json_text(text: String) -> Response {
    let headers = [
        (header::CONTENT_TYPE, "application/json"),
        (header::CACHE_CONTROL, "no-store"),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    ];
    (headers, text).into_response()
}

pub(super) fn json_of(value: &impl Serialize) -> Result<Response, Problem> {
    let text = serde_json::to_string(value).map_err(|error| StoreError::corrupt("an answer", error))?;
    Ok(json_text(text))
}

/// The account whose token a request carries.
pub(super) async fn account_of(service: &Service, headers: &HeaderMap) -> Result<Account, Problem> {
    let text = headers.get(header::AUTHORIZATION).filter(|value| value.len() <= MAX_AUTHORIZATION);
    let text = text.and_then(|value| value.to_str().ok());
    let token = text.and_then(|text| text.strip_prefix("Bearer ")).map(str::trim);
    let found = service.store.account_by(token).await?;
    found.map_err(|denied| Problem::new(StatusCode::UNAUTHORIZED, "token", denied.to_string()))
}
