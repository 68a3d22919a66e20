//! The server of the page. Whoever does not name its token gets nothing that shows or moves the robot.

use std::collections::BTreeMap;
use std::future::Future;
use std::io;
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
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
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use subtle::ConstantTimeEq;
use thiserror::Error;
use tokio::io::DuplexStream;
use tokio::net::TcpStream;
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

/// Longest handshake of TLS.
const MAX_HANDSHAKE: Duration = Duration::from_secs(5);
/// Longest wait for a request on a connection over TLS.
const MAX_WAIT: Duration = Duration::from_secs(10);
/// Most connections over TLS at once, and from one address. Those of pages are counted apart.
const MAX_CONNECTIONS: usize = 128;
const MAX_CONNECTIONS_OF_PEER: usize = 24;

/// Makes of an accepted connection the stream of what it carries.
pub type Secure =
    Box<dyn Fn(TcpStream) -> Pin<Box<dyn Future<Output = io::Result<DuplexStream>> + Send>> + Send + Sync>;

/// Why the page cannot be served.
#[derive(Debug, Error)]
pub enum ServeError {
    #[error("cannot listen on {address}: {source}; choose another port")]
    Listen { address: SocketAddr, source: io::Error },
    #[error("cannot draw a token")]
    Token(#[from] fiatlux_access::AccessError),
    #[error("the server of the page failed")]
    Serve(#[source] io::Error),
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
    /// The name of this machine in the page's address, and TLS.
    secure: Option<(String, Secure)>,
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
        Ok(Self { listener, address: bound, site: Arc::new(site), secure: None })
    }

    /// Speaks HTTPS, with an address of this host.
    #[must_use]
    pub fn over_tls(mut self, host: &str, secure: Secure) -> Self {
        self.secure = Some((host.to_owned(), secure));
        self
    }

    /// The address to open in a browser. Whoever has it can drive.
    pub fn url(&self) -> String {
        let token = &self.site.token;
        let port = self.address.port();
        match &self.secure {
            None => format!("http://{}/?token={token}", self.address),
            Some((host, _)) if host.contains(':') => format!("https://[{host}]:{port}/?token={token}"),
            Some((host, _)) => format!("https://{host}:{port}/?token={token}"),
        }
    }

    /// Answers requests until `stop` is set.
    ///
    /// # Errors
    /// [`ServeError::Serve`].
    pub fn serve(self, stop: &AtomicBool) -> Result<(), ServeError> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(ServeError::Serve)?;
        let served = runtime.block_on(async {
            let listener = tokio::net::TcpListener::from_std(self.listener)?;
            let router = router(self.site);
            let served = async {
                match self.secure {
                    None => axum::serve(listener, router).await,
                    Some((_, secure)) => serve_tls(&listener, &secure, router).await,
                }
            };
            tokio::select! {
                served = served => served,
                () = stopped(stop) => Ok(()),
            }
        });
        runtime.shutdown_background();
        served.map_err(ServeError::Serve)
    }
}

/// Connections by the address that they come from.
#[derive(Default)]
struct Connections(Mutex<BTreeMap<IpAddr, usize>>);

/// A connection as long as it is open.
struct Place(Arc<Connections>, IpAddr);

impl Connections {
    /// `None` where there are too many.
    fn place(self: &Arc<Self>, peer: IpAddr) -> Option<Place> {
        let mut open = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let has_room = open.values().sum::<usize>() < MAX_CONNECTIONS
            && open.get(&peer).is_none_or(|count| *count < MAX_CONNECTIONS_OF_PEER);
        has_room.then(|| {
            *open.entry(peer).or_default() += 1;
            Place(Arc::clone(self), peer)
        })
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut open = self.0.0.lock().unwrap_or_else(PoisonError::into_inner);
        let count = open.get(&self.1).map_or(0, |count| count - 1);
        if count == 0 {
            open.remove(&self.1);
        } else {
            open.insert(self.1, count);
        }
    }
}

/// Answers requests over TLS. Connections that say nothing in time are closed, and those that are too many at once.
async fn serve_tls(listener: &tokio::net::TcpListener, secure: &Secure, router: Router) -> io::Result<()> {
    let connections = Arc::new(Connections::default());
    loop {
        // Such as too many open files: it passes when connections end.
        let Ok((stream, peer)) = listener.accept().await else {
            tokio::time::sleep(LOOK).await;
            continue;
        };
        let Some(place) = connections.place(peer.ip()) else { continue };
        let secured = secure(stream);
        let service = TowerToHyperService::new(router.clone());
        tokio::spawn(async move {
            let _place = place;
            if let Ok(Ok(stream)) = tokio::time::timeout(MAX_HANDSHAKE, secured).await {
                let mut http = http1::Builder::new();
                http.timer(TokioTimer::new()).header_read_timeout(MAX_WAIT);
                // A connection that breaks is one that ends.
                let _ = http.serve_connection(TokioIo::new(stream), service).with_upgrades().await;
            }
        });
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
