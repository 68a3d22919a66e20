//! Addresses, time-outs, and a connection with a deadline over many reads.

use std::io::{self, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

use crate::BridgeError;

/// Maximum size of a message from a model server, bytes. A chunk of 50 rows of 132 numbers takes 26 kB.
pub const MAX_REPLY: usize = 4 << 20;

/// Time limits of a connection to a model server.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Timeouts {
    /// Until a connection is accepted.
    pub connect: Duration,
    /// For the handshake, and from a request to the end of its answer.
    pub reply: Duration,
}

impl Default for Timeouts {
    fn default() -> Self {
        Self { connect: Duration::from_secs(5), reply: Duration::from_secs(15) }
    }
}

/// Port of a WebSocket server whose address has none.
const HTTP_PORT: u16 = 80;

#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Address {
    host: String,
    port: u16,
    path: String,
}

impl Address {
    /// Parses `SCHEME://HOST:PORT/PATH`, with an IPv6 host in brackets. Only WebSocket has a path and a default port.
    pub fn parse(given: &str, scheme: &'static str) -> Result<Self, BridgeError> {
        let wrong = || BridgeError::Address { given: given.into(), scheme };
        let rest = given.strip_prefix(scheme).and_then(|rest| rest.strip_prefix("://")).ok_or_else(wrong)?;
        let (place, path) = rest.split_at(rest.find(['/', '?', '#']).unwrap_or(rest.len()));
        let path = path.split('#').next().unwrap_or_default();
        let (host, port) = match place.rsplit_once(':').filter(|(_, port)| !port.ends_with(']')) {
            Some((host, port)) => (host, port.parse().ok().filter(|port| *port != 0).ok_or_else(wrong)?),
            None if scheme == "ws" => (place, HTTP_PORT),
            None => return Err(wrong()),
        };
        let host = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).unwrap_or(host);
        if host.is_empty() || rest.contains(char::is_whitespace) {
            return Err(wrong());
        }
        Ok(Self { host: host.into(), port, path: path.into() })
    }

    /// Path and query as in an HTTP request.
    pub fn path(&self) -> String {
        if self.path.starts_with('/') { self.path.clone() } else { format!("/{}", self.path) }
    }

    /// Connects to the first address of the host that answers.
    pub fn connect(&self, timeout: Duration) -> Result<DeadlineStream, BridgeError> {
        let failed = |source| BridgeError::Connect { address: self.to_string(), source };
        let deadline = Instant::now() + timeout;
        let mut last = io::Error::new(io::ErrorKind::NotFound, "the host has no address");
        for place in (self.host.as_str(), self.port).to_socket_addrs().map_err(failed)? {
            let left = deadline.saturating_duration_since(Instant::now()).max(Duration::from_millis(1));
            match TcpStream::connect_timeout(&place, left) {
                Ok(stream) => {
                    stream.set_nodelay(true).map_err(failed)?;
                    return Ok(DeadlineStream { stream, deadline });
                }
                Err(error) => last = error,
            }
        }
        Err(failed(last))
    }
}

impl std::fmt::Display for Address {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.host.contains(':') {
            true => write!(f, "[{}]:{}", self.host, self.port),
            false => write!(f, "{}:{}", self.host, self.port),
        }
    }
}

/// A connection that keeps its deadline even if the other side sends byte by byte.
#[derive(Debug)]
pub(crate) struct DeadlineStream {
    stream: TcpStream,
    deadline: Instant,
}

impl DeadlineStream {
    /// Sets the deadline for everything that follows, counted from now.
    pub fn allow(&mut self, time: Duration) {
        self.deadline = Instant::now() + time;
    }

    fn left(&self) -> io::Result<Duration> {
        let left = self.deadline.saturating_duration_since(Instant::now());
        if left.is_zero() { Err(io::ErrorKind::TimedOut.into()) } else { Ok(left) }
    }
}

fn timed<T>(result: io::Result<T>) -> io::Result<T> {
    result.map_err(|error| match error.kind() {
        io::ErrorKind::WouldBlock => io::ErrorKind::TimedOut.into(),
        _ => error,
    })
}

impl Read for DeadlineStream {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        self.stream.set_read_timeout(Some(self.left()?))?;
        timed(self.stream.read(into))
    }
}

impl Write for DeadlineStream {
    fn write(&mut self, from: &[u8]) -> io::Result<usize> {
        self.stream.set_write_timeout(Some(self.left()?))?;
        timed(self.stream.write(from))
    }

    fn flush(&mut self) -> io::Result<()> {
        self.stream.flush()
    }
}

/// An error of the connection that names the request.
pub(crate) fn broken(error: &io::Error, question: &str, waited: Duration) -> BridgeError {
    match error.kind() {
        io::ErrorKind::TimedOut => BridgeError::Timeout { question: question.into(), waited },
        io::ErrorKind::UnexpectedEof => {
            BridgeError::Lost { question: question.into(), problem: "the server closed it".into() }
        }
        _ => BridgeError::Lost { question: question.into(), problem: error.to_string() },
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn addresses_have_scheme_host_and_port() {
        let read = |text| Address::parse(text, "tcp").map(|address| address.to_string());
        assert_eq!(read("tcp://lab:5555").unwrap(), "lab:5555");
        assert_eq!(read("tcp://[::1]:5555/x").unwrap(), "[::1]:5555");
        for wrong in
            ["lab:5555", "ws://lab:1", "tcp://lab", "tcp://:1", "tcp://lab:0", "tcp://lab:70000", "tcp://a b:1"]
        {
            let error = read(wrong).unwrap_err().to_string();
            assert!(error.contains(wrong) && error.contains("tcp://HOST:PORT"), "{error}");
        }
        let read = |text| Address::parse(text, "ws").map(|address| (address.to_string(), address.path()));
        for (text, place, path) in [
            ("ws://lab:8000", "lab:8000", "/"),
            ("ws://[fd00::1]:8000/v1/model?key=a/b#top", "[fd00::1]:8000", "/v1/model?key=a/b"),
            ("ws://lab?key=1", "lab:80", "/?key=1"),
            ("ws://[::1]", "[::1]:80", "/"),
        ] {
            assert_eq!(read(text).unwrap(), (place.to_owned(), path.to_owned()), "{text}");
        }
        assert!(read("wss://lab:443").unwrap_err().to_string().contains("--model-host"));
    }
}
