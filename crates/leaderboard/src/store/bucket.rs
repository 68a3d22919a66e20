//! A bucket of S3, or of a server that speaks its protocol, over the HTTP client that the rest of the program uses.

use std::future::Future;
use std::io::Read as _;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use http_body_util::BodyExt as _;
use hyper::body::{Body, Bytes, Frame};
use object_store::aws::AmazonS3Builder;
use object_store::client::{
    ClientOptions, HttpClient, HttpConnector, HttpError, HttpErrorKind, HttpRequest, HttpResponse, HttpResponseBody,
    HttpService,
};
use object_store::prefix::PrefixStore;
use object_store::{ObjectStore, RetryConfig};
use tokio::sync::mpsc;
use ureq::Agent;

/// Size of the pieces of an answer, bytes, and the number of those that wait to be taken.
const PIECE: usize = 256 << 10;
const PIECES: usize = 4;
const CONNECT: Duration = Duration::from_secs(10);
/// Time limit for the head of an answer.
const PATIENCE: Duration = Duration::from_secs(60);
/// Time limit for a request with all its repeats: people wait for pages.
const RETRY: Duration = Duration::from_secs(30);

/// A bucket, below a prefix if that is not empty. Endpoint, region and credentials are in these variables, as Amazon's own programs name
/// them (`AWS_ACCESS_KEY_ID`, `AWS_ENDPOINT_URL`, `AWS_ALLOW_HTTP`, ...).
pub(super) fn open(
    bucket: &str,
    prefix: &str,
    variables: impl IntoIterator<Item = (String, String)>,
) -> object_store::Result<Arc<dyn ObjectStore>> {
    let known = |(name, value): (String, String)| Some((name.to_ascii_lowercase().parse().ok()?, value));
    let own = variables.into_iter().filter(|(name, _)| name.starts_with("AWS_")).filter_map(known);
    let builder = own.fold(AmazonS3Builder::new(), |builder, (key, value)| builder.with_config(key, value));
    let store = builder
        .with_bucket_name(bucket)
        .with_http_connector(Connector)
        .with_disable_bulk_delete(true)
        .with_retry(RetryConfig { max_retries: 5, retry_timeout: RETRY, ..RetryConfig::default() })
        .build()?;
    Ok(if prefix.is_empty() { Arc::new(store) } else { Arc::new(PrefixStore::new(store, prefix)) })
}

#[derive(Debug)]
struct Connector;

impl HttpConnector for Connector {
    fn connect(&self, _options: &ClientOptions) -> object_store::Result<HttpClient> {
        let config = Agent::config_builder()
            .http_status_as_error(false)
            .max_redirects(0)
            .timeout_connect(Some(CONNECT))
            .timeout_recv_response(Some(PATIENCE))
            .user_agent(concat!("fiatlux/", env!("CARGO_PKG_VERSION")))
            .build();
        Ok(HttpClient::new(Service(config.into())))
    }
}

#[derive(Debug)]
struct Service(Agent);

type Called<'f> = Pin<Box<dyn Future<Output = Result<HttpResponse, HttpError>> + Send + 'f>>;

impl HttpService for Service {
    fn call<'s, 'f>(&'s self, request: HttpRequest) -> Called<'f>
    where
        's: 'f,
        Self: 'f,
    {
        let agent = self.0.clone();
        Box::pin(async move {
            let (parts, body) = request.into_parts();
            let body = body.collect().await?.to_bytes();
            let (send, receive) = mpsc::channel(PIECES);
            let called = tokio::task::spawn_blocking(move || {
                // Some methods have no body, not even an empty one.
                let answer = if body.is_empty() && ["GET", "HEAD", "DELETE"].contains(&parts.method.as_str()) {
                    agent.run(ureq::http::Request::from_parts(parts, ()))
                } else {
                    agent.run(ureq::http::Request::from_parts(parts, body.to_vec()))
                };
                let answer = answer.map_err(http_error)?;
                let (parts, body) = answer.into_parts();
                Ok::<_, HttpError>((parts, body))
            });
            let (parts, body) = called.await.map_err(|error| HttpError::new(HttpErrorKind::Unknown, error))??;
            // Another thread for the rest of the answer, which ends when nobody takes it any more.
            tokio::task::spawn_blocking(move || send_body(body, &send));
            Ok(HttpResponse::from_parts(parts, HttpResponseBody::new(Received(receive))))
        })
    }
}

fn send_body(body: ureq::Body, to: &mpsc::Sender<Result<Bytes, HttpError>>) {
    let mut reader = body.into_reader();
    loop {
        let mut piece = Vec::new();
        let read = reader.by_ref().take(PIECE as u64).read_to_end(&mut piece);
        let piece = match read {
            Ok(0) => return,
            Ok(_) => Ok(piece.into()),
            Err(error) => Err(HttpError::new(HttpErrorKind::Interrupted, error)),
        };
        let is_last = piece.is_err();
        if to.blocking_send(piece).is_err() || is_last {
            return;
        }
    }
}

fn http_error(error: ureq::Error) -> HttpError {
    let kind = match &error {
        ureq::Error::Timeout(_) => HttpErrorKind::Timeout,
        ureq::Error::ConnectionFailed | ureq::Error::HostNotFound => HttpErrorKind::Connect,
        ureq::Error::Io(error) if error.kind() == std::io::ErrorKind::ConnectionRefused => HttpErrorKind::Connect,
        ureq::Error::Io(_) | ureq::Error::Protocol(_) => HttpErrorKind::Interrupted,
        _ => HttpErrorKind::Unknown,
    };
    HttpError::new(kind, error)
}

/// The body of an answer, piece by piece.
struct Received(mpsc::Receiver<Result<Bytes, HttpError>>);

impl Body for Received {
    type Data = Bytes;
    type Error = HttpError;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, HttpError>>> {
        self.0.poll_recv(context).map(|piece| piece.map(|piece| piece.map(Frame::data)))
    }
}
