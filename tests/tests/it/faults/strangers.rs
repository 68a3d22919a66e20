//! A peer on the open listener of a server, next to our programs: it says and answers whatever it likes, and they go on as if it
//! were not there.

use std::time::Duration;

use fiatlux_proto::keys::ServerKeys;
use fiatlux_proto::v3::{
    EpisodeEnd, EpisodeHeader, EpisodeResult, Notice, Observation, ResetReply, StepRecord, StepRecordAck, notice,
};
use fiatlux_proto::{Message, keys};
use fiatlux_tests::programs::{PATIENCE, Service, Watch, alone, connect, grade, played};
use zenoh::{Session, Wait};

use super::LONG;
use super::raw::{action, open, request};

/// Messages that a session would take if they were its own.
fn interfere(stranger: &Session, keys: &keys::SessionKeys, round: u64) {
    let message = "forged".to_owned();
    let lost = Notice { code: notice::Code::Lost.into(), message, remedy: "forged".into(), ..Notice::default() };
    let end = EpisodeEnd { success: true, cause: "success".into(), steps: round, ..EpisodeEnd::default() };
    let result = EpisodeResult { end: Some(end.clone()), ..EpisodeResult::default() };
    let ended = Observation { step: round, end: Some(end), ..Observation::default() };
    let header = Some(EpisodeHeader { task: "S08".into(), ..EpisodeHeader::default() });
    let row = StepRecord { seq: round, header, result: Some(result), ..StepRecord::default() };
    let ack = StepRecordAck { recorder: "liar".into(), next_seq: 1 << 32, ..StepRecordAck::default() };
    for (key, payload) in [
        (keys.action(), action(0, round).encode_to_vec()),
        (keys.notice(), lost.encode_to_vec()),
        (keys.observation(), ended.encode_to_vec()),
        (keys.truth_row(), row.encode_to_vec()),
        (keys.truth_ack(), ack.encode_to_vec()),
    ] {
        for attachment in [Vec::new(), vec![round as u8; 16], vec![round as u8; 24]] {
            stranger.put(key.clone(), payload.clone()).attachment(attachment).wait().unwrap();
        }
    }
    for key in [keys.observation(), keys.live(), keys.client()] {
        stranger.delete(key).wait().unwrap();
    }
    for key in [keys.reset(), keys.close(), keys.look(), keys.truth_rows()] {
        drop(stranger.get(key).payload(Vec::new()).attachment(vec![1; 24]).wait().unwrap());
    }
    for key in [keys.live(), keys.client(), ServerKeys::new("test").alive()] {
        drop(stranger.liveliness().declare_token(key).wait().unwrap());
    }
}

/// Guards a client's process, its recorder and its server: the episode is the one that is played alone, its bag is whole and
/// the only one, nobody ends before it is time, and a flood of sessions keeps nobody out.
#[test]
fn a_stranger_beside_the_programs() {
    let service = Service::start("stranger", &[]);
    let mut recorder = service.record();
    let watch = Watch::start(service.port);
    let stranger = connect(service.port);
    // It answers every query, with what would be an end.
    let answers = stranger.declare_queryable("fiatlux/v3/**").callback(|query| {
        let key = query.key_expr().clone();
        drop(query.reply(key, ResetReply::default().encode_to_vec()).attachment(vec![1; 24]).wait());
    });
    let answers = answers.wait().unwrap();
    let forged = ServerKeys::new("test").session("forged");
    let _live = stranger.liveliness().declare_token(forged.live()).wait().unwrap();
    let mut client = service.client(&[&LONG[..], &["--recorded"]].concat());
    let session = watch.wait_for(100);
    let keys = ServerKeys::new("test").session(&session);
    let mut rounds = 0;
    while client.is_running() {
        interfere(&stranger, &keys, 100 + rounds);
        interfere(&stranger, &forged, rounds);
        rounds += 1;
        std::thread::sleep(Duration::from_millis(10));
    }
    assert!(rounds > 20, "{rounds}");
    assert_eq!(played(&mut client), alone(&LONG));
    assert!(!client.log().contains("forged"), "{}", client.log());
    recorder.wait_for("time-out after 6000 steps");
    let (code, results) = grade(&service.bags(), &service.folder);
    assert_eq!(code, 0, "{results:#}");
    let episodes = results["episodes"].as_array().unwrap();
    assert_eq!((episodes.len(), &episodes[0]["state_digest"]), (1, &alone(&LONG)[0].digest.clone().into()));
    let log = service.server.log();
    assert!(log.contains("dropping messages that are not of the session's client"), "{log}");

    drop(answers);
    let mut flood = 0;
    for _ in 0..64 {
        flood += usize::from(open(&connect(service.port), request("S01").encode_to_vec()).is_ok());
    }
    assert!(flood > 0, "{flood}");
    let quick = ["--policy", "zero", "--task", "S07"];
    assert_eq!(service.play(&quick), alone(&quick));
    recorder.signal("TERM");
    assert!(recorder.finish(PATIENCE).0.success());
}
