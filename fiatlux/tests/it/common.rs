//! Made-up episodes.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output as Done;
use std::sync::Arc;

use fiatlux_bag::{BagWriter, topic};
use fiatlux_proto::v3::{EpisodeEnd, EpisodeHeader, EpisodeResult};
use fiatlux_proto::{Message, PROTOCOL};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{Row, Task};
use fiatlux_wire::{domain_sample_message, state_message};
use fiatlux_world::{Episode, EpisodeSpec, Scene, SceneConfig};
use nalgebra::Translation3;

/// A folder of one test, empty.
pub fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    folder
}

pub fn episode() -> Episode {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let spec = EpisodeSpec::new(Task::S05, 0, 0);
    let gains = robot.gains(GainSet::Fiatlux);
    let scene = Scene::build(&SceneConfig::default(), robot, spec.scene(gains)).unwrap();
    Episode::start(Arc::new(scene), &spec).unwrap()
}

pub fn header() -> EpisodeHeader {
    EpisodeHeader {
        domain_sample: Some(domain_sample_message(&episode().domain_sample())),
        protocol: Some(PROTOCOL),
        task: "S05".into(),
        gains: "fiatlux".into(),
        robot: "g1_inspire".into(),
        model_digest: Robot::benchmark().unwrap().digest().into(),
        scene_digest: SceneConfig::default().digest(),
        ..EpisodeHeader::default()
    }
}

/// The robot of a start state slides sideways.
pub fn rows(count: u64) -> Vec<Row> {
    let episode = episode();
    let row = |step: u64| {
        let mut row = episode.row().clone();
        row.step = step;
        row.robot.pose = Translation3::new(0.0, 0.05 * step as f64, 0.0) * row.robot.pose;
        row
    };
    (0..count).map(row).collect()
}

pub fn begin(path: &Path, header: &EpisodeHeader, rows: &[Row]) -> BagWriter {
    let mut writer = BagWriter::create(path, header).unwrap();
    for row in rows {
        writer.message(topic::STATE, row.step, &state_message(row).encode_to_vec()).unwrap();
    }
    writer
}

pub fn write(path: &Path, header: &EpisodeHeader, rows: &[Row]) -> PathBuf {
    let end = EpisodeEnd { cause: "time-out".into(), steps: rows.len() as u64 - 1, ..EpisodeEnd::default() };
    begin(path, header, rows).finish(&EpisodeResult { end: Some(end), ..EpisodeResult::default() }).unwrap();
    path.into()
}

pub fn bag(folder: &Path) -> PathBuf {
    write(&folder.join("S05.mcap"), &header(), &rows(9))
}

pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[track_caller]
pub fn check(done: &Done, code: i32, words: &[&str]) {
    let said = String::from_utf8_lossy(&done.stderr);
    assert_eq!(done.status.code(), Some(code), "{said}");
    for word in words {
        assert!(said.contains(word), "'{word}' is not in: {said}");
    }
}
