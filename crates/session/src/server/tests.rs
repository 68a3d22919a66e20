//! Tests what the machine adds to its host; `sim-server` tests the rules of the protocol over real episodes.

use std::cell::Cell;
use std::rc::Rc;

use fiatlux_proto::v3::{Action, ActionRecord, EpisodeEnd, EpisodeResult, Joint};

use super::*;
use crate::command::{Command, CommandError};

const NOW: Duration = Duration::from_secs(100);

/// A host that counts steps instead of simulating.
#[derive(Debug, Default)]
struct Counter {
    present: Observation,
    records: Rc<Cell<u64>>,
    fails_to_step: bool,
    fails_to_record: bool,
}

fn failure(what: &str) -> Refusal {
    Refusal::new(RefusalCode::Start, "", what)
}

impl Host for Counter {
    fn stage(&mut self, episode: u64) -> Result<&Observation, Refusal> {
        self.present = Observation { episode, ..Observation::default() };
        Ok(&self.present)
    }

    fn step(&mut self, command: &Command) -> Result<&Observation, Refusal> {
        assert_eq!(*command, Command::JointTarget(vec![0.5, -0.5]));
        if self.fails_to_step {
            return Err(failure("the ladder is gone"));
        }
        self.present.step += 1;
        Ok(&self.present)
    }

    fn look(&mut self, _sensors: &[String]) -> Result<Observation, Refusal> {
        Ok(self.present.clone())
    }

    fn record(&mut self, action: Option<ActionRecord>, large: bool) -> Result<StepRecord, Refusal> {
        assert!(!large, "nobody records");
        if self.fails_to_record && action.is_some() {
            return Err(failure("the camera is blind"));
        }
        self.records.set(self.records.get() + 1);
        Ok(StepRecord { step: self.present.step, events: vec![b"the host's".into()], ..StepRecord::default() })
    }

    fn cut_short(&self, cause: &str, _: &str) -> EpisodeResult {
        let end = Some(EpisodeEnd { cause: cause.into(), ..EpisodeEnd::default() });
        EpisodeResult { total_reward: 2.5, end, ..EpisodeResult::default() }
    }
}

/// A session with a running episode 0.
fn running(host: Counter) -> ServerSession<Counter, ()> {
    let info = SessionInfo {
        joints: vec![Joint { name: "knee".into(), ..Joint::default() }; 2],
        action_scale: 0.5,
        action_limit: 1e3,
        control_dt: 0.02,
        ..SessionInfo::default()
    };
    let mut session = ServerSession::new(host, info, false, Timeouts::default(), NOW);
    session.handle(Input::ClientSeen, NOW);
    session.handle(Input::Reset(Bytes::new(), ()), NOW);
    let staged = outputs(&mut session);
    assert!(matches!(staged[..], [Output::Reply((), "ResetReply", _), Output::StepRecord(_)]), "{staged:?}");
    session
}

fn outputs(session: &mut ServerSession<Counter, ()>) -> Vec<Output<()>> {
    std::iter::from_fn(|| session.poll()).collect()
}

fn act(session: &mut ServerSession<Counter, ()>, step: u64, target: Vec<f64>) {
    let action = Action { step, joint_target: target, ..Action::default() };
    session.handle(Input::Action(action.encode_to_vec().into()), NOW);
}

#[test]
fn a_row_is_recorded_after_its_observation_is_out() {
    let host = Counter::default();
    let records = Rc::clone(&host.records);
    let mut session = running(host);
    act(&mut session, 7, vec![0.5, -0.5]);
    assert!(matches!(outputs(&mut session)[..], [Output::Notice(_)]));
    act(&mut session, 0, vec![0.5, -0.5]);
    assert!(matches!(session.poll(), Some(Output::Observation(_))));
    assert_eq!(records.get(), 1, "only row 0");
    let Some(Output::StepRecord(bytes)) = session.poll() else { panic!("no record") };
    let record = StepRecord::decode(bytes).expect("a record");
    assert_eq!((records.get(), record.seq, record.step, record.events.len()), (2, 1, 1, 2));
    assert_eq!(Event::decode(record.events[0].as_slice()).map(|event| event.kind), Ok("refused".into()));
    assert_eq!(record.events[1], b"the host's");
    // It is not lost either if nobody polls in between.
    act(&mut session, 1, vec![0.5, -0.5]);
    session.handle(Input::Terminate("the test ends"), NOW);
    let found = outputs(&mut session);
    let [Output::Observation(_), Output::StepRecord(row), Output::Notice(_), Output::StepRecord(end), Output::Closed] =
        &found[..]
    else {
        panic!("{found:?}")
    };
    let seq = |bytes: &Bytes| StepRecord::decode(bytes.clone()).expect("a record").seq;
    assert_eq!((seq(row), seq(end)), (2, 3));
    let result = StepRecord::decode(end.clone()).expect("a record").result.expect("a result");
    assert_eq!(result.total_reward, 2.5);
}

#[test]
fn a_host_that_fails_closes_its_session() {
    let mut session = running(Counter { fails_to_step: true, ..Counter::default() });
    act(&mut session, 0, vec![0.5, -0.5]);
    let found = outputs(&mut session);
    assert!(matches!(found[..], [Output::Notice(_), Output::StepRecord(_), Output::Closed]), "{found:?}");

    let mut session = running(Counter { fails_to_record: true, ..Counter::default() });
    act(&mut session, 0, vec![0.5, -0.5]);
    let found = outputs(&mut session);
    let [Output::Observation(_), Output::Notice(notice), Output::StepRecord(_), Output::Closed] = &found[..] else {
        panic!("{found:?}")
    };
    let message = Notice::decode(notice.clone()).expect("a notice").message;
    assert_eq!(message, "the session is closed: the camera is blind");
    assert!(session.wake_at().is_some(), "it waits for a recorder");
}

/// Guards a joint target that is finite, but beyond the range of an action.
#[test]
fn a_target_that_is_no_action_does_not_reach_the_host() {
    let mut session = running(Counter::default());
    for value in [f64::MAX, 1e155, -500.01] {
        act(&mut session, 0, vec![0.5, value]);
        let found = outputs(&mut session);
        let [Output::Notice(notice)] = &found[..] else { panic!("{value}: {found:?}") };
        let notice = Notice::decode(notice.clone()).expect("a notice");
        assert_eq!((notice.code(), notice.field.as_str()), (NoticeCode::Value, "joint_target"));
        let said = format!("joint_target of joint 'knee' is {value:?}; it must be from -500 to 500");
        assert_eq!(notice.message, said);
        assert_eq!(notice.remedy, "clip joint targets to the limits of the joints");
    }
    act(&mut session, 0, vec![0.5, -0.5]);
    assert!(
        matches!(outputs(&mut session)[..], [Output::Observation(_), Output::StepRecord(_)]),
        "the episode goes on"
    );
}

/// Guards the bounds of both forms from both sides, and a session without a bound.
#[test]
fn commands_have_a_bound() {
    let joint = Joint { name: "knee".into(), q0: 0.25, ..Joint::default() };
    let info = SessionInfo { joints: vec![joint], action_scale: 0.5, action_limit: 1e3, ..SessionInfo::default() };
    let action = |number| Command::Action(vec![number]).check(&info);
    let target = |number| Command::JointTarget(vec![number]).check(&info);
    assert_eq!([action(1e3), action(-1e3), target(500.25), target(-499.75)], [Ok(()), Ok(()), Ok(()), Ok(())]);
    for number in [1000.1, -1000.1, 1e155, f64::MAX] {
        let error = action(number).expect_err("too large");
        assert_eq!(error.to_string(), format!("action of joint 'knee' is {number:?}; it must be from -1000 to 1000"));
        assert_eq!((error.field(), error.remedy()), ("action", "clip the action, whose usual range is [-1, 1]"));
    }
    for number in [500.3, -499.8] {
        let error = target(number).expect_err("too large").to_string();
        assert_eq!(error, format!("joint_target of joint 'knee' is {number:?}; it must be from -499.75 to 500.25"));
    }
    assert!(matches!(action(f64::NAN), Err(CommandError::NotFinite { .. })));
    let unbounded = SessionInfo { action_limit: 0.0, ..info.clone() };
    assert_eq!(Command::Action(vec![1e155]).check(&unbounded), Ok(()));
    let error = Command::JointTarget(vec![f64::MAX]).check(&unbounded);
    assert!(matches!(error, Err(CommandError::NotFinite { .. })));
}

/// Guards that a take with a step is `stopped` where its client ends it, and `aborted` where the client is gone, as other episodes are.
#[test]
fn only_a_take_can_be_stopped() {
    let cause_after = |steps: u64, take: bool, input: Input<()>, later: Duration| {
        let mut session = running(Counter::default());
        session.info.take = take;
        (0..steps).for_each(|step| act(&mut session, step, vec![0.5, -0.5]));
        while session.poll().is_some() {}
        session.handle(input, NOW + later);
        let mut found = None;
        while let Some(output) = session.poll() {
            if let Output::StepRecord(bytes) = output {
                let record = StepRecord::decode(bytes).expect("a record");
                found = found.or(record.result.and_then(|result| result.end).map(|end| end.cause));
            }
        }
        found.expect("an end")
    };
    let cause = |take, input, later| cause_after(1, take, input, later);
    let reset = || Input::Reset(ResetRequest { episode: 1 }.encode_to_vec().into(), ());
    let close = || Input::Close(CloseRequest {}.encode_to_vec().into(), ());
    assert_eq!(cause(true, reset(), Duration::ZERO), STOPPED);
    assert_eq!(cause(true, close(), Duration::ZERO), STOPPED);
    assert_eq!(cause(false, close(), Duration::ZERO), ABORTED);
    assert_eq!(cause_after(0, true, close(), Duration::ZERO), ABORTED, "a take of no step");
    assert_eq!(cause(true, Input::Terminate("the server shuts down"), Duration::ZERO), ABORTED);
    assert_eq!(cause(true, Input::Tick, Duration::from_secs(3600)), ABORTED);
}

/// Guards a client on a busy machine, whose token comes later than the grace time of its server.
#[test]
fn a_new_session_waits_for_its_client_as_long_as_for_its_claim() {
    let (ms, grace) = (Duration::from_millis, Duration::from_millis(500));
    let timeouts = Timeouts { grace, ..Timeouts::default() };
    let ends_after = |seen: bool| {
        let mut session: ServerSession<Counter, ()> =
            ServerSession::new(Counter::default(), SessionInfo::default(), false, timeouts, NOW);
        if seen {
            session.handle(Input::ClientSeen, NOW + ms(4_999));
            session.handle(Input::ClientGone, NOW + ms(6_000));
        }
        session.wake_at().map(|at| at - NOW)
    };
    assert_eq!((ends_after(false), ends_after(true)), (Some(ms(5_000)), Some(ms(6_500))));
    let patient = Timeouts { grace: ms(9_000), ..timeouts };
    let session: ServerSession<Counter, ()> =
        ServerSession::new(Counter::default(), SessionInfo::default(), false, patient, NOW);
    assert_eq!(session.wake_at(), Some(NOW + ms(9_000)));
}

/// Guards an episode of a policy that thinks for long: in lockstep it goes on as long as its client is there, up to the limit that
/// the session states. A client that is gone ends it after the grace time, and in real time nobody is waited for.
#[test]
fn in_lockstep_a_slow_answer_ends_nothing() {
    let is_open = |session: &mut ServerSession<Counter, ()>, later: u64| {
        session.handle(Input::Tick, NOW + Duration::from_secs(later));
        outputs(session);
        session.phase == Phase::Open
    };
    let mut session = running(Counter::default());
    assert_eq!(session.info().action_timeout_s, 600.0);
    assert!(is_open(&mut session, 599), "its client is there");
    act(&mut session, 0, vec![0.5, -0.5]);
    assert!(matches!(outputs(&mut session)[..], [Output::Observation(_), Output::StepRecord(_)]), "and acts at last");
    assert_eq!(session.wake_at(), Some(NOW + Duration::from_secs(600)));
    assert!(!is_open(&mut session, 600), "but its place is not kept for ever");

    let mut session = running(Counter::default());
    session.handle(Input::ClientGone, NOW + Duration::from_secs(300));
    assert!(is_open(&mut session, 309) && !is_open(&mut session, 310), "the grace time of a client that is gone");

    let mut session = running(Counter::default());
    session.timeouts.lockstep = Duration::MAX;
    assert!(is_open(&mut session, 1 << 40), "in one process nobody else needs the place");

    let mut session = running(Counter::default());
    session.info.mode = Mode::RealTime.into();
    assert!(is_open(&mut session, 59) && !is_open(&mut session, 60));
}
