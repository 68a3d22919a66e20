//! The server of the page. Whoever does not name its token gets nothing that shows or moves the robot.

use std::future::Future;
use std::io;
use std::net::{SocketAddr, TcpListener};
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
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
use tokio::io::DuplexStream;
use tokio::net::TcpStream;
use tungstenite::handshake::derive_accept_key;

use crate::page;
use crate::pages::Pages;
use crate::socket::talk;
use crate::station::Station;

/// Time between two looks whether the server should stop.
const LOOK: Duration = Duration::from_millis(50);
/// Time in which pages are told that the program ends.
const FAREWELL: Duration = Duration::from_millis(500);
/// Bytes of a token.
const TOKEN_BYTES: usize = 16;

/// Makes of an accepted connection the stream of what it carries.
pub type Secure =
    Box<dyn Fn(TcpStream) -> Pin<Box<dyn Future<Output = io::Result<DuplexStream>> + Send>> + Send + Sync>;

/// Why the page cannot be served.
#[derive(Debug, Error)]
pub enum ServeError {
    #[error("cannot listen on {address}; choose another port with --port")]
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
    /// Names of this machine besides `localhost`.
    names: Vec<String>,
    pages: Pages,
}

/// The page's server.
pub struct Cockpit {
    listener: TcpListener,
    address: SocketAddr,
    site: Site,
    secure: Option<Secure>,
}

impl Cockpit {
    /// Listens on an address; port 0 picks a free one. It answers requests for addresses in digits, `localhost` and `names`.
    ///
    /// # Errors
    /// [`ServeError`]: the address is taken or not this machine's.
    pub fn bind(address: SocketAddr, names: &[String], station: Arc<Station>) -> Result<Self, ServeError> {
        let failed = |source| ServeError::Listen { address, source };
        let listener = TcpListener::bind(address).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let bound = listener.local_addr().map_err(failed)?;
        let token = HEXLOWER.encode(&fiatlux_access::random::<TOKEN_BYTES>()?);
        let site = Site { station, token, names: names.to_vec(), pages: Pages::default() };
        Ok(Self { listener, address: bound, site, secure: None })
    }

    /// Speaks HTTPS, for these names of this host, the one in the page's address first.
    #[must_use]
    pub fn over_tls(mut self, names: Vec<String>, secure: Secure) -> Self {
        self.site.names = names;
        self.secure = Some(secure);
        self
    }

    /// The address to open in a browser. Whoever has it can drive.
    pub fn url(&self) -> String {
        let token = &self.site.token;
        let port = self.address.port();
        match (&self.secure, self.site.names.first()) {
            (Some(_), Some(host)) if host.contains(':') => format!("https://[{host}]:{port}/?token={token}"),
            (Some(_), Some(host)) => format!("https://{host}:{port}/?token={token}"),
            _ => format!("http://{}/?token={token}", self.address),
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
            let site = Arc::new(self.site);
            let router = router(Arc::clone(&site));
            let served = async {
                match self.secure {
                    None => site::serve(&listener, &router, |stream| std::future::ready(Ok(stream))).await,
                    Some(secure) => site::serve(&listener, &router, secure).await,
                }
            };
            tokio::select! {
                () = served => {}
                () = stopped(stop) => {}
            }
            // Those that do not listen are left.
            drop(tokio::time::timeout(FAREWELL, site.pages.end()).await);
            Ok(())
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

/// Lets only requests to this machine pass, adds the headers of every answer, and ends connections whose request was refused: an idle
/// one would keep its place.
async fn guard(State(site): State<Arc<Site>>, request: Request, next: Next) -> Response {
    let mut answer = if site::is_own(site::host_of(request.headers()), &site.names) {
        next.run(request).await
    } else {
        let text = "this server answers only to its addresses, to localhost, and to the names that --host gives it";
        problem(StatusCode::MISDIRECTED_REQUEST, text)
    };
    if answer.status() == StatusCode::SWITCHING_PROTOCOLS {
        return answer;
    }
    let is_refused = answer.status().is_client_error();
    let headers = answer.headers_mut();
    if is_refused {
        headers.insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
    headers.entry(header::CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    site::guarded(answer)
}

/// Lets only requests with the token pass.
async fn admit(State(site): State<Arc<Site>>, request: Request, next: Next) -> Response {
    if site.admits(request.uri()) {
        if let Some(connection) = site::connection_of(&request) {
            connection.know();
        }
        return next.run(request).await;
    }
    if request.uri().path() == "/" {
        // A page that is loaded again no longer has the token in its address.
        let mut answer = with_policy(page::door());
        *answer.status_mut() = StatusCode::FORBIDDEN;
        return answer;
    }
    let text = "open the address that `fiatlux teleop` printed, with its token: without it nothing is shown";
    problem(StatusCode::FORBIDDEN, text)
}

/// The text of a header; empty where there is none.
fn text_of<'a>(headers: &'a HeaderMap, name: &header::HeaderName) -> &'a str {
    headers.get(name).and_then(|value| value.to_str().ok()).unwrap_or_default()
}

impl Site {
    fn admits(&self, uri: &Uri) -> bool {
        let given = uri.query().unwrap_or_default().split('&').find_map(|part| part.strip_prefix("token="));
        given.is_some_and(|given| bool::from(given.as_bytes().ct_eq(self.token.as_bytes())))
    }
}

async fn home() -> Response {
    with_policy(page::home())
}

/// A page with its Content-Security-Policy.
fn with_policy((html, policy): (String, String)) -> Response {
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
    let headers = request.headers();
    // Browsers say from which page a connection comes; other programs say nothing, and have the token.
    let is_own = headers.get(header::ORIGIN).is_none_or(|origin| {
        origin.to_str().is_ok_and(|origin| site::is_same_origin(origin, site::host_of(headers), &site.names))
    });
    if !is_own {
        let text =
            "only the page of this server may connect; behind a tunnel that changes the name, give that with --host";
        return problem(StatusCode::FORBIDDEN, text);
    }
    let Some(accept) = accept_key(headers) else {
        return problem(StatusCode::BAD_REQUEST, "this address is for the page's WebSocket of version 13");
    };
    let page = site.pages.enter(&site.station);
    let upgrade = hyper::upgrade::on(request);
    tokio::spawn(async move {
        if let Ok(upgraded) = upgrade.await {
            talk(TokioIo::new(upgraded), &page).await;
        }
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
        text_of(headers, &name).split(',').any(|part| part.trim().eq_ignore_ascii_case(word))
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
