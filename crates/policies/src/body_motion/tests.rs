//! A scripted sender in place of the PICO program.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::PathBuf;

use fiatlux_client::Command;
use fiatlux_proto::v3::{Pose as PoseMessage, Privileged};
use fiatlux_robot::{GainSet, Robot};

use super::*;
use crate::Policies;
use crate::tests::standing;

/// Small networks written by Python: the encoder halves 64 of its inputs, which `tests/oracle/foreign.py` lists.
const NETWORKS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../foreign/tests/fixtures");

/// A publisher that waits for its subscriber.
struct Sender(TcpListener);

impl Sender {
    fn new() -> (Self, String) {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = format!("tcp://{}", listener.local_addr().expect("an address"));
        (Self(listener), address)
    }

    fn accept(&self) -> TcpStream {
        let (mut stream, _) = self.0.accept().expect("a subscriber");
        let mut greeting = [0; 64];
        stream.read_exact(&mut greeting).expect("a greeting");
        stream.write_all(&greeting).expect("sent");
        let ready = b"\x05READY\x0bSocket-Type\x00\x00\x00\x03PUB";
        stream.write_all(&[&[4, ready.len() as u8], &ready[..]].concat()).expect("sent");
        let mut head = [0; 2];
        stream.read_exact(&mut head).expect("READY");
        let mut body = vec![0; usize::from(head[1])];
        stream.read_exact(&mut body).expect("READY");
        let mut asked = [0; 7];
        stream.read_exact(&mut asked).expect("a subscription");
        assert_eq!(&asked, b"\x00\x05\x01pose");
        stream
    }
}

fn send(stream: &mut TcpStream, message: &[u8]) {
    stream.write_all(&[&[2], &(message.len() as u64).to_be_bytes()[..], message].concat()).expect("sent");
}

fn message(version: u8, fields: &[(&str, &[usize], &[f32])], index: i64) -> Vec<u8> {
    let named: Vec<String> = fields
        .iter()
        .map(|(name, shape, _)| format!(r#"{{"name":"{name}","dtype":"f32","shape":{shape:?}}}"#))
        .chain([r#"{"name":"frame_index","dtype":"i64","shape":[1]}"#.into()])
        .collect();
    let mut header =
        format!(r#"{{"v":{version},"endian":"le","count":1,"fields":[{}]}}"#, named.join(",")).into_bytes();
    header.resize(1280, 0);
    let numbers = fields.iter().flat_map(|(_, _, numbers)| numbers.iter().flat_map(|number| number.to_le_bytes()));
    [b"pose", &header[..], &numbers.chain(index.to_le_bytes()).collect::<Vec<u8>>()].concat()
}

/// The operator looks to the left by 0.3 rad and leans forwards by 0.2; joint k of frame i is at (k + i) / 100.
fn body(index: i64) -> Vec<u8> {
    let joints: Vec<f32> = (0..72).map(|part| (part / 3) as f32 / 100.0 + index as f32 / 100.0).collect();
    let turn = nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.2, 0.3);
    let root = [turn.w, turn.i, turn.j, turn.k].map(|part| part as f32);
    let mut angles = [9.0_f32; 29];
    (0..6).for_each(|wrist| angles[23 + wrist] = index as f32 / 10.0 + wrist as f32 / 100.0);
    message(
        3,
        &[("smpl_joints", &[1, 24, 3], &joints), ("body_quat", &[1, 4], &root), ("joint_pos", &[1, 29], &angles)],
        index,
    )
}

/// An observation of the robot's heading.
fn observed(heading: f64) -> Observation {
    let (sin, cos) = (heading / 2.0).sin_cos();
    let robot = PoseMessage { position: vec![0.0, 0.0, 0.79], quaternion: vec![cos, 0.0, 0.0, sin] };
    let privileged = Some(Privileged { robot: Some(robot), ..Privileged::default() });
    Observation { privileged, ..Observation::default() }
}

/// Waits until the newest frame is that one.
fn until(tracked: &TrackedBody, index: i64) {
    let start = Instant::now();
    loop {
        let motion = tracked.stream.motion();
        if matches!(motion, Some((BodyMotion::Frames(frames), _)) if frames.last().is_some_and(|last| last.index == index))
        {
            return;
        }
        assert!(start.elapsed() < Duration::from_secs(20), "frame {index} does not come: {}", tracked.stream.problem());
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn assert_near(found: &[f32], expected: impl IntoIterator<Item = f64>) {
    for (index, expected) in expected.into_iter().enumerate() {
        assert!((f64::from(found[index]) - expected).abs() < 1e-5, "{index}: {found:?}, {expected}");
    }
}

/// Frames become what the encoder reads: joints and wrists in time, orientations from the robot's heading. Broken messages change
/// nothing, a stream that is silent is held, and one that comes back goes on.
#[test]
fn a_tracked_body_moves_the_robot() {
    let (sender, address) = Sender::new();
    let opened = std::thread::spawn(move || TrackedBody::open(&address, Path::new(NETWORKS)));
    let mut stream = sender.accept();
    send(&mut stream, &body(0));
    let mut tracked = opened.join().expect("no panic").expect("opened");
    tracked.reset();
    (1..12).for_each(|index| send(&mut stream, &body(index)));
    until(&tracked, 11);
    let token = tracked.token(&observed(1.0)).expect("a token");
    assert_near(&token[..1], [1.0]);
    let joints = |frame: usize| (0..18).map(move |part| ((part / 3) as f64 + frame as f64) / 200.0);
    assert_near(&token[1..19], joints(2));
    assert_near(&token[19..37], joints(11));
    // The robot looks where the operator does; what is left is the lean about its left.
    let (sin, cos) = (0.1_f64.sin() * 0.1_f64.cos(), 0.2_f64.cos() / 2.0);
    assert_near(&token[37..43], [cos, 0.0, 0.0, 0.5, -sin, 0.0]);
    assert_near(&token[49..61], (0..12).map(|part| if part < 6 { 0.1 } else { 0.55 } + (part % 6) as f64 / 200.0));
    assert_near(&token[61..], [0.0; 3]);
    // The robot has turned to the left by 90 degrees, so that the operator looks to its right.
    let token = tracked.token(&observed(1.0 + std::f64::consts::FRAC_PI_2)).expect("a token");
    assert_near(&token[37..43], [0.0, 0.5, -cos, 0.0, -sin, 0.0]);

    let wrong = message(3, &[("smpl_joints", &[1, 24, 3], &[f32::NAN; 72]), ("body_quat", &[1, 4], &[0.5; 4])], 12);
    send(&mut stream, &wrong);
    send(&mut stream, &body(12)[..1500]);
    send(&mut stream, &message(4, &[("token_state", &[64], &[0.0; 64])], 12));
    let start = Instant::now();
    while !tracked.stream.problem().contains("version 4 in a stream of version 3") {
        assert!(start.elapsed() < Duration::from_secs(20), "{}", tracked.stream.problem());
        std::thread::sleep(LOOK);
    }
    std::thread::sleep(MAX_AGE);
    let held = tracked.token(&observed(1.0)).expect("a token");
    assert_near(&held[1..19], joints(11));
    assert_near(&held[19..37], joints(11));

    drop(stream);
    let mut stream = sender.accept();
    send(&mut stream, &body(13));
    until(&tracked, 13);
    assert_near(&tracked.token(&observed(1.0)).expect("a token")[19..37], joints(13));
    let blind = Observation::default();
    assert!(matches!(tracked.token(&blind), Err(PolicyError::Sensor { sensor: "privileged", .. })));
    drop((stream, sender));
}

/// The policy plays a stream of tokens as it plays a file of them, and needs no encoder for it.
#[test]
fn a_stream_of_tokens_plays_as_a_file_of_them() {
    let robot = Robot::benchmark().expect("loads");
    let (info, standing) = standing(&robot, GainSet::Sonic);
    let first = Observation { privileged: observed(0.0).privileged, ..standing };
    let (sender, address) = Sender::new();
    let path: PathBuf = std::env::temp_dir().join(format!("fiatlux-stream-token-{}.txt", std::process::id()));
    std::fs::write(&path, "0.25 ".repeat(64)).expect("written");
    let play = |words: String| {
        let mut policy = Policies::default().make(&format!("sonic:{NETWORKS},{words}")).expect("made");
        policy.reset(&info, &first).expect("fits");
        (policy.sensors().len(), policy.act(&first).expect("acts"))
    };
    let sent = std::thread::spawn(move || {
        let mut stream = sender.accept();
        send(&mut stream, &message(4, &[("token_state", &[64], &[0.25; 64])], 0));
        (sender, stream)
    });
    let (sensors, streamed) = play(format!("stream={address}"));
    drop(sent.join());
    let (_, recorded) = play(format!("token={}", path.display()));
    std::fs::remove_file(path).expect("removed");
    assert_eq!((sensors, &streamed), (2, &recorded));
    assert!(matches!(streamed, Command::JointTarget(_)));
}

#[test]
fn a_missing_stream_and_a_missing_encoder_are_named() {
    let said = |error: PolicyError| fiatlux_cli::in_full(&error);
    let closed = Sender::new().1;
    let refused =
        |address: &str| TrackedBody::open_within(Duration::from_millis(300), address, Path::new(NETWORKS)).err();
    let error = said(refused(&closed).expect("nobody listens"));
    assert!(error.contains("no body came") && error.contains(&closed) && error.contains("start the sender"), "{error}");
    let error = said(refused("lab:5556").expect("no address"));
    assert!(error.contains("tcp://HOST:PORT"), "{error}");
    let (sender, address) = Sender::new();
    let empty = std::env::temp_dir();
    let opened = std::thread::spawn(move || TrackedBody::open(&address, &empty).err());
    let mut stream = sender.accept();
    send(&mut stream, &body(0));
    let error = said(opened.join().expect("no panic").expect("no encoder there"));
    assert!(error.contains("model_encoder.onnx") && error.contains("nvidia/GEAR-SONIC"), "{error}");
}
