//! Worlds under violent targets.

use std::collections::BTreeMap;
use std::sync::Arc;

use fiatlux_dynamics::{ShapeId, State};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{BodyRow, Row, Task, diverged, errand};
use fiatlux_world::{Random, Scene, SceneConfig, SceneKind, SceneSpec, ShapeOwner, StartOptions, Stream, World, start};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use super::TrialReport;
use crate::BenchError;

/// Control steps of a run under violent targets and of one from a random start.
const RUN: usize = 500;
const START: usize = 50;
/// Control steps for which a random start keeps its targets.
pub(super) const HOLD: usize = 10;
/// Fastest joint of a random start, rad/s.
const START_SPEED: f64 = 5.0;
/// A run is deep if it exceeds this depth (m) in more rows than the number below (0.1 s).
const DEEP: f64 = 5e-3;
const DEEP_ROWS: usize = 5;

/// Draw of the targets in every control step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Pattern {
    /// All joints from one limit to the other and back, at 25 Hz.
    Unison,
    /// Every second joint against its neighbours.
    Alternating,
    /// Each joint to one of its limits.
    Limits,
    /// Actions of up to this many times the box [-1, 1].
    Boxes(f64),
}

pub(super) const PATTERNS: [Pattern; 8] = [
    Pattern::Unison,
    Pattern::Alternating,
    Pattern::Limits,
    Pattern::Boxes(1.0),
    Pattern::Boxes(2.0),
    Pattern::Boxes(3.0),
    Pattern::Boxes(5.0),
    Pattern::Boxes(10.0),
];

impl Pattern {
    pub fn name(self) -> String {
        match self {
            Pattern::Unison => "limits, in unison".into(),
            Pattern::Alternating => "limits, alternating".into(),
            Pattern::Limits => "limits, random".into(),
            Pattern::Boxes(boxes) => format!("random, {boxes} boxes"),
        }
    }

    /// Draws the targets of a control step, rad.
    pub fn draw(self, robot: &Robot, step: usize, random: &mut Random, targets: &mut [f64]) {
        for (index, (joint, target)) in robot.joints().iter().zip(targets).enumerate() {
            let unit = random.unit();
            let upper = match self {
                Pattern::Unison => step % 2 == 1,
                Pattern::Alternating => (step + index) % 2 == 1,
                Pattern::Limits => unit < 0.5,
                Pattern::Boxes(boxes) => {
                    *target = robot.q0()[index] + fiatlux_world::ACTION_SCALE * boxes * (2.0 * unit - 1.0);
                    continue;
                }
            };
            *target = if upper { joint.upper } else { joint.lower };
        }
    }
}

/// Shared by all runs.
pub(super) struct Trials {
    robot: Arc<Robot>,
    config: SceneConfig,
    room: Arc<Scene>,
}

impl Trials {
    pub fn new() -> Result<Self, BenchError> {
        let robot = Arc::new(Robot::benchmark().map_err(|e| BenchError::Scene(e.into()))?);
        let config = SceneConfig::default();
        let spec = SceneSpec::new(SceneKind::CoupledLadder, 0, robot.gains(GainSet::Fiatlux));
        let room = Scene::build(&config, Arc::clone(&robot), spec).map_err(|e| BenchError::Scene(e.into()))?;
        Ok(Self { robot, config, room: Arc::new(room) })
    }

    /// A task's start state; tasks and seeds rotate with the number of the run.
    pub fn start(&self, run: u64) -> Result<World, BenchError> {
        let tasks = Task::ALL.len() as u64;
        let (task, seed) = (Task::ALL[(run % tasks) as usize], run / tasks);
        let spec = SceneSpec::new(SceneKind::of(task), seed % 64, self.robot.gains(GainSet::Fiatlux));
        let scene =
            Scene::build(&self.config, Arc::clone(&self.robot), spec).map_err(|e| BenchError::Scene(e.into()))?;
        start(Arc::new(scene), task, seed, &StartOptions::default()).map_err(|e| BenchError::Scene(e.into()))
    }

    /// Plays 10 s under a pattern.
    pub fn violent(&self, pattern: Pattern, run: u64) -> Result<TrialReport, BenchError> {
        let mut random = Random::of_term(Stream::Trial, &pattern.name(), run, 0);
        let mut world = self.start(run)?;
        play(&mut world, run, RUN, |step, targets| pattern.draw(&self.robot, step, &mut random, targets))
    }

    /// Plays 1 s from a posture that touches nothing, anywhere near the ladder, towards random targets.
    pub fn random_start(&self, index: u64) -> Result<TrialReport, BenchError> {
        let (mut world, sets) = self.start_and_targets(index)?;
        play(&mut world, index, START, |step, targets| targets.copy_from_slice(&sets[step / HOLD]))
    }

    /// A random start and its targets, rad, each for [`HOLD`] control steps.
    pub fn start_and_targets(&self, index: u64) -> Result<(World, [Vec<f64>; START / HOLD]), BenchError> {
        let mut random = Random::of_term(Stream::Trial, "start", index, 0);
        let mut world = World::new(Arc::clone(&self.room));
        let mut row = world.row().clone();
        loop {
            self.draw_start(&mut row, &mut random);
            world.reset_to(&row).map_err(|e| BenchError::Scene(e.into()))?;
            if !self.touches(world.state())? {
                break;
            }
        }
        let sets = std::array::from_fn(|_| {
            self.robot.joints().iter().map(|joint| random.uniform(joint.lower, joint.upper)).collect()
        });
        Ok((world, sets))
    }

    fn draw_start(&self, row: &mut Row, random: &mut Random) {
        let ladder = self.room.world_from(errand::LADDER).translation.vector;
        let at = Vector3::new(
            ladder.x + random.uniform(-1.2, 1.2),
            ladder.y + random.uniform(-1.2, 1.2),
            random.uniform(0.5, 2.0),
        );
        let [roll, pitch, yaw] = [0.6, 0.6, std::f64::consts::PI].map(|most| random.uniform(-most, most));
        let rotation = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
        row.robot = BodyRow::at_rest(Isometry3::from_parts(at.into(), rotation));
        for (index, joint) in self.robot.joints().iter().enumerate() {
            row.joint_position[index] = random.uniform(joint.lower, joint.upper);
            row.joint_velocity[index] = random.uniform(-START_SPEED, START_SPEED);
        }
    }

    fn touches(&self, state: &State) -> Result<bool, BenchError> {
        let contacts = self.room.model.contacts_at(&state.qpos, 0.0).map_err(|e| BenchError::Scene(e.into()))?;
        let robot = |shape: ShapeId| matches!(self.room.owner(shape), ShapeOwner::Robot(_));
        Ok(contacts.iter().any(|contact| robot(contact.shape_a) || robot(contact.shape_b)))
    }
}

/// Plays the given number of control steps, or until the state has diverged.
fn play(
    world: &mut World,
    run: u64,
    steps: usize,
    mut draw: impl FnMut(usize, &mut [f64]),
) -> Result<TrialReport, BenchError> {
    let scene = Arc::clone(world.scene());
    let mut report = TrialReport { runs: 1, deepest_run: run, ..TrialReport::default() };
    let mut targets = world.row().joint_target.clone();
    let action = vec![0.0; targets.len()];
    let (mut rows_deep, mut deepest) = (0, (0.0, String::new()));
    for step in 0..steps {
        draw(step, &mut targets);
        let row = world.step(&action, &targets).map_err(|e| BenchError::Scene(e.into()))?;
        report.steps += fiatlux_world::SUBSTEPS as u64;
        report.retried += u64::from(row.retried);
        report.unconverged += u64::from(row.unconverged);
        report.joint_speed = report.joint_speed.max(row.joint_speed_peak);
        report.pelvis_speed = report.pelvis_speed.max(row.robot.linear_velocity.norm());
        let (penetration, ended) = (row.penetration, diverged(row));
        rows_deep = if penetration > DEEP { rows_deep + 1 } else { 0 };
        let is_deep = rows_deep > DEEP_ROWS;
        report.penetration = report.penetration.max(penetration);
        if is_deep {
            report.deep_runs = 1;
            deepest = deeper(&scene, world, deepest);
        }
        if ended {
            report.diverged = 1;
            break;
        }
    }
    if report.deep_runs > 0 {
        report.deep_pairs = BTreeMap::from([(deepest.1, (1, deepest.0))]);
    }
    Ok(report)
}

fn deeper(scene: &Scene, world: &World, deepest: (f64, String)) -> (f64, String) {
    let contacts = world.dynamics().contacts();
    let name = |shape: ShapeId| scene.model.shapes()[shape.0].name.as_str();
    match contacts.iter().min_by(|a, b| a.distance.total_cmp(&b.distance)) {
        Some(contact) if -contact.distance > deepest.0 => {
            (-contact.distance, format!("{} and {}", name(contact.shape_a), name(contact.shape_b)))
        }
        _ => deepest,
    }
}
