//! A grasp that encloses the bulb holds it in a shaken hand, also in a slippery one.

use std::sync::Arc;

use fiatlux_robot::GainSet;
use fiatlux_rules::{Task, pins};
use fiatlux_world::{PHYSICS_DT, Scene, SceneKind, SceneSpec, StartOptions, start};

use crate::shaken::{Down, enclosing, settling, shake};

/// Friction of dry plastic on glass, and the robot's own.
const FRICTIONS: [Option<f64>; 2] = [Some(0.5), None];

#[test]
fn a_shaken_bulb_stays_in_a_grasp_that_encloses_it() {
    for name in pins::RANKED_ROBOTS {
        let robot = Arc::new(enclosing(name).unwrap().unwrap());
        for task in [Task::S06, Task::S11] {
            for friction in FRICTIONS {
                let mut spec = SceneSpec::new(SceneKind::of(task), 1000, robot.gains(GainSet::default()));
                spec.hand_friction = friction;
                let scene = Arc::new(Scene::build(&settling().unwrap(), Arc::clone(&robot), spec).unwrap());
                let options = StartOptions { reset_noise: false, ..StartOptions::default() };
                let world = start(scene, task, 0, &options).unwrap();
                let bulb = task.spec().start.in_hand().unwrap();
                for down in [Down::Palm, Down::Fingers, Down::Back] {
                    let shaken = shake(&world, bulb, down, PHYSICS_DT, 12.0);
                    let said = format!("{name} {task} {friction:?} {down:?}: {shaken:?}");
                    assert!(shaken.moved_m < 1e-3 && shaken.turned_rad < 0.03 && shaken.unconverged == 0, "{said}");
                }
            }
        }
    }
}
