//! The stream of a tracked body, as GEAR-SONIC's PICO program publishes it: packed messages `pose` over ZeroMQ, 50 a second.
//!
//! A message is the topic, 1,280 bytes of JSON with the names, types and shapes of its fields, and their numbers one after another,
//! little-endian. Versions 2 and 3 hold joints of the body, version 4 a token.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use fiatlux_robot::BODY;
use serde::Deserialize;

use crate::BridgeError;
use crate::net::{Address, Timeouts};
use crate::zmq::Sub;

const TOPIC: &str = "pose";
/// Bytes of the JSON of a message.
const HEADER: usize = 1280;
/// Largest message, bytes: one of ten frames takes some 10,000.
const MAX_MESSAGE: usize = 1 << 18;
const MAX_FIELDS: usize = 64;
/// Most frames of a message, and frames that are kept.
const MAX_FRAMES: usize = 64;
const KEPT: usize = 10;
/// Frames that may be missing between two; after more the motion begins anew.
const MAX_GAP: u64 = 25;
/// A publisher that says nothing for this long is connected anew, after a pause.
const SILENCE: Duration = Duration::from_secs(2);
const PAUSE: Duration = Duration::from_millis(200);
const TIMEOUTS: Timeouts = Timeouts { connect: Duration::from_secs(2), reply: Duration::from_secs(2) };
/// No joint is farther from the body's root, m; no wrist turns farther, rad.
const MAX_PLACE: f64 = 5.0;
const MAX_ANGLE: f64 = 7.0;
/// Index of the first wrist joint in Isaac Lab's order.
const FIRST_WRIST: usize = 23;
const POINTS: usize = 24;

/// A moment of a tracked body.
#[derive(Debug, Clone, PartialEq)]
pub struct BodyFrame {
    /// Counts the frames of the sender, 50 a second.
    pub index: i64,
    /// Places of the 24 joints of `SMPL` from the root, in its axes: x, y, z of each, m.
    pub joints: [f32; 3 * POINTS],
    /// Orientation of the root in the world: w, x, y, z.
    pub root: [f64; 4],
    /// Angles of the robot's wrists (roll, pitch, yaw; left and right in turn), rad; zeros where the sender gives none.
    pub wrists: [f32; 6],
}

/// The newest motion of a stream.
#[derive(Debug, Clone, PartialEq)]
pub enum BodyMotion {
    /// The last frames, oldest first, at least one.
    Frames(Vec<BodyFrame>),
    /// A motion in the code of GEAR-SONIC's encoder.
    Token(Box<[f32; 64]>),
}

#[derive(Debug, Default)]
struct Received {
    version: Option<u8>,
    frames: VecDeque<BodyFrame>,
    token: Option<Box<[f32; 64]>>,
    at: Option<Instant>,
    /// The last fault of the stream.
    problem: String,
}

/// Receives the stream, and connects anew when it is lost, until it is dropped.
#[derive(Debug)]
pub struct BodyStream {
    received: Arc<Mutex<Received>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl BodyStream {
    /// Begins to receive from an address such as `tcp://HOST:5556`.
    ///
    /// # Errors
    /// [`BridgeError::Stream`]; no thread can be started.
    pub fn start(address: &str) -> Result<Self, BridgeError> {
        let address = Address::parse(address, "tcp").map_err(|_| BridgeError::Stream { given: address.into() })?;
        let (received, stop) = (Arc::<Mutex<Received>>::default(), Arc::<AtomicBool>::default());
        let (to, until) = (Arc::clone(&received), Arc::clone(&stop));
        let run = move || {
            while !until.load(Ordering::Relaxed) {
                let Err(error) = receive(&address, &to, &until) else { continue };
                {
                    let mut received = lock(&to);
                    (received.version, received.problem) = (None, reason(&error));
                }
                std::thread::sleep(PAUSE);
            }
        };
        let started = std::thread::Builder::new().name("body-stream".into()).spawn(run);
        let thread = started.map_err(|error| BridgeError::malformed("the stream of the body", error.to_string()))?;
        Ok(Self { received, stop, thread: Some(thread) })
    }

    /// The newest motion and its age; `None` until the first message.
    pub fn motion(&self) -> Option<(BodyMotion, Duration)> {
        let received = lock(&self.received);
        let age = received.at?.elapsed();
        let motion = match &received.token {
            Some(token) => BodyMotion::Token(token.clone()),
            None => BodyMotion::Frames(received.frames.iter().cloned().collect()),
        };
        Some((motion, age))
    }

    /// The last fault of the stream; empty where there was none.
    pub fn problem(&self) -> String {
        lock(&self.received).problem.clone()
    }
}

impl Drop for BodyStream {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        // It ends within the time for a message; a thread that panicked has nothing to give.
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn lock(received: &Mutex<Received>) -> MutexGuard<'_, Received> {
    received.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A fault of the stream, without the remedies of a model server.
fn reason(error: &BridgeError) -> String {
    match error {
        BridgeError::Connect { source, .. } => format!("nothing accepts a connection: {source}"),
        BridgeError::Handshake { problem, .. } => format!("what answers does not speak ZeroMQ: {problem}"),
        BridgeError::Silent { waited, .. } => format!("no handshake within {:.1} s", waited.as_secs_f64()),
        BridgeError::Timeout { waited, .. } => format!("no message for {:.1} s", waited.as_secs_f64()),
        BridgeError::Lost { problem, .. } => format!("the connection was lost: {problem}"),
        BridgeError::TooLarge { size, most } => format!("a message of {size} bytes; the limit is {most}"),
        BridgeError::Malformed { what, problem } => format!("{what}: {problem}"),
        other => other.to_string(),
    }
}

fn receive(address: &Address, to: &Mutex<Received>, stop: &AtomicBool) -> Result<(), BridgeError> {
    let mut socket = Sub::connect(address, TIMEOUTS, TOPIC)?;
    while !stop.load(Ordering::Relaxed) {
        let message = socket.next(MAX_MESSAGE, SILENCE)?;
        let read = Message::read(&message);
        let mut received = lock(to);
        if let Err(problem) = read.and_then(|message| received.take(message)) {
            received.problem = problem;
        }
    }
    Ok(())
}

impl Received {
    fn take(&mut self, message: Message) -> Result<(), String> {
        let version = *self.version.get_or_insert(message.version);
        if version != message.version {
            return Err(format!(
                "a message of version {} in a stream of version {version}; restart the sender",
                message.version
            ));
        }
        match message.motion {
            BodyMotion::Token(token) => self.token = Some(token),
            BodyMotion::Frames(frames) => {
                self.token = None;
                for frame in frames {
                    let last = self.frames.back().map_or(frame.index.saturating_sub(1), |last| last.index);
                    // A sender that starts anew counts from zero.
                    if frame.index.abs_diff(last) > MAX_GAP {
                        self.frames.clear();
                    } else if frame.index <= last {
                        continue;
                    }
                    self.frames.push_back(frame);
                    if self.frames.len() > KEPT {
                        self.frames.pop_front();
                    }
                }
            }
        }
        self.problem.clear();
        self.at = Some(Instant::now());
        Ok(())
    }
}

#[derive(Debug)]
struct Message {
    version: u8,
    motion: BodyMotion,
}

#[derive(Debug, Deserialize)]
struct Header {
    v: u8,
    endian: String,
    fields: Vec<Field>,
}

#[derive(Debug, Deserialize)]
struct Field {
    name: String,
    dtype: String,
    shape: Vec<usize>,
}

impl Field {
    /// Bytes of a number.
    fn size(&self) -> Result<usize, String> {
        match self.dtype.as_str() {
            "f32" | "i32" => Ok(4),
            "f64" | "i64" => Ok(8),
            "u8" | "bool" => Ok(1),
            other => {
                Err(format!("field {} has the type {other}; known ones are f32, f64, i32, i64, u8, bool", self.name))
            }
        }
    }

    fn count(&self) -> Option<usize> {
        self.shape
            .iter()
            .try_fold(1_usize, |count, size| count.checked_mul(*size))
            .filter(|count| *count <= MAX_MESSAGE)
    }

    fn numbers(&self, bytes: &[u8]) -> Result<Vec<f64>, String> {
        let numbers: Vec<f64> = match self.dtype.as_str() {
            "f32" => bytes.as_chunks().0.iter().map(|part| f32::from_le_bytes(*part).into()).collect(),
            "f64" => bytes.as_chunks().0.iter().map(|part| f64::from_le_bytes(*part)).collect(),
            "i32" => bytes.as_chunks().0.iter().map(|part| i32::from_le_bytes(*part).into()).collect(),
            "i64" => bytes.as_chunks().0.iter().map(|part| i64::from_le_bytes(*part) as f64).collect(),
            _ => bytes.iter().map(|byte| f64::from(*byte)).collect(),
        };
        match numbers.iter().position(|number| !number.is_finite()) {
            Some(index) => Err(format!("number {index} of field {} is {}", self.name, numbers[index])),
            None => Ok(numbers),
        }
    }
}

/// The fields of a message with their bytes.
struct Fields<'a>(Vec<(Field, &'a [u8])>);

impl Fields<'_> {
    /// The numbers of a field, by rows of `width`; `None` where the message lacks it.
    fn rows<const WIDTH: usize>(&self, names: &[&str]) -> Result<Option<Vec<[f64; WIDTH]>>, String> {
        let Some((field, bytes)) = self.0.iter().find(|(field, _)| names.contains(&field.name.as_str())) else {
            return Ok(None);
        };
        let numbers = field.numbers(bytes)?;
        match numbers.as_chunks::<WIDTH>() {
            (rows, []) => Ok(Some(rows.to_vec())),
            _ => Err(format!("field {} has the shape {:?}; its rows have {WIDTH} numbers", field.name, field.shape)),
        }
    }

    fn needed<const WIDTH: usize>(&self, names: &[&str], version: u8) -> Result<Vec<[f64; WIDTH]>, String> {
        let rows = self.rows(names)?;
        rows.ok_or_else(|| format!("a message of version {version} lacks the field {}", names[0]))
    }
}

impl Message {
    /// Reads a message; what is wrong with it is said in words.
    fn read(bytes: &[u8]) -> Result<Self, String> {
        let body = bytes.strip_prefix(TOPIC.as_bytes()).ok_or("a message of another topic")?;
        let (header, mut numbers) =
            body.split_at_checked(HEADER).ok_or_else(|| format!("a message of {} bytes has no header", bytes.len()))?;
        let text = header.split(|byte| *byte == 0).next().unwrap_or_default();
        let header: Header =
            serde_json::from_slice(text).map_err(|error| format!("the header of a message cannot be read: {error}"))?;
        if header.endian != "le" || header.fields.len() > MAX_FIELDS {
            return Err(format!("a message of {} fields, byte order {}", header.fields.len(), header.endian));
        }
        let mut fields = Vec::new();
        for field in header.fields {
            let size = field.size()?;
            let length = field.count().and_then(|count| count.checked_mul(size));
            let split = length.and_then(|length| numbers.split_at_checked(length));
            let (own, rest) = split.ok_or_else(|| format!("the message ends within the field {}", field.name))?;
            numbers = rest;
            fields.push((field, own));
        }
        if !numbers.is_empty() {
            return Err(format!("the message has {} bytes more than its fields", numbers.len()));
        }
        let motion = motion(&Fields(fields), header.v)?;
        Ok(Self { version: header.v, motion })
    }
}

fn motion(fields: &Fields<'_>, version: u8) -> Result<BodyMotion, String> {
    match version {
        4 => match fields.needed::<64>(&["token_state"], version)?.as_slice() {
            [token] => Ok(BodyMotion::Token(Box::new(token.map(|number| number as f32)))),
            tokens => Err(format!("a message of {} tokens; one is expected", tokens.len())),
        },
        2 | 3 => {
            let indices = fields.needed::<1>(&["frame_index"], version)?;
            let joints = fields.needed::<{ 3 * POINTS }>(&["smpl_joints"], version)?;
            let roots = fields.needed::<4>(&["body_quat", "body_quat_w"], version)?;
            let angles = fields.rows::<BODY>(&["joint_pos"])?;
            let angles = angles.unwrap_or_else(|| vec![[0.0; BODY]; joints.len()]);
            let counts = [joints.len(), roots.len(), angles.len()];
            if !(1..=MAX_FRAMES).contains(&indices.len()) || counts.iter().any(|count| *count != indices.len()) {
                return Err(format!(
                    "{} frame indices, and {counts:?} rows of joints, roots and angles",
                    indices.len()
                ));
            }
            let frames = indices.iter().zip(joints).zip(roots).zip(angles);
            let frames = frames.map(|((([index], joints), root), angles)| {
                let wrists: [f64; 6] = std::array::from_fn(|joint| angles[FIRST_WRIST + joint]);
                let far = joints.iter().find(|part| part.abs() > MAX_PLACE);
                let far = far.or(wrists.iter().find(|angle| angle.abs() > MAX_ANGLE));
                let length = root.iter().map(|part| part * part).sum::<f64>().sqrt();
                match far {
                    Some(number) => Err(format!("{number} is neither a place of a joint nor an angle of a wrist")),
                    None if (length - 1.0).abs() > 0.1 => Err(format!("the root's quaternion has length {length}")),
                    None => Ok(BodyFrame {
                        index: *index as i64,
                        joints: joints.map(|part| part as f32),
                        root: root.map(|part| part / length),
                        wrists: wrists.map(|angle| angle as f32),
                    }),
                }
            });
            let frames = frames.collect::<Result<Vec<_>, String>>()?;
            match frames.windows(2).all(|pair| pair[0].index < pair[1].index) {
                true => Ok(BodyMotion::Frames(frames)),
                false => Err("the frames of a message are not in order".into()),
            }
        }
        1 => Err("messages of version 1 hold joints of a robot, and no body; let the sender use version 3".into()),
        other => Err(format!("messages have version {other}; known ones are 2, 3 and 4")),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// A message of fields of f32, except for `frame_index`.
    fn message(version: u8, fields: &[(&str, &[usize], f32)], first: i64) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut named = Vec::new();
        for (name, shape, value) in fields {
            let count: usize = shape.iter().product();
            let dtype = if *name == "frame_index" { "i64" } else { "f32" };
            named.push(format!(r#"{{"name":"{name}","dtype":"{dtype}","shape":{shape:?}}}"#));
            for number in 0..count {
                match dtype {
                    "i64" => bytes.extend((first + number as i64).to_le_bytes()),
                    _ => bytes.extend(value.to_le_bytes()),
                }
            }
        }
        let mut header =
            format!(r#"{{"v":{version},"endian":"le","count":1,"fields":[{}]}}"#, named.join(",")).into_bytes();
        header.resize(HEADER, 0);
        [TOPIC.as_bytes(), &header, &bytes].concat()
    }

    fn body(version: u8, frames: usize, first: i64) -> Vec<u8> {
        let fields: [(&str, &[usize], f32); 4] = [
            ("smpl_joints", &[frames, 24, 3], 0.25),
            ("body_quat", &[frames, 4], 0.5),
            ("joint_pos", &[frames, 29], -0.5),
            ("frame_index", &[frames], 0.0),
        ];
        message(version, &fields, first)
    }

    fn take(received: &mut Received, bytes: &[u8]) -> Result<(), String> {
        Message::read(bytes).and_then(|message| received.take(message))
    }

    #[test]
    fn frames_are_joined_whatever_the_sender_repeats_or_loses() {
        let mut received = Received::default();
        take(&mut received, &body(3, 5, 100)).unwrap();
        take(&mut received, &body(3, 5, 101)).unwrap();
        take(&mut received, &body(3, 1, 108)).unwrap();
        take(&mut received, &body(3, 1, 104)).unwrap();
        let indices = |received: &Received| received.frames.iter().map(|frame| frame.index).collect::<Vec<_>>();
        assert_eq!(indices(&received), [100, 101, 102, 103, 104, 105, 108]);
        assert_eq!((received.frames[0].joints[71], received.frames[0].wrists), (0.25, [-0.5; 6]));
        take(&mut received, &body(3, 2, 200)).unwrap();
        assert_eq!(indices(&received), [200, 201], "a gap of more than half a second");
        take(&mut received, &body(3, 12, 0)).unwrap();
        assert_eq!(indices(&received), (2..12).collect::<Vec<_>>(), "the sender was restarted");
        assert!(take(&mut received, &body(2, 1, 12)).unwrap_err().contains("restart the sender"));
    }

    #[test]
    fn tokens_are_taken_as_they_are() {
        let mut received = Received::default();
        take(&mut received, &message(4, &[("token_state", &[1, 64], -0.5), ("frame_index", &[1], 0.0)], 3)).unwrap();
        assert_eq!(received.token.as_deref(), Some(&[-0.5; 64]));
    }

    #[test]
    fn wrong_messages_are_refused_in_words() {
        let quaternion = ("body_quat", &[1_usize, 4][..], 0.5_f32);
        let (joints, index) = (("smpl_joints", &[1_usize, 24, 3][..], 0.1_f32), ("frame_index", &[1_usize][..], 0.0));
        let cases: [(Vec<u8>, &str); 12] = [
            (b"command".to_vec(), "another topic"),
            (b"pose{}".to_vec(), "no header"),
            (body(1, 1, 0), "no body"),
            (body(9, 1, 0), "version 9"),
            (body(3, 65, 0), "65 frame indices"),
            (body(3, 1, 0)[..1500].to_vec(), "ends within the field"),
            ([body(3, 1, 0), vec![0]].concat(), "1 bytes more"),
            (message(3, &[joints, quaternion], 0), "lacks the field frame_index"),
            (message(3, &[joints, quaternion, ("frame_index", &[2], 0.0)], 0), "2 frame indices"),
            (message(3, &[("smpl_joints", &[1, 24, 3], f32::NAN), quaternion, index], 0), "is NaN"),
            (message(3, &[("smpl_joints", &[1, 24, 3], 6.0), quaternion, index], 0), "6 is neither"),
            (message(3, &[joints, ("body_quat", &[1, 4], 0.0), index], 0), "length 0"),
        ];
        for (bytes, words) in cases {
            let problem = Message::read(&bytes).unwrap_err();
            assert!(problem.contains(words), "{words}: {problem}");
        }
        assert!(Message::read(&message(4, &[("token_state", &[63], 0.0)], 0)).unwrap_err().contains("64 numbers"));
    }
}
