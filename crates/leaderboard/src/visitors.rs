//! Limits on the share of the service that one address may use, with a reserve for small pages.
//!
//! The address is that of the connection. Behind a proxy on this machine, or one that the service trusts, it is the one that the proxy
//! says, see [`Proxies`](crate::Proxies).

use std::collections::BTreeMap;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use axum::body::HttpBody;
use axum::extract::Request;
use axum::http::{HeaderMap, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::Service;
use crate::api::Problem;

/// An address may have this share of all connections, ...
const SHARE_OF_ADDRESS: usize = 8;
/// ... but at least this many.
const MIN_OF_ADDRESS: usize = 4;
/// Uploads and large answers may have this share of all connections. The rest is reserved for small pages.
const SHARE_OF_LARGE: usize = 2;
/// Size of the system's buffer for an answer, bytes. A fixed size makes the progress of a slow client visible, and
/// limits the memory of all of them together.
pub(crate) const SEND_BUFFER: u32 = 128 << 10;
/// Bodies up to this size are small, bytes: they fit into the system's buffer, even if their reader does not read.
const SMALL: u64 = SEND_BUFFER as u64;
/// Wrong tokens that an address may send before it is slowed.
const FREE_DENIALS: u32 = 3;
/// Pause after the first wrong token that is slowed. It doubles with each further one.
const FIRST_PAUSE: Duration = Duration::from_millis(125);
/// Time without a wrong token after which an address is forgotten.
const FORGET: Duration = Duration::from_secs(600);
/// Maximum number of addresses whose wrong tokens are counted.
const MAX_DENIED: usize = 4096;

/// The connections of all addresses.
#[derive(Debug)]
pub(crate) struct Visitors {
    service: Arc<Service>,
    most_of_address: usize,
    connections: Mutex<BTreeMap<IpAddr, usize>>,
    large: Arc<Semaphore>,
    /// Wrong tokens by address, with the time of the last one.
    denied: Mutex<BTreeMap<IpAddr, (u32, Instant)>>,
}

impl Visitors {
    pub fn new(service: Arc<Service>, most_connections: usize) -> Arc<Self> {
        Arc::new(Self {
            service,
            most_of_address: (most_connections / SHARE_OF_ADDRESS).max(MIN_OF_ADDRESS),
            connections: Mutex::default(),
            large: Arc::new(Semaphore::new((most_connections / SHARE_OF_LARGE).max(1))),
            denied: Mutex::default(),
        })
    }

    /// A new connection from `peer` to the address `own` of this machine; `None` if its address has too many already. Those of a proxy
    /// are counted by request.
    pub fn connect(self: &Arc<Self>, peer: IpAddr, own: IpAddr) -> Option<Arc<Visit>> {
        let (peer, own) = (peer.to_canonical(), own.to_canonical());
        let is_proxy = self.service.options.proxies.has(peer, own);
        let slot = if is_proxy { None } else { Some(self.slot(peer)?) };
        Some(Arc::new(Visit { visitors: Arc::clone(self), peer, is_proxy, _slot: slot, held: Mutex::default() }))
    }

    fn slot(self: &Arc<Self>, address: IpAddr) -> Option<ConnectionSlot> {
        let address = network(address);
        let mut connections = lock(&self.connections);
        let count = connections.entry(address).or_insert(0);
        if *count >= self.most_of_address {
            self.service.metrics.refused.fetch_add(1, Ordering::Relaxed);
            return None;
        }
        *count += 1;
        Some(ConnectionSlot { visitors: Arc::clone(self), address })
    }

    /// Counts and logs a wrong token; returns the pause before the answer.
    fn deny(&self, address: IpAddr) -> Duration {
        let (address, now) = (network(address), Instant::now());
        let mut denied = lock(&self.denied);
        denied.retain(|_, (_, last)| now.duration_since(*last) < FORGET);
        if denied.len() >= MAX_DENIED && !denied.contains_key(&address) {
            let oldest = denied.iter().min_by_key(|(_, (_, last))| *last).map(|(address, _)| *address);
            oldest.map(|oldest| denied.remove(&oldest));
        }
        let (count, last) = denied.entry(address).or_insert((0, now));
        (*count, *last) = (count.saturating_add(1), now);
        if count.is_power_of_two() {
            tracing::warn!(%address, count, "wrong tokens; more are slowed");
        }
        let Some(doublings) = count.checked_sub(FREE_DENIALS + 1) else { return Duration::ZERO };
        FIRST_PAUSE
            .saturating_mul(1_u32.checked_shl(doublings).unwrap_or(u32::MAX))
            .min(self.service.options.token_pause)
    }
}

/// One of the connections of an address.
#[derive(Debug)]
struct ConnectionSlot {
    visitors: Arc<Visitors>,
    address: IpAddr,
}

impl Drop for ConnectionSlot {
    fn drop(&mut self) {
        let mut connections = lock(&self.visitors.connections);
        if let Some(count) = connections.get_mut(&self.address) {
            *count -= 1;
            if *count == 0 {
                connections.remove(&self.address);
            }
        }
    }
}

/// A connection. Each of its requests carries it as an extension.
#[derive(Debug)]
pub(crate) struct Visit {
    visitors: Arc<Visitors>,
    peer: IpAddr,
    is_proxy: bool,
    _slot: Option<ConnectionSlot>,
    /// Held by the last request: its answer may still be on the way when its body has been handed to the system.
    held: Mutex<(Option<ConnectionSlot>, Option<OwnedSemaphorePermit>)>,
}

impl Visit {
    fn address(&self, headers: &HeaderMap) -> IpAddr {
        if self.is_proxy { self.visitors.service.options.proxies.visitor(self.peer, headers) } else { self.peer }
    }

    /// Takes one of the places for uploads and large answers, if it has none.
    fn take_large(&self) -> Result<(), Problem> {
        let mut held = lock(&self.held);
        if held.1.is_none() {
            let permit = Arc::clone(&self.visitors.large).try_acquire_owned();
            held.1 =
                Some(permit.map_err(|_| Problem::busy("too many uploads and downloads at once; try again later"))?);
        }
        Ok(())
    }
}

/// Admits a request if its address and its kind have a free place.
pub(crate) async fn admit(request: Request, next: Next) -> Response {
    // Without a connection, as in tests, nothing is counted.
    let Some(visit) = request.extensions().get::<Arc<Visit>>().cloned() else { return next.run(request).await };
    let address = visit.address(request.headers());
    *lock(&visit.held) = (None, None);
    if visit.is_proxy {
        let Some(slot) = visit.visitors.slot(address) else {
            let message = format!(
                "{address} has too many requests at once; try again later (a proxy in front of this service must send \
                 X-Forwarded-For)"
            );
            return refused(Problem::new(StatusCode::TOO_MANY_REQUESTS, "address", message));
        };
        lock(&visit.held).0 = Some(slot);
    }
    if is_large(request.body())
        && let Err(problem) = visit.take_large()
    {
        return refused(problem);
    }
    let has_token = request.headers().contains_key(header::AUTHORIZATION);
    let answer = next.run(request).await;
    if has_token && answer.status() == StatusCode::UNAUTHORIZED {
        tokio::time::sleep(visit.visitors.deny(address)).await;
    }
    if is_large(answer.body())
        && let Err(problem) = visit.take_large()
    {
        return refused(problem);
    }
    answer
}

/// A refusal that ends the connection: an idle one would keep its place.
fn refused(problem: Problem) -> Response {
    let close = [(header::CONNECTION, "close"), (header::RETRY_AFTER, "5")];
    (close, problem).into_response()
}

/// True if a body has more bytes than are [`SMALL`], or no known size.
fn is_large(body: &impl HttpBody) -> bool {
    body.size_hint().exact().is_none_or(|bytes| bytes > SMALL)
}

/// The key of an address: for IPv6 the network, whose addresses belong to one site.
fn network(address: IpAddr) -> IpAddr {
    match address {
        IpAddr::V4(_) => address,
        IpAddr::V6(address) => Ipv6Addr::from_bits(address.to_bits() >> 64 << 64).into(),
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
