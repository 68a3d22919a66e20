//! Plays and records the episode that the tests show.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use fiatlux_bag::{BagWriter, topic};
use fiatlux_proto::v3::{EpisodeEnd, EpisodeHeader, EpisodeResult, Event, Judgement, Randomization};
use fiatlux_proto::{Message, PROTOCOL};
use fiatlux_replay::{POSE, Replay};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{BENCHMARK_VERSION, CONTROL_DT, Row, Task, manifest};
use fiatlux_wire::{
    Frames, domain_sample_message, drive_message, geometry_message, hand_body_names, joint_groups_message,
    state_message,
};
use fiatlux_world::{Episode, EpisodeSpec, GENERATORS, Scene, SceneConfig};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

/// Maximum length of the episode in steps; the robot may fall earlier.
const STEPS: u64 = 150;

pub struct Random(pub u64);

impl Random {
    pub fn below(&mut self, limit: usize) -> usize {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        ((self.0 >> 33) as usize) % limit
    }
}

/// An episode that was played here: its rows, its robot, and its bag.
pub struct RecordedEpisode {
    pub folder: PathBuf,
    pub bag: PathBuf,
    pub rows: Vec<Row>,
    /// For each row, the criteria of the judge in force.
    pub criteria: Vec<Vec<bool>>,
    pub scene: Arc<Scene>,
    pub cause: &'static str,
}

pub fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

pub fn play(name: &str, task: Task, seed: u64) -> RecordedEpisode {
    let folder = folder(name);
    let spec = EpisodeSpec::new(task, seed, 0);
    let robot = Arc::new(Robot::by_name("g1_inspire").unwrap());
    let gains = robot.gains(GainSet::default());
    let scene = Arc::new(Scene::build(&SceneConfig::default(), robot, spec.scene(gains)).unwrap());
    let mut episode = Episode::start(Arc::clone(&scene), &spec).unwrap();
    let header = header(&episode);
    let bag = folder.join(format!("{task}.mcap"));
    let mut writer = BagWriter::create(&bag, &header).unwrap();
    let frames = Frames::new(&scene.robot);
    let (mut rows, mut criteria) = (Vec::new(), Vec::new());
    let mut random = Random(seed + 1);
    loop {
        let row = episode.row().clone();
        writer.message(topic::TF, row.step, &frames.transforms(&row).encode_to_vec()).unwrap();
        writer.message(topic::STATE, row.step, &state_message(&row).encode_to_vec()).unwrap();
        if row.step == 0 {
            let event = Event { kind: "start".into(), subject: header.task.clone(), ..Event::default() };
            writer.message(topic::EVENT, 0, &event.encode_to_vec()).unwrap();
        }
        criteria.push(episode.verdict().criteria.as_slice().to_vec());
        rows.push(row);
        if episode.end().is_some() || rows.len() as u64 > STEPS {
            break;
        }
        let target: Vec<f64> =
            episode.row().joint_target.iter().map(|q| q + random.below(2000) as f64 * 2e-5 - 0.02).collect();
        let action = episode.action_for(&target);
        episode.step(&action).unwrap();
    }
    let steps = rows.len() as u64 - 1;
    let cause = episode.end().map_or("aborted", |end| end.cause().name());
    let judgement = || Judgement { cause: cause.into(), steps, ..Judgement::default() };
    let result = EpisodeResult {
        end: Some(EpisodeEnd { cause: cause.into(), steps, ..EpisodeEnd::default() }),
        published: Some(judgement()),
        strict: Some(judgement()),
        ..EpisodeResult::default()
    };
    let bag = writer.finish(&result).unwrap();
    RecordedEpisode { folder, bag, rows, criteria, scene, cause }
}

fn header(episode: &Episode) -> EpisodeHeader {
    let (scene, spec) = (episode.scene(), episode.spec());
    let robot = &scene.robot;
    EpisodeHeader {
        protocol: Some(PROTOCOL),
        policy: "restless".into(),
        task: spec.task.short_id().into(),
        instruction: spec.task.instruction().into(),
        seed: spec.seed,
        gains: GainSet::default().to_string(),
        robot: "g1_inspire".into(),
        end_on: episode.judge().ends_on().iter().map(|cause| cause.name().to_owned()).collect(),
        thresholds: spec.thresholds.entries().map(|(name, value)| (name.to_owned(), value)).collect(),
        geometry: Some(geometry_message(episode.judge().geometry())),
        benchmark_version: BENCHMARK_VERSION,
        random: GENERATORS.into(),
        digest_layout: manifest().layout.clone(),
        model_digest: robot.digest().into(),
        scene_digest: scene.config.digest(),
        joint_groups: Some(joint_groups_message(&scene.joint_groups())),
        joint_names: robot.joints().iter().map(|joint| joint.name.clone()).collect(),
        hand_bodies: hand_body_names(robot),
        episode_protocol: spec.protocol.name().into(),
        horizon_steps: spec.task.horizon_steps(),
        control_dt: CONTROL_DT,
        randomization: Some(Randomization::default()),
        domain_sample: Some(domain_sample_message(&episode.domain_sample())),
        reward: "benchmark".into(),
        drives: spec.identity(scene).drives.iter().map(drive_message).collect(),
        ..EpisodeHeader::default()
    }
}

/// A track as its tests need it, decoded.
pub struct Track {
    pub steps: Vec<u32>,
    pub flags: Vec<u32>,
    pub hand_force: Vec<f32>,
    pub kept_steps: Vec<u32>,
    pub numbers: Vec<f32>,
    pub width: usize,
}

/// Decodes a track from its description alone: the poses of all frames, then the forces, of each kept row.
pub fn read_track(replay: &Replay) -> Track {
    let (bytes, info) = (replay.track(), &replay.document().track);
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    assert_eq!(&bytes[..4], b"FLTR");
    let [version, rows, kept, columns] = [4, 8, 12, 16].map(|at| word(at) as usize);
    assert_eq!((version, columns), (2, info.width));
    let at = 20 + 12 * rows + 4 * kept;
    assert_eq!(bytes.len(), at + 4 * kept * columns);
    let words = |from: usize, count: usize| (0..count).map(|i| word(from + 4 * i)).collect::<Vec<u32>>();
    let (stored, joints) = (unplaned(&bytes[at..], columns), info.joints.len());
    let forces = columns - 3 * info.forces.len();
    let mut numbers = Vec::new();
    for row in stored.chunks(columns) {
        let on_grid: Vec<f64> = row.iter().map(|number| f64::from(*number) * info.grid.pose).collect();
        let mut links: Vec<Isometry3<f64>> = Vec::new();
        for link in &info.links {
            let turn = |joint: usize| UnitQuaternion::new(Vector3::from(link.axis) * on_grid[POSE + joint]);
            links.push(match link.parent {
                None => isometry(&on_grid[..POSE]),
                Some(parent) => {
                    links[parent] * isometry(&link.at) * link.joint.map_or_else(UnitQuaternion::identity, turn)
                }
            });
        }
        numbers.extend(links.iter().flat_map(pose));
        numbers.extend(on_grid[POSE + joints..forces].iter().map(|number| *number as f32));
        numbers.extend(row[forces..].iter().map(|number| (f64::from(*number) * info.grid.force) as f32));
    }
    Track {
        steps: words(20, rows),
        flags: words(20 + 4 * rows, rows),
        hand_force: words(20 + 8 * rows, rows).into_iter().map(f32::from_bits).collect(),
        kept_steps: words(20 + 12 * rows, kept),
        width: numbers.len() / kept,
        numbers,
    }
}

/// Whole numbers in rows, out of bytes that hold their changes column by column, the lowest bytes of all first.
pub fn unplaned(bytes: &[u8], columns: usize) -> Vec<i32> {
    let count = bytes.len() / 4;
    let rows = count / columns;
    let mut numbers = vec![0; count];
    for column in 0..columns {
        let mut value = 0_i32;
        for row in 0..rows {
            let at = column * rows + row;
            let change = u32::from_le_bytes([0, 1, 2, 3].map(|plane| bytes[at + plane * count]));
            value = value.wrapping_add((change >> 1) as i32 ^ -((change & 1) as i32));
            numbers[row * columns + column] = value;
        }
    }
    numbers
}

fn isometry(pose: &[f64]) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(pose[3], pose[4], pose[5], pose[6]));
    Isometry3::from_parts(Translation3::new(pose[0], pose[1], pose[2]), turn)
}

pub fn pose(pose: &Isometry3<f64>) -> [f32; POSE] {
    let (at, q) = (&pose.translation.vector, pose.rotation.quaternion());
    [at.x, at.y, at.z, q.w, q.i, q.j, q.k].map(|number| number as f32)
}
