//! Peers that send what none of our programs sends. Whoever sends it is told what is wrong, and nobody else notices.

use std::time::{Duration, Instant};

use fiatlux_access::{RecorderKey, RowsKey};
use fiatlux_proto::v3::notice::Code;
use fiatlux_proto::v3::refusal::Code as Refused;
use fiatlux_proto::v3::{
    Action, CloseReply, Observation, OpenRequest, StepRecord, StepRecordAck, StepRecordRequest, Version,
};
use fiatlux_proto::{Message, PROTOCOL, limits};
use fiatlux_tests::programs::{PATIENCE, Service, Watch, alone, connect, grade, played};
use zenoh::Wait;
use zenoh::query::{ConsolidationMode, Reply};

use super::LONG;
use super::raw::{JOINTS, Raw, action, ask, ask_with, noise, open, request};

/// Each bad action in step 3 of episode 0, and what its notice names: code, field, a part of its words.
fn bad_actions() -> Vec<(&'static str, Vec<u8>, Code, &'static str, &'static str)> {
    let numbers = |numbers: Vec<f64>| Action { action: numbers, ..action(0, 3) }.encode_to_vec();
    let nan = |at: usize| (0..JOINTS).map(|joint| if joint == at { f64::NAN } else { 0.0 }).collect::<Vec<_>>();
    let both = Action { joint_target: vec![0.0; JOINTS], ..action(0, 3) }.encode_to_vec();
    let targets = Action { action: Vec::new(), joint_target: nan(0), ..action(0, 3) }.encode_to_vec();
    let unknown = [action(0, 3).encode_to_vec(), vec![0x78, 1]].concat();
    vec![
        ("a number too few", numbers(vec![0.0; JOINTS - 1]), Code::Value, "action", "52 numbers instead of 53"),
        ("a number too many", numbers(vec![0.0; JOINTS + 1]), Code::Value, "action", "54 numbers instead of 53"),
        ("no number", numbers(nan(7)), Code::Value, "action", "is not finite"),
        ("no target", targets, Code::Value, "joint_target", "is not finite"),
        ("both lists", both, Code::Value, "action", "both action and joint_target are filled"),
        ("neither list", numbers(Vec::new()), Code::Value, "action", "neither action nor joint_target is filled"),
        ("an old step", action(0, 1).encode_to_vec(), Code::Step, "step", "step 1; the present step is 3"),
        ("a future step", action(0, 4).encode_to_vec(), Code::Step, "step", "step 4; the present step is 3"),
        ("the last step there is", action(0, u64::MAX).encode_to_vec(), Code::Step, "step", "the present step is 3"),
        ("another episode", action(1, 3).encode_to_vec(), Code::Step, "episode", "episode 1; episode 0 runs"),
        ("an unknown field", unknown, Code::Malformed, "", "field with number 15"),
        ("random bytes", noise(1, 300), Code::Malformed, "", "cannot decode as Action"),
        ("a large message", noise(2, 1 << 20), Code::Size, "", "a message of 1048576 bytes; the limit is 16384"),
    ]
}

/// Runs longer than two seconds of a flood and what comes before, on a fast machine too: 18,000 steps.
const LONGER: [&str; 6] = ["--policy", "zero", "--task", "S08", "--episodes", "3"];

/// Guards that a session survives whatever its client sends: each message is named in a notice, none becomes a step, the
/// right action is still taken; and a session next to it has the rows that it has alone.
#[test]
fn a_hostile_client() {
    let service = Service::start("hostile", &[]);
    let watch = Watch::start(service.port);
    let mut other = service.client(&LONGER);
    watch.wait_for(100);
    let raw = Raw::open(service.port, &request("S08"));
    (0..3).for_each(|step| drop(raw.step(step)));
    for (name, bytes, code, field, words) in bad_actions() {
        raw.send(bytes);
        let notice = raw.notice();
        assert_eq!((notice.code(), notice.field.as_str(), notice.count), (code, field, 1), "{name}: {notice:?}");
        assert_eq!((notice.episode, notice.step), (0, 3), "{name}");
        assert!(notice.message.contains(words) && !notice.remedy.is_empty(), "{name}: {notice:?}");
    }
    assert!(raw.is_quiet(), "nothing of that was taken as an action");
    raw.step(3);

    // A flood of 10,000 messages a second.
    let start = Instant::now();
    let mut sent = 0;
    while start.elapsed() < Duration::from_secs(2) {
        let message = if sent % 2 == 0 { noise(sent, 100) } else { action(0, 100).encode_to_vec() };
        raw.send(message);
        sent += 1;
        std::thread::sleep(Duration::from_micros(100 * sent).saturating_sub(start.elapsed()));
    }
    assert!(other.is_running(), "the other session ran all the time");
    let notices = raw.notices_until_quiet(Duration::from_secs(2));
    let counted: u64 = notices.iter().map(|notice| notice.count).sum();
    println!("{sent} messages sent, {} notices for {counted}", notices.len());
    assert!(notices.len() <= 10 * limits::MAX_NOTICES_PER_S as usize, "the client can bear it: {}", notices.len());
    // A notice may be lost on a full link.
    assert!(sent > 10_000 && counted > sent / 10 * 9 && counted <= sent, "noticed are {counted} of {sent} messages");
    raw.step(4);
    assert_eq!(played(&mut other), alone(&LONGER));
}

/// A session plays while another client sends messages so large that the server's link refuses them.
fn plays_beside_large_messages(service: &Service) {
    let watch = Watch::start(service.port);
    let mut other = service.client(&LONG);
    watch.wait_for(100);
    let raw = Raw::open(service.port, &request("S08"));
    for _ in 0..3 {
        raw.send(vec![0; 10 << 20]);
    }
    assert!(other.is_running(), "the other session ran all the time");
    assert_eq!(played(&mut other), alone(&LONG));
    open(&connect(service.port), request("S01").encode_to_vec()).unwrap();
}

/// Guards the server against a message that is larger than its link takes: it costs its sender's session at most.
#[test]
fn a_message_of_ten_megabytes() {
    plays_beside_large_messages(&Service::start("large", &[]));
}

/// Guards the same where all clients share one link to the server, through a router.
#[test]
fn a_message_of_ten_megabytes_through_a_router() {
    let (service, _router) = Service::start_behind_router("large-router");
    plays_beside_large_messages(&service);
}

/// Guards that what cannot be opened is refused with the field that is wrong and what to do, and takes no room.
#[test]
fn hostile_requests_to_open() {
    let service = Service::start("refusals", &["--capacity", "1"]);
    let link = connect(service.port);
    let set = |name: &str, value: f64| [(name.to_owned(), value)].into();
    let version = Version { major: PROTOCOL.major + 1, minor: 4 };
    let cases: [(OpenRequest, Refused, &str, &[&str]); 11] = [
        (OpenRequest { protocol: Some(version), ..request("S01") }, Refused::Version, "protocol", &["4.4", "3.14"]),
        (OpenRequest { protocol: None, ..request("S01") }, Refused::Version, "protocol", &["3.14"]),
        (request("S99"), Refused::Unknown, "task", &["S99", "S01"]),
        (
            OpenRequest { sensors: vec!["smell".into()], ..request("S01") },
            Refused::Unknown,
            "sensors",
            &["does not exist"],
        ),
        (OpenRequest { image_width: 100_000, ..request("S01") }, Refused::Value, "image_width", &["from 16 to 640"]),
        (
            OpenRequest { sensors: vec!["features".into()], weights: "../secret".into(), ..request("S01") },
            Refused::Value,
            "weights",
            &["--weights DIR"],
        ),
        (OpenRequest { robot: "h1".into(), ..request("S01") }, Refused::Unknown, "robot", &["use one of 'g1_inspire'"]),
        (OpenRequest { gains: "soft".into(), ..request("S01") }, Refused::Unknown, "gains", &["sonic"]),
        (
            OpenRequest { thresholds: set("fragility", 1.0), ..request("S01") },
            Refused::Unknown,
            "thresholds",
            &["fragility_n"],
        ),
        (
            OpenRequest { thresholds: set("fragility_n", f64::NAN), ..request("S01") },
            Refused::Value,
            "thresholds",
            &["finite"],
        ),
        (OpenRequest { mode: 9, ..request("S01") }, Refused::Unknown, "mode", &["MODE_LOCKSTEP"]),
    ];
    for (request, code, field, words) in cases {
        let refusal = open(&link, request.encode_to_vec()).unwrap_err();
        assert_eq!((refusal.code(), refusal.field.as_str()), (code, field), "{refusal:?}");
        assert!(words.iter().all(|word| refusal.message.contains(word)), "{refusal:?}");
    }
    for seed in 0..50 {
        let refusal = open(&link, noise(seed, 40 + seed as usize)).unwrap_err();
        assert_eq!(refusal.code(), Refused::Malformed, "{refusal:?}");
    }
    let refusal = open(&link, vec![0; 100_000]).unwrap_err();
    assert_eq!((refusal.code(), refusal.message.contains("larger than")), (Refused::Malformed, true), "{refusal:?}");

    let raw = Raw::open(service.port, &request("S01"));
    let busy = open(&link, request("S01").encode_to_vec()).unwrap_err();
    assert_eq!(busy.code(), Refused::Busy, "{busy:?}");
    assert!(busy.message.contains("--capacity"), "{busy:?}");
    let reply = raw.ask::<CloseReply>(&raw.keys.close(), noise(1, 30)).unwrap();
    assert_eq!(reply.refusal.unwrap().code(), Refused::Malformed, "the session stays");
    raw.step(0);
    assert_eq!(raw.ask::<CloseReply>(&raw.keys.close(), Vec::new()), Ok(CloseReply::default()));
    open(&link, request("S01").encode_to_vec()).unwrap();
}

/// Guards the recording against another recorder that lies: what it says of truths that do not exist frees none, what it
/// asks for is bounded, and the bag is whole.
#[test]
fn a_hostile_recorder() {
    let service = Service::start("hostile-recorder", &[]);
    let mut recorder = service.record();
    let watch = Watch::start(service.port);
    let mut client = service.client(&[&LONG[..], &["--recorded"]].concat());
    let session = watch.wait_for(100);
    let link = connect(service.port);
    let keys = fiatlux_proto::keys::ServerKeys::new("test").session(&session);
    for round in 0..100 {
        for next_seq in [u64::MAX, u64::MAX / 2, 1 << 32, 100_000] {
            let ack = StepRecordAck { recorder: "liar".into(), next_seq, ..StepRecordAck::default() }.encode_to_vec();
            link.put(keys.truth_ack(), ack).wait().unwrap();
        }
        for garbage in [noise(round, 60), vec![0xff; 10], vec![0; 100_000], Vec::new()] {
            link.put(keys.truth_ack(), garbage).wait().unwrap();
        }
    }
    let key = RecorderKey::read(&service.recorder_key()).unwrap();
    let rows = RowsKey::of_recorder(&key, "test", &session).unwrap();
    // One that has the key lies no better.
    for next_seq in [u64::MAX, u64::MAX / 2, 1 << 32, 100_000] {
        let ack = StepRecordAck { recorder: "liar".into(), next_seq, ..StepRecordAck::default() }.encode_to_vec();
        let proof = rows.prove("ack", &ack).to_vec();
        link.put(keys.truth_ack(), ack).attachment(proof).wait().unwrap();
    }
    let truths = |from_seq, count| {
        let request = StepRecordRequest { from_seq, count }.encode_to_vec();
        let proof = rows.prove("rows", &request).to_vec();
        let query = link.get(keys.truth_rows()).payload(request).attachment(proof);
        let replies = query.consolidation(ConsolidationMode::None).wait().unwrap();
        let open = |reply: Reply| {
            StepRecord::decode(&*rows.open(&reply.result().unwrap().payload().to_bytes()).unwrap()).unwrap()
        };
        replies.iter().map(open).collect::<Vec<_>>()
    };
    let all = truths(0, u64::MAX);
    assert!(all.len() as u64 <= limits::MAX_TRUTHS_PER_REQUEST, "{}", all.len());
    assert!(truths(u64::MAX, u64::MAX).is_empty() && truths(1 << 40, 1).is_empty());
    let refused = ask::<StepRecord>(&link, &keys.truth_rows(), noise(3, 50)).remove(0).unwrap_err();
    assert_eq!(refused.code(), Refused::Closed, "without the key");
    let garbage = noise(3, 50);
    let proof = rows.prove("rows", &garbage).to_vec();
    let refused = ask_with::<StepRecord>(&link, &keys.truth_rows(), garbage, Some(proof)).remove(0).unwrap_err();
    assert_eq!(refused.code(), Refused::Malformed, "{refused:?}");
    assert!(client.is_running(), "all that came during the episode");

    assert_eq!(played(&mut client), alone(&LONG));
    recorder.wait_for("time-out after 6000 steps");
    let (code, results) = grade(&service.bags(), &service.folder);
    assert_eq!((code, &results["episodes"][0]["state_digest"]), (0, &alone(&LONG)[0].digest.clone().into()));
    let gone = ask::<Observation>(&link, &keys.observation(), Vec::new()).remove(0).unwrap_err();
    assert_eq!(gone.code(), Refused::Closed, "the session is over");
    recorder.signal("TERM");
    assert!(recorder.finish(PATIENCE).0.success());
}
