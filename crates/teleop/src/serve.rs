//! The server of the page. Whoever does not name its token gets nothing that shows or moves the robot.

use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::extract::{Path, Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use data_encoding::HEXLOWER;
use fiatlux_replay::site;
use hyper_util::rt::TokioIo;
use subtle::ConstantTimeEq;
use thiserror::Error;
use tungstenite::handshake::derive_accept_key;

use crate::page;
use crate::socket::talk;
use crate::station::Station;

/// Time between two looks whether the server should stop.
const LOOK: Duration = Duration::from_millis(50);
/// Most pages at once.
const MAX_PAGES: usize = 16;
/// Bytes of a token.
const TOKEN_BYTES: usize = 16;

/// Why the page cannot be served.
#[derive(Debug, Error)]
pub enum ServeError {
    #[error("cannot listen on {address}: {source}; choose another port")]
    Listen { address: SocketAddr, source: std::io::Error },
    #[error("cannot draw a token")]
    Token(#[from] fiatlux_access::AccessError),
    #[error("the server of the page failed")]
    Serve(#[source] std::io::Error),
}

/// Shared by all requests.
struct Site {
    station: Arc<Station>,
    token: String,
    port: u16,
    /// Other names than those of the loopback interface are answered.
    is_open: bool,
    pages: AtomicUsize,
}

/// The page's server.
pub struct Cockpit {
    listener: TcpListener,
    address: SocketAddr,
    site: Arc<Site>,
}

impl Cockpit {
    /// Listens on an address; port 0 picks a free one.
    ///
    /// # Errors
    /// [`ServeError`]: the address is taken or not this machine's.
    pub fn bind(address: SocketAddr, station: Arc<Station>) -> Result<Self, ServeError> {
        let failed = |source| ServeError::Listen { address, source };
        let listener = TcpListener::bind(address).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let bound = listener.local_addr().map_err(failed)?;
        let token = HEXLOWER.encode(&fiatlux_access::random::<TOKEN_BYTES>()?);
        let is_open = !bound.ip().is_loopback();
        let site = Site { station, token, port: bound.port(), is_open, pages: AtomicUsize::new(0) };
        Ok(Self { listener, address: bound, site: Arc::new(site) })
    }

    /// The address to open in a browser. Whoever has it can drive.
    pub fn url(&self) -> String {
        format!("http://{}/?token={}", self.address, self.site.token)
    }

    /// Answers requests until `stop` is set.
    ///
    /// # Errors
    /// [`ServeError::Serve`].
    pub fn serve(self, stop: &AtomicBool) -> Result<(), ServeError> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(ServeError::Serve)?;
        let served = runtime.block_on(async {
            let listener = tokio::net::TcpListener::from_std(self.listener)?;
            let server = axum::serve(listener, router(self.site));
            tokio::select! {
                served = server.into_future() => served,
                () = stopped(stop) => Ok(()),
            }
        });
        runtime.shutdown_background();
        served.map_err(ServeError::Serve)
    }
}

async fn stopped(stop: &AtomicBool) {
    while !stop.load(Ordering::Relaxed) {
        tokio::time::sleep(LOOK).await;
    }
}

fn router(site: Arc<Site>) -> Router {
    let guarded = Router::new()
        .route("/", get(home))
        .route("/document.json", get(document))
        .route("/meshes.bin", get(meshes))
        .route("/drive", get(drive))
        .layer(from_fn_with_state(Arc::clone(&site), admit));
    Router::new()
        .merge(guarded)
        // The same for everybody: nothing of the robot is in it.
        .route("/page/{file}", get(page_file))
        .fallback(|| async { problem(StatusCode::NOT_FOUND, "nothing is at this address") })
        .layer(from_fn_with_state(Arc::clone(&site), guard))
        .with_state(site)
}

/// Adds the headers of every answer; on the loopback interface lets only requests to its own names pass.
async fn guard(State(site): State<Arc<Site>>, request: Request, next: Next) -> Response {
    let host = request.headers().get(header::HOST).and_then(|host| host.to_str().ok()).unwrap_or_default();
    let (name, asked) = host.rsplit_once(':').unwrap_or((host, "80"));
    let is_own = ["127.0.0.1", "localhost", "[::1]"].contains(&name) && asked == site.port.to_string();
    let mut answer = if site.is_open || is_own {
        next.run(request).await
    } else {
        problem(StatusCode::MISDIRECTED_REQUEST, "this server answers only to 127.0.0.1 and localhost with its port")
    };
    if answer.status() == StatusCode::SWITCHING_PROTOCOLS {
        return answer;
    }
    answer.headers_mut().entry(header::CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    site::guarded(answer)
}

/// Lets only requests with the token pass.
async fn admit(State(site): State<Arc<Site>>, request: Request, next: Next) -> Response {
    if site.admits(request.uri()) {
        return next.run(request).await;
    }
    let text = "open the address that `fiatlux teleop` printed, with its token: without it nothing is shown";
    problem(StatusCode::FORBIDDEN, text)
}

impl Site {
    fn admits(&self, uri: &Uri) -> bool {
        let given = uri.query().unwrap_or_default().split('&').find_map(|part| part.strip_prefix("token="));
        given.is_some_and(|given| bool::from(given.as_bytes().ct_eq(self.token.as_bytes())))
    }
}

async fn home() -> Response {
    let (html, policy) = page::home();
    let mut answer = content("text/html; charset=utf-8", html);
    if let Ok(policy) = HeaderValue::from_str(&policy) {
        answer.headers_mut().insert(header::CONTENT_SECURITY_POLICY, policy);
    }
    answer
}

async fn document(State(site): State<Arc<Site>>) -> Response {
    content("application/json", site.station.room().document.clone())
}

async fn meshes(State(site): State<Arc<Site>>) -> Response {
    content("application/octet-stream", site.station.room().meshes.clone())
}

async fn page_file(Path(file): Path<String>) -> Response {
    match page::part(&file) {
        Some((kind, text)) => content(kind, text),
        None => problem(StatusCode::NOT_FOUND, "the page has no such file"),
    }
}

/// Opens the connection of a page.
async fn drive(State(site): State<Arc<Site>>, request: Request) -> Response {
    let Some(accept) = accept_key(request.headers()) else {
        return problem(StatusCode::BAD_REQUEST, "this address is for the page's WebSocket of version 13");
    };
    if site.pages.fetch_add(1, Ordering::Relaxed) >= MAX_PAGES {
        site.pages.fetch_sub(1, Ordering::Relaxed);
        return problem(StatusCode::SERVICE_UNAVAILABLE, "too many pages are open; close one");
    }
    let upgrade = hyper::upgrade::on(request);
    tokio::spawn(async move {
        if let Ok(upgraded) = upgrade.await {
            talk(TokioIo::new(upgraded), Arc::clone(&site.station)).await;
        }
        site.pages.fetch_sub(1, Ordering::Relaxed);
    });
    let mut answer = StatusCode::SWITCHING_PROTOCOLS.into_response();
    let headers = answer.headers_mut();
    headers.insert(header::UPGRADE, HeaderValue::from_static("websocket"));
    headers.insert(header::CONNECTION, HeaderValue::from_static("upgrade"));
    headers.insert(header::SEC_WEBSOCKET_ACCEPT, accept);
    answer
}

/// The answer to the key of a request for a WebSocket; `None` if it is none.
fn accept_key(headers: &HeaderMap) -> Option<HeaderValue> {
    let has = |name: header::HeaderName, word: &str| {
        let value = headers.get(name).and_then(|value| value.to_str().ok()).unwrap_or_default();
        value.split(',').any(|part| part.trim().eq_ignore_ascii_case(word))
    };
    let asks = has(header::UPGRADE, "websocket") && has(header::CONNECTION, "upgrade");
    if !asks || !has(header::SEC_WEBSOCKET_VERSION, "13") {
        return None;
    }
    let key = headers.get(header::SEC_WEBSOCKET_KEY)?;
    HeaderValue::from_str(&derive_accept_key(key.as_bytes())).ok()
}

fn content(kind: &'static str, body: impl Into<Body>) -> Response {
    ([(header::CONTENT_TYPE, kind)], body.into()).into_response()
}

fn problem(status: StatusCode, what: &'static str) -> Response {
    (status, content("text/plain; charset=utf-8", what)).into_response()
}
