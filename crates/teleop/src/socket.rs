//! The connection of a page: inputs come in, states go out, the newest ones only.

use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::sync::watch;
use tungstenite::protocol::{CloseFrame, Role, WebSocketConfig};
use tungstenite::{Error, Message, WebSocket};

use crate::pages::{Farewell, Page};

/// Largest message of a page, bytes: that of a headset has some 2,000.
const MAX_MESSAGE: usize = 32 * 1024;
/// A page that reads nothing for this long is dropped.
const MAX_WRITE: Duration = Duration::from_secs(5);

/// Bytes that have arrived and bytes to send, between the WebSocket and the connection.
#[derive(Debug, Default)]
struct Pipe {
    arrived: VecDeque<u8>,
    outgoing: Vec<u8>,
}

impl Read for Pipe {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.arrived.is_empty() { Err(io::ErrorKind::WouldBlock.into()) } else { self.arrived.read(buffer) }
    }
}

impl Write for Pipe {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.outgoing.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Budget of a page, in units: a message is one, and so are this many bytes. A headset sends 120 messages of 2,000 bytes a second, which
/// are 240 units.
const UNIT_BYTES: f64 = 2048.0;
const MAX_RATE: f64 = 500.0;
/// Units that a page may save up, for what a network delivers late.
const MAX_SAVED: f64 = 500.0;

/// Limits what a page may send: the rest of it waits, at the page's own end, and costs the others nothing.
#[derive(Debug)]
struct Budget {
    units: f64,
    /// When `units` was computed.
    at: Instant,
}

impl Budget {
    fn new(now: Instant) -> Self {
        Self { units: MAX_SAVED, at: now }
    }

    fn spend(&mut self, units: f64, now: Instant) {
        self.units = (self.units + MAX_RATE * (now - self.at).as_secs_f64()).min(MAX_SAVED) - units;
        self.at = now;
    }

    /// When the page may send again.
    fn ready_at(&self) -> Instant {
        self.at + Duration::from_secs_f64((-self.units).max(0.0) / MAX_RATE)
    }
}

/// The server's end of a page's WebSocket, without the connection that carries its bytes.
pub struct Frames(WebSocket<Pipe>);

impl Default for Frames {
    fn default() -> Self {
        let config = WebSocketConfig::default().max_message_size(Some(MAX_MESSAGE)).max_frame_size(Some(MAX_MESSAGE));
        Self(WebSocket::from_raw_socket(Pipe::default(), Role::Server, Some(config)))
    }
}

impl Frames {
    /// Takes in bytes of the page and gives each text to `take`, whose error the page is told. Returns the number of messages.
    ///
    /// # Errors
    /// The connection ends on bytes that are not frames, and on a message over the limit.
    pub fn take(&mut self, bytes: &[u8], mut take: impl FnMut(&str) -> Result<(), String>) -> Result<usize, Error> {
        self.0.get_mut().arrived.extend(bytes);
        let mut count = 0;
        while let Some(message) = next(&mut self.0)? {
            count += 1;
            let Message::Text(text) = message else { continue };
            if let Err(problem) = take(&text) {
                self.0.send(Message::text(serde_json::json!({ "problem": problem }).to_string()))?;
            }
        }
        Ok(count)
    }

    /// Bytes for the page.
    pub fn outgoing(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.0.get_mut().outgoing)
    }
}

/// Serves a page until one of the two ends it.
pub(crate) async fn talk(stream: impl AsyncRead + AsyncWrite + Unpin, page: &Page) {
    // A connection that breaks is one that ends.
    drop(serve(stream, page).await);
}

async fn serve(mut stream: impl AsyncRead + AsyncWrite + Unpin, page: &Page) -> Result<(), Error> {
    let Page { station, id, .. } = page;
    let mut frames = Frames::default();
    let (mut live, mut status, mut driver) =
        (station.live.subscribe(), station.status.subscribe(), station.driver.subscribe());
    let mut ended = page.ended.clone();
    live.mark_changed();
    status.mark_changed();
    driver.mark_changed();
    let mut budget = Budget::new(Instant::now());
    let mut buffer = [0; 4096];
    loop {
        let outgoing = frames.outgoing();
        if !outgoing.is_empty() {
            let sent = tokio::time::timeout(MAX_WRITE, stream.write_all(&outgoing)).await;
            sent.map_err(|_| Error::Io(io::ErrorKind::TimedOut.into()))??;
        }
        let ready_at = budget.ready_at();
        let may_read = ready_at <= Instant::now();
        tokio::select! {
            biased;
            farewell = farewell(&mut ended) => {
                frames.0.close(Some(CloseFrame { code: farewell.code().into(), reason: "".into() }))?;
                let outgoing = frames.outgoing();
                stream.write_all(&outgoing).await?;
                return Ok(stream.shutdown().await?);
            }
            () = tokio::time::sleep_until(ready_at.into()), if !may_read => {}
            read = stream.read(&mut buffer), if may_read => {
                let length = read?;
                if length == 0 {
                    return Ok(());
                }
                let messages = frames.take(&buffer[..length], |text| station.take(*id, text))?;
                let now = Instant::now();
                budget.spend(messages as f64 + length as f64 / UNIT_BYTES, now);
                page.has_sent(budget.ready_at() > now);
            }
            changed = status.changed() => {
                if changed.is_err() {
                    return Ok(());
                }
                let text = serde_json::json!({ "status": &*status.borrow_and_update() }).to_string();
                frames.0.send(Message::text(text))?;
            }
            changed = driver.changed() => {
                if changed.is_err() {
                    return Ok(());
                }
                let drives = *driver.borrow_and_update() == *id;
                frames.0.send(Message::text(serde_json::json!({ "drives": drives }).to_string()))?;
            }
            changed = live.changed() => {
                if changed.is_err() {
                    return Ok(());
                }
                let state = Arc::clone(&live.borrow_and_update());
                if !state.is_empty() {
                    frames.0.send(Message::binary(state.as_slice().to_vec()))?;
                }
            }
        }
    }
}

/// Waits until the page has to go.
async fn farewell(ended: &mut watch::Receiver<Option<Farewell>>) -> Farewell {
    let farewell = ended.wait_for(Option::is_some).await;
    farewell.ok().and_then(|farewell| *farewell).unwrap_or(Farewell::End)
}

/// The next message of what has arrived; `None` until more comes.
fn next(socket: &mut WebSocket<Pipe>) -> Result<Option<Message>, Error> {
    match socket.read() {
        Ok(message) => Ok(Some(message)),
        Err(Error::Io(error)) if error.kind() == io::ErrorKind::WouldBlock => Ok(None),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The largest number of messages that a page can have taken in, of those that it sends at a rate for a time.
    fn taken(rate: f64, bytes: f64, secs: f64) -> f64 {
        let start = Instant::now();
        let (mut budget, mut count, mut now) = (Budget::new(start), 0.0, start);
        while (now - start).as_secs_f64() < secs {
            budget.spend(1.0 + bytes / UNIT_BYTES, now);
            count += 1.0;
            now = (now + Duration::from_secs_f64(1.0 / rate)).max(budget.ready_at());
        }
        count
    }

    #[test]
    fn a_device_is_never_held_up_and_a_flood_is() {
        assert!(taken(50.0, 120.0, 20.0) >= 999.0, "keys");
        assert!(taken(120.0, 2000.0, 20.0) >= 2399.0, "a headset");
        assert!(taken(1e5, 6.0, 10.0) < 10.0 * MAX_RATE + MAX_SAVED + 10.0, "small messages");
        assert!(taken(1e5, MAX_MESSAGE as f64, 10.0) < 400.0, "large messages");
    }
}
