//! A client of raw messages that plays an episode of a run.

use std::sync::mpsc::Receiver;

use fiatlux_access::Label;
use fiatlux_proto::Message;
use fiatlux_proto::keys::{ServerKeys, SessionKeys};
use fiatlux_proto::v3::run_request::Ask;
use fiatlux_proto::v3::{
    Action, CloseReply, CloseRequest, EpisodeEnd, Notice, Observation, Refusal, ResetReply, ResetRequest, SessionInfo,
    reset_reply, run_reply,
};
use zenoh::liveliness::LivelinessToken;
use zenoh::{Session, Wait};

use super::{JOINTS, KEY};
use crate::common::{Keys, answer, ask_run, ask_sealed, channel_of, subscribe_sealed};

/// Two ways through an episode; both fall.
fn action(way: u64, step: u64) -> Vec<f64> {
    (0..JOINTS).map(|joint| 0.3 * (step as f64 * 0.1 + (joint as u64 + way) as f64).sin()).collect()
}

pub struct Player {
    zenoh: Session,
    pub info: SessionInfo,
    pub keys: SessionKeys,
    sealing: Keys,
    pub observations: Receiver<Observation>,
    pub notices: Receiver<Notice>,
    _token: LivelinessToken,
}

impl Player {
    pub fn open(zenoh: &Session, episode: u32) -> Self {
        Self::open_on(zenoh, "test", episode)
    }

    pub fn open_on(zenoh: &Session, server: &str, episode: u32) -> Self {
        match ask_run(zenoh, server, ["first", KEY], Ask::Open(episode)) {
            (run_reply::Reply::Session(info), Some(secrets)) => Self::of(zenoh, info, channel_of(&secrets)),
            (other, _) => panic!("no session: {other:?}"),
        }
    }

    pub fn of(zenoh: &Session, info: SessionInfo, sealing: Keys) -> Self {
        let keys = ServerKeys::new(&info.server).session(&info.session);
        let token = zenoh.liveliness().declare_token(keys.client()).wait().unwrap();
        let observations = subscribe_sealed(zenoh, keys.observation(), &sealing);
        let notices = subscribe_sealed(zenoh, keys.notice(), &sealing);
        Self { zenoh: zenoh.clone(), info, keys, sealing, observations, notices, _token: token }
    }

    pub fn reset(&self, episode: u64) -> Result<Observation, Refusal> {
        let request = ResetRequest { episode }.encode_to_vec();
        let reply: ResetReply = ask_sealed(&self.zenoh, &self.sealing, &self.keys.reset(), request).unwrap()?;
        match reply.reply.unwrap() {
            reset_reply::Reply::Observation(observation) => Ok(observation),
            reset_reply::Reply::Refusal(refusal) => Err(refusal),
        }
    }

    pub fn act(&self, way: u64, step: u64) {
        let action = Action { step, action: action(way, step), ..Action::default() };
        let bytes = action.encode_to_vec();
        let attachment = self.sealing.lock().unwrap().seal(Label::Message("action"), &bytes).to_vec();
        self.zenoh.put(self.keys.action(), bytes).attachment(attachment).wait().unwrap();
    }

    pub fn play(&self, way: u64, steps: u64) -> Option<EpisodeEnd> {
        self.reset(0).unwrap();
        for step in 0..steps {
            self.act(way, step);
            let observation = answer(&self.observations, step, || self.act(way, step));
            assert_eq!(observation.step, step + 1);
            if observation.end.is_some() {
                return observation.end;
            }
        }
        None
    }

    pub fn close(self) {
        let request = CloseRequest {}.encode_to_vec();
        let _: Option<Result<CloseReply, _>> = ask_sealed(&self.zenoh, &self.sealing, &self.keys.close(), request);
    }
}
