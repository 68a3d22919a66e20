//! A server and its recorder in one process.

use std::path::PathBuf;
use std::time::Duration;

use fiatlux_access::RecorderKey;
use fiatlux_carrier::Carrier;

use crate::{BagReport, Naming, Recorder, RecorderOptions, RecordsFrom, RecordsTo, Server, ServerError, ServerOptions};

/// Longest time for bags to close after the last episode.
const CLOSING_TIME: Duration = Duration::from_secs(15);

/// Bags of a server in this process.
pub struct LocalBags {
    /// Their folder.
    pub out: PathBuf,
    pub naming: Naming,
    /// As of [`RecorderOptions`].
    pub thin: bool,
    /// As of [`RecorderOptions`].
    pub on_bag: Box<dyn Fn(BagReport) + Send + Sync>,
}

/// A server, and the recorder of its sessions where there is one, until they are stopped or dropped.
pub struct LocalServer {
    // Dropped first: the recorder still takes what the server sends last.
    server: Server,
    recorder: Option<Recorder>,
    carrier: Carrier,
}

impl LocalServer {
    /// Starts both on a carrier, under the server's name. Records go to the recorder alone, whatever `options` say.
    ///
    /// # Errors
    /// [`ServerError`], that the recorder does not start among them.
    pub fn start(carrier: Carrier, options: ServerOptions, bags: Option<LocalBags>) -> Result<Self, ServerError> {
        let key = RecorderKey::generate()?;
        let record = |LocalBags { out, naming, thin, on_bag }| {
            let options = RecorderOptions {
                out,
                server: Some(options.name.clone()),
                name: options.name.clone(),
                naming,
                thin,
                records: RecordsFrom::ThisProcess(key.clone()),
                on_bag,
                // The bag that lacks them is reported as cut.
                on_loss: Box::new(|_, _| ()),
            };
            Recorder::start(carrier.clone(), options)
        };
        let recorder = bags.map(record).transpose()?;
        let options = ServerOptions { records_to: RecordsTo::ThisProcess(key), ..options };
        Ok(Self { server: Server::start(carrier.clone(), options)?, recorder, carrier })
    }

    /// The carrier that both are on.
    pub fn carrier(&self) -> &Carrier {
        &self.carrier
    }

    pub fn open_sessions(&self) -> usize {
        self.server.open_sessions()
    }

    /// Aborts what is open, waits for bags to close, and stops both.
    pub fn stop(self) {
        self.server.shutdown(CLOSING_TIME);
        drop(self.recorder.map(Recorder::stop));
    }
}
