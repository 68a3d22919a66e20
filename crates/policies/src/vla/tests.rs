use std::error::Error;
use std::f64::consts::FRAC_PI_3;
use std::net::TcpListener;

use fiatlux_bridge::{Dialect, Form, ModelChunk, Tensor};
use fiatlux_robot::GainSet;
use tungstenite::Message;

use super::*;
use crate::tests::standing;

/// The record has the whole chunk once, within the protocol's limits, and the origin of each action.
#[test]
fn a_note_becomes_a_record_within_bounds() {
    assert_eq!(Note::default().record(), None);
    let part = |key: &str, width: usize, rows: usize| (key.to_owned(), width, vec![0.5; width * rows]);
    let chunk = ModelChunk { rows: 30, parts: vec![part("left_arm", 7, 30), part("waist", 3, 30)], server_s: None };
    let note = |chunk, problem: &str| Note {
        chunk: Some(chunk),
        latency_s: 0.2,
        server_s: Some(0.145),
        problem: problem.into(),
        played: Some((2, 4, 5)),
    };
    let record = note(chunk, "").record().expect("a record");
    assert_eq!((record.index, record.row, record.values.len(), record.width), (2, 4, 300, 10));
    assert_eq!(record.keys, ["left_arm:7", "waist:3"]);
    assert!((record.age_s - 0.1).abs() < 1e-12);
    let large = ModelChunk { rows: 400, parts: vec![part("all", 512, 400)], server_s: None };
    let record = note(large, &"ü".repeat(300)).record().expect("a record");
    assert_eq!((record.values.len(), record.width, record.problem.len()), (0, 0, 256));
}

#[test]
fn flags_that_are_missing_are_told() {
    let error =
        |args: VlaArgs| args.source("", false).err().map(|error| format!("{error} {error:?}")).unwrap_or_default();
    assert!(error(VlaArgs::default()).contains("--dialect and --model"));
    let model = |map: Option<&str>, url: &str| VlaArgs {
        dialect: Some(Dialect::Gr00t),
        model: Some(url.into()),
        map: map.map(str::to_owned),
        ..VlaArgs::default()
    };
    assert!(error(model(None, "ws://lab:1")).contains("Address"));
    assert!(error(model(Some("openpi_g1"), "tcp://lab:1")).contains("it is not for gr00t"));
    assert!(error(VlaArgs { prefix: Some(31), ..model(None, "tcp://lab:1") }).contains("a chunk has 30 rows"));
    assert!(error(model(None, "tcp://lab:1")).is_empty());
    let on = |controller: &str| VlaArgs { controller: Some(controller.into()), ..model(None, "tcp://lab:1") };
    assert!(error(on("own")).is_empty());
    for controller in ["sonic:x", "gear", "gear:", "own:x", "walk"] {
        let said = error(on(controller));
        assert!(said.contains(&format!("'{controller}', but the mapping unitree_g1 outputs commands")), "{said}");
    }
    assert!(error(on("gear:/nowhere")).contains("/nowhere/Balance.onnx"));
    assert!(error(on("gear:/nowhere,vx=1")).contains("use names of reading, gains"));
}

/// A server of openpi that takes a while for its first answer, as one that compiles does; returns its address.
fn slow_at_first(time: Duration) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let url = format!("ws://{}", listener.local_addr().expect("an address"));
    std::thread::spawn(move || {
        let pack = |value: rmpv::Value| {
            let mut bytes = Vec::new();
            rmpv::encode::write_value(&mut bytes, &value).expect("memory");
            Message::binary(bytes)
        };
        let actions = Tensor::f32(vec![50, 23], &[0.0; 50 * 23]).expect("an array").write(Form::Openpi);
        let mut left = time;
        for stream in listener.incoming() {
            let mut socket = tungstenite::accept(stream.expect("a connection")).expect("a handshake");
            let _ = socket.send(pack(rmpv::Value::Map(vec![])));
            while let Ok(Message::Binary(_)) = socket.read() {
                std::thread::sleep(std::mem::take(&mut left));
                let _ = socket.send(pack(rmpv::Value::Map(vec![("actions".into(), actions.clone())])));
            }
        }
    });
    url
}

/// A server that compiles for its first answer is waited for before an episode, by a time of its own; where it takes longer, the
/// error says so, and not that the dialect is wrong.
#[test]
fn a_first_answer_may_take_long() {
    let checked = |time: Duration, warm_up: u16| {
        let args = VlaArgs {
            dialect: Some(Dialect::Openpi),
            model: Some(slow_at_first(time)),
            reply_timeout: Some(1),
            warm_up_timeout: Some(warm_up),
            ..VlaArgs::default()
        };
        args.checked("", false)
    };
    let slow = Duration::from_millis(1500);
    let source = checked(slow, 10).expect("it waits");
    let answer = source.probe().expect("a contract").answer.expect("an answer");
    assert!(answer.rows.is_ok() && answer.latency < Duration::from_secs(1), "no episode pays for it");
    let error = checked(slow, 1).err().and_then(|error| error.source().map(ToString::to_string)).expect("too slow");
    assert!(
        error.contains("within 1 s") && error.contains("--warm-up-timeout") && !error.contains("dialect"),
        "{error}"
    );
    // Without that question the first one of the episode pays, and the reason is time as well, also while the server is busy.
    let source = checked(Duration::from_secs(4), 0).expect("no question");
    let mut client = ModelClient::new(source.0.options.model().expect("an address"), Duration::from_millis(1500));
    let error = client.ask(&source.example().expect("an observation")).err().expect("too slow").to_string();
    assert!(error.contains("--reply-timeout"), "{error}");
}

/// The mapping is read for the robot that the session has: its own fingers play the model's, and the policy's name says so.
#[test]
fn a_mapping_is_read_for_the_robot_of_the_session() {
    let args =
        VlaArgs { dialect: Some(Dialect::Openpi), model: Some(slow_at_first(Duration::ZERO)), ..VlaArgs::default() };
    let mut policy = args.source("dex3", false).expect("its joints are known").policy();
    assert_eq!(policy.name(), "vla:openpi:openpi_g1:dex3");
    let [width, height] = policy.image_size().expect("it sees");
    let camera = Some(Image { width, height, rgb: vec![90; (3 * width * height) as usize] });
    let session = |name: &str| {
        let robot = Robot::by_name(name).expect("known");
        let (info, first) = standing(&robot, GainSet::default());
        let sensors = vec![Sensor::from("camera")];
        (robot, SessionInfo { sensors, ..info }, Observation { camera: camera.clone(), ..first })
    };
    let (robot, info, first) = session("g1_dex3");
    policy.reset(&info, &first).expect("the robot of the mapping");
    let Command::JointTarget(targets) = policy.act(&first).expect("an answer") else { panic!("actions") };
    assert_eq!(targets.len(), 43);
    let target = |joint: &str| targets[robot.joint_index(joint).expect(joint)];
    // The model's grips are 0: an open hand, its thumb turned to one stop.
    for (side, thumb) in [("left", -FRAC_PI_3), ("right", FRAC_PI_3)] {
        for (joint, open) in [("thumb_0", thumb), ("index_0", 0.0), ("middle_1", 0.0)] {
            assert!((target(&format!("{side}_hand_{joint}_joint")) - open).abs() < 1e-4, "{side} {joint}");
        }
    }
    let (_, info, first) = session("g1_inspire");
    let error = policy.reset(&info, &first).expect_err("another robot").to_string();
    assert!(error.contains("--robot g1_dex3"), "{error}");
    let error = args.source("h1", false).expect_err("an unknown robot").to_string();
    assert!(error.contains("g1_dex3"), "{error}");
}

/// The session has what the state needs: forces, and the LiDAR of the mapping's sight.
#[test]
fn the_senses_of_the_state_are_asked_for() {
    let args = |real_time: bool| {
        let map = concat!(env!("CARGO_MANIFEST_DIR"), "/../bridge/tests/written_mapping.toml");
        let args = VlaArgs {
            dialect: Some(Dialect::Gr00t),
            model: Some("tcp://lab:1".into()),
            map: Some(map.into()),
            ..VlaArgs::default()
        };
        args.source("", real_time).expect("a mapping")
    };
    let lidar = |real_time: bool| {
        let sensors = args(real_time).policy().sensors();
        sensors.into_iter().find(|sensor| sensor.name == "lidar").expect("it needs it")
    };
    assert!(lidar(false).on_request && lidar(false).see_room);
    assert!(!lidar(true).on_request && lidar(true).rate_hz == REAL_TIME_HZ);
    let source = args(false);
    let check = |sensors: &[Sensor]| {
        let info = SessionInfo { sensors: sensors.to_vec(), ..SessionInfo::default() };
        source.0.check_senses(&info).map_err(|error| error.to_string())
    };
    let asked = source.policy().sensors();
    assert_eq!(check(&asked), Ok(()));
    for name in ["hand_contact", "lidar"] {
        let others: Vec<Sensor> = asked.iter().filter(|sensor| sensor.name != name).cloned().collect();
        assert!(check(&others).is_err_and(|error| error.contains(&format!("needs the sensor {name}"))));
    }
    let blind: Vec<Sensor> = asked.into_iter().map(|sensor| Sensor { see_room: false, ..sensor }).collect();
    assert!(check(&blind).is_err_and(|error| error.contains("the mapping needs lidar+room")));
}
