//! The connection of a page: inputs come in, states go out, the newest ones only.

use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Error, Message, WebSocket};

use crate::station::Station;

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

/// Serves a page until one of the two ends it.
pub(crate) async fn talk(stream: impl AsyncRead + AsyncWrite + Unpin, station: Arc<Station>) {
    let id = station.enter();
    // A connection that breaks is one that ends.
    let _ = serve(stream, &station, id).await;
    station.leave(id);
}

async fn serve(mut stream: impl AsyncRead + AsyncWrite + Unpin, station: &Station, id: u64) -> Result<(), Error> {
    let config = WebSocketConfig::default().max_message_size(Some(MAX_MESSAGE)).max_frame_size(Some(MAX_MESSAGE));
    let mut socket = WebSocket::from_raw_socket(Pipe::default(), Role::Server, Some(config));
    let (mut live, mut status, mut driver) =
        (station.live.subscribe(), station.status.subscribe(), station.driver.subscribe());
    live.mark_changed();
    status.mark_changed();
    driver.mark_changed();
    let mut buffer = [0; 4096];
    loop {
        let outgoing = std::mem::take(&mut socket.get_mut().outgoing);
        if !outgoing.is_empty() {
            let sent = tokio::time::timeout(MAX_WRITE, stream.write_all(&outgoing)).await;
            sent.map_err(|_| Error::Io(io::ErrorKind::TimedOut.into()))??;
        }
        tokio::select! {
            biased;
            read = stream.read(&mut buffer) => {
                let length = read?;
                if length == 0 {
                    return Ok(());
                }
                socket.get_mut().arrived.extend(&buffer[..length]);
                while let Some(message) = next(&mut socket)? {
                    let Message::Text(text) = message else { continue };
                    if let Err(problem) = station.take(id, &text) {
                        let said = serde_json::json!({ "problem": problem }).to_string();
                        socket.send(Message::text(said))?;
                    }
                }
            }
            changed = status.changed() => {
                if changed.is_err() {
                    return Ok(());
                }
                let text = serde_json::json!({ "status": &*status.borrow_and_update() }).to_string();
                socket.send(Message::text(text))?;
            }
            changed = driver.changed() => {
                if changed.is_err() {
                    return Ok(());
                }
                let drives = *driver.borrow_and_update() == id;
                socket.send(Message::text(serde_json::json!({ "drives": drives }).to_string()))?;
            }
            changed = live.changed() => {
                if changed.is_err() {
                    return Ok(());
                }
                let state = Arc::clone(&live.borrow_and_update());
                if !state.is_empty() {
                    socket.send(Message::binary(state.as_slice().to_vec()))?;
                }
            }
        }
    }
}

/// The next message of what has arrived; `None` until more comes.
fn next(socket: &mut WebSocket<Pipe>) -> Result<Option<Message>, Error> {
    match socket.read() {
        Ok(message) => Ok(Some(message)),
        Err(Error::Io(error)) if error.kind() == io::ErrorKind::WouldBlock => Ok(None),
        Err(error) => Err(error),
    }
}
