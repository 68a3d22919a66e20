//! One episode of `climb`, without a server.

use std::error::Error;
use std::f64::consts::FRAC_PI_2;

use fiatlux_client::Policy;
use fiatlux_dynamics::{BodyVariation, Dynamics, Input, ShapeId, State, Variation};
use fiatlux_policies::Climb;
use fiatlux_rules::{CONTROL_DT, Cause, Protocol, Row, Task, Verdict, errand};
use fiatlux_skills::path::Map;
use fiatlux_world::{ACTION_SCALE, PHYSICS_DT, PropScale, SUBSTEPS, Scene, ShapeOwner, World};
use nalgebra::{Isometry3, Point3, Vector3};

#[path = "../game/mod.rs"]
mod game;

use game::{Game, SPREAD, Start, push_towards};

/// Speed of a joint from which physics steps are looked at one by one, rad/s.
const FAST: f64 = 10.0;
/// Least force that counts as a touch, N.
const TOUCH: f64 = 0.1;
/// Parts of a limit that are told apart.
const BINS: usize = 1000;
/// Where the ladder's steps end on the floor, in its frame, m.
const STEPS_Y: f64 = -0.49;
/// The golden ratio: multiples of it spread times and masses over the rooms.
const RATIO: f64 = 0.618_034;

/// Differences of an episode from the benchmark's.
#[derive(Debug, Clone, Default)]
pub struct Changes {
    /// Friction of the ladder's shapes; it holds between ladder and soles, whose own is 0.5, and not on the floor, whose own is 1.
    pub friction: Option<f64>,
    pub scale: PropScale,
    /// Factor of every mass of the robot, less 1, and the largest part by which each link's differs from that.
    pub mass: f64,
    pub masses: f64,
    /// Control steps until an action has an effect.
    pub delay: usize,
    /// Speed that the whole robot gets once while it climbs, m/s: in each room at another time, in another direction.
    pub push: Option<f64>,
    /// Angles of shoulders and elbows at which the arms are when it begins, rad: roll and elbow, as `ladder` leaves them.
    pub arms: Option<[f64; 2]>,
}

/// The figures of an episode.
#[derive(Debug)]
pub struct Played {
    pub cause: Cause,
    pub seconds: f64,
    /// Time in the plan and of the whole plan, s.
    pub progress: Option<(f64, f64)>,
    /// Of the pelvis at the end, m.
    pub height: f64,
    /// Way of the ladder, m, and its largest tilt, rad.
    pub ladder: (f64, f64),
    /// Largest effort of a joint relative to its limit, as measured at the ends of steps.
    pub effort: f64,
    /// The loads, once the robot is on its way.
    #[allow(dead_code)]
    pub loads: Loads,
}

/// Loads of robot and bulb, at the ends of control steps where nothing else is said.
#[derive(Debug, Clone)]
pub struct Loads {
    /// For each joint, how often its effort was which thousandth of its limit; the last one counts what is at the limit.
    pub efforts: Vec<[u32; BINS + 1]>,
    /// For each joint, its largest speed in all physics steps, in parts of the rated one; below 10 rad/s, at the ends of control steps.
    pub speeds: Vec<f64>,
    /// Depth of the deepest contact in all physics steps, m.
    pub penetration: f64,
    /// Largest force on a part of the robot other than its feet, of all but the robot and the bulbs, N, and both names.
    pub touch: (f64, String),
    /// Step of the first of them, and both names.
    pub first_touch: Option<(u64, String)>,
    /// Largest force of the bulb on a body of the hand in all physics steps, N.
    pub grip: f64,
    /// Rows in which the strict rules do not have the bulb in the grip of a hand, and the longest run of them.
    pub loose: (u32, u32),
}

/// A state of an episode, for whoever watches.
#[allow(dead_code)]
pub struct Moment<'a> {
    pub row: &'a Row,
    /// Time in the plan, s.
    pub time: Option<f64>,
    pub verdict: &'a Verdict,
}

impl Loads {
    fn new(joints: usize) -> Self {
        Self {
            efforts: vec![[0; BINS + 1]; joints],
            speeds: vec![0.0; joints],
            penetration: 0.0,
            touch: (0.0, String::new()),
            first_touch: None,
            grip: 0.0,
            loose: (0, 0),
        }
    }

    fn take(&mut self, world: &World) {
        let (row, scene) = (world.row(), world.scene());
        for (joint, gains) in scene.spec.gains.0.iter().enumerate() {
            let share = row.joint_effort[joint].abs() / gains.effort_limit;
            self.efforts[joint][((BINS as f64 * share) as usize).min(BINS)] += 1;
            self.speeds[joint] = self.speeds[joint].max(row.joint_velocity[joint].abs() / gains.speed_limit);
        }
        self.penetration = self.penetration.max(row.penetration);
        let peaks = errand::HAND_FORCE_PEAK.iter().flat_map(|load| row.load(*load));
        self.grip = peaks.copied().fold(self.grip, f64::max);
        for contact in world.dynamics().contacts() {
            let [a, b] = [contact.shape_a, contact.shape_b].map(|shape| (scene.owner(shape), shape));
            let (link, other) = match (a.0, b.0) {
                (ShapeOwner::Robot(_), ShapeOwner::Robot(_)) => continue,
                (ShapeOwner::Robot(link), _) => (link, b),
                (_, ShapeOwner::Robot(link)) => (link, a),
                _ => continue,
            };
            let is_bulb = matches!(other.0, ShapeOwner::OLD_BULB | ShapeOwner::FRESH_BULB);
            let force = contact.force.norm();
            if is_bulb || scene.robot.feet().contains(&link) || force < TOUCH {
                continue;
            }
            let names = || format!("{} on {}", scene.model.shapes()[other.1.0].name, scene.robot.links()[link].name);
            self.first_touch.get_or_insert_with(|| (row.step, names()));
            if force > self.touch.0 {
                self.touch = (force, names());
            }
        }
    }
}

/// The last control step once more, to see which joint was the fast one in it. Without attachments, which do not act on the robot.
fn see_speeds(world: &World, state: &mut State, again: &mut Dynamics, speeds: &mut [f64]) {
    let (scene, row) = (world.scene(), world.row());
    let mut targets = vec![0.0; scene.model.drives().len()];
    scene.robot_ids.joints.iter().zip(&row.joint_target).for_each(|(ids, target)| targets[ids.drive] = *target);
    for _ in 0..SUBSTEPS {
        again.step(&scene.model, state, &Input { targets: &targets, ..Input::default() }, PHYSICS_DT);
        for ((ids, gains), speed) in scene.robot_ids.joints.iter().zip(&scene.spec.gains.0).zip(speeds.iter_mut()) {
            *speed = speed.max(state.qvel[ids.dof].abs() / gains.speed_limit);
        }
    }
}

/// Pose of the pelvis in the ladder's frame with x into it from the side of its steps.
pub fn ladder_from_pelvis(row: &Row) -> Isometry3<f64> {
    let ladder = row.things[errand::LADDER].pose * Isometry3::rotation(Vector3::z() * FRAC_PI_2);
    ladder.inverse() * row.robot.pose
}

/// Distance from the middle of the ladder's steps to the nearest wall or thing, m, as an episode begins.
#[allow(dead_code)]
pub fn before_the_steps(task: Task, seed: u64) -> Result<f64, Box<dyn Error>> {
    let game = Game::start(Start::of(task, seed)?)?;
    let steps = game.world().row().things[errand::LADDER].pose * Point3::new(0.0, STEPS_Y, 0.0);
    let things = Map::outlines(&game.info, [0.1, 1.9]).filter(|(name, _)| name != "ladder");
    Ok(Map::new(things, 0.0).clearance([steps.x, steps.y]))
}

fn variation(scene: &Scene, seed: u64, changes: &Changes) -> Variation {
    let mut variation = Variation::default();
    if let Some(friction) = changes.friction {
        let shapes = (0..scene.model.shapes().len()).map(ShapeId);
        variation.frictions =
            shapes.filter(|shape| scene.owner(*shape) == ShapeOwner::LADDER).map(|shape| (shape, friction)).collect();
    }
    if changes.mass != 0.0 || changes.masses != 0.0 {
        for (index, ids) in scene.robot_ids.links.iter().enumerate() {
            let drawn = (RATIO * (1 + seed * 61 + index as u64) as f64).fract();
            let mass = 1.0 + changes.mass + changes.masses * (2.0 * drawn - 1.0);
            variation.bodies.push((ids.body, BodyVariation { mass, ..BodyVariation::default() }));
        }
    }
    variation
}

/// Plays the first episode of a room. `watch` is given each state.
pub fn play(
    mut climb: Climb,
    task: Task,
    seed: u64,
    changes: &Changes,
    mut watch: impl FnMut(&Moment<'_>),
) -> Result<Played, Box<dyn Error>> {
    let mut start = Start { delay: changes.delay, ..Start::of(task, seed)? };
    start.spec.scale = changes.scale;
    let mut game = Game::start_varied(start, |scene| variation(scene, seed, changes))?;
    let mut seen = game.observe()?;
    if let Some([roll, elbow]) = changes.arms {
        for (joint, action) in game.world().scene().robot.joints().iter().zip(&mut seen.last_action) {
            let angle = match joint.name.as_str() {
                "left_shoulder_roll_joint" => roll,
                "right_shoulder_roll_joint" => -roll,
                "left_elbow_joint" | "right_elbow_joint" => elbow,
                _ => continue,
            };
            *action = (angle / ACTION_SCALE) as f32;
        }
    }
    climb.reset(&game.info, &seen)?;
    let gains = game.world().scene().spec.gains.clone();
    let first = game.world().row().things[errand::LADDER].pose;
    let grip =
        task.spec().gate.criteria_of(Protocol::Strict).position(|criterion| criterion.name.ends_with("_in_grip"));
    let (mut ladder, mut effort, mut loads, mut loose) = ((0.0_f64, 0.0_f64), 0.0_f64, Loads::new(gains.0.len()), 0);
    let climbing = match task {
        Task::S02 | Task::S10 => [20.0, 44.0],
        Task::Climb => [20.0, 80.0],
        _ => [8.0, 86.0],
    };
    let (mut is_pushed, mut again) = (false, game.world().dynamics().clone());
    loop {
        let row = game.world().row();
        let now = row.things[errand::LADDER].pose;
        let moved = (now.translation.vector - first.translation.vector).norm();
        ladder = (ladder.0.max(moved), ladder.1.max(now.rotation.angle_to(&first.rotation)));
        let shares = row.joint_effort.iter().zip(&gains.0).map(|(effort, gains)| effort.abs() / gains.effort_limit);
        effort = shares.fold(effort, f64::max);
        loads.take(game.world());
        let holds = grip.is_none_or(|grip| game.verdict().criteria.as_slice()[grip]);
        loose = if holds { 0 } else { loose + 1 };
        loads.loose = (loads.loose.0 + u32::from(!holds), loads.loose.1.max(loose));
        let progress = climb.progress();
        watch(&Moment { row, time: progress.map(|(time, _)| time), verdict: game.verdict() });
        if let Some(end) = game.verdict().end {
            let height = row.robot.pose.translation.z;
            return Ok(Played {
                cause: end.cause(),
                seconds: end.step as f64 * CONTROL_DT,
                progress,
                height,
                ladder,
                effort,
                loads,
            });
        }
        let part = (RATIO * (seed + 1) as f64).fract();
        let due = climbing[0] + part * (climbing[1] - climbing[0]);
        let is_due = !is_pushed && game.seconds() > due;
        let push = changes.push.filter(|_| is_due).map(|speed| push_towards(SPREAD * seed as f64, speed));
        is_pushed |= is_due;
        let mut state = game.world().state().clone();
        seen = game.step(&mut climb, &seen, push)?;
        if push.is_none() && game.world().row().joint_speed_peak > FAST {
            see_speeds(game.world(), &mut state, &mut again, &mut loads.speeds);
        }
    }
}
