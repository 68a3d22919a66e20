//! Estimates the position of the centre of mass over the feet, and its velocity, from noisy sensors.

use fiatlux_robot::Robot;
use fiatlux_rules::{CONTROL_DT, GRAVITY};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector2, Vector3};

use super::SMALLEST_HEIGHT;
use crate::Sensed;

/// Share of the difference by which the vertical goes, each step, to the one that flat soles show. The gyroscope carries it
/// on by 0.0023 rad of noise a step; six noisy joints show it within 0.007 rad. A steady Kalman filter would take 0.28; less
/// trusts a foot less that is not flat on the ground yet.
const SOLE_GAIN: f64 = 0.2;
/// The same towards the sensed direction of gravity, whose noise of 0.03 rad is the largest: enough to notice a robot that
/// tips over the edge of its feet.
const GRAVITY_GAIN: f64 = 0.01;

/// Gains of the steady Kalman filter of the pendulum, from (position, velocity) as measured to (position, velocity) as
/// estimated, for noise of 5 mm and 0.06 m/s and accelerations of 0.4 m/s^2 that the model does not know. Its capture point
/// is good to 6 mm.
const POSITION_GAINS: [f64; 2] = [0.17, 0.007];
const VELOCITY_GAINS: [f64; 2] = [1.06, 0.10];

/// The robot as an inverted pendulum. The level frame has the pelvis's origin and heading, its z axis points up.
pub(crate) struct Pendulum {
    /// Rotation from the pelvis frame to the level frame.
    pub(crate) level_from_pelvis: UnitQuaternion<f64>,
    /// Centre of mass as the joints show it, level frame, m.
    pub(crate) com: Vector3<f64>,
    /// Centres of the left and the right sole, level frame, m.
    pub(crate) soles: [Vector3<f64>; 2],
    /// Mass of the robot, kg.
    pub(crate) mass: f64,
    /// Centre of mass from the middle between the soles, over the ground, estimated, m.
    pub(crate) position: Vector2<f64>,
    /// Velocity of the centre of mass over the ground, estimated, m/s.
    pub(crate) velocity: Vector2<f64>,
}

impl Pendulum {
    /// Where the robot would come to rest, from the middle between the soles, m.
    pub(crate) fn capture_point(&self) -> Vector2<f64> {
        let height = (self.com.z - 0.5 * (self.soles[0].z + self.soles[1].z)).max(SMALLEST_HEIGHT);
        self.position + self.velocity / libm::sqrt(GRAVITY / height)
    }
}

/// Filters of the vertical and of the centre of mass.
#[derive(Debug, Clone)]
pub(super) struct Estimator {
    mass: f64,
    /// State of the filters; `None` before the first observation.
    memory: Option<Memory>,
}

#[derive(Debug, Clone, Copy)]
struct Memory {
    /// Vertical as a unit vector in the pelvis frame.
    up: Vector3<f64>,
    position: Vector2<f64>,
    velocity: Vector2<f64>,
    /// Centre of pressure commanded since the last observation.
    pressure: Vector2<f64>,
}

impl Estimator {
    pub(super) fn new(robot: &Robot) -> Self {
        Self { mass: robot.total_mass(), memory: None }
    }

    /// Forgets what it has seen.
    pub(super) fn restart(&mut self) {
        self.memory = None;
    }

    /// Takes in an observation: the links' poses and the soles' centres as its joints have them, and the vertical as flat
    /// soles show it, of any length, all in the pelvis frame.
    pub(super) fn update(
        &mut self,
        robot: &Robot,
        sensed: &Sensed<'_>,
        pelvis_from_link: &[Isometry3<f64>],
        sole_up: &Vector3<f64>,
        soles: &[Point3<f64>; 2],
    ) -> Pendulum {
        let turning = Vector3::from(sensed.base_angular_velocity);
        let sole_up = direction(sole_up);
        let up = self.memory.map_or(sole_up, |memory| {
            let up = memory.up - turning.cross(&memory.up) * CONTROL_DT;
            let sensed_up = -Vector3::from(sensed.projected_gravity);
            direction(&(up + SOLE_GAIN * (sole_up - up) + GRAVITY_GAIN * (sensed_up - up)))
        });
        // `None` only upside down.
        let level_from_pelvis = UnitQuaternion::rotation_between(&up, &Vector3::z()).unwrap_or_default();

        let moments = robot.links().iter().zip(pelvis_from_link);
        let moment: Vector3<f64> = moments.map(|(link, pose)| link.mass * (pose * Point3::from(link.com)).coords).sum();
        let com = level_from_pelvis * (moment / self.mass);
        let soles = soles.map(|sole| level_from_pelvis * sole.coords);
        let middle = (soles[0] + soles[1]) / 2.0;
        // Assumes that the robot turns as one piece with its pelvis; the noisy joint velocities would give a worse
        // estimate.
        let pelvis_velocity = Vector3::from(sensed.base_linear_velocity);
        let com_velocity = level_from_pelvis * pelvis_velocity + (level_from_pelvis * turning).cross(&com);

        let measured = (com - middle).xy();
        let rate = GRAVITY / (com.z - middle.z).max(SMALLEST_HEIGHT);
        let (position, velocity) = match self.memory {
            None => (measured, Vector2::zeros()),
            Some(memory) => memory.fused(rate, &measured, &com_velocity.xy()),
        };
        let pressure = self.memory.map_or(position, |memory| memory.pressure);
        self.memory = Some(Memory { up, position, velocity, pressure });
        Pendulum { level_from_pelvis, com, soles, mass: self.mass, position, velocity }
    }

    /// Notes the centre of pressure commanded until the next observation, relative to the middle between the soles, m.
    pub(super) fn pushed_at(&mut self, pressure: Vector2<f64>) {
        if let Some(memory) = &mut self.memory {
            memory.pressure = pressure;
        }
    }
}

impl Memory {
    /// Position and velocity one control step later, from the pendulum's law (`rate` is g/h) and a measurement.
    fn fused(
        &self,
        rate: f64,
        measured: &Vector2<f64>,
        measured_velocity: &Vector2<f64>,
    ) -> (Vector2<f64>, Vector2<f64>) {
        let acceleration = rate * (self.position - self.pressure);
        let position = self.position + CONTROL_DT * (self.velocity + 0.5 * CONTROL_DT * acceleration);
        let velocity = self.velocity + CONTROL_DT * acceleration;
        let (off, off_velocity) = (measured - position, measured_velocity - velocity);
        (
            position + POSITION_GAINS[0] * off + POSITION_GAINS[1] * off_velocity,
            velocity + VELOCITY_GAINS[0] * off + VELOCITY_GAINS[1] * off_velocity,
        )
    }
}

/// The unit vector along a vector; straight up if it is zero.
fn direction(vector: &Vector3<f64>) -> Vector3<f64> {
    vector.try_normalize(1e-9).unwrap_or_else(Vector3::z)
}
