//! A session over real episodes: each rule of the protocol as inputs and what comes out, at times that the test chooses.
#![allow(clippy::unwrap_used)]

use std::time::Duration;

use fiatlux_bag::{Bag, BagWriter, Completeness};
use fiatlux_proto::v3::{
    Action, ActionRecord, CloseRequest, EpisodeResult, LookReply, LookRequest, Notice, OpenRequest, ResetReply,
    ResetRequest, Sensor, State, StepRecord, StepRecordAck, StepRecordRequest, look_reply, notice, reset_reply,
};
use fiatlux_proto::{Bytes, PROTOCOL, limits};
use fiatlux_session::server::{Input, MAX_EVENTS, Output, Timeouts};
use fiatlux_session::{Machine, ServerSession};
use fiatlux_wire::read_row;
use fiatlux_world::SceneConfig;

use super::*;
use crate::server::plan;
use crate::server::scenes::{Robots, Scenes};

/// The G1 with Inspire hands.
const JOINTS: usize = 53;

/// A policy of that name makes its simulation panic.
pub(in crate::server) const PANICS: &str = "panics";

const MS: Duration = Duration::from_millis(1);
const TIMEOUTS: Timeouts = Timeouts {
    grace: Duration::from_secs(10),
    action: Duration::from_secs(60),
    resend: Duration::from_millis(100),
    recorder: Duration::from_secs(10),
};

/// A session without a network: what it sends is kept, and time is what the test says.
struct Harness {
    session: ServerSession<Simulation, u32>,
    now: Duration,
    sent: Vec<Output<u32>>,
}

#[derive(Debug, PartialEq)]
enum Sent {
    Observation(u64),
    Notice(notice::Code),
    StepRecord(u64),
    Reply(u32),
    Refused(u32),
    Closed,
    Done,
}

fn harness(request: OpenRequest) -> Harness {
    let mut harness = without_client(request);
    harness.give(Input::ClientSeen);
    harness
}

fn without_client(request: OpenRequest) -> Harness {
    let bytes = OpenRequest { protocol: Some(PROTOCOL), task: "S07".into(), ..request }.encode_to_vec();
    let plan = plan::read(&bytes).unwrap();
    let scenes = Scenes::new(SceneConfig::default(), Robots::load().unwrap(), None);
    let gains = scenes.robot(plan.hands).gains(plan.gains);
    let built = scenes.get(plan.hands, plan.episode(0).scene(gains)).unwrap();
    let now = Duration::from_secs(100);
    let recorded = plan.recorded;
    let simulation = Simulation::new("lab", "1", plan, built, None);
    let info = simulation.info();
    let session = ServerSession::new(simulation, info, recorded, TIMEOUTS, now);
    Harness { session, now, sent: Vec::new() }
}

impl Harness {
    /// Gives an input; what is sent in answer is kept, and returned in short.
    fn give(&mut self, input: Input<u32>) -> Vec<Sent> {
        self.session.handle(input, self.now);
        self.sent = std::iter::from_fn(|| self.session.poll()).collect();
        self.sent.iter().map(short).collect()
    }

    fn act(&mut self, episode: u64, step: u64) -> Vec<Sent> {
        self.send(&Action { episode, step, action: vec![0.0; JOINTS], joint_target: vec![], chunk: None })
    }

    fn send(&mut self, action: &Action) -> Vec<Sent> {
        self.give(Input::Action(action.encode_to_vec().into()))
    }

    fn reset(&mut self, episode: u64) -> Vec<Sent> {
        self.give(Input::Reset(ResetRequest { episode }.encode_to_vec().into(), 1))
    }

    fn close(&mut self) -> Vec<Sent> {
        self.give(Input::Close(CloseRequest {}.encode_to_vec().into(), 2))
    }

    fn ack(&mut self, next_seq: u64) -> Vec<Sent> {
        self.give(Input::Ack(StepRecordAck { recorder: "r".into(), next_seq }.encode_to_vec().into()))
    }

    /// Lets time pass up to just before and then to the time that the session asked for.
    fn sleep(&mut self) -> Vec<Sent> {
        let at = self.session.wake_at().unwrap();
        self.now = at.saturating_sub(Duration::from_nanos(1)).max(self.now);
        assert_eq!(self.give(Input::Tick), [], "nothing is due before its time");
        self.now = at.max(self.now);
        self.give(Input::Tick)
    }

    /// What a recorder is sent that asks.
    fn records(&mut self, from_seq: u64, count: u64) -> Vec<Bytes> {
        self.give(Input::StepRecords(StepRecordRequest { from_seq, count }.encode_to_vec().into(), 3));
        match self.sent.pop() {
            Some(Output::Reply(3, "StepRecord", records)) => records,
            other => panic!("{other:?}"),
        }
    }

    fn record(&self) -> StepRecord {
        let mut records = self.sent.iter().filter_map(|output| match output {
            Output::StepRecord(bytes) => Some(StepRecord::decode(bytes.clone()).unwrap()),
            _ => None,
        });
        records.next_back().unwrap()
    }

    fn observed(&self) -> Observation {
        let mut observations = self.sent.iter().filter_map(|output| match output {
            Output::Observation(bytes) => Some(Observation::decode(bytes.clone()).unwrap()),
            _ => None,
        });
        observations.next_back().unwrap()
    }

    fn notice(&self) -> Notice {
        let mut notices = self.sent.iter().filter_map(|output| match output {
            Output::Notice(bytes) => Some(Notice::decode(bytes.clone()).unwrap()),
            _ => None,
        });
        notices.next_back().unwrap()
    }

    fn result(&self) -> EpisodeResult {
        self.record().result.unwrap()
    }

    fn reset_reply(&self) -> reset_reply::Reply {
        let reply = self.sent.iter().find_map(|output| match output {
            Output::Reply(1, "ResetReply", replies) => Some(replies[0].clone()),
            _ => None,
        });
        ResetReply::decode(reply.unwrap()).unwrap().reply.unwrap()
    }

    /// Runs to the end of an episode; returns its number of steps.
    fn finish(&mut self, episode: u64, from: u64) -> u64 {
        for step in from.. {
            self.act(episode, step);
            if self.record().result.is_some() {
                return step + 1;
            }
        }
        unreachable!()
    }
}

fn short(output: &Output<u32>) -> Sent {
    match output {
        Output::Observation(bytes) => Sent::Observation(Observation::decode(bytes.clone()).unwrap().step),
        Output::Notice(bytes) => Sent::Notice(Notice::decode(bytes.clone()).unwrap().code()),
        Output::StepRecord(bytes) => Sent::StepRecord(StepRecord::decode(bytes.clone()).unwrap().seq),
        Output::Reply(to, _, _) => Reply(*to),
        Output::Refuse(to, _) => Refused(*to),
        Output::Closed => Closed,
        Output::Done => Done,
    }
}

use Sent::{Closed, Done, Refused, Reply};

fn observation(step: u64) -> Sent {
    Sent::Observation(step)
}

fn record(seq: u64) -> Sent {
    Sent::StepRecord(seq)
}

fn notice_of(code: notice::Code) -> Sent {
    Sent::Notice(code)
}

#[test]
fn lockstep_answers_each_action_once() {
    let mut harness = harness(OpenRequest::default());
    assert_eq!(harness.reset(5), [Reply(1), record(0)]);
    let header = harness.record();
    assert_eq!(header.header.unwrap().episode, 5);
    assert!(header.scene == harness.session.host().built.shapes.to_vec());
    for step in 0..3 {
        assert_eq!(harness.act(5, step), [observation(step + 1), record(step + 1)]);
    }
    let recorded = harness.record();
    assert_eq!((recorded.step, State::decode(&*recorded.state).unwrap().step), (3, 3));
    assert_eq!(ActionRecord::decode(&*recorded.action).unwrap().action.unwrap().step, 2);
}

#[test]
fn the_action_before_the_present_one_brings_the_observation_again() {
    let mut harness = harness(OpenRequest::default());
    harness.reset(0);
    harness.act(0, 0);
    for _ in 0..3 {
        assert_eq!(harness.act(0, 0), [observation(1)]);
    }
    let last = harness.finish(0, 1);
    assert_eq!(harness.act(0, last - 1), [observation(last)], "after the end too");
    assert_eq!(harness.act(0, last), [notice_of(notice::Code::Step)]);
}

#[test]
fn wrong_actions_are_refused_and_recorded() {
    use notice::Code::{Malformed, Step, Value};
    let mut harness = harness(OpenRequest::default());
    assert_eq!(harness.act(0, 0), [notice_of(Step)], "no episode yet");
    harness.reset(3);
    let good = Action { episode: 3, step: 0, action: vec![0.0; JOINTS], joint_target: vec![], chunk: None };
    let nan = |mut numbers: Vec<f64>| {
        numbers[5] = f64::NAN;
        numbers
    };
    let zeros = || vec![0.0; JOINTS];
    let cases = [
        (Action { episode: 2, ..good.clone() }, Step, "episode"),
        (Action { step: 1, ..good.clone() }, Step, "step"),
        (Action { step: u64::MAX, ..good.clone() }, Step, "step"),
        (Action { action: vec![], ..good.clone() }, Value, "action"),
        (Action { joint_target: zeros(), ..good.clone() }, Value, "action"),
        (Action { action: vec![0.0; JOINTS - 1], ..good.clone() }, Value, "action"),
        (Action { action: nan(zeros()), ..good.clone() }, Value, "action"),
        (Action { action: vec![], joint_target: nan(zeros()), ..good.clone() }, Value, "joint_target"),
        (Action { action: vec![], joint_target: vec![f64::MAX; JOINTS], ..good.clone() }, Value, "joint_target"),
        (Action { action: vec![1e155; JOINTS], ..good.clone() }, Value, "action"),
        (Action { action: vec![-1000.1; JOINTS], ..good.clone() }, Value, "action"),
    ];
    let count = cases.len();
    for (action, code, field) in cases {
        harness.now += Duration::from_secs(1);
        assert_eq!(harness.send(&action), [notice_of(code)], "{field}");
        let notice = harness.notice();
        assert_eq!((notice.field.as_str(), notice.episode, notice.step), (field, 3, 0));
        assert!(!notice.message.is_empty() && !notice.remedy.is_empty());
    }
    assert_eq!(harness.give(Input::Action(vec![0xff; 9].into())), [notice_of(Malformed)]);
    assert_eq!(harness.send(&good), [observation(1), record(1)], "the server went on waiting");
    assert_eq!(harness.record().events.len(), count + 1);
    harness.send(&Action { step: 1, ..good });
    assert!(harness.record().events.is_empty());
}

/// Whatever is sent, the bag of the episode can be closed and read.
#[test]
fn the_wildest_actions_leave_a_whole_bag() {
    let mut harness = harness(OpenRequest::default());
    harness.reset(0);
    let first = harness.record();
    let path = std::env::temp_dir().join(format!("fiatlux-wild-{}.mcap", std::process::id()));
    let mut writer = BagWriter::create(&path, first.header.as_ref().unwrap()).unwrap();
    writer.push(&first).unwrap();
    let result = loop {
        let step = writer.next_step() - 1;
        let of_size = |size: f64| Action { step, action: vec![size; JOINTS], ..Action::default() };
        harness.now += Duration::from_secs(1);
        assert_eq!(harness.send(&of_size(1e155)), [notice_of(notice::Code::Value)]);
        let notice = harness.notice();
        assert!(notice.message.contains("is 1e155; it must be from -1000 to 1000"), "{}", notice.message);
        harness.send(&of_size(if step.is_multiple_of(2) { 1e3 } else { -1e3 }));
        let record = harness.record();
        writer.push(&record).unwrap();
        if let Some(result) = record.result {
            break result;
        }
    };
    assert_eq!(result.strict.as_ref().expect("played by strict").control_effort, JOINTS as f64 * 1e6);
    let path = writer.finish(&result).unwrap();
    let bag = Bag::open(&path).unwrap();
    assert_eq!((bag.completeness(), bag.result()), (&Completeness::Whole, Some(&result)));
    let layout = harness.session.host().built.scene.robot_layout();
    let rows: Vec<_> = bag.states().map(|state| read_row(&state.unwrap(), layout).unwrap()).collect();
    assert_eq!(rows.len() as u64, result.end.unwrap().steps + 1);
    std::fs::remove_file(path).unwrap();
}

#[test]
fn joint_targets_are_recorded_in_action_units() {
    let mut harness = harness(OpenRequest::default());
    harness.reset(0);
    let target = vec![0.1; JOINTS];
    harness.send(&Action { joint_target: target.clone(), ..Action::default() });
    let row = State::decode(&*harness.record().state).unwrap();
    let q0 = harness.session.host().built.scene.robot.q0().to_vec();
    for joint in 0..JOINTS {
        assert_eq!(row.action[joint], (target[joint] - q0[joint]) / 0.5, "{joint}");
    }
}

/// A delay of 40 ms is the actions of two steps before, and the staged posture until they come; none is what it always was.
#[test]
fn delayed_actions_act_later() {
    let action =
        |step: u64| -> Vec<f64> { (0..JOINTS).map(|joint| 0.02 * libm::sin(step as f64 + joint as f64)).collect() };
    let digest = |delay_ms: u32, action: &dyn Fn(u64) -> Vec<f64>| {
        let mut harness = harness(OpenRequest { action_delay_ms: delay_ms, ..OpenRequest::default() });
        harness.reset(0);
        let mut rows = Vec::new();
        for step in 0..12 {
            harness.send(&Action { step, action: action(step), ..Action::default() });
            let record = harness.record();
            let received = ActionRecord::decode(&*record.action).unwrap().action.unwrap();
            assert_eq!(received.action, action(step), "recorded as it arrived");
            rows.push(State::decode(&*record.state).unwrap().action);
        }
        let digest = harness.session.host().run.as_ref().unwrap().episode.digest().hex();
        (digest, rows)
    };
    let staged = {
        let mut harness = harness(OpenRequest::default());
        harness.reset(0);
        State::decode(&*harness.record().state).unwrap().action
    };
    let (shifted, rows) = digest(0, &|step| if step < 2 { staged.clone() } else { action(step - 2) });
    assert_eq!(digest(40, &action), (shifted, rows), "shifted by hand");
    assert_ne!(digest(40, &action).0, digest(0, &action).0);
}

/// The recorded actions in a session of the recorded request give the recorded rows, whatever delay there was.
#[test]
fn a_delayed_episode_plays_again_from_its_records() {
    let play = |request: OpenRequest, actions: &[Action]| -> (OpenRequest, Vec<Action>, Vec<Vec<u8>>) {
        let mut harness = harness(request);
        harness.reset(0);
        let header = harness.record().header.unwrap();
        let played = actions.iter().map(|action| {
            harness.send(action);
            let record = harness.record();
            (ActionRecord::decode(&*record.action).unwrap().action.unwrap(), record.state)
        });
        let (received, rows) = played.unzip();
        (header.request.unwrap(), received, rows)
    };
    let actions: Vec<Action> = (0..10)
        .map(|step| {
            let numbers: Vec<f64> =
                (0..JOINTS).map(|joint| 0.1 * libm::sin(0.7 * step as f64 + joint as f64)).collect();
            let (action, joint_target) = if step % 2 == 0 { (numbers, vec![]) } else { (vec![], numbers) };
            Action { step, action, joint_target, ..Action::default() }
        })
        .collect();
    let (request, received, rows) = play(OpenRequest { action_delay_ms: 100, ..OpenRequest::default() }, &actions);
    assert_eq!(request.action_delay_ms, 100);
    assert_eq!(play(request, &received).2, rows);
}

#[test]
fn a_flood_gets_a_bounded_answer_and_a_bounded_record() {
    let mut harness = harness(OpenRequest::default());
    harness.reset(0);
    let answers: usize = (0..1000).map(|_| harness.act(9, 9).len()).sum();
    assert_eq!(answers, limits::MAX_NOTICES_PER_S as usize);
    assert_eq!(harness.sleep(), [notice_of(notice::Code::Step)]);
    assert_eq!(harness.notice().count, 1000 - u64::from(limits::MAX_NOTICES_PER_S));
    harness.act(0, 0);
    assert_eq!(harness.record().events.len(), MAX_EVENTS + 1);
    assert_eq!(harness.give(Input::Dropped(40)), [notice_of(notice::Code::Rate)]);
    assert_eq!(harness.notice().count, 40);
    assert_eq!(harness.give(Input::TooLarge(1 << 20)), [notice_of(notice::Code::Size)]);
}

/// A client that adds up the counts of its notices knows of every message that was refused, and why the session is closed.
#[test]
fn the_notices_of_a_flood_add_up() {
    let mut harness = harness(OpenRequest::default());
    harness.reset(0);
    let mut counted = 0;
    let mut count = |harness: &Harness| counted += harness.notice().count;
    for _ in 0..50 {
        if !harness.act(9, 9).is_empty() {
            count(&harness);
        }
    }
    harness.give(Input::Dropped(40));
    harness.give(Input::Terminate("the server shuts down"));
    assert!(harness.notice().message.contains("the server shuts down"), "{:?}", harness.notice());
    count(&harness);
    assert_eq!(counted, 50 + 40 + 1);
}

#[test]
fn resets() {
    let mut harness = harness(OpenRequest::default());
    harness.reset(0);
    let first = harness.reset_reply();
    assert_eq!(harness.reset(0), [Reply(1)], "the same observation again");
    assert_eq!(harness.reset_reply(), first);
    harness.act(0, 0);
    assert_eq!(harness.reset(1), [record(2), Reply(1), record(3)], "abort, then row 0");
    harness.act(1, 0);
    assert_eq!(harness.reset(1).len(), 3, "a running episode starts over");
    assert_eq!(harness.act(0, 1), [notice_of(notice::Code::Step)], "of the episode before");
    let steps = harness.finish(1, 0);
    assert_eq!(harness.result().end.unwrap().steps, steps);
    assert_eq!(harness.reset(2).len(), 2, "an episode that has ended is not aborted");
    harness.give(Input::Reset(vec![0xff; 3].into(), 1));
    assert!(matches!(harness.reset_reply(), reset_reply::Reply::Refusal(_)));
}

#[test]
fn the_last_observation_says_how_it_ended() {
    let mut harness = harness(OpenRequest::default());
    harness.reset(0);
    let steps = harness.finish(0, 0);
    let end = harness.result().end.unwrap();
    assert_eq!((end.cause.as_str(), end.steps, end.success), ("fall", steps, false));
    let seen = Observation::decode(&*harness.record().observation).unwrap();
    assert_eq!(seen.end, Some(end));
    assert_eq!(harness.give(Input::Observation(4)), [Reply(4)]);
}

#[test]
fn closing_aborts_and_drains() {
    let mut harness = harness(OpenRequest::default());
    assert_eq!(harness.give(Input::Observation(4)), [Refused(4)]);
    harness.reset(0);
    harness.act(0, 0);
    assert_eq!(harness.close(), [record(2), Closed, Reply(2)]);
    let aborted = harness.record();
    assert!(aborted.state.is_empty());
    assert_eq!((harness.result().end.unwrap().cause.as_str(), aborted.step), ("aborted", 1));
    assert_eq!(harness.close(), [Reply(2)]);
    harness.reset(1);
    assert!(matches!(harness.reset_reply(), reset_reply::Reply::Refusal(r) if r.code() == Code::Closed));
    assert_eq!(harness.act(0, 1), [notice_of(notice::Code::Step)]);
    let request = StepRecordRequest { from_seq: 1, count: 9 };
    assert_eq!(harness.give(Input::StepRecords(request.encode_to_vec().into(), 3)), [Reply(3)]);
    assert_eq!(harness.ack(2), []);
    assert_eq!(harness.ack(3), [Done], "all is acknowledged");
    assert_eq!(harness.session.wake_at(), None);
}

#[test]
fn a_closed_session_does_not_wait_for_ever() {
    let mut harness = harness(OpenRequest::default());
    harness.reset(0);
    harness.close();
    harness.now += 3000 * MS;
    harness.ack(1);
    assert_eq!(harness.session.wake_at(), Some(harness.now + TIMEOUTS.recorder));
    assert_eq!(harness.sleep(), [Done]);
}

#[test]
fn a_client_without_a_token_is_let_go() {
    let mut harness = harness(OpenRequest::default());
    harness.reset(0);
    harness.give(Input::ClientGone);
    harness.now += TIMEOUTS.grace - MS;
    assert_eq!(harness.give(Input::ClientSeen), [], "it came back in time");
    assert_eq!(harness.act(0, 0), [observation(1), record(1)], "and goes on where it was");
    harness.give(Input::ClientGone);
    assert_eq!(harness.sleep(), [notice_of(notice::Code::Lost), record(2), Closed]);

    let mut never = without_client(OpenRequest::default());
    assert_eq!(never.sleep(), [notice_of(notice::Code::Lost), Closed, Done], "nor one that never came");
}

#[test]
fn a_silent_client_is_let_go() {
    let mut harness = harness(OpenRequest::default());
    harness.reset(0);
    harness.now += TIMEOUTS.action - MS;
    harness.act(0, 0);
    let since = harness.now;
    harness.now += 1000 * MS;
    // Neither of these is an action that the server waits for.
    harness.act(0, 0);
    harness.act(0, 7);
    assert_eq!(harness.session.wake_at(), Some(since + TIMEOUTS.action));
    assert_eq!(harness.sleep(), [notice_of(notice::Code::Lost), record(2), Closed]);
}

#[test]
fn lockstep_waits_for_its_recorder() {
    let window = limits::RECORDING_WINDOW;
    let ends = vec!["time-out".to_owned()];
    let mut harness = harness(OpenRequest { recorded: true, end_on: ends, ..OpenRequest::default() });
    harness.reset(0);
    for step in 0..window - 1 {
        assert_eq!(harness.act(0, step).len(), 2, "{step}");
    }
    let next = window - 1;
    assert_eq!(harness.act(0, next), [], "512 rows are not on disk");
    assert_eq!(harness.act(0, next), [], "asked again, it still waits");
    harness.now += 5000 * MS;
    assert_eq!(harness.ack(1), [observation(next + 1), record(next + 1)]);
    assert_eq!(harness.act(0, next + 1), []);
    // The recorder is silent: the session goes on without it, and says so.
    assert_eq!(harness.sleep(), [notice_of(notice::Code::Lost), observation(next + 2), record(next + 2)]);
    assert_eq!(harness.record().events.len(), 1);
    assert_eq!(harness.act(0, next + 2).len(), 2, "no wait without a recorder");
    let mut first_from = |from_seq| harness.records(from_seq, 1);
    assert!(first_from(0) == first_from(3) && first_from(3) != first_from(4), "0 to 2 are lost");
    harness.ack(3);
    assert_eq!(harness.act(0, next + 3), [], "it is back, and the window is full");
    assert_eq!(harness.reset(1), [], "a reset waits too");
    assert_eq!(harness.ack(10), [record(next + 4), Reply(1), record(next + 5)]);
}

#[test]
fn without_a_recorder_nothing_waits() {
    let ends = vec!["time-out".to_owned()];
    let mut harness = harness(OpenRequest { end_on: ends, ..OpenRequest::default() });
    harness.reset(0);
    for step in 0..limits::RECORDING_WINDOW + 5 {
        assert_eq!(harness.act(0, step).len(), 2, "{step}");
    }
}

#[test]
fn shutdown_aborts() {
    let mut harness = harness(OpenRequest::default());
    harness.reset(0);
    assert!(!harness.session.is_settled());
    assert_eq!(
        harness.give(Input::Terminate("the server shuts down")),
        [notice_of(notice::Code::Lost), record(1), Closed]
    );
    assert!(harness.session.is_settled(), "nobody records it");
}

#[test]
fn real_time_steps_by_the_clock() {
    let mut harness = harness(OpenRequest { mode: 2, ..OpenRequest::default() });
    harness.reset(0);
    assert_eq!(harness.act(0, 0), [observation(1), record(1)], "the first action starts the clock");
    assert_eq!(harness.session.wake_at(), Some(harness.now + 20 * MS));
    assert_eq!(harness.sleep(), [observation(2), record(2)]);
    let taken = |harness: &Harness| ActionRecord::decode(&*harness.record().action).unwrap();
    assert!(taken(&harness).held);
    harness.now += 5 * MS;
    assert_eq!(harness.act(0, 1), [notice_of(notice::Code::Step)], "late");
    assert_eq!(harness.act(0, 52), [notice_of(notice::Code::Step)], "more than a second ahead");
    assert_eq!(harness.act(0, 2), []);
    harness.now += 15 * MS;
    assert_eq!(harness.give(Input::Tick), [observation(3), record(3)]);
    assert_eq!((taken(&harness).held, taken(&harness).lateness_s), (false, 0.005));
    // A server that cannot keep up goes on from now.
    harness.now += 95 * MS;
    let sent = harness.give(Input::Tick);
    assert_eq!(sent, [notice_of(notice::Code::Late), observation(4), record(4)]);
    assert_eq!(harness.session.wake_at(), Some(harness.now + 20 * MS));
    harness.close();
    assert_eq!(harness.result().missed_steps, 2);
}

fn look(harness: &mut Harness, episode: u64, step: u64, sensors: &[&str]) -> look_reply::Reply {
    let sensors = sensors.iter().map(|name| (*name).to_owned()).collect();
    let bytes = LookRequest { episode, step, sensors }.encode_to_vec();
    assert_eq!(harness.give(Input::Look(bytes.into(), 9)), [Reply(9)]);
    let Some(Output::Reply(9, "LookReply", replies)) = harness.sent.last() else { panic!("{:?}", harness.sent.last()) };
    LookReply::decode(replies[0].clone()).unwrap().reply.unwrap()
}

#[test]
fn a_look_shows_the_present_step() {
    let on_request = |name: &str| Sensor { on_request: true, ..Sensor::from(name) };
    let sensors = vec![on_request("camera"), on_request("privileged"), Sensor::from("last_action")];
    let mut harness = harness(OpenRequest { sensors, image_width: 32, image_height: 16, ..OpenRequest::default() });
    harness.reset(0);
    harness.act(0, 0);
    let recorded = Observation::decode(harness.record().observation.as_slice()).unwrap();
    let look_reply::Reply::Observation(seen) = look(&mut harness, 0, 1, &["camera"]) else { panic!("refused") };
    assert_eq!((seen.episode, seen.step), (0, 1));
    assert_eq!(seen.camera.map(|image| image.rgb.len()), Some(3 * 32 * 16));
    assert_eq!((seen.privileged, seen.last_action.len()), (None, 0), "not asked for");
    // The bag has the last action alone: the others are only looked at.
    assert_eq!((recorded.camera, recorded.last_action.len()), (None, JOINTS));

    let refused = |harness: &mut Harness, episode, step, sensor| match look(harness, episode, step, &[sensor]) {
        look_reply::Reply::Refusal(refusal) => refusal,
        look_reply::Reply::Observation(_) => panic!("not refused"),
    };
    for (episode, step, sensor, field, message) in [
        (0, 0, "camera", "step", "step 0 is not the present one, 1"),
        (0, 2, "camera", "step", "step 2"),
        (1, 1, "camera", "episode", "episode 1"),
        (0, 1, "lidar", "sensors", "no sensor 'lidar' but last_action, camera, privileged"),
        (0, 1, "smell", "sensors", "no sensor 'smell'"),
    ] {
        let refusal = refused(&mut harness, episode, step, sensor);
        assert_eq!(refusal.field, field);
        assert!(refusal.message.contains(message), "{refusal:?}");
    }
    harness.close();
    assert_eq!(refused(&mut harness, 0, 1, "camera").code(), Code::Closed);
}

/// Large sensors are in the bag at the rate that was asked for, apart from the observation; small ones as published.
#[test]
fn bags_have_large_sensors_at_their_own_rate() {
    let camera = Sensor { rate_hz: 10.0, recorded: true, record_hz: 25.0, ..Sensor::from("camera") };
    let lidar = Sensor { rate_hz: 25.0, ..Sensor::from("lidar") };
    let sensors = vec![camera, lidar, Sensor::from("proprioception")];
    let asked = OpenRequest { sensors, image_width: 16, image_height: 16, recorded: true, ..OpenRequest::default() };
    let mut unrecorded = harness(OpenRequest { recorded: false, ..asked.clone() });
    unrecorded.reset(0);
    assert!(unrecorded.record().camera.is_empty(), "nobody would take it");
    let mut harness = harness(asked);
    harness.reset(0);
    for step in 0..7 {
        let row = harness.record();
        let published = if step == 0 {
            let reset_reply::Reply::Observation(first) = harness.reset_reply() else { panic!("refused") };
            first
        } else {
            harness.observed()
        };
        assert_eq!((row.step, published.step), (step, step));
        assert_eq!(published.camera.is_some(), step % 5 == 0, "{step}");
        assert_eq!(published.lidar.is_empty(), step % 2 == 1, "{step}");
        assert_eq!(row.camera.is_empty(), step % 2 == 1, "{step}");
        assert!(row.lidar.is_empty(), "not recorded");
        let recorded = Observation::decode(row.observation.as_slice()).unwrap();
        assert_eq!(recorded, Observation { camera: None, lidar: Vec::new(), ..published });
        harness.act(0, step);
    }
}

/// The robot of a session follows from the hands that were asked for; what stands still is told with it.
#[test]
fn a_session_says_which_robot_and_room_it_has() {
    for (hands, joints, bodies) in [("", 53, 34), ("inspire", 53, 34), ("bare", 29, 10)] {
        let harness = without_client(OpenRequest { hands: hands.into(), ..OpenRequest::default() });
        let info = harness.session.info();
        assert_eq!((info.joints.len(), info.hand_bodies.len()), (joints, bodies), "hands '{hands}'");
        let names: Vec<&str> = info.footprints.iter().map(|footprint| footprint.name.as_str()).collect();
        for name in ["bench", "crate", "fixture", "wall_west"] {
            assert!(names.contains(&name), "{name} in {names:?}");
        }
        for footprint in &info.footprints {
            assert!(footprint.outline.len() == 8 && footprint.bottom < footprint.top, "{footprint:?}");
        }
    }
}
