//! Episodes made up without a simulator, and bags of them.
#![allow(dead_code)] // Each test file uses a part of this module.

#[path = "../../../rules/tests/common/mod.rs"]
pub mod room;

use std::path::{Path, PathBuf};

use fiatlux_bag::BagWriter;
use fiatlux_proto::{ABORTED, Message, PROTOCOL, v3};
use fiatlux_rules::{
    BENCHMARK_VERSION, Judge, JudgeOptions, Protocol, Rewards, Row, RowDigest, Task, Thresholds, manifest, pins,
};
use fiatlux_wire::{
    geometry_message, header_digest, joint_groups_message, joint_groups_of, judgement_message, read_identity,
    reward_of, state_message,
};
use room::{Draw, goal_of, row_at, start_of, topple, touch};

/// Number of random changes of a test: a tenth, or all with `FIATLUX_ALL_MUTATIONS` set.
pub fn mutations(all: usize) -> usize {
    if std::env::var_os("FIATLUX_ALL_MUTATIONS").is_some() { all } else { all / 10 }
}

/// The course of an episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Story {
    /// Nothing happens until this step.
    Waits(u64),
    Falls(u64),
    Succeeds(u64),
    /// The goal is reached at this step, with a bulb crushed on the way.
    Crushes(u64),
}

/// A temporary folder, removed on drop.
pub struct Folder(pub PathBuf);

impl Folder {
    pub fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("fiatlux-grading-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).expect("a folder");
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn names(what: &str, count: usize) -> Vec<String> {
    (0..count).map(|k| format!("{what}_{k}")).collect()
}

pub fn header(task: Task, seed: u64) -> v3::EpisodeHeader {
    sealed(v3::EpisodeHeader {
        protocol: Some(PROTOCOL),
        version: "0.1.0".into(),
        server: "test".into(),
        policy: "zero".into(),
        task: task.short_id().into(),
        task_id: task.id().into(),
        instruction: task.instruction().into(),
        seed,
        mode: v3::Mode::Lockstep.into(),
        gains: "fiatlux".into(),
        robot: "g1_inspire".into(),
        episode_protocol: Protocol::Published.name().into(),
        thresholds: Thresholds::default().entries().map(|(key, value)| (key.into(), value)).collect(),
        random: "pcg64/1".into(),
        digest_layout: manifest().layout.clone(),
        model_digest: pins::model("g1_inspire").expect("pinned").into(),
        scene_digest: pins::SCENE.into(),
        end_on: judge(task).ends_on().iter().map(|cause| cause.name().into()).collect(),
        drives: vec![v3::JointDrive { stiffness: 100.0, ..v3::JointDrive::default() }; room::LAYOUT.joints],
        domain_sample: Some(v3::DomainSample {
            prop_scale: Some(v3::PropScale {
                ladder_x: 1.0,
                ladder_y: 1.0,
                ladder_z: 1.0,
                socket: 1.0,
                fresh_bulb: 1.0,
            }),
            ..v3::DomainSample::default()
        }),
        randomization: Some(v3::Randomization::default()),
        reward: "benchmark".into(),
        control_dt: 0.02,
        benchmark_version: BENCHMARK_VERSION,
        geometry: Some(geometry_message(&room::geometry())),
        joint_groups: Some(joint_groups_message(&room::joint_groups())),
        joint_names: names("joint", room::LAYOUT.joints),
        hand_bodies: names("body", room::LAYOUT.hand_bodies()),
        ..v3::EpisodeHeader::default()
    })
}

/// A header with the request that led to it, as a server records it.
pub fn requested(header: v3::EpisodeHeader) -> v3::EpisodeHeader {
    let request = v3::OpenRequest {
        policy: header.policy.clone(),
        task: header.task.clone(),
        seed: header.seed,
        episode_protocol: header.episode_protocol.clone(),
        recorded: true,
        ..v3::OpenRequest::default()
    };
    sealed(v3::EpisodeHeader { request: Some(request), image_width: 256, image_height: 256, ..header })
}

/// A header with the start of its digest chain, as a server makes it.
pub fn sealed(header: v3::EpisodeHeader) -> v3::EpisodeHeader {
    match read_identity(&header) {
        Ok(identity) => v3::EpisodeHeader { digest_context: identity.digest().hex(), ..header },
        Err(_) => header,
    }
}

fn judge(task: Task) -> Judge {
    Judge::new(Protocol::Published, task, Thresholds::default(), room::geometry(), JudgeOptions::default())
}

/// Rows like a simulator's: every number moves a little.
pub fn rows(task: Task, seed: u64, story: Story) -> Vec<Row> {
    let mut draw = Draw(seed ^ task as u64);
    let (Story::Waits(at) | Story::Falls(at) | Story::Succeeds(at) | Story::Crushes(at)) = story;
    let until = at + u64::from(task.spec().gate.sustain_steps);
    let mut rows = Vec::new();
    let mut judge = judge(task);
    for step in 0..=until {
        let succeeds = matches!(story, Story::Succeeds(_) | Story::Crushes(_)) && step >= at;
        let mut row = row_at(step, &if succeeds { goal_of(task) } else { start_of(task) });
        if matches!(story, Story::Falls(_)) && step >= at {
            topple(&mut row);
        }
        if story == Story::Crushes(at) && step > at / 2 && step < at / 2 + 8 {
            touch(&mut row, 1 - room::OLD, room::LEFT, 20.0 + 12.0 * (step - at / 2) as f64);
        }
        for list in [&mut row.joint_position, &mut row.joint_velocity, &mut row.joint_effort, &mut row.joint_target] {
            list.iter_mut().for_each(|number| *number = 0.01 * draw.unit());
        }
        row.action.iter_mut().for_each(|number| *number = 0.3 * draw.unit());
        for force in room::hand_forces(&mut row).filter(|force| force.norm() > 0.0) {
            *force *= 1.0 + 0.3 * draw.unit();
        }
        if step == 0 {
            judge.start(&row)
        } else {
            judge.advance(&row)
        };
        let ended = judge.verdict().end.is_some();
        rows.push(row);
        if ended {
            break;
        }
    }
    rows
}

/// The result that a server would give.
pub fn result(header: &v3::EpisodeHeader, rows: &[Row]) -> v3::EpisodeResult {
    let mut judge = judge(header.task.parse().expect("a task"));
    let mut digest = RowDigest::from_hex(&header.digest_context).expect("the start of a chain");
    let mut rewards =
        Rewards::new(&judge, reward_of(header).expect("a reward"), joint_groups_of(header).expect("joints"));
    let mut total_reward = 0.0;
    for row in rows {
        if row.step == 0 {
            judge.start(row);
            rewards.start(&judge, row);
        } else {
            judge.advance(row);
            rewards.advance(&judge, row);
            total_reward += rewards.reward();
        }
        digest.push(row);
    }
    let summary = judge.summary();
    let end = v3::EpisodeEnd {
        cause: summary.end.map_or(ABORTED, |end| end.cause().name()).into(),
        causes: summary.end.map_or(vec![], |end| end.causes.iter().map(|cause| cause.name().into()).collect()),
        steps: rows.len() as u64 - 1,
        success: summary.success,
        digest: digest.hex(),
        gate_progress: summary.gate_progress,
        broken: summary.broken,
        dropped: summary.dropped,
    };
    v3::EpisodeResult {
        end: Some(end),
        published: Some(judgement_message(&judge)),
        total_reward,
        header_digest: header_digest(header),
        ..v3::EpisodeResult::default()
    }
}

pub fn begin(path: &Path, header: &v3::EpisodeHeader, rows: &[Row]) -> BagWriter {
    let mut writer = BagWriter::create(path, header).expect("a new bag");
    for row in rows {
        writer.message(fiatlux_bag::topic::STATE, row.step, &state_message(row).encode_to_vec()).expect("a message");
    }
    writer
}

pub fn write(path: &Path, task: Task, seed: u64, story: Story) {
    let (header, rows) = (requested(header(task, seed)), rows(task, seed, story));
    begin(path, &header, &rows).finish(&result(&header, &rows)).expect("finished");
}
