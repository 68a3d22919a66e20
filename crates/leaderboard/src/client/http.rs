//! HTTP requests to one service.

use std::io::{self, Read};
use std::time::Duration;

use serde_json::Value;
use ureq::http::Request;
use ureq::{Agent, SendBody};

use super::SubmitError;

/// Maximum size of a response, bytes: 20,000 files of about 250 each.
const MAX_ANSWER: u64 = 16 << 20;
/// Time limit of a request without a file.
const PATIENCE: Duration = Duration::from_secs(90);
const CONNECT: Duration = Duration::from_secs(15);

/// One service, and the token for it.
pub(super) struct Http {
    agent: Agent,
    url: String,
    authorization: String,
}

pub(super) struct Answer {
    pub status: u16,
    /// The body; `null` if it is not JSON.
    pub json: Value,
}

impl Answer {
    pub fn refused(&self) -> SubmitError {
        let text = |field: &str| self.json["error"][field].as_str().map(str::to_owned);
        let code = text("code").unwrap_or_else(|| self.status.to_string());
        let message = text("message").unwrap_or_else(|| "it gives no reason; check that it is a leaderboard".into());
        SubmitError::Refused { code, message }
    }
}

impl Http {
    pub fn new(url: &str, token: &str) -> Result<Self, SubmitError> {
        let url = url.trim_end_matches('/');
        let host = ["https://", "http://"].iter().find_map(|scheme| url.strip_prefix(scheme));
        // A path is that of a proxy, which takes it off.
        let is_good = |rest: &str| !rest.is_empty() && !rest.starts_with('/') && !rest.contains(['?', '#', '@', ' ']);
        if !host.is_some_and(is_good) {
            return Err(SubmitError::Url { url: url.into() });
        }
        let config = Agent::config_builder()
            .http_status_as_error(false)
            // A redirect must not carry the token to another host.
            .max_redirects(0)
            .timeout_connect(Some(CONNECT))
            .timeout_recv_response(Some(PATIENCE))
            .user_agent(concat!("fiatlux/", env!("CARGO_PKG_VERSION")))
            .build();
        Ok(Self { agent: config.into(), url: url.into(), authorization: format!("Bearer {}", token.trim()) })
    }

    pub fn ask(&self, method: &str, address: &str, body: Option<&str>) -> Result<Answer, String> {
        let request = self.request(method, address, body.map_or(0, |body| body.len() as u64))?;
        let mut bytes = body.unwrap_or_default().as_bytes();
        self.send(request, &mut bytes)
    }

    /// Sends `length` bytes of a file from its current position. `on_bytes` gets the length of each part that was read,
    /// and stops the upload by returning `false`.
    pub fn put(
        &self,
        address: &str,
        file: impl Read,
        length: u64,
        on_bytes: &mut dyn FnMut(u64) -> bool,
    ) -> Result<Answer, String> {
        let request = self.request("PUT", address, length)?;
        self.send(request, &mut ProgressReader { file: file.take(length), on_bytes })
    }

    pub fn unanswered(&self, reason: String) -> SubmitError {
        SubmitError::Unanswered { url: self.url.clone(), reason }
    }

    pub fn unreadable(&self, reason: &str) -> SubmitError {
        SubmitError::Unreadable { url: self.url.clone(), reason: reason.into() }
    }

    fn request(&self, method: &str, address: &str, length: u64) -> Result<ureq::http::request::Builder, String> {
        let mut request = Request::builder()
            .method(method)
            .uri(format!("{}{address}", self.url))
            .header("Authorization", &self.authorization);
        if method != "GET" {
            request = request.header("Content-Length", length);
        }
        Ok(request)
    }

    fn send<'b>(&self, request: ureq::http::request::Builder, body: &'b mut (dyn Read + 'b)) -> Result<Answer, String> {
        let is_get = request.method_ref().is_some_and(|method| method == "GET");
        let in_words = |error: ureq::http::Error| error.to_string();
        let answer = match is_get {
            true => self.agent.run(request.body(()).map_err(in_words)?),
            false => self.agent.run(request.body(SendBody::from_reader(body)).map_err(in_words)?),
        };
        let mut answer = answer.map_err(|error| error.to_string())?;
        let status = answer.status().as_u16();
        let text = answer.body_mut().with_config().limit(MAX_ANSWER).read_to_string();
        let text = text.map_err(|error| error.to_string())?;
        Ok(Answer { status, json: serde_json::from_str(&text).unwrap_or(Value::Null) })
    }
}

impl std::fmt::Debug for Http {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Http").field("url", &self.url).finish_non_exhaustive()
    }
}

/// A reader that reports the length of each part.
struct ProgressReader<'a, R> {
    file: R,
    on_bytes: &'a mut dyn FnMut(u64) -> bool,
}

impl<R: Read> Read for ProgressReader<'_, R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let length = self.file.read(buffer)?;
        if length > 0 && !(self.on_bytes)(length as u64) {
            return Err(io::Error::new(io::ErrorKind::ConnectionAborted, "stopped"));
        }
        Ok(length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_of_services_are_told_from_others() {
        for url in ["http://board:8080", "https://board.example.org/", "https://example.org/board", "http://[::1]:8080"]
        {
            assert!(Http::new(url, "t").is_ok(), "{url}");
        }
        assert_eq!(Http::new("https://example.org/board/", "t").expect("an address").url, "https://example.org/board");
        for url in [
            "",
            "board",
            "http://",
            "http:///board",
            "ftp://board",
            "http://a@b",
            "http://a/?b",
            "http://a/#b",
            "http://a b",
        ] {
            assert!(Http::new(url, "t").is_err(), "{url}");
        }
    }
}
