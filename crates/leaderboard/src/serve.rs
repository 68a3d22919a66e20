//! The HTTP server, with limits on connections, headers and waiting times.

use std::io;
use std::net::{IpAddr, SocketAddr};
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use axum::Router;
use hyper::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service as _, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::sync::{Semaphore, watch};
use tokio::task::JoinSet;

use crate::paced::Paced;
use crate::visitors::{SEND_BUFFER, Visit, Visitors};
use crate::{Pace, Service};

/// Maximum size of the head of a request, bytes, and of the data that a client sends ahead.
const MAX_HEAD: usize = 32 << 10;
const MAX_HEADERS: usize = 64;
/// Time limit for the head of a request, from the end of the request before it.
const HEAD_TIME: Duration = Duration::from_secs(10);
/// Maximum lifetime of a connection; after that a client must open another one.
const CONNECTION_TIME: Duration = Duration::from_secs(6 * 3600);
/// Time in which requests must end when the service stops.
const DRAIN: Duration = Duration::from_secs(10);
/// Wait after the system has refused a connection, for example because file handles ran out.
const PAUSE: Duration = Duration::from_millis(50);

/// Connections that wait to be accepted.
const BACKLOG: u32 = 1024;
/// Maximum number of connections to the address for metrics.
const MAX_METRICS_CONNECTIONS: usize = 16;

/// Listens on an address, for [`serve`]; port 0 picks a free one.
pub fn listen(address: SocketAddr) -> io::Result<TcpListener> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
    socket.set_reuseaddr(true)?;
    // Its connections inherit the size.
    socket.set_send_buffer_size(SEND_BUFFER)?;
    socket.bind(address)?;
    socket.listen(BACKLOG)
}

/// Answers only requests for `/metrics`, until it is dropped.
pub async fn serve_metrics(service: Arc<Service>, listener: TcpListener) -> io::Result<()> {
    let (router, pace) = (crate::metrics::router(Arc::clone(&service)), service.options.pace);
    let open = |_, _| {
        let router = router.clone();
        Some(move |stream, ended| answer(stream, None, router, pace, ended))
    };
    accept(listener, MAX_METRICS_CONNECTIONS, std::future::pending(), open).await;
    Ok(())
}

/// Answers requests until `stop` completes; then accepts no new ones, and gives open ones ten seconds to end.
pub async fn serve(
    service: Arc<Service>,
    listener: TcpListener,
    most_connections: usize,
    stop: impl Future<Output = ()>,
) -> io::Result<()> {
    let router = crate::router(Arc::clone(&service));
    let visitors = Visitors::new(Arc::clone(&service), most_connections);
    let open = |peer, own| {
        // Closed at once if its address has too many.
        let visit = visitors.connect(peer, own)?;
        let (service, router) = (Arc::clone(&service), router.clone());
        Some(move |stream, ended| async move {
            service.metrics.connections.fetch_add(1, Ordering::Relaxed);
            answer(stream, Some(visit), router, service.options.pace, ended).await;
            service.metrics.connections.fetch_sub(1, Ordering::Relaxed);
        })
    };
    accept(listener, most_connections, stop, open).await;
    Ok(())
}

/// Accepts connections until `stop` completes. `open` makes the answering task; with `None` the connection is closed.
async fn accept<Answer, Answering>(
    listener: TcpListener,
    most_connections: usize,
    stop: impl Future<Output = ()>,
    open: impl Fn(IpAddr, IpAddr) -> Option<Answer>,
) where
    Answer: FnOnce(TcpStream, watch::Receiver<bool>) -> Answering,
    Answering: Future<Output = ()> + Send + 'static,
{
    let places = Arc::new(Semaphore::new(most_connections));
    let (ending, ended) = watch::channel(false);
    let mut connections = JoinSet::new();
    let mut stop = pin!(stop);
    loop {
        // While no place is free, new connections wait in the system's queue.
        let place = tokio::select! {
            place = Arc::clone(&places).acquire_owned() => place,
            () = &mut stop => break,
        };
        let Ok(place) = place else { break };
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            () = &mut stop => break,
        };
        while connections.try_join_next().is_some() {}
        match accepted {
            Ok((stream, peer)) => {
                // A connection that has no address is broken already.
                let Ok(own) = stream.local_addr() else { continue };
                let Some(answer) = open(peer.ip(), own.ip()) else { continue };
                let answering = answer(stream, ended.clone());
                connections.spawn(async move {
                    answering.await;
                    drop(place);
                });
            }
            Err(error) => {
                tracing::warn!(%error, "cannot accept a connection");
                tokio::time::sleep(PAUSE).await;
            }
        }
    }
    drop(listener);
    ending.send_replace(true);
    let drained = async { while connections.join_next().await.is_some() {} };
    if tokio::time::timeout(DRAIN, drained).await.is_err() {
        tracing::warn!(open = connections.len(), "connections were cut; their uploads can be resumed");
    }
}

/// Answers the requests of a connection, each of which carries the visit as an extension.
async fn answer(
    stream: TcpStream,
    visit: Option<Arc<Visit>>,
    router: Router,
    pace: Pace,
    mut ended: watch::Receiver<bool>,
) {
    // Small responses should not wait for each other; a failure to set this only makes them slower.
    drop(stream.set_nodelay(true));
    let service = service_fn(move |mut request: Request<Incoming>| {
        if let Some(visit) = &visit {
            request.extensions_mut().insert(Arc::clone(visit));
        }
        TowerToHyperService::new(router.clone()).call(request)
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD_TIME)
        .max_headers(MAX_HEADERS)
        // Some clients close their side once they have sent a request.
        .half_close(true)
        .max_buf_size(MAX_HEAD)
        .serve_connection(TokioIo::new(Paced::new(stream, pace)), service);
    let mut connection = pin!(connection);
    let late = tokio::time::sleep(CONNECTION_TIME);
    let done = tokio::select! {
        done = connection.as_mut() => done,
        () = async { drop(ended.wait_for(|ended| *ended).await) } => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
        () = late => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = done {
        tracing::debug!(%error, "a connection ended with an error");
    }
}
