//! Each rule of the protocol as inputs and what comes out, at times that the test chooses.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use fiatlux_proto::PROTOCOL;
use fiatlux_proto::v3::{
    Action, ActionRecord, EpisodeResult, LookReply, LookRequest, OpenRequest, ResetReply, Sensor, State, StepRecord,
    StepRecordAck, StepRecordRequest, look_reply, notice, refusal, reset_reply,
};
use fiatlux_robot::Robot;

use fiatlux_world::SceneConfig;

use super::*;
use crate::server::plan;
use crate::server::scenes::Scenes;

/// The G1 with Inspire hands.
const JOINTS: usize = 53;

const MS: Duration = Duration::from_millis(1);
const TIMES: Times = Times {
    grace: Duration::from_secs(10),
    action_timeout: Duration::from_secs(60),
    resend: Duration::from_millis(100),
    recorder_timeout: Duration::from_secs(10),
};

/// A session at a desk: what it says is kept, and time is what the test says.
struct Desk {
    session: Session<u32>,
    now: Duration,
    said: Vec<Output<u32>>,
}

#[derive(Debug, PartialEq)]
enum Said {
    Observation(u64),
    Notice(notice::Code),
    StepRecord(u64),
    Reply(u32),
    Refused(u32),
    Closed,
    Done,
}

fn desk(request: OpenRequest) -> Desk {
    let bytes = OpenRequest { protocol: Some(PROTOCOL), task: "S07".into(), ..request }.encode_to_vec();
    let plan = plan::read(&bytes).unwrap();
    let robot = Arc::new(Robot::g1_inspire().unwrap());
    let scenes = Scenes::new(SceneConfig::default(), robot, None);
    let gains = scenes.robot().gains(plan.gains);
    let built = scenes.get(plan.episode(0).scene(gains)).unwrap();
    let now = Duration::from_secs(100);
    let mut session = Session::new("lab", "1", plan, TIMES, built, None, now);
    session.handle(Input::ClientSeen, now, &mut |_| ());
    Desk { session, now, said: Vec::new() }
}

impl Desk {
    /// Gives an input; what is said in answer is kept in short.
    fn give(&mut self, input: Input<u32>) -> Vec<Said> {
        self.said.clear();
        let said = &mut self.said;
        self.session.handle(input, self.now, &mut |output| said.push(output));
        self.said.iter().map(short).collect()
    }

    fn act(&mut self, episode: u64, step: u64) -> Vec<Said> {
        self.send(&Action { episode, step, action: vec![0.0; JOINTS], joint_target: vec![] })
    }

    fn send(&mut self, action: &Action) -> Vec<Said> {
        self.give(Input::Action(action.encode_to_vec().into()))
    }

    fn reset(&mut self, episode: u64) -> Vec<Said> {
        self.give(Input::Reset(ResetRequest { episode }.encode_to_vec().into(), 1))
    }

    fn close(&mut self) -> Vec<Said> {
        self.give(Input::Close(CloseRequest {}.encode_to_vec().into(), 2))
    }

    fn ack(&mut self, next_seq: u64) -> Vec<Said> {
        self.give(Input::Ack(StepRecordAck { recorder: "r".into(), next_seq }.encode_to_vec().into()))
    }

    /// Lets time pass up to just before and then to the time that the session asked for.
    fn sleep(&mut self) -> Vec<Said> {
        let at = self.session.wake_at().unwrap();
        self.now = at.saturating_sub(Duration::from_nanos(1)).max(self.now);
        assert_eq!(self.give(Input::Tick), [], "nothing is due before its time");
        self.now = at.max(self.now);
        self.give(Input::Tick)
    }

    fn truth(&self) -> StepRecord {
        let mut truths = self.said.iter().filter_map(|output| match output {
            Output::StepRecord(bytes) => Some(StepRecord::decode(&*bytes.to_bytes()).unwrap()),
            _ => None,
        });
        truths.next_back().unwrap()
    }

    fn observed(&self) -> Observation {
        let mut observations = self.said.iter().filter_map(|output| match output {
            Output::Observation(bytes) => Some(Observation::decode(&*bytes.to_bytes()).unwrap()),
            _ => None,
        });
        observations.next_back().unwrap()
    }

    fn notice(&self) -> Notice {
        let mut notices = self.said.iter().filter_map(|output| match output {
            Output::Notice(bytes) => Some(Notice::decode(&*bytes.to_bytes()).unwrap()),
            _ => None,
        });
        notices.next_back().unwrap()
    }

    fn result(&self) -> EpisodeResult {
        self.truth().result.unwrap()
    }

    fn reset_reply(&self) -> reset_reply::Reply {
        let reply = self.said.iter().find_map(|output| match output {
            Output::Reply(1, "ResetReply", replies) => Some(replies[0].to_bytes().into_owned()),
            _ => None,
        });
        ResetReply::decode(&*reply.unwrap()).unwrap().reply.unwrap()
    }

    /// Runs to the end of an episode; returns its number of steps.
    fn finish(&mut self, episode: u64, from: u64) -> u64 {
        for step in from.. {
            self.act(episode, step);
            if self.truth().result.is_some() {
                return step + 1;
            }
        }
        unreachable!()
    }
}

fn short(output: &Output<u32>) -> Said {
    match output {
        Output::Observation(bytes) => Said::Observation(Observation::decode(&*bytes.to_bytes()).unwrap().step),
        Output::Notice(bytes) => Said::Notice(Notice::decode(&*bytes.to_bytes()).unwrap().code()),
        Output::StepRecord(bytes) => Said::StepRecord(StepRecord::decode(&*bytes.to_bytes()).unwrap().seq),
        Output::Reply(to, _, _) => Reply(*to),
        Output::Refuse(to, _) => Refused(*to),
        Output::Closed => Closed,
        Output::Done => Done,
    }
}

use Said::{Closed, Done, Refused, Reply};

fn observation(step: u64) -> Said {
    Said::Observation(step)
}

fn truth(seq: u64) -> Said {
    Said::StepRecord(seq)
}

fn notice_of(code: notice::Code) -> Said {
    Said::Notice(code)
}

#[test]
fn lockstep_answers_each_action_once() {
    let mut desk = desk(OpenRequest::default());
    assert_eq!(desk.reset(5), [Reply(1), truth(0)]);
    let header = desk.truth();
    assert_eq!(header.header.unwrap().episode, 5);
    assert!(header.scene == desk.session.built.shapes.to_vec());
    for step in 0..3 {
        assert_eq!(desk.act(5, step), [observation(step + 1), truth(step + 1)]);
    }
    let recorded = desk.truth();
    assert_eq!((recorded.step, State::decode(&*recorded.state).unwrap().step), (3, 3));
    assert_eq!(ActionRecord::decode(&*recorded.action).unwrap().action.unwrap().step, 2);
}

#[test]
fn the_action_before_the_present_one_brings_the_observation_again() {
    let mut desk = desk(OpenRequest::default());
    desk.reset(0);
    desk.act(0, 0);
    for _ in 0..3 {
        assert_eq!(desk.act(0, 0), [observation(1)]);
    }
    let last = desk.finish(0, 1);
    assert_eq!(desk.act(0, last - 1), [observation(last)], "after the end too");
    assert_eq!(desk.act(0, last), [notice_of(notice::Code::Step)]);
}

#[test]
fn wrong_actions_are_refused_and_recorded() {
    use notice::Code::{Malformed, Step, Value};
    let mut desk = desk(OpenRequest::default());
    assert_eq!(desk.act(0, 0), [notice_of(Step)], "no episode yet");
    desk.reset(3);
    let good = Action { episode: 3, step: 0, action: vec![0.0; JOINTS], joint_target: vec![] };
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
    ];
    let count = cases.len();
    for (action, code, field) in cases {
        desk.now += Duration::from_secs(1);
        assert_eq!(desk.send(&action), [notice_of(code)], "{field}");
        let notice = desk.notice();
        assert_eq!((notice.field.as_str(), notice.episode, notice.step), (field, 3, 0));
        assert!(!notice.message.is_empty() && !notice.remedy.is_empty());
    }
    assert_eq!(desk.give(Input::Action(vec![0xff; 9].into())), [notice_of(Malformed)]);
    assert_eq!(desk.send(&good), [observation(1), truth(1)], "the server went on waiting");
    assert_eq!(desk.truth().events.len(), count + 1);
    desk.send(&Action { step: 1, ..good });
    assert!(desk.truth().events.is_empty());
}

#[test]
fn joint_targets_are_recorded_in_action_units() {
    let mut desk = desk(OpenRequest::default());
    desk.reset(0);
    let target = vec![0.1; JOINTS];
    desk.send(&Action { joint_target: target.clone(), ..Action::default() });
    let row = State::decode(&*desk.truth().state).unwrap();
    let q0 = desk.session.built.scene.robot.q0().to_vec();
    for joint in 0..JOINTS {
        assert_eq!(row.action[joint], (target[joint] - q0[joint]) / 0.5, "{joint}");
    }
}

#[test]
fn a_flood_gets_a_bounded_answer_and_a_bounded_record() {
    let mut desk = desk(OpenRequest::default());
    desk.reset(0);
    let answers: usize = (0..1000).map(|_| desk.act(9, 9).len()).sum();
    assert_eq!(answers, limits::MAX_NOTICES_PER_S as usize);
    assert_eq!(desk.sleep(), [notice_of(notice::Code::Step)]);
    assert_eq!(desk.notice().count, 1000 - u64::from(limits::MAX_NOTICES_PER_S));
    desk.act(0, 0);
    assert_eq!(desk.truth().events.len(), MAX_EVENTS + 1);
    assert_eq!(desk.give(Input::PassedOver(40)), [notice_of(notice::Code::Rate)]);
    assert_eq!(desk.notice().count, 40);
    assert_eq!(desk.give(Input::TooLarge(1 << 20)), [notice_of(notice::Code::Size)]);
}

#[test]
fn resets() {
    let mut desk = desk(OpenRequest::default());
    desk.reset(0);
    let first = desk.reset_reply();
    assert_eq!(desk.reset(0), [Reply(1)], "the same observation again");
    assert_eq!(desk.reset_reply(), first);
    desk.act(0, 0);
    assert_eq!(desk.reset(1), [truth(2), Reply(1), truth(3)], "abort, then row 0");
    desk.act(1, 0);
    assert_eq!(desk.reset(1).len(), 3, "a running episode starts over");
    assert_eq!(desk.act(0, 1), [notice_of(notice::Code::Step)], "of the episode before");
    let steps = desk.finish(1, 0);
    assert_eq!(desk.result().steps, steps);
    assert_eq!(desk.reset(2).len(), 2, "an episode that has ended is not aborted");
    desk.give(Input::Reset(vec![0xff; 3].into(), 1));
    assert!(matches!(desk.reset_reply(), reset_reply::Reply::Refusal(_)));
}

#[test]
fn the_last_observation_says_how_it_ended() {
    let mut desk = desk(OpenRequest::default());
    desk.reset(0);
    let steps = desk.finish(0, 0);
    let end = desk.result().end.unwrap();
    assert_eq!((end.cause.as_str(), end.steps, end.success), ("fall", steps, false));
    let seen = Observation::decode(&*desk.truth().observation).unwrap();
    assert_eq!(seen.end, Some(end));
    assert_eq!(desk.give(Input::Observation(4)), [Reply(4)]);
}

#[test]
fn closing_aborts_and_drains() {
    let mut desk = desk(OpenRequest::default());
    assert_eq!(desk.give(Input::Observation(4)), [Refused(4)]);
    desk.reset(0);
    desk.act(0, 0);
    assert_eq!(desk.close(), [truth(2), Closed, Reply(2)]);
    let aborted = desk.truth();
    assert!(aborted.state.is_empty());
    assert_eq!((desk.result().end.unwrap().cause.as_str(), aborted.step), ("aborted", 1));
    assert_eq!(desk.close(), [Reply(2)]);
    desk.reset(1);
    assert!(matches!(desk.reset_reply(), reset_reply::Reply::Refusal(r) if r.code() == refusal::Code::Closed));
    assert_eq!(desk.act(0, 1), [notice_of(notice::Code::Step)]);
    let request = StepRecordRequest { from_seq: 1, count: 9 };
    assert_eq!(desk.give(Input::StepRecords(request.encode_to_vec().into(), 3)), [Reply(3)]);
    assert_eq!(desk.ack(2), []);
    assert_eq!(desk.ack(3), [Done], "all is acknowledged");
    assert_eq!(desk.session.wake_at(), None);
}

#[test]
fn a_closed_session_does_not_wait_for_ever() {
    let mut desk = desk(OpenRequest::default());
    desk.reset(0);
    desk.close();
    desk.now += 3000 * MS;
    desk.ack(1);
    assert_eq!(desk.session.wake_at(), Some(desk.now + TIMES.recorder_timeout));
    assert_eq!(desk.sleep(), [Done]);
}

#[test]
fn a_client_without_a_token_is_let_go() {
    let mut desk = desk(OpenRequest::default());
    desk.reset(0);
    desk.give(Input::ClientGone);
    desk.now += TIMES.grace - MS;
    assert_eq!(desk.give(Input::ClientSeen), [], "it came back in time");
    assert_eq!(desk.act(0, 0), [observation(1), truth(1)], "and goes on where it was");
    desk.give(Input::ClientGone);
    assert_eq!(desk.sleep(), [notice_of(notice::Code::Lost), truth(2), Closed]);

    let mut never = self::desk(OpenRequest::default());
    never.session.client_gone = Some(never.now);
    assert_eq!(never.sleep(), [notice_of(notice::Code::Lost), Closed, Done], "nor one that never came");
}

#[test]
fn a_silent_client_is_let_go() {
    let mut desk = desk(OpenRequest::default());
    desk.reset(0);
    desk.now += TIMES.action_timeout - MS;
    desk.act(0, 0);
    let since = desk.now;
    desk.now += 1000 * MS;
    // Neither of these is an action that the server waits for.
    desk.act(0, 0);
    desk.act(0, 7);
    assert_eq!(desk.session.wake_at(), Some(since + TIMES.action_timeout));
    assert_eq!(desk.sleep(), [notice_of(notice::Code::Lost), truth(2), Closed]);
}

#[test]
fn lockstep_waits_for_its_recorder() {
    let window = limits::RECORDING_WINDOW;
    let ends = vec!["time-out".to_owned()];
    let mut desk = desk(OpenRequest { recorded: true, end_on: ends, ..OpenRequest::default() });
    desk.reset(0);
    for step in 0..window - 1 {
        assert_eq!(desk.act(0, step).len(), 2, "{step}");
    }
    let next = window - 1;
    assert_eq!(desk.act(0, next), [], "512 rows are not on disk");
    assert_eq!(desk.act(0, next), [], "asked again, it still waits");
    desk.now += 5000 * MS;
    assert_eq!(desk.ack(1), [observation(next + 1), truth(next + 1)]);
    assert_eq!(desk.act(0, next + 1), []);
    // The recorder is silent: the session goes on without it, and says so.
    assert_eq!(desk.sleep(), [notice_of(notice::Code::Lost), observation(next + 2), truth(next + 2)]);
    assert_eq!(desk.truth().events.len(), 1);
    assert_eq!(desk.act(0, next + 2).len(), 2, "no wait without a recorder");
    let first_from = |from_seq| desk.session.window.get(&StepRecordRequest { from_seq, count: 1 });
    assert!(first_from(0) == first_from(3) && first_from(3) != first_from(4), "0 to 2 are lost");
    desk.ack(3);
    assert_eq!(desk.act(0, next + 3), [], "it is back, and the window is full");
    assert_eq!(desk.reset(1), [], "a reset waits too");
    assert_eq!(desk.ack(10), [truth(next + 4), Reply(1), truth(next + 5)]);
}

#[test]
fn without_a_recorder_nothing_waits() {
    let ends = vec!["time-out".to_owned()];
    let mut desk = desk(OpenRequest { end_on: ends, ..OpenRequest::default() });
    desk.reset(0);
    for step in 0..limits::RECORDING_WINDOW + 5 {
        assert_eq!(desk.act(0, step).len(), 2, "{step}");
    }
}

#[test]
fn shutdown_aborts() {
    let mut desk = desk(OpenRequest::default());
    desk.reset(0);
    assert!(!desk.session.is_settled());
    assert_eq!(desk.give(Input::Shutdown), [notice_of(notice::Code::Lost), truth(1), Closed]);
    assert!(desk.session.is_settled(), "nobody records it");
}

#[test]
fn real_time_steps_by_the_clock() {
    let mut desk = desk(OpenRequest { mode: 2, ..OpenRequest::default() });
    desk.reset(0);
    assert_eq!(desk.act(0, 0), [observation(1), truth(1)], "the first action starts the clock");
    assert_eq!(desk.session.wake_at(), Some(desk.now + 20 * MS));
    assert_eq!(desk.sleep(), [observation(2), truth(2)]);
    let record = |desk: &Desk| ActionRecord::decode(&*desk.truth().action).unwrap();
    assert!(record(&desk).held);
    desk.now += 5 * MS;
    assert_eq!(desk.act(0, 1), [notice_of(notice::Code::Step)], "late");
    assert_eq!(desk.act(0, 52), [notice_of(notice::Code::Step)], "more than a second ahead");
    assert_eq!(desk.act(0, 2), []);
    desk.now += 15 * MS;
    assert_eq!(desk.give(Input::Tick), [observation(3), truth(3)]);
    assert_eq!((record(&desk).held, record(&desk).lateness_s), (false, 0.005));
    // A server that cannot keep up goes on from now.
    desk.now += 95 * MS;
    let said = desk.give(Input::Tick);
    assert_eq!(said, [notice_of(notice::Code::Unspecified), observation(4), truth(4)]);
    assert_eq!(desk.session.wake_at(), Some(desk.now + 20 * MS));
    desk.close();
    assert_eq!(desk.result().missed_steps, 2);
}

fn look(desk: &mut Desk, episode: u64, step: u64, sensors: &[&str]) -> look_reply::Reply {
    let sensors = sensors.iter().map(|name| (*name).to_owned()).collect();
    let bytes = LookRequest { episode, step, sensors }.encode_to_vec();
    assert_eq!(desk.give(Input::Look(bytes.into(), 9)), [Reply(9)]);
    let Some(Output::Reply(9, "LookReply", replies)) = desk.said.last() else { panic!("{:?}", desk.said.last()) };
    LookReply::decode(&*replies[0].to_bytes()).unwrap().reply.unwrap()
}

#[test]
fn a_look_shows_the_present_step() {
    let on_request = |name: &str| Sensor { on_request: true, ..Sensor::from(name) };
    let sensors = vec![on_request("camera"), on_request("privileged"), Sensor::from("last_action")];
    let mut desk = desk(OpenRequest { sensors, image_width: 32, image_height: 16, ..OpenRequest::default() });
    desk.reset(0);
    desk.act(0, 0);
    let recorded = Observation::decode(desk.truth().observation.as_slice()).unwrap();
    let look_reply::Reply::Observation(seen) = look(&mut desk, 0, 1, &["camera"]) else { panic!("refused") };
    assert_eq!((seen.episode, seen.step), (0, 1));
    assert_eq!(seen.camera.map(|image| image.rgb.len()), Some(3 * 32 * 16));
    assert_eq!((seen.privileged, seen.last_action.len()), (None, 0), "not asked for");
    // The bag has the last action alone: the others are only looked at.
    assert_eq!((recorded.camera, recorded.last_action.len()), (None, JOINTS));

    let refused = |desk: &mut Desk, episode, step, sensor| match look(desk, episode, step, &[sensor]) {
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
        let refusal = refused(&mut desk, episode, step, sensor);
        assert_eq!(refusal.field, field);
        assert!(refusal.message.contains(message), "{refusal:?}");
    }
    desk.close();
    assert_eq!(refused(&mut desk, 0, 1, "camera").code(), refusal::Code::Closed);
}

/// Large sensors are in the bag at the rate that was asked for, apart from the observation; small ones as published.
#[test]
fn bags_have_large_sensors_at_their_own_rate() {
    let camera = Sensor { rate_hz: 10.0, recorded: true, record_hz: 25.0, ..Sensor::from("camera") };
    let lidar = Sensor { rate_hz: 25.0, ..Sensor::from("lidar") };
    let sensors = vec![camera, lidar, Sensor::from("proprioception")];
    let asked = OpenRequest { sensors, image_width: 16, image_height: 16, recorded: true, ..OpenRequest::default() };
    let mut unrecorded = desk(OpenRequest { recorded: false, ..asked.clone() });
    unrecorded.reset(0);
    assert!(unrecorded.truth().camera.is_empty(), "nobody would take it");
    let mut desk = desk(asked);
    desk.reset(0);
    for step in 0..7 {
        let truth = desk.truth();
        let published = if step == 0 {
            let reset_reply::Reply::Observation(first) = desk.reset_reply() else { panic!("refused") };
            first
        } else {
            desk.observed()
        };
        assert_eq!((truth.step, published.step), (step, step));
        assert_eq!(published.camera.is_some(), step % 5 == 0, "{step}");
        assert_eq!(published.lidar.is_empty(), step % 2 == 1, "{step}");
        assert_eq!(truth.camera.is_empty(), step % 2 == 1, "{step}");
        assert!(truth.lidar.is_empty(), "not recorded");
        let recorded = Observation::decode(truth.observation.as_slice()).unwrap();
        assert_eq!(recorded, Observation { camera: None, lidar: Vec::new(), ..published });
        desk.act(0, step);
    }
}
