//! The server of replays, for this machine only.

use std::io;
use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::answers::router;
use crate::connections::serve;
use crate::served::ServedBags;
use crate::{Bags, ReplayError};

/// Time between two checks whether the server should stop.
const LOOK: Duration = Duration::from_millis(50);

/// Shows bags in a browser on this machine. It listens on the loopback interface and answers only requests for an
/// address or `localhost`, so that no page of another host can read it under another name. Clients name episodes by number, never
/// files.
#[derive(Debug)]
pub struct Viewer {
    listener: TcpListener,
    address: SocketAddr,
    served: Arc<ServedBags>,
}

impl Viewer {
    /// Listens on a port of 127.0.0.1; 0 picks a free one.
    pub fn bind(bags: Bags, port: u16) -> Result<Self, ReplayError> {
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
        let failed = |source| ReplayError::Listen { address, source };
        let listener = TcpListener::bind(address).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let bound = listener.local_addr().map_err(failed)?;
        Ok(Self { listener, address: bound, served: Arc::new(ServedBags::new(bags)) })
    }

    /// Address to open in a browser.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Answers requests until `stop` is set.
    pub fn serve(self, stop: &AtomicBool) -> Result<(), ReplayError> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(ReplayError::Serve)?;
        let served = runtime.block_on(async {
            let listener = tokio::net::TcpListener::from_std(self.listener)?;
            let router = router(self.served);
            let plain = |stream| std::future::ready(io::Result::Ok(stream));
            tokio::select! {
                () = serve(&listener, &router, plain) => {}
                () = stopped(stop) => {}
            }
            Ok(())
        });
        // Does not wait for a replay that is still being read.
        runtime.shutdown_background();
        served.map_err(ReplayError::Serve)
    }
}

async fn stopped(stop: &AtomicBool) {
    while !stop.load(Ordering::Relaxed) {
        tokio::time::sleep(LOOK).await;
    }
}
