//! Content of the page: the room as a document, and its state after each control step as bytes.

use fiatlux_proto::v3::{Observation, Pose, SessionInfo};
use fiatlux_render::Lighting;
use fiatlux_replay::Stage;
use fiatlux_robot::Robot;
use fiatlux_rules::{Motion, Task, manifest};
use fiatlux_world::{EpisodeSpec, Scene};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use serde::Serialize;

use crate::measures::{Goal, Measure};
use crate::pilot::Driven;

/// First bytes of a state.
const MAGIC: [u8; 4] = *b"FLTV";
/// Bytes before the poses of a state, see [`View::state`].
pub const HEAD_BYTES: usize = 64;
/// Share by which shown joint angles follow the sensed ones, whose noise would make the picture tremble.
const FOLLOWS: f64 = 0.5;
/// Where things are shown that the task does not have.
const NOWHERE: f64 = -100.0;

/// Document by which the page draws a room. The numbers of its surfaces are apart, see [`Stage::bytes`].
#[derive(Debug, Clone, Serialize)]
pub struct Document {
    pub stage: Stage,
    /// Numbers of a state before its poses, in bytes.
    pub head_bytes: usize,
    /// The robot's eye: the frame that carries it, its pose there as in [`fiatlux_replay::POSE`], and its view, rad.
    pub eye: Option<Eye>,
    /// Names of the gate's criteria, in the order of their bits.
    pub criteria: Vec<String>,
    /// The number behind each of them, where there is one.
    pub measures: Vec<Option<Measure>>,
    pub goal: Option<Goal>,
    pub task: String,
    pub name: String,
    pub instruction: String,
    /// In decimal digits, because a browser's numbers cannot hold all seeds.
    pub seed: String,
    /// Force on a hand that breaks a bulb, N.
    pub fragility_n: f64,
    pub control_dt: f64,
}

#[derive(Debug, Clone, Copy, Serialize)]
pub struct Eye {
    pub frame: usize,
    pub pose: [f64; 7],
    pub horizontal_fov: f64,
}

/// Name of the camera whose view the operator can take.
const EYE: &str = "camera";

impl Document {
    pub fn new(scene: &Scene, spec: &EpisodeSpec) -> Self {
        let task: Task = spec.task;
        let robot = &scene.robot;
        let stage = Stage::new(scene, &Lighting::of(&spec.light()));
        let criteria: Vec<String> =
            task.spec().gate.criteria_of(spec.protocol).map(|criterion| criterion.name.to_owned()).collect();
        let eye = robot.camera(EYE).or(robot.cameras().first());
        Self {
            head_bytes: HEAD_BYTES,
            eye: eye.map(|camera| Eye {
                frame: camera.link,
                pose: numbers(&camera.link_from_camera),
                horizontal_fov: camera.horizontal_fov,
            }),
            measures: criteria.iter().map(|name| Measure::of(name, task, scene, &stage, spec)).collect(),
            goal: Goal::of(task, scene, &stage),
            criteria,
            stage,
            task: task.short_id().into(),
            name: task.name().into(),
            instruction: task.instruction().into(),
            seed: spec.seed.to_string(),
            fragility_n: spec.thresholds.fragility_n,
            control_dt: fiatlux_rules::CONTROL_DT,
        }
    }
}

fn numbers(pose: &Isometry3<f64>) -> [f64; 7] {
    let (at, turn) = (&pose.translation.vector, pose.rotation.quaternion());
    [at.x, at.y, at.z, turn.w, turn.i, turn.j, turn.k]
}

/// Content of a state besides the observation.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Timing {
    /// The page's own time of the input that was used, ms; negative if none was.
    pub echo_ms: f64,
    /// Age of that input when it was used, and the time from the observation to its answer, ms.
    pub age_ms: f32,
    pub answer_ms: f32,
}

/// Turns observations into states.
pub(crate) struct View {
    robot: Robot,
    q0: Vec<f64>,
    shown: Vec<f64>,
}

impl View {
    pub fn new(robot: Robot, info: &SessionInfo) -> Self {
        Self { robot, q0: info.joints.iter().map(|joint| joint.q0).collect(), shown: Vec::new() }
    }

    /// The state after a step, little-endian. First `FLTV`, the step, the criteria as bits, flags (u32 each), the page's own
    /// time of the input in use (f64, ms), then f32: its age and the time of the answer (ms), the gate's progress, the largest
    /// force on the left and the right hand (N), the commanded velocity (three numbers) and height, and one that is not used.
    /// Then a pose (f32) for each frame of the stage, and those at which the left and the right hand are wanted.
    ///
    /// Flags: 1 frozen, 2 and 4 the hands that follow, 8 and 16 the seated bulbs, 32 and 64 the hands with a goal, 128 and 256 the hand
    /// that keys move, 512 and 1024 the hands that were told to close.
    pub fn state(&mut self, seen: &Observation, driven: &Driven, timing: Timing) -> Option<Vec<u8>> {
        let privileged = seen.privileged.as_ref()?;
        let turned = &seen.proprioception.as_ref()?.joint_position;
        if turned.len() != self.q0.len() {
            return None;
        }
        let pelvis = pose(privileged.robot.as_ref())?;
        let now = self.q0.iter().zip(turned).map(|(q0, turned)| q0 + f64::from(*turned));
        if self.shown.is_empty() || seen.step == 0 {
            self.shown = now.collect();
        } else {
            self.shown.iter_mut().zip(now).for_each(|(shown, now)| *shown += FOLLOWS * (now - *shown));
        }
        let links = self.robot.forward_kinematics(&self.shown, &pelvis).ok()?;
        let verdict = seen.verdict.clone().unwrap_or_default();
        let criteria = verdict.criteria.iter().take(32).enumerate();
        let bits = criteria.fold(0_u32, |bits, (index, holds)| bits | (u32::from(*holds) << index));
        let seated = |index: usize| privileged.seated.get(index) == Some(&true);
        let flags = [
            driven.is_frozen,
            driven.follows[0],
            driven.follows[1],
            seated(0),
            seated(1),
            driven.goals[0].is_some(),
            driven.goals[1].is_some(),
            driven.chosen == Some(0),
            driven.chosen == Some(1),
            driven.closes[0],
            driven.closes[1],
        ];
        let flags = flags.iter().enumerate().fold(0_u32, |flags, (index, is)| flags | (u32::from(*is) << index));
        // The right hand comes first.
        let (right, left) = seen.hand_contact_force.split_at(seen.hand_contact_force.len() / 2);
        let command = &driven.command;
        let goals = [0, 1].map(|side| pelvis * driven.goals[side].unwrap_or(links[self.robot.palms()[side]]));
        let things = manifest().things.iter().filter(|thing| thing.motion == Motion::Free).map(|thing| {
            let found = match thing.name.as_str() {
                "ladder" => privileged.ladder.as_ref(),
                "old_bulb" => privileged.old_bulb.as_ref(),
                "fresh_bulb" => privileged.fresh_bulb.as_ref(),
                _ => None,
            };
            pose(found).unwrap_or(Isometry3::translation(0.0, 0.0, NOWHERE))
        });
        let mut bytes = Vec::with_capacity(HEAD_BYTES + 28 * (links.len() + 5));
        bytes.extend(MAGIC);
        let step = u32::try_from(seen.step).unwrap_or(u32::MAX);
        bytes.extend([step, bits, flags].iter().flat_map(|word| word.to_le_bytes()));
        bytes.extend(timing.echo_ms.to_le_bytes());
        let [vx, vy, wz] = command.velocity.map(|part| part as f32);
        let (progress, height) = (verdict.gate_progress as f32, command.height as f32);
        let head = [timing.age_ms, timing.answer_ms, progress, largest(left), largest(right), vx, vy, wz, height, 0.0];
        bytes.extend(head.iter().flat_map(|number| number.to_le_bytes()));
        let poses = links.into_iter().chain(things).chain(goals).flat_map(|pose| numbers(&pose));
        bytes.extend(poses.flat_map(|number| (number as f32).to_le_bytes()));
        Some(bytes)
    }
}

/// The largest force on a body, N.
fn largest(forces: &[f32]) -> f32 {
    let force = |&[x, y, z]: &[f32; 3]| (x * x + y * y + z * z).sqrt();
    forces.as_chunks().0.iter().map(force).fold(0.0, f32::max)
}

fn pose(pose: Option<&Pose>) -> Option<Isometry3<f64>> {
    let pose = pose?;
    let (&[x, y, z], &[w, i, j, k]) = (pose.position.as_slice(), pose.quaternion.as_slice()) else { return None };
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
    Some(Isometry3::from_parts(Translation3::new(x, y, z), turn))
}
