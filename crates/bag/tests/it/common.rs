//! Made-up episodes.
#![allow(dead_code, missing_docs)]

use std::path::{Path, PathBuf};

use fiatlux_bag::{BagWriter, topic};
use fiatlux_proto::v3::{
    Action, ActionRecord, EpisodeEnd, EpisodeHeader, EpisodeResult, Event, Observation, Reward, State, StepRecord,
};
use fiatlux_proto::{Message, PROTOCOL, foxglove};

pub struct Random(pub u64);

impl Random {
    pub fn below(&mut self, limit: usize) -> usize {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        ((self.0 >> 33) as usize) % limit
    }

    fn number(&mut self) -> f64 {
        self.below(1 << 30) as f64 / f64::from(1 << 30)
    }
}

pub fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("a folder for the test");
    folder
}

pub fn header() -> EpisodeHeader {
    EpisodeHeader {
        protocol: Some(PROTOCOL),
        server: "lab".into(),
        session: "7".into(),
        task: "S01".into(),
        seed: u64::MAX,
        thresholds: [("fragility_n".to_owned(), 50.1)].into(),
        joint_names: (0..53).map(|i| format!("joint_{i}")).collect(),
        control_dt: 0.02,
        ..EpisodeHeader::default()
    }
}

pub fn result(rows: u64) -> EpisodeResult {
    let (cause, digest) = ("time-out".into(), "ab12".into());
    let end = EpisodeEnd { cause, digest, steps: rows - 1, gate_progress: 1.0 / 3.0, ..EpisodeEnd::default() };
    EpisodeResult { end: Some(end), ..EpisodeResult::default() }
}

pub fn state(step: u64) -> State {
    let mut random = Random(step);
    let mut list = |length| (0..length).map(|_| random.number()).collect::<Vec<_>>();
    State { step, joint_position: list(53), joint_velocity: list(53), ..State::default() }
}

pub fn truth(step: u64) -> StepRecord {
    let mut truth = StepRecord { seq: step, step, state: state(step).encode_to_vec(), ..StepRecord::default() };
    truth.observation = Observation { step, last_action: vec![0.25; 53], ..Observation::default() }.encode_to_vec();
    if step == 0 {
        truth.scene = foxglove::SceneUpdate { entities: vec![foxglove::SceneEntity::default()], deletions: vec![] }
            .encode_to_vec();
    } else {
        let action = Action { step: step - 1, action: vec![0.5; 53], ..Action::default() };
        truth.action = ActionRecord { action: Some(action), ..ActionRecord::default() }.encode_to_vec();
        truth.reward = Reward { step, total: 0.5, ..Reward::default() }.encode_to_vec();
    }
    if step.is_multiple_of(10) {
        let event = Event { step, kind: "criterion".into(), ..Event::default() }.encode_to_vec();
        truth.events = vec![event.clone(), event];
    }
    truth
}

/// Pushes rows, with poses at every second one.
pub fn push(writer: &mut BagWriter, rows: std::ops::Range<u64>) {
    for step in rows {
        if step.is_multiple_of(2) {
            let frames = foxglove::FrameTransforms { transforms: vec![foxglove::FrameTransform::default()] };
            writer.message(topic::TF, step, &frames.encode_to_vec()).expect("a message is written");
        }
        writer.push(&truth(step)).expect("a row is written");
    }
}

/// Writes a whole bag with this many rows, and returns its path.
pub fn write(path: &Path, rows: u64) -> PathBuf {
    let mut writer = BagWriter::create(path, &header()).expect("a new bag");
    push(&mut writer, 0..rows);
    writer.finish(&result(rows)).expect("a finished bag")
}
