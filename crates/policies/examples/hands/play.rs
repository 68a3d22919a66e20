//! One episode of `hands`, without a server.

use std::error::Error;
use std::sync::Arc;

use fiatlux_client::Policy;
use fiatlux_dynamics::Wrench;
use fiatlux_policies::Hands;
use fiatlux_robot::Robot;
use fiatlux_rules::{Bulb, CONTROL_DT, Cause, Row, Task, Verdict, errand};
use fiatlux_skills::grip::on_side;
use fiatlux_world::{AppliedWrench, SceneConfig, Target, World};
use nalgebra::{UnitQuaternion, Vector3};

#[path = "../game/mod.rs"]
mod game;

use game::{Game, Start, push_towards};

/// Differences of an episode from the benchmark's.
#[derive(Debug, Clone, Default)]
pub struct Changes {
    /// The robot, in place of the benchmark's.
    pub robot: Option<String>,
    /// The bulb begins in the left hand, as its mirror image would in the right one.
    pub left: bool,
    /// Numbers of the scene, over its own (TOML).
    pub scene: Option<String>,
    /// Friction of the hands, in place of the drawn one.
    pub friction: Option<f64>,
    /// Size of the fresh bulb.
    pub fresh_bulb: Option<f64>,
    /// Control steps until an action has an effect.
    pub delay: usize,
    /// A push of the whole robot, m/s, half a second after a phase began for the first time.
    pub push: Option<(f64, String)>,
    /// A force lays the fresh bulb down, away from the robot, in another direction in each room.
    pub lying: bool,
}

/// The end of an episode.
#[allow(dead_code)]
pub struct Played {
    pub cause: Cause,
    pub seconds: f64,
    pub phase: String,
    /// Largest force of the task's bulb on a body of the hands, N, and without the first ten rows, whose grip is the start's.
    pub peak: f64,
    pub later_peak: f64,
    /// A bulb was broken or dropped.
    pub is_spoilt: bool,
    /// Deepest overlap of two shapes, m.
    pub penetration: f64,
}

/// A state of an episode, for whoever watches.
#[allow(dead_code)]
pub struct Moment<'a> {
    pub row: &'a Row,
    pub phase: &'a str,
    /// Distance of the hand from where it is commanded, m.
    pub off: f64,
    pub verdict: &'a Verdict,
}

/// The bulb that a task is about.
pub fn bulb_of(task: Task) -> Bulb {
    task.spec().bulbs.first().copied().unwrap_or(Bulb::Fresh)
}

/// Forces of a bulb on the bodies of the hands, N.
pub fn forces(row: &Row, bulb: Bulb) -> impl Iterator<Item = f64> {
    row.force(errand::HAND_FORCE[bulb as usize]).iter().map(|force| force.norm())
}

/// Control steps in which a force lays the bulb down, and the force, N.
const TOPPLED: u64 = 12;
const TOPPLING_FORCE: f64 = 0.03;

/// The force on the fresh bulb at its centre of mass.
fn topple(world: &World, seed: u64) -> Option<AppliedWrench> {
    let ahead = world.row().robot.pose.rotation * Vector3::x();
    // Between a quarter turn to the right and one to the left.
    let turn = 1.5 * (2.4 * seed as f64).sin();
    let level = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), ahead.y.atan2(ahead.x) + turn);
    let wrench = Wrench { force: level * Vector3::x() * TOPPLING_FORCE, torque: Vector3::zeros() };
    let body = world.scene().body(Bulb::Fresh.thing())?;
    Some(AppliedWrench { target: Target::Body(body), point: None, wrench })
}

/// Puts the bulb of a start from the right hand into the left one.
fn carry_left(config: &mut SceneConfig) {
    let carry = &mut config.start.carry;
    let on_left = |name: &str| on_side(name, 0);
    carry.hand_link = on_left(&carry.hand_link);
    carry.glass_center[2] = -carry.glass_center[2];
    let [about_x, about_y] = carry.glass_tilt;
    carry.glass_tilt = [std::f64::consts::PI - about_x, -about_y];
    let is_mirrored = |name: &str| ["roll", "yaw"].iter().any(|axis| name.contains(axis));
    for angles in [&mut carry.arm, &mut carry.platform_arm] {
        let right = std::mem::take(angles);
        let left = right.iter().map(|(name, angle)| (on_left(name), if is_mirrored(name) { -angle } else { *angle }));
        *angles = left.collect();
    }
    carry.grip = carry.grip.iter().map(|(name, angle)| (on_left(name), *angle)).collect();
}

/// Plays the first episode of a room.
pub fn play(
    task: Task,
    seed: u64,
    mut hands: Hands,
    changes: &Changes,
    mut watch: impl FnMut(&Moment<'_>),
) -> Result<Played, Box<dyn Error>> {
    let mut start = Start { hand_friction: changes.friction, delay: changes.delay, ..Start::of(task, seed)? };
    if let Some(robot) = &changes.robot {
        start.robot = Arc::new(Robot::by_name(robot)?);
    }
    if let Some(scene) = &changes.scene {
        start.config = SceneConfig::from_toml(scene)?;
    }
    if changes.left {
        carry_left(&mut start.config);
    }
    start.spec.scale.fresh_bulb = changes.fresh_bulb.unwrap_or(start.spec.scale.fresh_bulb);
    let mut game = Game::start(start)?;
    let mut seen = game.observe()?;
    hands.reset(&game.info, &seen)?;
    let bulb = bulb_of(task);
    let (mut peak, mut later_peak, mut penetration, mut phase) =
        (forces(game.world().row(), bulb).fold(0.0, f64::max), 0.0_f64, 0.0_f64, String::new());
    let mut push_at = None;
    loop {
        if let Some(end) = game.verdict().end {
            let is_spoilt = game.verdict().broken || game.verdict().dropped;
            let seconds = end.step as f64 * CONTROL_DT;
            return Ok(Played { cause: end.cause(), seconds, phase, peak, later_peak, is_spoilt, penetration });
        }
        let step = game.world().row().step;
        let topples = changes.lying && step < TOPPLED;
        game.wrenches = topples.then(|| topple(game.world(), seed)).flatten().into_iter().collect();
        let push = changes.push.as_ref().filter(|_| push_at == Some(step));
        let push = push.map(|(speed, _)| push_towards(2.4 * seed as f64, *speed));
        seen = game.step(&mut hands, &seen, push)?;
        let row = game.world().row();
        let force = forces(row, bulb).fold(0.0, f64::max);
        peak = peak.max(force);
        later_peak = if row.step > 10 { later_peak.max(force) } else { later_peak };
        penetration = penetration.max(row.penetration);
        let off;
        (phase, off) = hands.progress().unwrap_or_default();
        if push_at.is_none() && changes.push.as_ref().is_some_and(|(_, during)| *during == phase) {
            push_at = Some(row.step + 25);
        }
        watch(&Moment { row, phase: &phase, off, verdict: game.verdict() });
    }
}
