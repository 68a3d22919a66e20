//! A ZeroMQ REQ socket: ZMTP 3.0 over TCP without encryption, one question and one answer at a time.
//!
//! Written here because the pure Rust crate (`zeromq` 0.7) reserves memory for any length that a peer announces and
//! cannot be given a limit: nine bytes from a hostile server end the process. The protocol is that of ZeroMQ RFC 23.

use std::io::{self, Read, Write};

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

/// A connection to a REP or ROUTER socket. It cannot be used after an error: REQ strictly alternates request and
/// answer.
#[derive(Debug)]
pub(crate) struct Req {
    stream: DeadlineStream,
    timeouts: Timeouts,
}

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
        let mut req = Self { stream: address.connect(timeouts.connect)?, timeouts };
        req.stream.allow(timeouts.reply);
        req.greet().map_err(|broken| match broken {
            FrameError::Io(error) if error.kind() == io::ErrorKind::TimedOut => {
                BridgeError::Silent { address: address.to_string(), transport: "ZeroMQ", waited: timeouts.reply }
            }
            FrameError::Io(error) => BridgeError::Lost { question: "greeting".into(), problem: error.to_string() },
            FrameError::Other(BridgeError::Malformed { problem, .. }) => {
                BridgeError::Handshake { address: address.to_string(), transport: "ZeroMQ", problem }
            }
            FrameError::Other(error) => error,
        })?;
        Ok(req)
    }

    /// Sends a question and waits for the answer.
    pub fn ask(&mut self, name: &str, question: &[u8]) -> Result<Vec<u8>, BridgeError> {
        self.stream.allow(self.timeouts.reply);
        let answer = self.send(question).map_err(FrameError::Io).and_then(|()| self.receive());
        answer.map_err(|error| match error {
            FrameError::Io(error) => broken(&error, name, self.timeouts.reply),
            FrameError::Other(error) => error,
        })
    }

    fn greet(&mut self) -> Result<(), FrameError> {
        let mut ours = [0; 64];
        ours[0] = 0xff;
        ours[9] = 0x7f;
        ours[10] = 3;
        ours[12..16].copy_from_slice(b"NULL");
        self.stream.write_all(&ours)?;
        let mut theirs = [0; 64];
        self.stream.read_exact(&mut theirs)?;
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
        for (name, value) in [("Socket-Type", "REQ"), ("Identity", "")] {
            ready.push(name.len() as u8);
            ready.extend_from_slice(name.as_bytes());
            ready.extend_from_slice(&(value.len() as u32).to_be_bytes());
            ready.extend_from_slice(value.as_bytes());
        }
        self.stream.write_all(&[COMMAND, ready.len() as u8])?;
        self.stream.write_all(&ready)?;
        let (flags, body) = self.frame(MAX_COMMAND)?;
        let is_ready = flags & COMMAND != 0 && body.starts_with(b"\x05READY");
        let kind = socket_type(&body);
        match kind {
            Some(b"REP" | b"ROUTER") if is_ready => Ok(()),
            Some(kind) if is_ready => {
                let kind = String::from_utf8_lossy(kind).into_owned();
                Err(FrameError::Other(wrong(&format!("its socket is {kind:?}; a policy server has REP"))))
            }
            _ => Err(FrameError::Other(wrong("it does not send READY"))),
        }
    }

    fn send(&mut self, question: &[u8]) -> io::Result<()> {
        // An empty frame separates the route from the question.
        let mut head = vec![MORE, 0];
        match u8::try_from(question.len()) {
            Ok(length) => head.extend([0, length]),
            Err(_) => {
                head.push(LONG);
                head.extend_from_slice(&(question.len() as u64).to_be_bytes());
            }
        }
        self.stream.write_all(&head)?;
        self.stream.write_all(question)?;
        self.stream.flush()
    }

    fn receive(&mut self) -> Result<Vec<u8>, FrameError> {
        let mut is_parted = false;
        for _ in 0..MAX_FRAMES {
            let (flags, frame) = self.frame(MAX_REPLY)?;
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

    fn frame(&mut self, most: usize) -> Result<(u8, Vec<u8>), FrameError> {
        let mut flags = [0];
        self.stream.read_exact(&mut flags)?;
        let [flags] = flags;
        if flags & !(MORE | LONG | COMMAND) != 0 {
            return Err(FrameError::Other(BridgeError::malformed("a frame", format!("its flags are {flags:#04x}"))));
        }
        let size = if flags & LONG != 0 {
            let mut size = [0; 8];
            self.stream.read_exact(&mut size)?;
            u64::from_be_bytes(size)
        } else {
            let mut size = [0];
            self.stream.read_exact(&mut size)?;
            u64::from(size[0])
        };
        let length = usize::try_from(size).ok().filter(|length| *length <= most);
        let length = length.ok_or(FrameError::Other(BridgeError::TooLarge { size, most }))?;
        let mut body = vec![0; length];
        self.stream.read_exact(&mut body)?;
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
