//! The start states of the tasks, from the data of their pages in `fiatlux-rules`: where the robot stands, where the
//! bulbs are, how large the noise is.
//!
//! Reset noise moves the robot and its joints (kept within their limits) off that; then the pelvis is set so high that
//! the lowest point of the soles is on what the robot stands on. A place is taken where something is nearer to the robot
//! or its bulb than the clearance, where the hand cannot close around its bulb, or where, in S05, the crate is nearly as near
//! as the gate asks for. Then S02, S05, S06, S07 and S10 start at the next free place around ladder or crate, in steps of
//! 5 degrees to either side, and the tasks on the platform up to 5 cm farther back, or else elsewhere on it. Where nothing is
//! free, or the noise puts two links into each other, it is drawn again.

mod hold;
mod place;

use std::sync::Arc;

use fiatlux_dynamics::ModelError;
use fiatlux_robot::RobotError;
use fiatlux_rules::{AttachmentRow, Bulb, Ladder, Row, Spot, Stand, StartSpec, Task, Thresholds, errand};
use nalgebra::Vector3;
use thiserror::Error;

use crate::{ACTION_SCALE, Scene, SceneKind, SceneParts, ShapeOwner, World, WorldError};

/// Options for the start of an episode.
#[derive(Debug, Clone, PartialEq)]
pub struct StartOptions {
    /// Adds the task's reset noise.
    pub reset_noise: bool,
    /// Seed that draws the reset noise, with the episode; `None` for the layout seed.
    pub seed: Option<u64>,
    /// Thresholds in force, which limit how hard a hand presses its bulb, and how near the crate S05 may start.
    pub thresholds: Thresholds,
}

impl Default for StartOptions {
    fn default() -> Self {
        Self { reset_noise: true, seed: None, thresholds: Thresholds::default() }
    }
}

/// Why a start state cannot be made.
#[derive(Debug, Clone, PartialEq, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum StartError {
    #[error("{task} starts in a {needed:?} scene and was given one of {found}; build it with SceneKind::of({task})")]
    Scene { task: Task, needed: SceneKind, found: SceneParts },
    #[error(
        "{task} seed {seed} episode {episode} plays in a scene with {what} {needed} and was given one with {found}; \
         build the scene that EpisodeSpec::scene describes"
    )]
    OtherScene { task: Task, seed: u64, episode: u64, what: &'static str, needed: String, found: String },
    #[error("scene config: {field} names '{name}', which the robot does not have")]
    Name { field: &'static str, name: String },
    #[error(
        "{task} seed {seed} episode {episode}: the {obstacle} is in the robot's way, and no other place is free; give the \
         room more space or make start.clearance smaller"
    )]
    Place { task: Task, seed: u64, episode: u64, obstacle: ShapeOwner },
    #[error(
        "{task} seed {seed} episode {episode}: the hand presses its bulb with {force_n:.2} N, not between {least_n} and \
         {most_n} N; check start.carry, hand friction and gains, or --set fragility_n"
    )]
    Hold { task: Task, seed: u64, episode: u64, force_n: f64, least_n: f64, most_n: f64 },
    #[error("cannot set the start state")]
    World(#[from] WorldError),
    #[error("cannot find where the hand is that takes the bulb")]
    Kinematics(#[from] RobotError),
    #[error("cannot find what is in the robot's way")]
    Contacts(#[from] ModelError),
}

impl SceneKind {
    /// The scene that a task is played in.
    pub fn of(task: Task) -> Self {
        match task.spec().start.ladder {
            Ladder::Free => SceneKind::FreeLadder,
            Ladder::Coupled => SceneKind::CoupledLadder,
            Ladder::Fixed => SceneKind::Climb,
        }
    }
}

/// Refuses a scene of another kind than the task needs.
pub(crate) fn check_kind(scene: &Scene, task: Task) -> Result<(), StartError> {
    let (needed, found) = (SceneKind::of(task), scene.spec.parts);
    if SceneParts::of(needed) == found { Ok(()) } else { Err(StartError::Scene { task, needed, found }) }
}

/// Offset of the robot from its nominal start, as drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct StartOffset {
    /// Offset along the world's x and y, m.
    pub shift: [f64; 2],
    /// Rotation about the vertical, rad.
    pub turn: f64,
    /// Offset of each joint in the public order, rad. An angle beyond its joint's limits stays at the limit.
    pub joints: Vec<f64>,
}

impl StartOffset {
    /// The nominal start of a robot with that many joints.
    pub fn none(joints: usize) -> Self {
        Self { shift: [0.0; 2], turn: 0.0, joints: vec![0.0; joints] }
    }
}

/// Inputs for placing and staging.
struct Start<'a> {
    scene: &'a Scene,
    task: Task,
    seed: u64,
    episode: u64,
    thresholds: &'a Thresholds,
    /// The bulb in the hand.
    carried: Option<Bulb>,
    /// Joint angles free of noise, the hand open, rad.
    posture: Vec<f64>,
}

/// A world in a task's start state of an episode; see [`start_drawn`].
///
/// # Errors
/// As [`start_drawn`].
pub fn start(scene: Arc<Scene>, task: Task, episode: u64, options: &StartOptions) -> Result<World, StartError> {
    start_drawn(scene, task, episode, options).map(|(world, _)| world)
}

/// A world in a task's start state of an episode, and the reset noise in it. Seed and episode draw the noise; where a
/// draw found no place for the robot, the noise is that of the draw that did.
///
/// Row 0 is that state at rest. Its targets are the nominal staged posture, free of noise, and its action is the same
/// in action units. A bulb in the hand is held: the row has the contact forces of the last physics step of staging.
///
/// # Errors
/// [`StartError`]: the scene is not the task's, the robot finds no place, its hand does not hold the bulb, or robot or
/// engine refused the state.
pub fn start_drawn(
    scene: Arc<Scene>,
    task: Task,
    episode: u64,
    options: &StartOptions,
) -> Result<(World, StartOffset), StartError> {
    check_kind(&scene, task)?;
    let seed = options.seed.unwrap_or(scene.spec.seed);
    let spec = &task.spec().start;
    let carried = spec.in_hand();
    let q0 = scene.robot.q0();
    let mut posture = q0.to_vec();
    let mut targets = q0.to_vec();
    if carried.is_some() {
        let carry = &scene.config.start.carry;
        hold::set_joints(&scene, "start.carry.arm", &carry.arm, &mut posture)?;
        if spec.robot == Stand::Platform {
            hold::set_joints(&scene, "start.carry.platform_arm", &carry.platform_arm, &mut posture)?;
        }
        targets.clone_from(&posture);
        for (joint, angle) in scene.bulb_grasp()?.grip {
            let limits = &scene.robot.joints()[joint];
            targets[joint] = angle.clamp(limits.lower, limits.upper);
        }
    }
    let noise = if options.reset_noise { place::noise(&scene, spec) } else { place::NO_NOISE };

    let mut world = World::new(Arc::clone(&scene));
    let mut row = world.row().clone();
    row.joint_target.clone_from(&targets);
    put_bulbs(&scene, spec, &mut row);
    let start = Start { scene: &scene, task, seed, episode, thresholds: &options.thresholds, carried, posture };
    let offset = start.put_robot(&mut world, &mut row, &noise)?;
    let action: Vec<f64> = targets.iter().zip(q0).map(|(target, q0)| (target - q0) / ACTION_SCALE).collect();
    world.begin(&action);
    Ok((world, offset))
}

/// Puts the bulbs where they start, those for the hand anywhere, and sets the socket's hold.
fn put_bulbs(scene: &Scene, spec: &StartSpec, row: &mut Row) {
    for bulb in Bulb::ALL {
        let spot = spec.spot(bulb);
        let pose = match spot {
            Spot::Socket => scene.world_from_seated_bulb(bulb),
            Spot::Crate => {
                let height = Vector3::z() * scene.config.crate_.placing_height;
                let crate_ = scene.world_from(errand::CRATE);
                scene.world_from_standing_bulb(bulb, crate_.translation.vector + height)
            }
            Spot::Bench | Spot::Parked | Spot::Hand => row.things[bulb.thing()].pose,
        };
        row.things[bulb.thing()].pose = pose;
        row.attachments[bulb as usize] = AttachmentRow { seated: spot == Spot::Socket, steps_beyond: 0 };
    }
}
