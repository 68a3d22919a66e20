//! Snapshots whose digest is right and whose content is not.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{RobotLayout, Row};
use fiatlux_world::{Scene, SceneConfig, SceneSpec};

use super::Snapshot;
use crate::{Bank, Batch, BatchConfig, Outputs, Walking};

#[test]
fn a_forged_state_is_refused_and_the_batch_lives() {
    let robot = Arc::new(Robot::by_name("g1_bare").unwrap());
    let spec = SceneSpec::floor(robot.gains(GainSet::default()));
    let bank = Bank::standing(Arc::new(Scene::build(&SceneConfig::default(), robot, spec).unwrap()));
    let task = Walking::new(&bank.scene, Default::default()).unwrap();
    let mut batch = Batch::new(BatchConfig { worlds: 2, ..BatchConfig::new(vec![bank]) }, &task).unwrap();
    let mut outputs = Outputs::new(&batch);
    let saved = batch.save().unwrap();
    type Forge = fn(&mut Snapshot);
    let forgeries: [(&str, Forge); 7] = [
        ("the world's start does not exist", |s| s.worlds[1].start = usize::MAX),
        ("world 1: the task cannot go on", |s| s.worlds[1].task.truncate(9)),
        ("world 1: the task cannot go on", |s| s.worlds[1].task.clear()),
        ("is damaged: world 1: ", |s| s.worlds[1].row = Row::zeros(RobotLayout { joints: 3, hand_bodies_per_side: 0 })),
        ("worlds of the snapshot has 1 numbers instead of 2", |s| drop(s.worlds.pop())),
        ("observation of the snapshot has", |s| {
            s.observation.pop();
        }),
        ("snapshot: settings is missing, but the batch has starts", |s| drop(s.settings.pop())),
    ];
    for (named, forge) in forgeries {
        let mut forged = saved.clone();
        forge(&mut forged);
        let read = Snapshot::from_bytes(&forged.to_bytes());
        let refused = read.and_then(|read| batch.restore(&read, &mut outputs.observation)).unwrap_err();
        let source = std::error::Error::source(&refused).map(ToString::to_string).unwrap_or_default();
        assert!(format!("{refused}: {source}").contains(named), "{refused}: {source}");
        batch.restore(&saved, &mut outputs.observation).unwrap();
        batch.step(&[0.0; 30], &mut outputs.buffers()).unwrap();
    }
}
