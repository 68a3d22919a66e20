//! Gives policies in Python the climb as a controller.

use std::sync::{Mutex, MutexGuard, PoisonError};

use fiatlux_policies::{ClimbCommand, Climber as Climbs};
use fiatlux_proto::v3::{Observation, Proprioception, SessionInfo};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{CONTROL_DT, Task};
use fiatlux_wire::joint_messages;
use fiatlux_world::ACTION_SCALE;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::fault::{failed, guarded, own_mut, refused};

/// The terms of proprioception in their order, then the last action.
type Terms = (Vec<f32>, Vec<f32>, Vec<f32>, f32, Vec<f32>, Vec<f32>, Vec<f32>);

/// The controller of one robot's climb.
#[pyclass(module = "fiatlux._native")]
pub(crate) struct Climber {
    climber: Mutex<Climbs>,
    step: u64,
}

#[pymethods]
impl Climber {
    /// Of one of the climbs, with the benchmark's robot and gains.
    #[new]
    fn new(task: &str) -> PyResult<Self> {
        let task: Task = task.parse().map_err(|_| PyValueError::new_err("task: use S02, S04, S10 or S12"))?;
        let robot = Robot::benchmark().map_err(|error| failed(&error))?;
        let joints = joint_messages(&robot, &robot.gains(GainSet::default()));
        let info = SessionInfo { joints, control_dt: CONTROL_DT, action_scale: ACTION_SCALE, ..SessionInfo::default() };
        let climber = Climbs::new(task, &info).map_err(|error| refused(&error))?;
        Ok(Self { climber: Mutex::new(climber), step: 0 })
    }

    fn restart(&mut self) {
        self.lock().restart();
        self.step = 0;
    }

    /// Targets of all joints, rad.
    fn step(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        sensed: Terms,
        ladder: [f64; 7],
        command: (f64, [f64; 2]),
    ) -> PyResult<Vec<f64>> {
        own_mut!(slf, this);
        let (
            base_angular_velocity,
            projected_gravity,
            base_linear_velocity,
            base_height,
            joint_position,
            joint_velocity,
            last_action,
        ) = sensed;
        let proprioception = Proprioception {
            base_angular_velocity,
            projected_gravity,
            base_linear_velocity,
            base_height,
            joint_position,
            joint_velocity,
        };
        let observation = Observation {
            step: this.step,
            proprioception: Some(proprioception),
            last_action,
            ..Observation::default()
        };
        let [x, y, z, w, i, j, k] = ladder;
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
        let ladder = Isometry3::from_parts(Translation3::new(x, y, z), rotation);
        let command = ClimbCommand { rate: command.0, lean: command.1 };
        let targets = py.detach(|| guarded(|| this.lock().step(&observation, &ladder, &command)))?;
        this.step += 1;
        targets.map_err(|error| refused(&error))
    }

    /// Name of what it does, and the part of the climb that is done.
    fn progress(&self) -> (String, Option<f64>) {
        self.lock().progress()
    }
}

impl Climber {
    /// Its search is not of a kind that threads share.
    fn lock(&self) -> MutexGuard<'_, Climbs> {
        self.climber.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
