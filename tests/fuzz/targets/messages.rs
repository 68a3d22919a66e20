//! Messages of strangers: to the three peers of a session, and messages and journals that are read.
#![no_main]

use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::LazyLock;
use std::time::Duration;

use fiatlux_bag::Bag;
use fiatlux_bag::run::Ledger;
use fiatlux_fuzz::{folder, parts, pause, put, seeds_wanted, write_seeds};
use fiatlux_proto::v3::{
    Action, ActionRecord, EpisodeEnd, EpisodeHeader, EpisodeResult, Joint, Observation, Refusal, ResetRequest,
    RunRequest, SessionInfo, State, StepRecord, StepRecordAck,
};
use fiatlux_proto::{Bytes, Message};
use fiatlux_session::{
    ClientSession, Command, Host, Machine, RecorderSession, ServerSession, client, recorder, server,
};
use fiatlux_wire::{layout_of, read_identity, read_row, reward_of, robot_of, scene_of};
use libfuzzer_sys::fuzz_target;
use sha2::{Digest as _, Sha256};

static PATH: LazyLock<PathBuf> = LazyLock::new(|| folder("messages").join("lab.run.jsonl"));

/// Most outputs after one input.
const MAX_OUTPUTS: usize = 10_000;

/// A simulation of three joints that ends after two steps.
#[derive(Default)]
struct Counter(Observation);

impl Host for Counter {
    fn stage(&mut self, episode: u64) -> Result<&Observation, Refusal> {
        self.0 = Observation { episode, ..Observation::default() };
        Ok(&self.0)
    }
    fn step(&mut self, _: &Command) -> Result<&Observation, Refusal> {
        self.0.step += 1;
        self.0.end = (self.0.step == 2).then(EpisodeEnd::default);
        Ok(&self.0)
    }
    fn look(&mut self, _: &[String]) -> Result<Observation, Refusal> {
        Ok(self.0.clone())
    }
    fn record(&mut self, _: Option<ActionRecord>, _: bool) -> Result<StepRecord, Refusal> {
        Ok(StepRecord { step: self.0.step, ..StepRecord::default() })
    }
    fn cut_short(&self, _: &str, _: &str) -> EpisodeResult {
        EpisodeResult::default()
    }
}

/// Carries out what a machine wants: nothing. It must want an end of it.
fn drain<M: Machine>(machine: &mut M) {
    let count = std::iter::from_fn(|| machine.poll()).take(MAX_OUTPUTS).count();
    assert!(count < MAX_OUTPUTS, "outputs without end");
}

/// One peer gets everything; of two bytes before each message the first says what it is, the second how much later it comes.
fn session(data: &[u8], recorded: bool) {
    let joints = vec![Joint::default(); 3];
    let info = SessionInfo { joints, action_scale: 0.5, resend_s: 0.1, grace_s: 10.0, ..SessionInfo::default() };
    let mut now = Duration::ZERO;
    let mut server = ServerSession::new(Counter::default(), info.clone(), recorded, server::Timeouts::default(), now);
    let mut client = ClientSession::new(&info);
    client.handle(client::Input::Start(0), now);
    let mut recorder = RecorderSession::new("lab", now);
    for (kind, part) in parts(data) {
        let [later, part @ ..] = part else { continue };
        now += pause(*later);
        let bytes = Bytes::copy_from_slice(part);
        let number = part.len() as u64;
        match kind % 24 {
            0 => server.handle(server::Input::Action(bytes), now),
            1 => server.handle(server::Input::Reset(bytes, ()), now),
            2 => server.handle(server::Input::Close(bytes, ()), now),
            3 => server.handle(server::Input::Look(bytes, ()), now),
            4 => server.handle(server::Input::Ack(bytes), now),
            5 => server.handle(server::Input::StepRecords(bytes, ()), now),
            6 => server.handle(server::Input::ClientGone, now),
            7 => server.handle(server::Input::ClientSeen, now),
            8 => server.handle(server::Input::Dropped(number), now),
            9 => server.handle(server::Input::Tick, now),
            10 => client.handle(client::Input::Observation(bytes), now),
            11 => client.handle(client::Input::Notice(bytes), now),
            12 => client.handle(client::Input::Reset(Some(Ok(bytes))), now),
            13 => client.handle(client::Input::Reset(Some(Err(bytes))), now),
            14 => client.handle(client::Input::LastObservation(Some(Ok(bytes))), now),
            15 => client.handle(client::Input::Reset(None), now),
            16 => client.handle(client::Input::Command(Command::Action(vec![0.0; 3])), now),
            17 => client.handle(client::Input::ServerSeen(number % 2 == 0), now),
            18 => client.handle(client::Input::Tick, now),
            19 => recorder.handle(recorder::Input::StepRecord(bytes), now),
            20 => recorder.handle(recorder::Input::Answered, now),
            21 => recorder.handle(recorder::Input::OnDisk(number), now),
            22 => recorder.handle(recorder::Input::ServerGone, now),
            _ => recorder.handle(recorder::Input::Tick, now),
        }
        drain(&mut server);
        drain(&mut client);
        drain(&mut recorder);
    }
}

/// A header, and rows of what it describes.
fn header(data: &[u8]) {
    let mut parts = parts(data).map(|(_, part)| part);
    let Some(header) = parts.next().and_then(|part| EpisodeHeader::decode(part).ok()) else { return };
    let _ = read_identity(&header).map(|identity| identity.digest().hex());
    let _ = reward_of(&header);
    let _ = robot_of(&header).map(|robot| scene_of(&header, robot.into()));
    if let Ok(layout) = layout_of(&header) {
        parts.filter_map(|part| State::decode(part).ok()).for_each(|state| drop(read_row(&state, layout)));
    }
}

/// Lines of a journal, whose chain is made anew.
fn journal(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let (mut link, mut out) = (String::new(), String::new());
    for line in text.lines().filter_map(|line| line.strip_suffix('}')) {
        let sum = Sha256::new().chain_update(&link).chain_update(line).finalize();
        // The signature is of the line before.
        let line_and_link = line.replace("PREVIOUS", &link);
        link = sum.iter().map(|byte| format!("{byte:02x}")).collect();
        let _ = writeln!(out, "{line_and_link},\"link\":\"{link}\"}}");
    }
    std::fs::write(&*PATH, out).expect("a file");
    let _ = Ledger::read(&*PATH);
}

/// Messages of a session of two steps.
fn seed_session() -> Vec<u8> {
    let mut out = Vec::new();
    let mut add = |kind, message: Vec<u8>| put(&mut out, kind, &[&[0][..], &message].concat());
    let action = |step| Action { step, action: vec![0.0; 3], ..Action::default() }.encode_to_vec();
    let seen = |step| Observation { step, ..Observation::default() }.encode_to_vec();
    let record = |seq| StepRecord { seq, step: seq, ..StepRecord::default() }.encode_to_vec();
    add(1, ResetRequest::default().encode_to_vec());
    add(12, seen(0));
    for step in 0..2 {
        add(0, action(step));
        add(16, Vec::new());
        add(10, seen(step + 1));
        add(19, record(step));
        add(21, vec![0; step as usize]);
    }
    add(4, StepRecordAck::default().encode_to_vec());
    add(3, Vec::new());
    add(9, Vec::new());
    out
}

const JOURNAL: &str = r#"{"protocol":{"major":3,"minor":9},"version":"1","server":"lab","run":"first","key_sha256":"abababababababababababababababababababababababababababababababab","spec":SPEC,"episodes":[{"task":"S01","seed":0},{"task":"S02","seed":0}],"unix_ms":1}
{"event":"opened","episode":0,"attempt":1,"session":"s","unix_ms":2}
{"event":"abandoned","episode":0,"attempt":1,"session":"s","steps":1,"digest":"cdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcd","marks":{"every":1,"hex":"00000000"},"cause":"gone"}
{"event":"restarted","unix_ms":3}
{"event":"opened","episode":0,"attempt":2,"session":"t","unix_ms":4}
{"event":"played","episode":0,"attempt":2,"session":"t","bag":"a.mcap","digest":"cdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcd","cause":"fall","success":false,"steps":9}
{"event":"finished","unix_ms":5}
{"event":"sealed","of":"PREVIOUS","key":"ed25519:","signature":""}
"#;

fuzz_target!(init: if let Some((folder, bag)) = seeds_wanted() {
    let bag = Bag::open(&bag).expect("a bag");
    let mut of_header = vec![2];
    put(&mut of_header, 0, &bag.header().encode_to_vec());
    for state in bag.states().take(2) {
        put(&mut of_header, 0, &state.expect("a row").encode_to_vec());
    }
    let spec = serde_json::to_string(&fiatlux_proto::v3::RunSpec::default()).expect("JSON");
    let journal = JOURNAL.replace("SPEC", &spec);
    let seeds = [
        ("session", [&[0][..], &seed_session()].concat()),
        ("recorded", [&[1][..], &seed_session()].concat()),
        ("header", of_header),
        ("journal", [&[3][..], journal.as_bytes()].concat()),
        ("run", [&[4][..], &RunRequest::default().encode_to_vec()].concat()),
    ];
    write_seeds(&folder, seeds.map(|(name, bytes)| (name.to_owned(), bytes)));
}, |data: &[u8]| {
    let Some((kind, data)) = data.split_first() else { return };
    match kind {
        0 | 1 => session(data, *kind == 1),
        2 => header(data),
        3 => journal(data),
        _ => drop(RunRequest::decode(data)),
    }
});
