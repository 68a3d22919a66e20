//! The server of replays: for this machine alone.

use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::answers::router;
use crate::page::Page;
use crate::shown::{Desk, Shown};
use crate::{Bags, ReplayError};

/// How often it looks whether it shall stop.
const LOOK: Duration = Duration::from_millis(50);

/// Shows bags in a browser of this machine. It listens on the loopback interface and answers requests for its own address
/// alone, so that no page of another host can read it under a name of its own. Clients name episodes by number, never files.
#[derive(Debug)]
pub struct Viewer {
    listener: TcpListener,
    address: SocketAddr,
    shelf: Arc<Shelf>,
}

impl Viewer {
    /// Listens on a port of 127.0.0.1; 0 is a free one.
    ///
    /// # Errors
    /// [`ReplayError::Listen`]: the port is taken.
    pub fn bind(bags: Bags, port: u16) -> Result<Self, ReplayError> {
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
        let failed = |source| ReplayError::Listen { address, source };
        let listener = TcpListener::bind(address).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let bound = listener.local_addr().map_err(failed)?;
        Ok(Self { listener, address: bound, shelf: Arc::new(Shelf::new(bags)) })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Answers requests until `stop` is set.
    ///
    /// # Errors
    /// [`ReplayError::Serve`]: the listener failed.
    pub fn serve(self, stop: &AtomicBool) -> Result<(), ReplayError> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(ReplayError::Serve)?;
        let served = runtime.block_on(async {
            let listener = tokio::net::TcpListener::from_std(self.listener)?;
            let server = axum::serve(listener, router(self.shelf, self.address.port()));
            tokio::select! {
                served = server.into_future() => served,
                () = stopped(stop) => Ok(()),
            }
        });
        // A replay that is being read is not waited for.
        runtime.shutdown_background();
        served.map_err(ReplayError::Serve)
    }
}

async fn stopped(stop: &AtomicBool) {
    while !stop.load(Ordering::Relaxed) {
        tokio::time::sleep(LOOK).await;
    }
}

/// The bags, their pages, and the replays that were asked for last.
#[derive(Debug)]
pub(crate) struct Shelf {
    pub bags: Bags,
    pub list: Page,
    pub replay: Page,
    desk: Desk,
}

impl Shelf {
    fn new(bags: Bags) -> Self {
        let replay = Page::replay(bags.count() > 1);
        Self { bags, list: Page::list(), replay, desk: Desk::default() }
    }

    /// The replay of a bag; none where there is no bag of that number.
    pub fn show(&self, index: usize) -> Option<Result<Shown, ReplayError>> {
        self.bags.file(index).map(|path| self.desk.show(path, None))
    }
}
