//! ZeroMQ sockets, ZMTP 3.0 over TCP without encryption: REQ with one question and one answer at a time, and SUB.
//!
//! Written here because the pure Rust crate (`zeromq` 0.7) reserves memory for any length that a peer announces and
//! cannot be given a limit: nine bytes from a hostile server end the process. The protocol is that of ZeroMQ RFC 23.

use std::io::{self, Read, Write};
use std::time::Duration;

use crate::BridgeError;
use crate::net::{Address, DeadlineStream, MAX_REPLY, Timeouts, broken};

/// Bits of the first byte of a frame.
const MORE: u8 = 1;
const LONG: u8 = 2;
const COMMAND: u8 = 4;

/// Maximum size of a command, bytes; a READY takes about 40.
const MAX_COMMAND: usize = 4096;

/// Maximum number of frames in an answer, and of commands between two frames; a REP socket sends fewer.
const MAX_FRAMES: usize = 8;

/// A connection after the greetings. It cannot be used after an error.
#[derive(Debug)]
struct Socket(DeadlineStream);

/// A connection to a REP or ROUTER socket. It cannot be used after an error: REQ strictly alternates request and
/// answer.
#[derive(Debug)]
pub(crate) struct Req {
    socket: Socket,
    timeouts: Timeouts,
}

/// A connection to a `PUB` or `XPUB` socket.
#[derive(Debug)]
pub(crate) struct Sub(Socket);

enum FrameError {
    Io(io::Error),
    Other(BridgeError),
}

impl From<io::Error> for FrameError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

impl Req {
    /// Connects and exchanges greetings, within `timeouts`.
    pub fn connect(address: &Address, timeouts: Timeouts) -> Result<Self, BridgeError> {
        Ok(Self { socket: Socket::connect(address, timeouts, "REQ", ["REP", "ROUTER"])?, timeouts })
    }

    /// Sends a question and waits for the answer.
    pub fn ask(&mut self, name: &str, question: &[u8]) -> Result<Vec<u8>, BridgeError> {
        self.socket.0.allow(self.timeouts.reply);
        // An empty frame separates the route from the question.
        let sent = self.socket.0.write_all(&[MORE, 0]).and_then(|()| self.socket.send(question));
        let answer = sent.map_err(FrameError::Io).and_then(|()| self.receive());
        answer.map_err(|error| match error {
            FrameError::Io(error) => broken(&error, name, self.timeouts.reply),
            FrameError::Other(error) => error,
        })
    }

    fn receive(&mut self) -> Result<Vec<u8>, FrameError> {
        let mut is_parted = false;
        for _ in 0..MAX_FRAMES {
            let (flags, frame) = self.socket.frame(MAX_REPLY)?;
            if flags & COMMAND != 0 {
                continue;
            }
            match (is_parted, flags & MORE != 0) {
                (false, true) if frame.is_empty() => is_parted = true,
                (true, false) => return Ok(frame),
                _ => break,
            }
        }
        Err(FrameError::Other(BridgeError::malformed("an answer", "it is not one frame after an empty one")))
    }
}

impl Sub {
    /// Connects and asks for the messages that begin with a topic, which is shorter than 255 bytes.
    pub fn connect(address: &Address, timeouts: Timeouts, topic: &str) -> Result<Self, BridgeError> {
        let mut socket = Socket::connect(address, timeouts, "SUB", ["PUB", "XPUB"])?;
        let asked = socket.send(&[&[1], topic.as_bytes()].concat());
        asked.map_err(|error| broken(&error, "subscription", timeouts.reply))?;
        Ok(Self(socket))
    }

    /// The next message, of one frame and at most `most` bytes. The connection is lost where none comes in time.
    pub fn next(&mut self, most: usize, time: Duration) -> Result<Vec<u8>, BridgeError> {
        self.0.0.allow(time);
        loop {
            let (flags, frame) = self.0.frame(most).map_err(|error| match error {
                FrameError::Io(error) => broken(&error, "next message", time),
                FrameError::Other(error) => error,
            })?;
            if flags & MORE != 0 {
                return Err(BridgeError::malformed("a message", "it has several parts"));
            }
            if flags & COMMAND == 0 {
                return Ok(frame);
            }
        }
    }
}

impl Socket {
    fn connect(
        address: &Address,
        timeouts: Timeouts,
        kind: &'static str,
        peers: [&'static str; 2],
    ) -> Result<Self, BridgeError> {
        let mut socket = Self(address.connect(timeouts.connect)?);
        socket.0.allow(timeouts.reply);
        socket.greet(kind, peers).map_err(|broken| match broken {
            FrameError::Io(error) if error.kind() == io::ErrorKind::TimedOut => {
                BridgeError::Silent { address: address.to_string(), transport: "ZeroMQ", waited: timeouts.reply }
            }
            FrameError::Io(error) => BridgeError::Lost { question: "greeting".into(), problem: error.to_string() },
            FrameError::Other(BridgeError::Malformed { problem, .. }) => {
                BridgeError::Handshake { address: address.to_string(), transport: "ZeroMQ", problem }
            }
            FrameError::Other(error) => error,
        })?;
        Ok(socket)
    }

    fn greet(&mut self, own: &str, peers: [&str; 2]) -> Result<(), FrameError> {
        let mut ours = [0; 64];
        ours[0] = 0xff;
        ours[9] = 0x7f;
        ours[10] = 3;
        ours[12..16].copy_from_slice(b"NULL");
        self.0.write_all(&ours)?;
        let mut theirs = [0; 64];
        self.0.read_exact(&mut theirs)?;
        if theirs[0] != 0xff || theirs[9] & 1 == 0 {
            return Err(FrameError::Other(wrong("its first bytes are not a ZeroMQ greeting")));
        }
        if theirs[10] < 3 {
            return Err(FrameError::Other(wrong(&format!(
                "it speaks version {} of the protocol; version 3 is needed",
                theirs[10]
            ))));
        }
        if theirs[12..32] != ours[12..32] {
            return Err(FrameError::Other(wrong("it asks for a password or encryption, which is not supported")));
        }
        let mut ready = b"\x05READY".to_vec();
        for (name, value) in [("Socket-Type", own), ("Identity", "")] {
            ready.push(name.len() as u8);
            ready.extend_from_slice(name.as_bytes());
            ready.extend_from_slice(&(value.len() as u32).to_be_bytes());
            ready.extend_from_slice(value.as_bytes());
        }
        self.0.write_all(&[COMMAND, ready.len() as u8])?;
        self.0.write_all(&ready)?;
        let (flags, body) = self.frame(MAX_COMMAND)?;
        let is_ready = flags & COMMAND != 0 && body.starts_with(b"\x05READY");
        let kind = socket_type(&body);
        match kind {
            Some(kind) if is_ready && peers.iter().any(|peer| peer.as_bytes() == kind) => Ok(()),
            Some(kind) if is_ready => {
                let kind = String::from_utf8_lossy(kind).into_owned();
                Err(FrameError::Other(wrong(&format!("its socket is {kind:?}; it should be {}", peers[0]))))
            }
            _ => Err(FrameError::Other(wrong("it does not send READY"))),
        }
    }

    fn send(&mut self, body: &[u8]) -> io::Result<()> {
        let head = match u8::try_from(body.len()) {
            Ok(length) => vec![0, length],
            Err(_) => [&[LONG][..], &(body.len() as u64).to_be_bytes()].concat(),
        };
        self.0.write_all(&head)?;
        self.0.write_all(body)?;
        self.0.flush()
    }

    fn frame(&mut self, most: usize) -> Result<(u8, Vec<u8>), FrameError> {
        let mut flags = [0];
        self.0.read_exact(&mut flags)?;
        let [flags] = flags;
        if flags & !(MORE | LONG | COMMAND) != 0 {
            return Err(FrameError::Other(BridgeError::malformed("a frame", format!("its flags are {flags:#04x}"))));
        }
        let size = if flags & LONG != 0 {
            let mut size = [0; 8];
            self.0.read_exact(&mut size)?;
            u64::from_be_bytes(size)
        } else {
            let mut size = [0];
            self.0.read_exact(&mut size)?;
            u64::from(size[0])
        };
        let length = usize::try_from(size).ok().filter(|length| *length <= most);
        let length = length.ok_or(FrameError::Other(BridgeError::TooLarge { size, most }))?;
        let mut body = vec![0; length];
        self.0.read_exact(&mut body)?;
        Ok((flags, body))
    }
}

fn wrong(problem: &str) -> BridgeError {
    BridgeError::malformed("a greeting", problem)
}

/// The `Socket-Type` property of a READY command.
fn socket_type(body: &[u8]) -> Option<&[u8]> {
    let mut rest = body.get(6..)?;
    while !rest.is_empty() {
        let (&length, after) = rest.split_first()?;
        let (name, after) = after.split_at_checked(usize::from(length))?;
        let (size, after) = after.split_at_checked(4)?;
        let size = u32::from_be_bytes(size.try_into().ok()?);
        let (value, after) = after.split_at_checked(usize::try_from(size).ok()?)?;
        if name.eq_ignore_ascii_case(b"Socket-Type") {
            return Some(value);
        }
        rest = after;
    }
    None
}
