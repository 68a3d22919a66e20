//! A session over real episodes: each rule of the protocol as inputs and what comes out, at times that the test chooses.
#![allow(clippy::unwrap_used)]

use std::time::Duration;

use fiatlux_bag::{Bag, BagWriter, Completeness};
use fiatlux_proto::v3::{
    Action, ActionRecord, CloseRequest, EpisodeResult, Event, LookReply, LookRequest, Notice, OpenRequest, ResetReply,
    ResetRequest, Sensor, State, StepRecord, StepRecordAck, StepRecordRequest, WholeBodyCommand, look_reply, notice,
    reset_reply,
};
use fiatlux_proto::{Bytes, Message, PROTOCOL, limits};
use fiatlux_session::server::{Input, MAX_EVENTS, Output, Timeouts};
use fiatlux_session::{Machine, ServerSession};
use fiatlux_wire::read_row;
use fiatlux_world::SceneConfig;

use super::*;
use crate::server::plan;
use crate::server::scenes::{Robots, Scenes};

mod actions;
mod conditions;
mod ends;

/// The G1 with Inspire hands.
const JOINTS: usize = 53;

/// A policy of that name makes its simulation panic.
pub(in crate::server) const PANICS: &str = "panics";

const MS: Duration = Duration::from_millis(1);
const TIMEOUTS: Timeouts = Timeouts {
    claim: Duration::from_secs(5),
    grace: Duration::from_secs(10),
    action: Duration::from_secs(60),
    lockstep: Duration::from_secs(60),
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
    let scenes = Scenes::new(SceneConfig::default(), Robots::load().unwrap(), Vec::new());
    let gains = scenes.robot(plan.robot).gains(plan.gains);
    let built = scenes.get(plan.robot, plan.episode(0).scene(gains)).unwrap();
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
        self.send(&Action { episode, step, action: vec![0.0; JOINTS], ..Action::default() })
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
        self.hear(&StepRecordAck { recorder: "r".into(), next_seq, ..StepRecordAck::default() })
    }

    fn hear(&mut self, ack: &StepRecordAck) -> Vec<Sent> {
        self.give(Input::Ack(ack.encode_to_vec().into()))
    }

    /// Lets time pass up to just before and then to the time that the session asked for.
    fn sleep(&mut self) -> Vec<Sent> {
        let at = self.session.wake_at().unwrap();
        self.now = at.saturating_sub(Duration::from_nanos(1)).max(self.now);
        assert_eq!(self.give(Input::Tick), [], "nothing is due before its time");
        self.now = at.max(self.now);
        self.give(Input::Tick)
    }

    /// Records that a recorder gets when it asks.
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
