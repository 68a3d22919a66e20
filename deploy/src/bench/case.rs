//! What is measured: start states in the whole scene, each with a number of steps from it.

use std::sync::Arc;

use fiatlux_dynamics::{BodyId, Dynamics, Input, Model, State, StepReport};
use fiatlux_robot::{GainSet, HandKind, Robot};
use fiatlux_rules::Bulb;
use fiatlux_world::{PHYSICS_DT, Scene, SceneConfig, SceneKind, SceneSpec, ShapeOwner, World};
use nalgebra::{Isometry3, Vector3};

use super::BenchError;

/// Stiffness and damping of the ankles, in units of their own, with which the robot stands without a controller.
pub(super) const FIRM_ANKLES: f64 = 8.0;
/// How far their pitch targets are from q0, rad: the lever of the weight before the ankles needs as much. Without it even
/// firm ankles let the robot tip over its toes, in MuJoCo too.
pub(super) const ANKLE_LEAN: f64 = 0.06;
/// Where the robot stands before it falls onto the ladder, in the ladder's frame: before the treads, m.
const BEFORE_LADDER: [f64; 2] = [0.0, -0.85];
/// Speed towards the ladder with which that fall begins, m/s.
const PUSH: f64 = 0.8;
/// Height at which everything falls freely, m.
const HIGH: f64 = 100.0;
/// Pelvis heights that tell a standing robot from a lying one, m.
const STANDING: f64 = 0.7;
const LYING: f64 = 0.35;

/// A start state and how many steps are measured from it.
#[derive(Debug, Clone)]
pub struct Case {
    /// Name in reports.
    pub name: &'static str,
    /// The scene's model.
    pub model: Arc<Model>,
    /// Start.
    pub start: State,
    /// Joint targets, rad, held all along.
    pub targets: Vec<f64>,
    /// Physics steps from the start.
    pub steps: usize,
}

/// All cases, `standing` first. Each holds the whole scene of layout seed 0: room, bench with both bulbs standing on it,
/// crate, fixture, ladder below it, robot.
///
/// # Errors
/// The scene cannot be built, or a start state does not come about.
pub fn cases() -> Result<Vec<Case>, BenchError> {
    let firm = Stage::new(FIRM_ANKLES)?;
    let soft = Stage::new(1.0)?;
    let standing = standing(&firm)?;
    let fist = hand_closed_on_nothing(&firm, &standing)?;
    Ok(vec![standing, fall_onto_ladder(&soft)?, lying(&soft)?, free_fall(&soft)?, fist])
}

/// The robot at q0 on firm ankles, settled.
fn standing(stage: &Stage) -> Result<Case, BenchError> {
    let name = "standing";
    let (mut start, mut targets) = (stage.start.clone(), stage.q0.clone());
    for (target, ids) in stage.standing_targets().into_iter().zip(&stage.scene.robot_ids.joints) {
        targets[ids.drive] = target;
    }
    stage.play(&mut start, &targets, 5.0, |_, _| {});
    stage.check_pelvis(name, &start, "above", |z| z > STANDING)?;
    Ok(stage.case(name, start, &targets))
}

/// A world in which the robot of `standing` stands, and its joint targets, rad in the public order.
pub(crate) fn standing_world() -> Result<(World, Vec<f64>), BenchError> {
    let stage = Stage::new(FIRM_ANKLES)?;
    let targets = stage.standing_targets();
    let mut world = World::new(stage.scene.clone());
    let action = vec![0.0; targets.len()];
    for _ in 0..250 {
        world.step(&action, &targets).map_err(|e| BenchError::Scene(e.into()))?;
    }
    stage.check_pelvis("many worlds", world.state(), "above", |z| z > STANDING)?;
    Ok((world, targets))
}

/// Pushed over before the ladder: one second from the first touch.
fn fall_onto_ladder(stage: &Stage) -> Result<Case, BenchError> {
    let name = "falling onto the ladder";
    let scene = &stage.scene;
    let mut state = stage.start.clone();
    let [x, y] = BEFORE_LADDER;
    let ladder_from_pelvis = Isometry3::new(Vector3::new(x, y, 0.0), Vector3::z() * std::f64::consts::FRAC_PI_2);
    let mut world_from_pelvis = scene.world_from_ladder * ladder_from_pelvis;
    world_from_pelvis.translation.z = stage.standing_height;
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

/// On the floor after a fall under zero action, settled.
fn lying(stage: &Stage) -> Result<Case, BenchError> {
    let name = "lying";
    let mut start = stage.start.clone();
    stage.play(&mut start, &stage.q0, 6.0, |_, _| {});
    stage.check_pelvis(name, &start, "below", |z| z < LYING)?;
    Ok(stage.case(name, start, &stage.q0))
}

/// Everything that can move, high above the room and at rest.
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

/// Standing, the right hand closed to a fist.
fn hand_closed_on_nothing(stage: &Stage, standing: &Case) -> Result<Case, BenchError> {
    let (scene, name) = (&stage.scene, "hand closed on nothing");
    let mut targets = standing.targets.clone();
    for (joint, ids) in scene.robot.joints().iter().zip(&scene.robot_ids.joints) {
        if joint.name.starts_with("R_") {
            targets[ids.drive] = joint.lower + 0.9 * (joint.upper - joint.lower);
        }
    }
    let mut start = standing.start.clone();
    stage.play(&mut start, &targets, 1.0, |_, _| {});
    stage.check_pelvis(name, &start, "above", |z| z > STANDING)?;
    Ok(stage.case(name, start, &targets))
}

/// The scene with both bulbs on the bench and the robot at q0 in its zone.
struct Stage {
    scene: Arc<Scene>,
    model: Arc<Model>,
    start: State,
    q0: Vec<f64>,
    standing_height: f64,
}

impl Stage {
    fn new(ankle_factor: f64) -> Result<Self, BenchError> {
        let robot = Arc::new(Robot::with_hands(HandKind::default()).map_err(|e| BenchError::Scene(e.into()))?);
        let mut gains = robot.gains(GainSet::Fiatlux);
        let ankles = (0..robot.joints().len()).filter(|&i| robot.joints()[i].name.contains("ankle"));
        gains.scale(ankles, ankle_factor);
        let config = SceneConfig::default();
        let spec = SceneSpec::new(SceneKind::CoupledLadder, 0, gains);
        let scene = Scene::build(&config, robot.clone(), spec).map_err(|e| BenchError::Scene(e.into()))?;

        let mut start = scene.model.reference_state();
        let mut q0 = vec![0.0; scene.model.drives().len()];
        for (ids, &angle) in scene.robot_ids.joints.iter().zip(robot.q0()) {
            start.qpos[ids.qpos] = angle;
            q0[ids.drive] = angle;
        }
        let standing_height = robot.standing_height();
        let world_from_pelvis = scene.layout.robot.world_from_place(standing_height);
        start.set_pose(&scene.model, scene.robot_ids.root, &world_from_pelvis);
        // The socket's hold is no part of the physics: without it the old bulb would fall out, so it stands on the bench.
        if let (Some(bench), Some(old_bulb)) = (scene.world_from_bench, scene.old_bulb) {
            let [x, y] = config.bench.bulb_spot;
            let spot = bench.translation.vector + Vector3::new(x - 0.4, y, config.bench.surface_height);
            start.set_pose(&scene.model, old_bulb, &scene.world_from_standing_bulb(Bulb::Old, spot));
        }
        Ok(Self { model: Arc::new(scene.model.clone()), scene: Arc::new(scene), start, q0, standing_height })
    }

    /// With which the robot stands on firm ankles; by joint.
    fn standing_targets(&self) -> Vec<f64> {
        let (joints, q0) = (self.scene.robot.joints(), self.scene.robot.q0());
        let lean = |j: usize| if joints[j].name.ends_with("ankle_pitch_joint") { ANKLE_LEAN } else { 0.0 };
        q0.iter().enumerate().map(|(j, q0)| q0 + lean(j)).collect()
    }

    fn case(&self, name: &'static str, start: State, targets: &[f64]) -> Case {
        Case { name, model: self.model.clone(), start, targets: targets.to_vec(), steps: 200 }
    }

    /// Steps for that time; `look` sees the state before each step and the world after it.
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
            robot && owners.contains(&ShapeOwner::Ladder) && contact.force.norm() > 0.0
        })
    }
}

impl Case {
    /// One physics step.
    pub(crate) fn step(&self, dynamics: &mut Dynamics, state: &mut State) -> StepReport {
        dynamics.step(&self.model, state, &Input { targets: &self.targets, ..Input::default() }, PHYSICS_DT)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each start state is what its name says; `cases` checks where the robot is.
    #[test]
    fn cases_come_about() {
        let cases = cases().expect("the published scene gives all cases");
        let mut contacts = Vec::new();
        for case in &cases {
            let (mut dynamics, mut state) = (Dynamics::new(&case.model), case.start.clone());
            let mut sum = 0;
            for step in 0..case.steps {
                let report = case.step(&mut dynamics, &mut state);
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
