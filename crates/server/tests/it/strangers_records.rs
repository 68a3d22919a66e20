//! Peers of the same network that want to read what a policy must not know, or to have something else recorded: they read
//! nothing, and bags hold what the server has said.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crate::common::LONG;
use crate::common::victim::{Heard, Victim, network, options, overhear, request};
use crate::common::{ask_run, replies};
use fiatlux_access::{RecorderKey, RowsKey};
use fiatlux_bag::{Bag, Completeness};
use fiatlux_proto::Message;
use fiatlux_proto::keys::ServerKeys;
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::run_request::Ask;
use fiatlux_proto::v3::{
    EpisodeEnd, EpisodeHeader, EpisodeResult, OpenRequest, RunSpec, StepRecord, StepRecordAck, StepRecordRequest,
    run_reply,
};
use fiatlux_server::{BagEnd, BagReport, Naming, Recorder, RecorderOptions, RecordsFrom, RecordsTo, ServerOptions};
use zenoh::{Session, Wait};

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("strangers").join(name);
    let _ = std::fs::remove_dir_all(&folder);
    folder
}

/// Where a server's records go, and which session is played.
enum Case {
    Nobody,
    Recorders,
    Record,
    Run,
    Replay,
}

/// Guards what a policy must not know: whatever a peer subscribes to and asks for, the session's own client too, it gets no
/// record that it can read. That holds wherever the records go, in runs, and for the rows of a replay.
#[test]
fn nobody_reads_a_truth() {
    for case in [Case::Nobody, Case::Recorders, Case::Record, Case::Run, Case::Replay] {
        let key = RecorderKey::generate().unwrap();
        let records_to = if matches!(case, Case::Recorders) { RecordsTo::Recorders(key) } else { RecordsTo::Nobody };
        let record = matches!(case, Case::Record | Case::Run).then(|| folder("truth"));
        let (_server, link, stranger) = network(ServerOptions { records_to, record, ..options() });
        let heard = [&link, &stranger].map(overhear);
        let victim = match case {
            Case::Run => {
                let spec =
                    RunSpec { policy: "tiny".into(), tasks: vec!["S07".into()], seeds: vec![1], ..RunSpec::default() };
                let run = ["first", "0123456789abcdef0123456789abcdef"];
                let (registered, _) = ask_run(&link, "test", run, Ask::Register(spec));
                assert!(matches!(registered, run_reply::Reply::Run(_)), "{registered:?}");
                let (opened, secrets) = ask_run(&link, "test", run, Ask::Open(0));
                let run_reply::Reply::Session(info) = opened else { panic!("{opened:?}") };
                Victim::enter(&link, &info, &secrets.unwrap())
            }
            Case::Replay => Victim::open_with(&link, &OpenRequest { replay: true, ..request() }),
            _ => Victim::open(&link),
        };
        victim.play(|_| ());
        let mut answers = Vec::new();
        for link in [&link, &stranger] {
            let asked = StepRecordRequest { from_seq: 0, count: 100 }.encode_to_vec();
            for attachment in [Vec::new(), vec![0; 16]] {
                for reply in replies(link, &victim.keys.truth_rows(), asked.clone(), attachment) {
                    assert_eq!(reply.unwrap_err().code(), Code::Closed);
                }
            }
            let ack =
                StepRecordAck { recorder: "liar".into(), next_seq: 5, ..StepRecordAck::default() }.encode_to_vec();
            link.put(victim.keys.truth_ack(), ack).wait().unwrap();
            for reply in link.get("**").payload(asked).timeout(Duration::from_secs(2)).wait().unwrap() {
                let Ok(sample) = reply.result() else { continue };
                answers.push((sample.key_expr().to_string(), sample.payload().to_bytes().into_owned(), Vec::new()));
            }
        }
        let heard: Vec<Heard> = heard.iter().flat_map(Receiver::try_iter).chain(answers).collect();
        let rows: Vec<_> = heard.iter().filter(|(key, ..)| key.contains("/truth/row")).collect();
        let is_published = matches!(case, Case::Recorders | Case::Replay);
        assert_eq!(!rows.is_empty(), is_published, "records leave the process sealed, or not at all");
        for (key, payload, _) in rows {
            let read = fiatlux_proto::decode::<StepRecord>(payload, usize::MAX);
            assert!(read.is_err(), "{key}: {:?}", read.map(|record| record.step));
        }
    }
}

fn recorder(link: &Session, out: PathBuf, key: &RecorderKey) -> (Recorder, Receiver<BagReport>) {
    let (sender, bags) = channel();
    let sender = Mutex::new(sender);
    let options = RecorderOptions {
        out,
        server: None,
        name: "recorder".into(),
        naming: Naming::Flat,
        thin: false,
        records: RecordsFrom::Servers(key.clone()),
        on_bag: Box::new(move |report| drop(sender.lock().unwrap().send(report))),
        on_loss: Box::new(|session, records| panic!("{session} lost {records} records")),
    };
    (Recorder::start(fiatlux_link::carrier(link), options).unwrap(), bags)
}

/// Plays a recorded session to its end; what its bag says is what its client was told.
fn plays_into_a_bag(link: &Session, bags: &Receiver<BagReport>, disturb: impl Fn(&Victim, u64)) -> EpisodeEnd {
    let victim = Victim::open_with(link, &OpenRequest { recorded: true, ..request() });
    let end = victim.play(|step| disturb(&victim, step));
    let report = bags.recv_timeout(LONG).unwrap();
    let BagEnd::Whole(result) = &report.end else { panic!("{report:?}") };
    assert_eq!(result.end.as_ref(), Some(&end));
    let bag = Bag::open(&report.path).unwrap();
    assert_eq!((bag.completeness(), bag.states().count() as u64), (&Completeness::Whole, end.steps + 1));
    victim.close();
    end
}

/// Guards a recorder against rows and tokens that are not of a server with its key: a stranger's session has no bag, and the
/// rows of another's are those that its server said.
#[test]
fn nobody_else_is_recorded() {
    let key = RecorderKey::generate().unwrap();
    let records_to = RecordsTo::Recorders(key.clone());
    let (server, link, stranger) = network(ServerOptions { records_to, ..options() });
    let out = folder("forged");
    let (_recorder, bags) = recorder(&stranger, out.clone(), &key);
    let alone = plays_into_a_bag(&link, &bags, |_, _| ());

    let success = EpisodeEnd { success: true, cause: "success".into(), ..alone.clone() };
    let record = move |seq| {
        let result = EpisodeResult { end: Some(success.clone()), ..EpisodeResult::default() };
        let header = Some(EpisodeHeader { task: "S07".into(), ..EpisodeHeader::default() });
        StepRecord { seq, header, result: Some(result), ..StepRecord::default() }.encode_to_vec()
    };
    let other = RecorderKey::generate().unwrap();
    let forged = ServerKeys::new("test").session("forged");
    let sealed = RowsKey::of_recorder(&other, "test", "forged").unwrap();
    // A session that is not there, with all that a recorder looks at.
    let _live = stranger.liveliness().declare_token(forged.live()).wait().unwrap();
    let answer = record.clone();
    let answers = stranger.declare_queryable("fiatlux/v3/*/s/*/truth/rows").callback(move |query| {
        let key = query.key_expr().clone();
        for payload in [answer(0), sealed.seal(0, &answer(0))] {
            drop(query.reply(key.clone(), payload).wait());
        }
    });
    let _answers = answers.wait().unwrap();
    let heard = overhear(&stranger);
    let sealed = RowsKey::of_recorder(&other, "test", "forged").unwrap();
    let seen = Mutex::new(Vec::new());
    let disturbed = plays_into_a_bag(&link, &bags, |victim, step| {
        for key in [victim.keys.truth_row(), forged.truth_row()] {
            for payload in [record(step), sealed.seal(step, &record(step))] {
                stranger.put(key.clone(), payload).wait().unwrap();
            }
        }
        let ack =
            StepRecordAck { recorder: "liar".into(), next_seq: step + 1, ..StepRecordAck::default() }.encode_to_vec();
        for proof in [Vec::new(), vec![9; 16]] {
            stranger.put(victim.keys.truth_ack(), ack.clone()).attachment(proof).wait().unwrap();
        }
        // Its own rows once more, cut, changed, under another number, and on the forged session's key.
        let mut seen = seen.lock().unwrap();
        seen.extend(heard.try_iter().filter(|(key, ..)| key.ends_with("/truth/row")));
        if let Some((key, payload, _)) = seen.get(step as usize / 2) {
            let (mut changed, mut renamed) = (payload.clone(), payload.clone());
            (changed[20], renamed[0]) = (changed[20] ^ 1, renamed[0].wrapping_add(1));
            for payload in [payload.clone(), payload[..payload.len() - 1].to_vec(), changed, renamed] {
                stranger.put(key.clone(), payload.clone()).wait().unwrap();
                stranger.put(forged.truth_row(), payload).wait().unwrap();
            }
        }
        // Tokens that come and go.
        drop(stranger.liveliness().declare_token(victim.keys.live()).wait().unwrap());
    });
    assert_eq!(disturbed, alone);
    assert!(bags.recv_timeout(Duration::from_secs(1)).is_err(), "a bag of the stranger's");
    assert_eq!(std::fs::read_dir(&out).unwrap().count(), 2);
    drop(server);
}

/// Guards a recorder against tokens of sessions that are not there: those that are get their bags.
#[test]
fn announced_sessions_crowd_out_no_other() {
    let key = RecorderKey::generate().unwrap();
    let records_to = RecordsTo::Recorders(key.clone());
    let (server, link, stranger) = network(ServerOptions { records_to, ..options() });
    let (_recorder, bags) = recorder(&link, folder("crowd"), &key);
    let proof = RowsKey::of_recorder(&RecorderKey::generate().unwrap(), "forged", "0").unwrap().token();
    let announce = |number: usize| {
        let keys = ServerKeys::new("forged").session(&number.to_string());
        [keys.live(), keys.truth_live(&proof)].map(|key| stranger.liveliness().declare_token(key).wait().unwrap())
    };
    let before: Vec<_> = (0..1500).map(announce).collect();
    let heard = overhear(&stranger);
    let alone = plays_into_a_bag(&link, &bags, |_, _| ());
    let among = Mutex::new(Vec::new());
    let disturbed = plays_into_a_bag(&link, &bags, |_, step| {
        among.lock().unwrap().extend((0..4).map(|number| announce(2000 + 4 * step as usize + number)));
    });
    assert_eq!(disturbed, alone);
    // Those that are followed are told what is on disk, each once in 5 s at least: none that was only announced.
    heard.try_iter().for_each(drop);
    std::thread::sleep(Duration::from_secs(6));
    let followed: BTreeSet<_> =
        heard.try_iter().map(|(key, ..)| key).filter(|key| key.ends_with("/truth/ack")).collect();
    assert!(followed.iter().all(|key| !key.contains("/forged/")), "{followed:?}");
    drop((server, before));
}

/// Guards a replay: its records are its opener's alone, no recorder gets them, and others' words on its keys are not records.
#[test]
fn a_replay_is_its_openers() {
    let key = RecorderKey::generate().unwrap();
    let records_to = RecordsTo::Recorders(key.clone());
    let (server, link, stranger) = network(ServerOptions { records_to, ..options() });
    let out = folder("replay");
    let (_recorder, bags) = recorder(&stranger, out.clone(), &key);
    let (info, secrets) =
        crate::common::open_session(&link, "test", &OpenRequest { replay: true, ..request() }).unwrap();
    let rows = RowsKey::of_opener(&secrets).unwrap();
    let victim = Victim::enter(&link, &info, &secrets);
    let _live = stranger.liveliness().declare_token(victim.keys.live()).wait().unwrap();
    let records: Arc<Mutex<Vec<Vec<u8>>>> = Arc::default();
    let taken = Arc::clone(&records);
    let subscriber = link.declare_subscriber(victim.keys.truth_row()).callback(move |sample| {
        taken.lock().unwrap().extend(rows.open(&sample.payload().to_bytes()));
    });
    let _subscriber = subscriber.wait().unwrap();
    let end = victim.play(|step| {
        stranger.put(victim.keys.truth_row(), vec![step as u8; 64]).wait().unwrap();
    });
    let until = Instant::now() + LONG;
    while (records.lock().unwrap().len() as u64) < end.steps + 1 {
        assert!(Instant::now() < until, "{} of {} records", records.lock().unwrap().len(), end.steps + 1);
        std::thread::sleep(Duration::from_millis(10));
    }
    let last =
        records.lock().unwrap().iter().map(|bytes| StepRecord::decode(&**bytes).unwrap()).max_by_key(|row| row.seq);
    assert_eq!(last.unwrap().result.unwrap().end, Some(end));
    victim.close();
    assert!(bags.recv_timeout(Duration::from_secs(1)).is_err());
    assert!(std::fs::read_dir(&out).is_ok_and(|files| files.count() == 0) || !out.exists());
    assert!(server.shutdown(LONG), "nobody is waited for");
}
