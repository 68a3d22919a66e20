//! The other side of the tests: a server that counts instead of simulating.

use fiatlux_proto::v3::{
    Action, EpisodeEnd, Joint, Mode, Observation, ObservationTerm, ResetReply, ResetRequest, SessionInfo, reset_reply,
};
use fiatlux_proto::{Message, decode};
use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::Rng as _;

pub fn info(joints: usize, real_time: bool) -> SessionInfo {
    let mode = if real_time { Mode::RealTime } else { Mode::Lockstep };
    SessionInfo {
        server: "lab".into(),
        mode: mode.into(),
        joints: vec![Joint::default(); joints],
        terms: vec![ObservationTerm {
            sensor: "last_action".into(),
            field: "last_action".into(),
            shape: vec![joints as u32],
            ..ObservationTerm::default()
        }],
        grace_s: 10.0,
        resend_s: 0.2,
        action_scale: 0.5,
        action_limit: 1e3,
        ..SessionInfo::default()
    }
}

pub fn observation(episode: u64, step: u64) -> Observation {
    Observation { episode, step, ..Observation::default() }
}

/// A generator of random numbers that repeats exactly.
pub struct Dice(Pcg64Mcg);

impl Dice {
    pub fn new(seed: u64) -> Self {
        Self(Pcg64Mcg::new(u128::from(seed)))
    }

    pub fn below(&mut self, bound: u64) -> u64 {
        (self.0.next_u64() >> 11) % bound
    }
}

/// Lockstep as in the protocol, but without refusals, since none may ever be needed.
pub struct FakeServer {
    pub episode: Option<u64>,
    /// The `step` of each action that was carried out, in order.
    pub taken: Vec<u64>,
    horizon: u64,
}

impl FakeServer {
    pub fn new(horizon: u64) -> Self {
        Self { episode: None, taken: Vec::new(), horizon }
    }

    pub fn reset(&mut self, bytes: &[u8]) -> Vec<u8> {
        let request: ResetRequest = decode(bytes, 100).expect("a reset");
        if self.episode == Some(request.episode) {
            assert!(self.taken.is_empty(), "a reset of the running episode would abort it");
        }
        self.episode = Some(request.episode);
        self.taken.clear();
        ResetReply { reply: Some(reset_reply::Reply::Observation(self.present())) }.encode_to_vec()
    }

    /// The observation that the server publishes after an action.
    pub fn act(&mut self, bytes: &[u8]) -> Option<Vec<u8>> {
        let action: Action = decode(bytes, 1 << 16).expect("an action");
        let step = self.taken.len() as u64;
        if action.step == step && step < self.horizon {
            self.taken.push(action.step);
        } else if action.step + 1 != step {
            // An old copy that was overtaken: a real server would refuse it with a notice.
            return None;
        }
        Some(self.present().encode_to_vec())
    }

    pub fn present(&self) -> Observation {
        let step = self.taken.len() as u64;
        let end = EpisodeEnd { cause: "time-out".into(), steps: step, ..EpisodeEnd::default() };
        Observation { end: (step == self.horizon).then_some(end), ..observation(self.episode.unwrap_or(0), step) }
    }
}
