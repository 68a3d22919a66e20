//! Gives policies in Python the whole-body controller.

use std::path::PathBuf;
use std::sync::Arc;

use fiatlux_skills::{HandGoal, Reach};
use fiatlux_wbc::{ARMS, Arms, BODY, BodyCommand, Controller, MOVED, Network, Sensed, WbcError};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use numpy::{PyReadonlyArrayDyn, PyReadwriteArrayDyn};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;

use crate::fault::{failed, guarded, not_contiguous, own, own_mut, refused};

/// The controller that this version ships, or another one, for one robot.
#[pyclass(module = "fiatlux._native")]
#[derive(Clone)]
pub(crate) struct WholeBody {
    weights: Option<PathBuf>,
    /// It bends lower than the network can, and never steps.
    stance: Stance,
    controller: Controller,
    arms: Arms,
    reach: Reach,
    /// An episode is under way.
    has_begun: bool,
}

#[pymethods]
impl WholeBody {
    #[new]
    #[pyo3(signature = (weights, stance=[false; 2]))]
    fn new(weights: Option<PathBuf>, stance: Stance) -> PyResult<Self> {
        let network = match &weights {
            None => Network::shipped().map_err(|error| failed(&error))?,
            Some(file) => Network::read(file).map_err(|error| refused(&error))?,
        };
        let arms = Arms::new(&network.contract().joints).map_err(|error| refused(&error))?;
        let reach = Reach::new().map_err(|error| refused(&error))?;
        let (mut controller, [bends_low, never_steps]) = (Controller::new(Arc::new(network)), stance);
        if bends_low {
            controller = controller.bending_low();
        }
        if never_steps {
            controller = controller.without_steps();
        }
        Ok(Self { weights, stance, controller, arms, reach, has_begun: false })
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, BodyArguments)> {
        if self.has_begun {
            let remedy = "call reset() first, copy it with copy.deepcopy, or make it in the policy's own reset";
            return Err(PyTypeError::new_err(format!("a WholeBody cannot be pickled during an episode; {remedy}")));
        }
        Ok((py.get_type::<Self>().into_any(), (self.weights.clone(), self.stance)))
    }

    fn __deepcopy__(&self, _memo: Bound<'_, PyAny>) -> Self {
        self.clone()
    }

    /// Resets the controller's state for another episode.
    fn restart(&mut self) {
        self.controller.restart();
        self.arms.restart();
        self.reach.restart();
        self.has_begun = false;
    }

    /// Name, standing angle (rad), stiffness, damping and effort limit of each joint that it knows: legs, waist, arms.
    fn joints(&self) -> Vec<(String, f64, f64, f64, f64)> {
        let joints = &self.controller.network().contract().joints;
        joints.iter().map(|j| (j.name.clone(), j.q0, j.stiffness, j.damping, j.effort_limit)).collect()
    }

    /// Refuses a command (vx, vy, wz, height, roll, pitch, yaw) outside the trained range.
    fn check(slf: &Bound<'_, Self>, command: [f64; 7]) -> PyResult<()> {
        own!(slf, this);
        this.controller.check(&BodyCommand::from(command)).map_err(|error| refused(&error))
    }

    /// Takes a control step; returns the joint targets of legs and waist, rad.
    fn step(
        slf: &Bound<'_, Self>,
        base_angular_velocity: [f64; 3],
        projected_gravity: [f64; 3],
        base_linear_velocity: [f64; 3],
        base_height: f64,
        joint_position: Vec<f64>,
        joint_velocity: Vec<f64>,
        command: [f64; 7],
    ) -> PyResult<[f64; MOVED]> {
        own_mut!(slf, this);
        let sensed = Sensed {
            base_angular_velocity,
            projected_gravity,
            base_linear_velocity,
            base_height,
            joint_position: &joint_position,
            joint_velocity: &joint_velocity,
        };
        this.has_begun = true;
        let mut targets = [0.0; MOVED];
        this.controller.step(&sensed, &BodyCommand::from(command), &mut targets).map_err(|error| refused(&error))?;
        Ok(targets)
    }

    /// Targets with which the arms rest at these angles, rad.
    fn hold_arms(
        slf: &Bound<'_, Self>,
        projected_gravity: [f64; 3],
        joint_position: Vec<f64>,
        angles: [f64; ARMS],
    ) -> PyResult<[f64; ARMS]> {
        own_mut!(slf, this);
        let sensed = Sensed { projected_gravity, ..Sensed::upright(&joint_position, &[]) };
        this.has_begun = true;
        this.arms.targets(&sensed, &angles).map_err(|error| refused(&error))
    }

    /// Poses of the palms in the pelvis frame.
    fn palms(slf: &Bound<'_, Self>, joint_position: Vec<f64>) -> PyResult<[Pose; 2]> {
        own_mut!(slf, this);
        let palms = this.reach.palms(&Sensed::upright(&joint_position, &[])).map_err(|error| refused(&error))?;
        Ok(palms.map(|palm| numbers_of(&palm)))
    }

    /// Angles of the arms, rad, that take the hands to their goals: poses and how firmly they are held there. Of each hand with a goal,
    /// what remains between that and the nearest pose that was found, m and rad.
    fn reach(
        slf: &Bound<'_, Self>,
        joint_position: Vec<f64>,
        goals: [Option<(Pose, [f64; 3])>; 2],
    ) -> PyResult<Reached> {
        own_mut!(slf, this);
        this.has_begun = true;
        let goals = goals.map(|goal| {
            goal.map(|(pose, firmness)| HandGoal { pelvis_from_palm: pose_of(pose), firmness: Some(firmness) })
        });
        let angles = this.reach.angles(&Sensed::upright(&joint_position, &[]), &goals);
        Ok((angles.map_err(|error| refused(&error))?, this.reach.residuals()))
    }
}

/// It bends low; it never steps.
type Stance = [bool; 2];

/// Angles of the arms, rad, and of each hand with a goal what remains, m and rad.
type Reached = ([f64; ARMS], [Option<[f64; 2]>; 2]);

/// Arguments of the constructor of `WholeBody`.
type BodyArguments = (Option<PathBuf>, Stance);

/// Arguments of the constructor of `WholeBodies`.
type BodiesArguments = (usize, usize, Option<PathBuf>, Stance);

/// Whole-body controllers of many worlds, each with the goals of both hands.
#[pyclass(module = "fiatlux._native")]
pub(crate) struct WholeBodies {
    bodies: Vec<WholeBody>,
    threads: usize,
    weights: Option<PathBuf>,
    stance: Stance,
}

/// Numbers of a world in `WholeBodies::step`: command, goals of both hands, targets; and in `WholeBodies::palms`.
const COMMAND: usize = 7;
const GOALS: usize = 14;

#[pymethods]
impl WholeBodies {
    #[new]
    fn new(worlds: usize, threads: usize, weights: Option<PathBuf>, stance: Stance) -> PyResult<Self> {
        let body = WholeBody::new(weights.clone(), stance)?;
        Ok(Self { bodies: vec![body; worlds], threads, weights, stance })
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, BodiesArguments)> {
        if self.bodies.iter().any(|body| body.has_begun) {
            let remedy = "call reset() first, copy it with copy.deepcopy, or make it in the policy's own reset";
            return Err(PyTypeError::new_err(format!("WholeBodies cannot be pickled during an episode; {remedy}")));
        }
        let arguments = (self.bodies.len(), self.threads, self.weights.clone(), self.stance);
        Ok((py.get_type::<Self>().into_any(), arguments))
    }

    fn __deepcopy__(&self, _memo: Bound<'_, PyAny>) -> Self {
        Self { bodies: self.bodies.clone(), weights: self.weights.clone(), ..*self }
    }

    /// Resets the controllers of the marked worlds.
    fn restart(slf: &Bound<'_, Self>, marks: PyReadonlyArrayDyn<'_, bool>) -> PyResult<()> {
        own_mut!(slf, this);
        let marks = marks.as_slice().map_err(|_| not_contiguous("marks"))?;
        this.bodies.iter_mut().zip(marks).filter(|(_, mark)| **mark).for_each(|(body, _)| body.restart());
        Ok(())
    }

    /// Takes a control step in every world: what is sensed (worlds x numbers, as `Proprioception` has them, with `joints` joints),
    /// commands, and poses of both palms in the pelvis frame, whose first number is NaN where an arm has no goal. Writes the targets
    /// of legs, waist and arms.
    fn step(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        sensed: PyReadonlyArrayDyn<'_, f64>,
        joints: usize,
        commands: PyReadonlyArrayDyn<'_, f64>,
        goals: PyReadonlyArrayDyn<'_, f64>,
        mut targets: PyReadwriteArrayDyn<'_, f64>,
    ) -> PyResult<()> {
        own_mut!(slf, this);
        let sensed = sensed.as_slice().map_err(|_| not_contiguous("sensed"))?;
        let commands = commands.as_slice().map_err(|_| not_contiguous("commands"))?;
        let goals = goals.as_slice().map_err(|_| not_contiguous("goals"))?;
        let targets = targets.as_slice_mut().map_err(|_| not_contiguous("targets"))?;
        let done = py.detach(|| {
            this.each(targets, BODY, |world, body, targets| {
                body.has_begun = true;
                let sensed = sensed_of(sensed, world, joints);
                let command = std::array::from_fn(|at| commands[world * COMMAND + at]);
                let (moved, arms) = targets.split_at_mut(MOVED);
                body.controller.step(&sensed, &BodyCommand::from(command), moved)?;
                let goal = |side: usize| {
                    let pose: Pose = std::array::from_fn(|at| goals[world * GOALS + side * 7 + at]);
                    (!pose[0].is_nan()).then(|| HandGoal { pelvis_from_palm: pose_of(pose), firmness: Some([1.0; 3]) })
                };
                let angles = body.reach.angles(&sensed, &[goal(0), goal(1)])?;
                arms.copy_from_slice(&body.arms.targets(&sensed, &angles)?);
                Ok(())
            })
        })?;
        done.map_err(|error| refused(&error))
    }

    /// Writes the poses of both palms in the pelvis frame of every world.
    fn palms(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        sensed: PyReadonlyArrayDyn<'_, f64>,
        joints: usize,
        mut palms: PyReadwriteArrayDyn<'_, f64>,
    ) -> PyResult<()> {
        own_mut!(slf, this);
        let sensed = sensed.as_slice().map_err(|_| not_contiguous("sensed"))?;
        let palms = palms.as_slice_mut().map_err(|_| not_contiguous("palms"))?;
        let done = py.detach(|| {
            this.each(palms, GOALS, |world, body, palms| {
                let [left, right] = body.reach.palms(&sensed_of(sensed, world, joints))?;
                palms[..7].copy_from_slice(&numbers_of(&left));
                palms[7..].copy_from_slice(&numbers_of(&right));
                Ok(())
            })
        })?;
        done.map_err(|error| refused(&error))
    }
}

impl WholeBodies {
    /// Calls `work` for each world with its part of `out`, on several threads; the first error.
    fn each(
        &mut self,
        out: &mut [f64],
        width: usize,
        work: impl Fn(usize, &mut WholeBody, &mut [f64]) -> Result<(), WbcError> + Sync,
    ) -> PyResult<Result<(), WbcError>> {
        let share = self.bodies.len().div_ceil(self.threads.max(1)).max(1);
        let work = &work;
        guarded(|| {
            std::thread::scope(|scope| {
                let parts = self.bodies.chunks_mut(share).zip(out.chunks_mut(share * width)).enumerate();
                let threads = parts.map(|(part, (bodies, out))| {
                    scope.spawn(move || {
                        let mut worlds = bodies.iter_mut().zip(out.chunks_mut(width)).enumerate();
                        worlds.try_for_each(|(at, (body, out))| work(part * share + at, body, out))
                    })
                });
                let threads: Vec<_> = threads.collect();
                let mut done = threads.into_iter().map(|thread| thread.join());
                done.try_for_each(|done| done.unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
            })
        })
    }
}

/// Sensed quantities of a world, in the order of `Proprioception`.
fn sensed_of(sensed: &[f64], world: usize, joints: usize) -> Sensed<'_> {
    let numbers = &sensed[world * (10 + 2 * joints)..][..10 + 2 * joints];
    let three = |at: usize| std::array::from_fn(|axis| numbers[at + axis]);
    let (joint_position, joint_velocity) = numbers[10..].split_at(joints);
    Sensed {
        base_angular_velocity: three(0),
        projected_gravity: three(3),
        base_linear_velocity: three(6),
        base_height: numbers[9],
        joint_position,
        joint_velocity,
    }
}

/// A palm's pose in the pelvis frame: position and quaternion.
type Pose = [f64; 7];

fn numbers_of(palm: &Isometry3<f64>) -> Pose {
    let (p, q) = (palm.translation, palm.rotation);
    [p.x, p.y, p.z, q.w, q.i, q.j, q.k]
}

fn pose_of(numbers: Pose) -> Isometry3<f64> {
    let [x, y, z, w, i, j, k] = numbers;
    Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::new_normalize(Quaternion::new(w, i, j, k)))
}
