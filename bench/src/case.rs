//! Cases to measure: start states in the whole scene, each with a number of steps from it.

use std::sync::Arc;

use fiatlux_dynamics::{BodyId, Dynamics, Input, Model, State, StepReport};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{AttachmentRow, BodyRow, Bulb, Row, errand};
use fiatlux_sensing::{NoiseSeed, Observer, Proprioception};
use fiatlux_wbc::Balance;
use fiatlux_world::{PHYSICS_DT, SUBSTEPS, Scene, SceneConfig, SceneKind, SceneSpec, ShapeOwner, World};
use nalgebra::{Isometry3, Vector3};

use super::BenchError;

/// Control steps under the balance controller before a robot counts as settled, and those of a second, which a case lasts.
const SETTLE: usize = 500;
const SECOND: usize = 50;
/// Largest movement of the pelvis of a standing robot within a case, m.
const STILL: f64 = 0.01;
/// Where the robot stands before it falls onto the ladder, in the ladder's frame: before the treads, m.
const BEFORE_LADDER: [f64; 2] = [0.0, -0.85];
/// Speed towards the ladder with which that fall begins, m/s.
const PUSH: f64 = 0.8;
/// Height at which everything falls freely, m.
const HIGH: f64 = 100.0;
/// Pelvis height that separates standing from lying, m.
const STANDING: f64 = 0.7;
const LYING: f64 = 0.35;

/// A start state and how many steps are measured from it.
#[derive(Debug, Clone)]
pub struct Case {
    pub name: &'static str,
    pub model: Arc<Model>,
    pub start: State,
    /// Joint targets by drive, rad, one set for each control step; the last is held.
    pub targets: Vec<Vec<f64>>,
    pub steps: usize,
}

/// All cases, `standing` first. Each holds the whole scene of layout seed 0: room, bench with both bulbs standing on it,
/// crate, fixture, ladder below it, robot. Gains are the published ones.
///
/// [`BenchError`]: the scene cannot be built, or a start state is not reached.
/// The scene cannot be built, or a start state does not come about.
pub fn cases() -> Result<Vec<Case>, BenchError> {
    let stage = Stage::new()?;
    let standing = stage.standing_case("standing", &stage.joint_q0)?;
    let fist = hand_closed_on_nothing(&stage)?;
    Ok(vec![standing, fall_onto_ladder(&stage)?, lying(&stage)?, free_fall(&stage)?, fist])
}

/// A world in which the robot of case `standing` stands, with its joint targets, rad in the public order.
pub(crate) fn standing_world() -> Result<(World, Vec<f64>), BenchError> {
    let stage = Stage::new()?;
    let standing = stage.balanced("many worlds", &stage.joint_q0)?;
    let targets = standing.world.row().joint_target.clone();
    Ok((standing.world, targets))
}

/// Pushed over in front of the ladder: one second from the first touch.
fn fall_onto_ladder(stage: &Stage) -> Result<Case, BenchError> {
    let name = "falling onto the ladder";
    let scene = &stage.scene;
    let mut state = stage.start.clone();
    let [x, y] = BEFORE_LADDER;
    let ladder_from_pelvis = Isometry3::new(Vector3::new(x, y, 0.0), Vector3::z() * std::f64::consts::FRAC_PI_2);
    let mut world_from_pelvis = scene.world_from(errand::LADDER) * ladder_from_pelvis;
    world_from_pelvis.translation.z = stage.world_from_pelvis.translation.z;
    state.set_pose(&scene.model, scene.robot_ids.root, &world_from_pelvis);
    let push = world_from_pelvis.rotation * Vector3::new(PUSH, 0.0, 0.0);
    state.qvel[scene.robot_ids.root_dof..scene.robot_ids.root_dof + 3].copy_from_slice(push.as_slice());

    let mut start = None;
    stage.play(&mut state, &stage.q0, 3.0, |before, dynamics| {
        if start.is_none() && stage.touches_ladder(dynamics) {
            start = Some(before.clone());
        }
    });
    let start = start.ok_or_else(|| BenchError::Start { case: name, problem: "the robot missed the ladder".into() })?;
    let case = stage.case(name, start, &stage.q0);
    let mut touching = 0;
    let seconds = case.steps as f64 * PHYSICS_DT;
    stage.play(&mut case.start.clone(), &stage.q0, seconds, |_, d| touching += usize::from(stage.touches_ladder(d)));
    if touching * 2 < case.steps {
        let problem =
            format!("the robot leans on the ladder in {touching} of {} steps; at least half expected", case.steps);
        return Err(BenchError::Start { case: name, problem });
    }
    Ok(case)
}

/// At rest on the floor after a fall under zero action.
fn lying(stage: &Stage) -> Result<Case, BenchError> {
    let name = "lying";
    let mut start = stage.start.clone();
    stage.play(&mut start, &stage.q0, 6.0, |_, _| {});
    stage.check_pelvis(name, &start, "below", |z| z < LYING)?;
    Ok(stage.case(name, start, &stage.q0))
}

/// Everything that can move, high above the room and starting at rest.
fn free_fall(stage: &Stage) -> Result<Case, BenchError> {
    let name = "free fall";
    let mut start = stage.start.clone();
    for (index, body) in stage.scene.model.bodies().iter().enumerate().skip(1) {
        if body.root == BodyId(index) {
            start.qpos[body.qpos_start + 2] += HIGH;
        }
    }
    let case = stage.case(name, start, &stage.q0);
    let mut loaded = 0;
    stage.play(&mut case.start.clone(), &stage.q0, 1.0, |_, dynamics| {
        loaded += dynamics.contacts().iter().filter(|contact| contact.force.norm() > 0.0).count();
    });
    if loaded > 0 {
        return Err(BenchError::Start { case: name, problem: format!("{loaded} contacts in the air; none expected") });
    }
    Ok(case)
}

/// Standing, with the right hand closed to a fist.
fn hand_closed_on_nothing(stage: &Stage) -> Result<Case, BenchError> {
    let mut staged = stage.joint_q0.clone();
    for (joint, target) in stage.scene.robot.joints().iter().zip(&mut staged) {
        if joint.name.starts_with("R_") {
            *target = joint.lower + 0.9 * (joint.upper - joint.lower);
        }
    }
    stage.standing_case("hand closed on nothing", &staged)
}

/// Stands the old bulb on the bench, since it would fall out of the socket, whose hold is not part of the engine.
/// Returns its pose; the identity if there is no bulb or no bench.
pub(super) fn stand_old_bulb_on_bench(scene: &Scene, state: &mut State) -> Isometry3<f64> {
    let (Some(world_from_bench), Some(old_bulb)) = (scene.world_from_bench, scene.body(errand::OLD_BULB)) else {
        return Isometry3::identity();
    };
    let bench = &scene.config.bench;
    let [x, y] = bench.bulb_spot;
    let spot = world_from_bench.translation.vector + Vector3::new(x - 0.4, y, bench.surface_height);
    let world_from_bulb = scene.world_from_standing_bulb(Bulb::Old, spot);
    state.set_pose(&scene.model, old_bulb, &world_from_bulb);
    world_from_bulb
}

/// The scene with both bulbs on the bench and the robot at q0 in its zone.
struct Stage {
    scene: Arc<Scene>,
    model: Arc<Model>,
    start: State,
    /// Targets at the standing posture, by drive and by joint, rad.
    q0: Vec<f64>,
    joint_q0: Vec<f64>,
    world_from_pelvis: Isometry3<f64>,
    world_from_old_bulb: Isometry3<f64>,
}

impl Stage {
    fn new() -> Result<Self, BenchError> {
        let robot = Arc::new(Robot::benchmark().map_err(|e| BenchError::Scene(e.into()))?);
        let config = SceneConfig::default();
        let spec = SceneSpec::new(SceneKind::CoupledLadder, 0, robot.gains(GainSet::Fiatlux));
        let scene = Scene::build(&config, robot.clone(), spec).map_err(|e| BenchError::Scene(e.into()))?;

        let mut start = scene.model.reference_state();
        let mut q0 = vec![0.0; scene.model.drives().len()];
        for (ids, &angle) in scene.robot_ids.joints.iter().zip(robot.q0()) {
            start.qpos[ids.qpos] = angle;
            q0[ids.drive] = angle;
        }
        let world_from_pelvis = scene.layout.robot.world_from_place(robot.standing_height());
        start.set_pose(&scene.model, scene.robot_ids.root, &world_from_pelvis);
        let world_from_old_bulb = stand_old_bulb_on_bench(&scene, &mut start);
        let (model, scene, joint_q0) = (Arc::new(scene.model.clone()), Arc::new(scene), robot.q0().to_vec());
        Ok(Self { model, scene, start, q0, joint_q0, world_from_pelvis, world_from_old_bulb })
    }

    /// The robot settled under the balance controller, its upper body at the `staged` targets, rad in the public order.
    fn balanced(&self, case: &'static str, staged: &[f64]) -> Result<Standing, BenchError> {
        let failed = |problem: String| BenchError::Start { case, problem };
        let robot = &self.scene.robot;
        let mut world = World::new(self.scene.clone());
        let mut row = world.row().clone();
        row.robot = BodyRow::at_rest(self.world_from_pelvis);
        row.things[errand::OLD_BULB] = BodyRow::at_rest(self.world_from_old_bulb);
        row.joint_position.clone_from(&self.joint_q0);
        row.attachments.fill(AttachmentRow::FREE);
        world.reset_to(&row).map_err(|e| failed(e.to_string()))?;

        let balance = Balance::new(robot.clone(), self.scene.spec.gains.clone(), &self.joint_q0)
            .map_err(|e| failed(e.to_string()))?;
        let observer = Observer::new(self.joint_q0.clone(), Some(NoiseSeed { seed: 0, episode: 0 }));
        let mut standing = Standing { world, balance, observer, staged: staged.to_vec() };
        for _ in 0..SETTLE {
            standing.step().map_err(failed)?;
        }
        self.check_pelvis(case, standing.world.state(), "above", |z| z > STANDING)?;
        Ok(standing)
    }

    /// Continues [`Stage::balanced`] for a second. Every simulator replays the recorded targets, since MuJoCo has no
    /// controller. Without a controller the robot would eventually tip over; within the second it must stay in place.
    fn standing_case(&self, name: &'static str, staged: &[f64]) -> Result<Case, BenchError> {
        let mut standing = self.balanced(name, staged)?;
        let start = standing.world.state().clone();
        let mut record = Vec::new();
        for _ in 0..SECOND {
            let row = standing.step().map_err(|problem| BenchError::Start { case: name, problem })?;
            let mut targets = self.q0.clone();
            for (ids, &target) in self.scene.robot_ids.joints.iter().zip(&row.joint_target) {
                targets[ids.drive] = target;
            }
            record.push(targets);
        }
        let case = Case { targets: record, ..self.case(name, start, &self.q0) };
        let (mut dynamics, mut end) = (Dynamics::new(&self.model), case.start.clone());
        for step in 0..case.steps {
            case.step(&mut dynamics, &mut end, step);
        }
        let at = self.scene.robot_ids.root_qpos;
        let pelvis = |state: &State| Vector3::from_column_slice(&state.qpos[at..at + 3]);
        let moved = (pelvis(&end) - pelvis(&case.start)).norm();
        if moved > STILL {
            let problem = format!("the pelvis moved by {moved:.4} m in a second; less than {STILL} m expected");
            return Err(BenchError::Start { case: name, problem });
        }
        Ok(case)
    }

    fn case(&self, name: &'static str, start: State, targets: &[f64]) -> Case {
        Case { name, model: self.model.clone(), start, targets: vec![targets.to_vec()], steps: SECOND * SUBSTEPS }
    }

    /// Steps for that time; `look` receives the state before each step and the world after it.
    fn play(&self, state: &mut State, targets: &[f64], seconds: f64, mut look: impl FnMut(&State, &Dynamics)) {
        let mut dynamics = Dynamics::new(&self.model);
        for _ in 0..(seconds / PHYSICS_DT).round() as usize {
            let before = state.clone();
            dynamics.step(&self.model, state, &Input { targets, ..Input::default() }, PHYSICS_DT);
            look(&before, &dynamics);
        }
    }

    fn check_pelvis(
        &self,
        case: &'static str,
        state: &State,
        expected: &str,
        ok: impl Fn(f64) -> bool,
    ) -> Result<(), BenchError> {
        let z = state.qpos[self.scene.robot_ids.root_qpos + 2];
        let limit = if expected == "above" { STANDING } else { LYING };
        let problem = format!("the pelvis is at {z:.2} m; {expected} {limit} m expected");
        if ok(z) { Ok(()) } else { Err(BenchError::Start { case, problem }) }
    }

    fn touches_ladder(&self, dynamics: &Dynamics) -> bool {
        dynamics.contacts().iter().any(|contact| {
            let owners = [contact.shape_a, contact.shape_b].map(|shape| self.scene.owner(shape));
            let robot = owners.iter().any(|owner| matches!(owner, ShapeOwner::Robot(_)));
            robot && owners.contains(&ShapeOwner::LADDER) && contact.force.norm() > 0.0
        })
    }
}

/// A robot that stands by the balance controller and what it senses, with the published noise.
struct Standing {
    world: World,
    balance: Balance,
    observer: Observer,
    /// Targets of all joints, rad.
    staged: Vec<f64>,
}

impl Standing {
    /// Takes a control step; an error says what failed.
    fn step(&mut self) -> Result<&Row, String> {
        let mut seen = Proprioception::zeros(0);
        self.observer.observe(self.world.row(), &mut seen);
        let targets = self.balance.step(&seen.view(), &self.staged).map_err(|e| e.to_string())?;
        let action = vec![0.0; targets.len()];
        self.world.step(&action, targets).map_err(|e| e.to_string())
    }
}

impl Case {
    /// Takes physics step `number` of the case.
    pub(crate) fn step(&self, dynamics: &mut Dynamics, state: &mut State, number: usize) -> StepReport {
        let targets = &self.targets[(number / SUBSTEPS).min(self.targets.len() - 1)];
        dynamics.step(&self.model, state, &Input { targets, ..Input::default() }, PHYSICS_DT)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each start state is what its name says; `cases` checks the robot's position.
    #[test]
    fn cases_come_about() {
        let cases = cases().expect("the published scene gives all cases");
        let mut contacts = Vec::new();
        for case in &cases {
            let (mut dynamics, mut state) = (Dynamics::new(&case.model), case.start.clone());
            let mut sum = 0;
            for step in 0..case.steps {
                let report = case.step(&mut dynamics, &mut state, step);
                assert!(report.converged, "{}: step {step} did not converge", case.name);
                sum += report.contacts;
            }
            assert!(state.qpos.iter().all(|q| q.is_finite()), "{}", case.name);
            contacts.push((case.name, f64::from(sum) / case.steps as f64));
        }
        let of = |name| contacts.iter().find(|(n, _)| *n == name).map_or(0.0, |(_, count)| *count);
        assert_eq!(of("free fall"), 0.0);
        assert!(of("hand closed on nothing") > of("standing"), "the fist's links touch each other: {contacts:?}");
    }
}
