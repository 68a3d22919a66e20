//! A start's bulb in a hand that is shaken: everything but the hand's joints is held still, and a force on the bulb stands for the
//! hand's motion. `tests/oracle/grip.py` has the same motion in MuJoCo.

use std::f64::consts::TAU;

use fiatlux_dynamics::{Contact, Dynamics, Input, Wrench};
use fiatlux_robot::{Robot, RobotError};
use fiatlux_rules::Bulb;
use fiatlux_world::{SceneConfig, SceneError, World};
use nalgebra::{Point3, Vector3};

/// Files of the robots with fingers, each with a grasp that encloses a bulb.
const ENCLOSING: [(&str, &str); 2] = [
    (include_str!("../../../robot/robots/g1_inspire.toml"), include_str!("../grasps/g1_inspire.toml")),
    (include_str!("../../../robot/robots/g1_dex3.toml"), include_str!("../grasps/g1_dex3.toml")),
];

/// The robot of that name with a grasp that encloses a bulb in place of its own; `None` for one that has none.
pub fn enclosing(name: &str) -> Option<Result<Robot, RobotError>> {
    let (file, grasp) = ENCLOSING.into_iter().find(|(file, _)| file.contains(&format!("\nname = \"{name}\"\n")))?;
    let (before, checks) = file.split_once("[checks]")?;
    let before = before.split_once("[bulb_grasp]").map_or(before, |(before, _)| before);
    Some(Robot::from_toml(&format!("{before}{grasp}\n[checks]{checks}")))
}

/// The scene in which hands close with slippery surfaces.
pub fn settling() -> Result<SceneConfig, SceneError> {
    SceneConfig::from_toml("[start.carry]\nclosing_time = 0.5\nsettling_time = 2.0\nholding_time = 0.2")
}

/// Where gravity points in the hand, whose fingers are along -y and whose palm faces -x.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Down {
    /// Into the palm, as at the start.
    Palm,
    /// From the fingers' ends to the wrist.
    Fingers,
    /// Out of the palm.
    Back,
}

/// Fate of the bulb.
#[derive(Debug)]
pub struct Shaken {
    /// From the mean place of the glass in the second second to that in the last, m; infinite for a bulb that was lost.
    pub moved_m: f64,
    /// Angle between the mean axes, rad.
    pub turned_rad: f64,
    pub unconverged: u32,
    /// Of the last step; the example prints them.
    #[allow(dead_code)]
    pub contacts: Vec<Contact>,
}

/// Distance at which a bulb is lost, m, and the glass's centre on the bulb's axis.
const LOST_M: f64 = 0.06;
const GLASS_M: f64 = 0.1531;

/// Gravity turns by up to 0.3 rad about three axes at 0.37 to 0.5 Hz, and the hand accelerates by 2 m/s^2 along each axis at 1.3 to
/// 2.1 Hz.
pub fn shake(world: &World, bulb: Bulb, down: Down, dt: f64, seconds: f64) -> Shaken {
    let (scene, row) = (world.scene(), world.row());
    let model = &scene.model;
    let body = scene.body(bulb.thing()).expect("a scene with bulbs");
    let mut locked = vec![true; model.nv()];
    let first = model.bodies()[body.0].dof_start;
    locked[first..first + 6].fill(false);
    let robot = &scene.robot;
    let of_scene = scene.config.start.carry.grip.keys().filter_map(|name| robot.joint_index(name));
    let fingers: Vec<usize> = match robot.bulb_grasp() {
        Some(grasp) => grasp.grip.iter().map(|(joint, _)| *joint).collect(),
        None => of_scene.collect(),
    };
    fingers.into_iter().for_each(|joint| locked[scene.robot_ids.joints[joint].dof] = false);
    let mut targets = vec![0.0; model.drives().len()];
    for (ids, target) in scene.robot_ids.joints.iter().zip(&row.joint_target) {
        targets[ids.drive] = *target;
    }
    let (palm, gravity, mass) = (row.world_from_palm[1], model.gravity(), model.bodies()[body.0].spec.mass);
    let inward = palm.inverse_transform_vector(&gravity);
    let down = match down {
        Down::Palm => inward,
        Down::Fingers => Vector3::y() * gravity.norm(),
        Down::Back => -inward,
    };
    let (mut state, mut dynamics) = (world.state().clone(), Dynamics::new(model));
    let (mut means, mut counts, mut unconverged) = ([[Vector3::zeros(); 2]; 2], [0_u32; 2], 0);
    for step in 0..(seconds / dt).round() as u64 {
        let time = step as f64 * dt;
        let sine = |hz: f64, phase: f64| libm::sin(TAU * hz * time + phase);
        let turn = Vector3::new(sine(0.37, 0.0), sine(0.5, 1.0), sine(0.43, 2.0)) * 0.3;
        let shaken = Vector3::new(sine(1.3, 0.0), sine(1.7, 0.5), sine(2.1, 1.1)) * 2.0;
        let felt = palm * (down + turn.cross(&down) + shaken);
        let wrench = Wrench { force: mass * (felt - gravity), torque: Vector3::zeros() };
        let input = Input { targets: &targets, wrenches: &[(body, wrench)], locked: &locked };
        unconverged += u32::from(!dynamics.step(model, &mut state, &input, dt).converged);
        dynamics.update(model, &state);
        let palm_from_bulb = palm.inverse() * dynamics.world_from_body(body);
        let now = [(palm_from_bulb * Point3::new(0.0, 0.0, GLASS_M)).coords, palm_from_bulb * Vector3::z()];
        for (window, begins) in [1.0, seconds - 1.0].into_iter().enumerate() {
            if (begins..begins + 1.0).contains(&time) {
                (0..2).for_each(|part| means[window][part] += now[part]);
                counts[window] += 1;
            }
        }
        if counts[0] > 0 && (now[0] - means[0][0] / f64::from(counts[0])).norm() > LOST_M {
            return Shaken { moved_m: f64::INFINITY, turned_rad: f64::INFINITY, unconverged, contacts: Vec::new() };
        }
    }
    let [first, last] = [0, 1].map(|window| means[window].map(|sum| sum / f64::from(counts[window].max(1))));
    let contacts = dynamics.contacts().to_vec();
    Shaken { moved_m: (first[0] - last[0]).norm(), turned_rad: first[1].angle(&last[1]), unconverged, contacts }
}
