//! Gives policies in Python the whole-body controller.

use std::path::PathBuf;
use std::sync::Arc;

use fiatlux_wbc::{ARMS, Arms, BodyCommand, Controller, HandGoal, MOVED, Network, Reach, Sensed};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;

use crate::fault::{failed, refused};

/// The controller that this version ships, or another one, for one robot.
#[pyclass(module = "fiatlux._native")]
#[derive(Clone)]
pub(crate) struct WholeBody {
    weights: Option<PathBuf>,
    controller: Controller,
    arms: Arms,
    reach: Reach,
    /// An episode is under way.
    has_begun: bool,
}

#[pymethods]
impl WholeBody {
    #[new]
    fn new(weights: Option<PathBuf>) -> PyResult<Self> {
        let network = match &weights {
            None => Network::shipped().map_err(|error| failed(&error))?,
            Some(file) => Network::read(file).map_err(|error| refused(&error))?,
        };
        let arms = Arms::new(&network.contract().joints).map_err(|error| refused(&error))?;
        let reach = Reach::new().map_err(|error| refused(&error))?;
        Ok(Self { weights, controller: Controller::new(Arc::new(network)), arms, reach, has_begun: false })
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (Option<PathBuf>,))> {
        if self.has_begun {
            let remedy = "call reset() first, copy it with copy.deepcopy, or make it in the policy's own reset";
            return Err(PyTypeError::new_err(format!("a WholeBody cannot be pickled during an episode; {remedy}")));
        }
        Ok((py.get_type::<Self>().into_any(), (self.weights.clone(),)))
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
    fn check(&self, command: [f64; 7]) -> PyResult<()> {
        self.controller.check(&BodyCommand::from(command)).map_err(|error| refused(&error))
    }

    /// Takes a control step; returns the joint targets of legs and waist, rad.
    fn step(
        &mut self,
        base_angular_velocity: [f64; 3],
        projected_gravity: [f64; 3],
        base_linear_velocity: [f64; 3],
        base_height: f64,
        joint_position: Vec<f64>,
        joint_velocity: Vec<f64>,
        command: [f64; 7],
    ) -> PyResult<[f64; MOVED]> {
        let sensed = Sensed {
            base_angular_velocity,
            projected_gravity,
            base_linear_velocity,
            base_height,
            joint_position: &joint_position,
            joint_velocity: &joint_velocity,
        };
        self.has_begun = true;
        let mut targets = [0.0; MOVED];
        self.controller.step(&sensed, &BodyCommand::from(command), &mut targets).map_err(|error| refused(&error))?;
        Ok(targets)
    }

    /// Targets with which the arms rest at these angles, rad.
    fn hold_arms(
        &mut self,
        projected_gravity: [f64; 3],
        joint_position: Vec<f64>,
        angles: [f64; ARMS],
    ) -> PyResult<[f64; ARMS]> {
        let sensed = Sensed { projected_gravity, ..Sensed::upright(&joint_position, &[]) };
        self.has_begun = true;
        self.arms.targets(&sensed, &angles).map_err(|error| refused(&error))
    }

    /// Poses of the palms in the pelvis frame.
    fn palms(&mut self, joint_position: Vec<f64>) -> PyResult<[Pose; 2]> {
        let palms = self.reach.palms(&Sensed::upright(&joint_position, &[])).map_err(|error| refused(&error))?;
        Ok(palms.map(|palm| {
            let (p, q) = (palm.translation, palm.rotation);
            [p.x, p.y, p.z, q.w, q.i, q.j, q.k]
        }))
    }

    /// Angles of the arms, rad, that take the hands to their goals: poses and how firmly they are held there.
    fn reach(&mut self, joint_position: Vec<f64>, goals: [Option<(Pose, [f64; 3])>; 2]) -> PyResult<[f64; ARMS]> {
        self.has_begun = true;
        let goals =
            goals.map(|goal| goal.map(|(pose, firmness)| HandGoal { pelvis_from_palm: pose_of(pose), firmness }));
        self.reach.angles(&Sensed::upright(&joint_position, &[]), &goals).map_err(|error| refused(&error))
    }
}

/// A palm's pose in the pelvis frame: position and quaternion.
type Pose = [f64; 7];

fn pose_of(numbers: Pose) -> Isometry3<f64> {
    let [x, y, z, w, i, j, k] = numbers;
    Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::new_normalize(Quaternion::new(w, i, j, k)))
}
