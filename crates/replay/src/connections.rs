//! The connections of a page's server: silent ones end, and a flood of them keeps nobody out.

use std::collections::BTreeMap;
use std::future::Future;
use std::io;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use axum::Router;
use axum::extract::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service as _, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Notify;
use tokio::time::Instant;

/// Longest time until a connection is ready for its first request, such as a handshake of TLS.
const MAX_HANDSHAKE: Duration = Duration::from_secs(5);
/// Longest wait for the head of a request.
const MAX_WAIT: Duration = Duration::from_secs(10);
/// Largest head of a request, bytes, and its number of headers.
const MAX_HEAD: usize = 32 << 10;
const MAX_HEADERS: usize = 64;
/// Most connections at once: those that have shown no token, and those that have. Together they stay below the 256 open files that some
/// systems allow.
const MAX_STRANGERS: usize = 128;
const MAX_KNOWN: usize = 48;
/// Time for which new connections of an address that has shown the token count as known, and the number of such addresses.
const REMEMBERED: Duration = Duration::from_secs(600);
const MAX_REMEMBERED: usize = 64;
/// Pause after a connection could not be accepted, such as for too many open files.
const PAUSE: Duration = Duration::from_millis(50);

/// The open connections of a server. When there are too many, the address that has most of them loses its oldest one, so that a newcomer
/// always gets in. Connections that have shown the token have places of their own.
#[derive(Debug, Default)]
pub struct Connections(Mutex<Open>);

#[derive(Debug, Default)]
struct Open {
    /// In the order in which they came.
    entries: Vec<Entry>,
    count: u64,
    /// Addresses that have shown the token, with the time of the last one. Programs of one machine share an address, so the loopback
    /// interface is never here.
    remembered: BTreeMap<IpAddr, Instant>,
}

#[derive(Debug)]
struct Entry {
    id: u64,
    peer: IpAddr,
    is_known: bool,
    closed: Arc<Notify>,
}

impl Open {
    /// Makes room for one more connection of a kind.
    fn make_room(&mut self, is_known: bool) {
        let max = if is_known { MAX_KNOWN } else { MAX_STRANGERS };
        let mut by_peer: BTreeMap<IpAddr, usize> = BTreeMap::new();
        let of_kind = || self.entries.iter().filter(|entry| entry.is_known == is_known);
        of_kind().for_each(|entry| *by_peer.entry(entry.peer).or_default() += 1);
        if of_kind().count() < max {
            return;
        }
        let most = by_peer.values().max().copied().unwrap_or_default();
        let oldest = self.entries.iter().position(|entry| entry.is_known == is_known && by_peer[&entry.peer] == most);
        if let Some(at) = oldest {
            self.entries.remove(at).closed.notify_one();
        }
    }
}

impl Connections {
    fn open(&self) -> MutexGuard<'_, Open> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn enter(self: &Arc<Self>, peer: IpAddr) -> Connection {
        let peer = peer.to_canonical();
        let mut open = self.open();
        let is_known = open.remembered.get(&peer).is_some_and(|last| last.elapsed() < REMEMBERED);
        open.make_room(is_known);
        open.count += 1;
        let (id, closed) = (open.count, Arc::new(Notify::new()));
        open.entries.push(Entry { id, peer, is_known, closed: Arc::clone(&closed) });
        Connection { all: Arc::clone(self), id, peer, closed }
    }
}

/// An open connection. Each of its requests carries it as an extension.
#[derive(Debug)]
pub struct Connection {
    all: Arc<Connections>,
    id: u64,
    peer: IpAddr,
    closed: Arc<Notify>,
}

impl Connection {
    /// It has shown the token: it gets a place that strangers cannot take.
    pub fn know(&self) {
        let mut open = self.all.open();
        if !self.peer.is_loopback() {
            if open.remembered.len() >= MAX_REMEMBERED {
                open.remembered.retain(|_, last| last.elapsed() < REMEMBERED);
            }
            if open.remembered.len() < MAX_REMEMBERED {
                open.remembered.insert(self.peer, Instant::now());
            }
        }
        let Some(at) = open.entries.iter().position(|entry| entry.id == self.id && !entry.is_known) else { return };
        let mut entry = open.entries.remove(at);
        entry.is_known = true;
        open.make_room(true);
        open.entries.push(entry);
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.all.open().entries.retain(|entry| entry.id != self.id);
    }
}

/// Answers requests for ever. `secure` makes of an accepted connection the stream of what it carries.
pub async fn serve<S, F>(listener: &TcpListener, router: &Router, secure: impl Fn(TcpStream) -> F)
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    F: Future<Output = io::Result<S>> + Send + 'static,
{
    let connections = Arc::new(Connections::default());
    loop {
        let Ok((stream, peer)) = listener.accept().await else {
            tokio::time::sleep(PAUSE).await;
            continue;
        };
        // A failure to set this only makes small answers slower.
        drop(stream.set_nodelay(true));
        let connection = Arc::new(connections.enter(peer.ip()));
        tokio::spawn(answer(connection, secure(stream), router.clone()));
        // In a flood of new connections, those that are open get their turn.
        tokio::task::yield_now().await;
    }
}

/// Answers the requests of a connection until it ends, breaks, or has to give its place away.
async fn answer<S>(connection: Arc<Connection>, secured: impl Future<Output = io::Result<S>>, router: Router)
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let closed = Arc::clone(&connection.closed);
    let serving = async {
        let Ok(Ok(stream)) = tokio::time::timeout(MAX_HANDSHAKE, secured).await else { return };
        let service = service_fn(move |mut request: hyper::Request<Incoming>| {
            request.extensions_mut().insert(Arc::clone(&connection));
            TowerToHyperService::new(router.clone()).call(request)
        });
        let mut http = http1::Builder::new();
        http.timer(TokioTimer::new()).header_read_timeout(MAX_WAIT).max_headers(MAX_HEADERS).max_buf_size(MAX_HEAD);
        // A connection that breaks is one that ends.
        drop(http.serve_connection(TokioIo::new(stream), service).with_upgrades().await);
    };
    tokio::select! {
        () = serving => {}
        () = closed.notified() => {}
    }
}

/// The connection of a request; `None` if no [`serve`] accepted it, as in tests.
pub fn connection_of(request: &Request) -> Option<&Connection> {
    request.extensions().get::<Arc<Connection>>().map(Arc::as_ref)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(last: u8) -> IpAddr {
        IpAddr::from([10, 9, 0, last])
    }

    fn is_open(connection: &Connection) -> bool {
        connection.all.open().entries.iter().any(|entry| entry.id == connection.id)
    }

    #[test]
    fn a_flood_pushes_out_its_own_connections() {
        let all = Arc::new(Connections::default());
        let reader = all.enter(address(1));
        let flood: Vec<Connection> = (0..1000).map(|index: u16| all.enter(address(2 + (index % 32) as u8))).collect();
        assert!(is_open(&reader), "it has one connection, and the others have four");
        assert_eq!(all.open().entries.len(), MAX_STRANGERS);
        assert!(!is_open(&flood[0]) && is_open(&flood[999]));
        drop(flood);
        assert_eq!(all.open().entries.len(), 1);
        drop(reader);
        assert!(all.open().entries.is_empty());
    }

    #[test]
    fn strangers_cannot_take_the_place_of_who_has_shown_the_token() {
        let all = Arc::new(Connections::default());
        let loopback = IpAddr::from([127, 0, 0, 1]);
        let known: Vec<Connection> = (0..6).map(|_| all.enter(loopback)).collect();
        known.iter().for_each(Connection::know);
        let _flood: Vec<Connection> = (0..1000).map(|_| all.enter(loopback)).collect();
        assert!(known.iter().all(is_open));
        // Even those with the token have a limit.
        let more: Vec<Connection> = (0..100).map(|_| all.enter(loopback)).collect();
        more.iter().for_each(Connection::know);
        assert_eq!(all.open().entries.iter().filter(|entry| entry.is_known).count(), MAX_KNOWN);
        assert!(more.last().is_some_and(is_open));
    }

    #[test]
    fn an_address_of_the_network_that_has_shown_the_token_is_remembered() {
        let all = Arc::new(Connections::default());
        all.enter(address(1)).know();
        let next = all.enter(address(1));
        let _flood: Vec<Connection> = (0..1000).map(|_| all.enter(address(2))).collect();
        assert!(is_open(&next) && all.open().entries[0].is_known);
        all.enter(IpAddr::from([127, 0, 0, 1])).know();
        let local = all.enter(IpAddr::from([127, 0, 0, 1]));
        assert!(all.open().entries.iter().any(|entry| entry.id == local.id && !entry.is_known));
    }
}
