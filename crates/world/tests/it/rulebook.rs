//! Groups of joints and limits that the rulebook reads are those of the robot's file.

use std::sync::Arc;

use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::JointGroups;
use fiatlux_world::{Scene, SceneConfig, SceneKind, SceneSpec};

#[expect(clippy::approx_constant, reason = "the figure of the robot's file, rounded as it is there")]
const PITCH: [f64; 2] = [-0.87267, 0.5236];
const ROLL: [f64; 2] = [-0.2618, 0.2618];

/// The published terms read these joints of the G1, by their places in its `joint_order`, with the limits of its ankles.
#[test]
fn the_groups_of_joints_are_the_published_ones() {
    for (name, joints) in [("g1_inspire", 53), ("g1_dex3", 43), ("g1_bare", 29), ("g1_inspire6", 53)] {
        let robot = Arc::new(Robot::by_name(name).unwrap());
        let spec = SceneSpec::new(SceneKind::FreeLadder, 0, robot.gains(GainSet::default()));
        let scene = Scene::build(&SceneConfig::default(), robot, spec).unwrap();
        let expected = JointGroups {
            legs: vec![0, 1, 2, 3, 6, 7, 8, 9],
            ankles: vec![(4, PITCH), (5, ROLL), (10, PITCH), (11, ROLL)],
            waist: vec![12, 13, 14],
            fingers: (29..joints).collect(),
        };
        assert_eq!(scene.joint_groups(), expected, "{name}");
    }
}
