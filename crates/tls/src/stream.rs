//! TLS between a connection and a stream in memory, on which the server speaks HTTP.

use std::io::{self, Read as _, Write as _};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use rustls::{ServerConfig, ServerConnection};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _, DuplexStream};
use tokio::net::TcpStream;
use tokio::sync::Notify;

use crate::Certificate;

/// Bytes between the server and TLS, each way.
const BUFFER: usize = 64 * 1024;
/// Bytes of a read.
const CHUNK: usize = 8 * 1024;
/// A peer that takes nothing for this long is dropped.
const MAX_WRITE: Duration = Duration::from_secs(5);
/// First byte of a TLS connection.
const HANDSHAKE: u8 = 0x16;
const PLAIN: &str = "HTTP/1.1 400 Bad Request\r\nContent-Type: text/plain; charset=utf-8\r\nConnection: close\r\n\r\n\
                     this port speaks HTTPS; open the address with https://\n";

/// TLS with a certificate.
#[derive(Clone)]
pub struct Tls(Arc<ServerConfig>);

impl Tls {
    pub fn new(certificate: &Certificate) -> Self {
        Self(Arc::clone(&certificate.config))
    }

    /// Shakes hands, however long it takes, and returns the stream of what the connection carries.
    ///
    /// # Errors
    /// The connection breaks, or its peer speaks no TLS. One that speaks HTTP is told so.
    pub async fn accept(self, mut stream: TcpStream) -> io::Result<DuplexStream> {
        let mut connection = ServerConnection::new(self.0).map_err(io::Error::other)?;
        let mut plain = Vec::new();
        let mut buffer = vec![0; CHUNK];
        let mut is_first = true;
        while connection.is_handshaking() {
            let length = stream.read(&mut buffer).await?;
            if length == 0 {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
            if std::mem::take(&mut is_first) && buffer[0] != HANDSHAKE {
                stream.write_all(PLAIN.as_bytes()).await?;
                stream.shutdown().await?;
                return Err(io::ErrorKind::InvalidData.into());
            }
            let taken = take(&mut connection, &buffer[..length], &mut plain);
            // An error has an alert for the peer.
            stream.write_all(&outgoing(&mut connection)?).await?;
            taken?;
        }
        stream.set_nodelay(true)?;
        let (near, far) = tokio::io::duplex(BUFFER);
        tokio::spawn(async move {
            // A connection that breaks is one that ends.
            let _ = pump(connection, stream, far, plain).await;
        });
        Ok(near)
    }
}

/// Takes in bytes of the network, and appends what they carry.
fn take(connection: &mut ServerConnection, mut bytes: &[u8], plain: &mut Vec<u8>) -> io::Result<()> {
    while !bytes.is_empty() && connection.read_tls(&mut bytes)? > 0 {
        let state =
            connection.process_new_packets().map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error))?;
        let start = plain.len();
        plain.resize(start + state.plaintext_bytes_to_read(), 0);
        connection.reader().read_exact(&mut plain[start..])?;
    }
    Ok(())
}

/// Bytes for the network.
fn outgoing(connection: &mut ServerConnection) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    while connection.wants_write() {
        connection.write_tls(&mut bytes)?;
    }
    Ok(bytes)
}

/// Carries bytes both ways until the server ends the stream, or the connection breaks.
async fn pump(
    connection: ServerConnection,
    stream: TcpStream,
    far: DuplexStream,
    mut plain: Vec<u8>,
) -> io::Result<()> {
    let (mut from_peer, mut to_peer) = stream.into_split();
    let (mut from_server, mut to_server) = tokio::io::split(far);
    let connection = Mutex::new(connection);
    let lock = || -> MutexGuard<'_, ServerConnection> { connection.lock().unwrap_or_else(PoisonError::into_inner) };
    // TLS itself has something to send.
    let wake = Notify::new();
    let inbound = async {
        let mut buffer = vec![0; CHUNK];
        loop {
            to_server.write_all(&plain).await?;
            plain.clear();
            let length = from_peer.read(&mut buffer).await?;
            if length == 0 {
                return to_server.shutdown().await;
            }
            take(&mut lock(), &buffer[..length], &mut plain)?;
            wake.notify_one();
        }
    };
    let outbound = async {
        let mut buffer = vec![0; CHUNK];
        let mut is_open = true;
        loop {
            let bytes = outgoing(&mut lock())?;
            if !bytes.is_empty() {
                tokio::time::timeout(MAX_WRITE, to_peer.write_all(&bytes)).await??;
            }
            if !is_open {
                return to_peer.shutdown().await;
            }
            tokio::select! {
                () = wake.notified() => {}
                read = from_server.read(&mut buffer) => match read? {
                    0 => {
                        lock().send_close_notify();
                        is_open = false;
                    }
                    length => lock().writer().write_all(&buffer[..length])?,
                },
            }
        }
    };
    tokio::pin!(outbound);
    tokio::select! {
        ended = &mut outbound => ended,
        ended = inbound => {
            ended?;
            outbound.await
        }
    }
}
