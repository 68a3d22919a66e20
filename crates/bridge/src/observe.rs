//! Turns our robot's sensor data into a model's observation.

use std::collections::VecDeque;

use fiatlux_robot::Robot;
use fiatlux_robot::lidar::RAYS;

use crate::image::{Picture, stacked};
use crate::lidar::sectors;
use crate::mapping::{Camera, KeyPart, Mapping};
use crate::reach::{nine, wrist};
use crate::{BridgeError, ModelObservation};

/// The robot's proprioception.
#[derive(Debug, Clone, Copy)]
pub struct Sensed<'a> {
    /// Angles of all joints, rad.
    pub joint_position: &'a [f64],
    /// Velocities of all joints, rad/s.
    pub joint_velocity: &'a [f64],
    /// Angular velocity of the pelvis in its frame, rad/s.
    pub base_angular_velocity: [f64; 3],
    /// Linear velocity of the pelvis in its frame, m/s.
    pub base_linear_velocity: [f64; 3],
    /// Direction of gravity in the pelvis frame.
    pub projected_gravity: [f64; 3],
    /// Height of the pelvis, m.
    pub base_height: f64,
    /// Forces on the bodies of both hands, right hand first, world axes, N: 3 each. May be empty if no part of the mapping
    /// needs them.
    pub hand_contact_force: &'a [f32],
    /// The newest scan of the LiDAR, m: [`RAYS`] ranges. May be empty if no part of the mapping needs it.
    pub lidar: &'a [f32],
}

impl<'a> Sensed<'a> {
    /// A robot that stands upright and at rest, without forces and scan. `zeros` holds a zero for each joint.
    pub fn still(joint_position: &'a [f64], zeros: &'a [f64], base_height: f64) -> Self {
        Self {
            joint_position,
            joint_velocity: zeros,
            base_angular_velocity: [0.0; 3],
            base_linear_velocity: [0.0; 3],
            projected_gravity: [0.0, 0.0, -1.0],
            base_height,
            hand_contact_force: &[],
            lidar: &[],
        }
    }
}

/// Recent pictures of a session's cameras, as far back as a mapping needs them.
#[derive(Debug, Clone, Default)]
pub struct Frames {
    /// Step, sensor and picture, newest last.
    kept: VecDeque<(u64, String, Picture)>,
}

impl Frames {
    /// Adds a picture of a step, and drops pictures that the mapping no longer needs.
    pub fn push(&mut self, mapping: &Mapping, step: u64, sensor: &str, picture: Picture) {
        self.kept.push_back((step, sensor.into(), picture));
        let longest = mapping.cameras.iter().filter_map(|camera| camera.delta.first()).min().copied().unwrap_or(0);
        let oldest = step.saturating_sub(steps_back(mapping, longest));
        // Keep the last picture before the oldest wanted step: it stands for that step where pictures are rare.
        for sensor in mapping.sensors() {
            let of = |kept: &&(u64, String, Picture)| kept.1 == sensor && kept.0 <= oldest;
            if let Some(first) = self.kept.iter().filter(of).map(|kept| kept.0).max() {
                self.kept.retain(|kept| kept.1 != sensor || kept.0 >= first);
            }
        }
    }

    /// The newest picture up to a step; if all are newer, as at the start of an episode, the oldest one.
    fn at(&self, sensor: &str, step: u64) -> Option<&Picture> {
        let mut of = self.kept.iter().filter(|kept| kept.1 == sensor);
        let before = self.kept.iter().rev().filter(|kept| kept.1 == sensor).find(|kept| kept.0 <= step);
        before.or_else(|| of.next()).map(|kept| &kept.2)
    }
}

/// Number of control steps from a frame to the present.
fn steps_back(mapping: &Mapping, delta: i64) -> u64 {
    (delta.unsigned_abs() as f64 * mapping.steps_per_row()).round() as u64
}

impl Mapping {
    /// Names of our sensors that the mapping's cameras need.
    pub fn sensors(&self) -> Vec<&str> {
        let mut sensors: Vec<&str> = self.cameras.iter().filter_map(|camera| camera.sensor.as_deref()).collect();
        sensors.sort_unstable();
        sensors.dedup();
        sensors
    }

    /// True if the state needs the LiDAR.
    pub fn has_lidar(&self) -> bool {
        self.has(|part| matches!(part, KeyPart::Lidar { .. }))
    }

    /// True if the state needs the forces on the hands.
    pub fn has_contact(&self) -> bool {
        self.has(|part| matches!(part, KeyPart::Contact { .. }))
    }

    fn has(&self, is_meant: impl Fn(&KeyPart) -> bool) -> bool {
        self.states.iter().flat_map(|key| &key.parts).any(is_meant)
    }

    /// Number of control steps before a request at which pictures are needed: 0 for the current one, and those of past
    /// frames.
    pub fn lookbacks(&self) -> Vec<u64> {
        let mut back: Vec<u64> =
            self.cameras.iter().flat_map(|camera| camera.delta.iter().map(|delta| steps_back(self, *delta))).collect();
        back.sort_unstable();
        back.dedup();
        back
    }

    /// The observation for a model at a step.
    ///
    /// # Errors
    /// [`BridgeError::Sensed`]: a camera has no picture, or one of another size.
    pub fn observe(
        &self,
        robot: &Robot,
        sensed: &Sensed<'_>,
        frames: &Frames,
        step: u64,
        instruction: &str,
        session: &str,
    ) -> Result<ModelObservation, BridgeError> {
        let image = |camera: &Camera| {
            let frame = |delta: &i64| {
                let Some(sensor) = &camera.sensor else { return Ok(Picture::black(camera.size)) };
                let picture = frames.at(sensor, step.saturating_sub(steps_back(self, *delta)));
                let missing = || BridgeError::Sensed {
                    what: format!("a picture of {sensor} for '{}'", camera.key),
                    remedy: "leave --sensors out, or name the sensor there",
                };
                picture.ok_or_else(missing)?.fitted(camera.size, camera.resize)
            };
            let pictures = camera.delta.iter().map(frame).collect::<Result<Vec<_>, _>>()?;
            Ok((camera.key.clone(), stacked(&pictures)?))
        };
        let mut states = Vec::with_capacity(self.states.len());
        for key in &self.states {
            let mut numbers = Vec::with_capacity(self.width(key));
            for part in &key.parts {
                self.sense(robot, sensed, part, &mut numbers)?;
            }
            states.push((key.key.clone(), numbers));
        }
        Ok(ModelObservation {
            images: self.cameras.iter().map(image).collect::<Result<_, BridgeError>>()?,
            states,
            language: (self.language.clone(), instruction.into()),
            session: session.into(),
            rows: self.horizon,
        })
    }

    fn sense(
        &self,
        robot: &Robot,
        sensed: &Sensed<'_>,
        part: &KeyPart,
        numbers: &mut Vec<f32>,
    ) -> Result<(), BridgeError> {
        let q = sensed.joint_position;
        let (joints, found) = (robot.joints().len(), [q.len(), sensed.joint_velocity.len()]);
        if found != [joints; 2] {
            let what = format!("angles and velocities of {joints} joints (it has {found:?})");
            return Err(BridgeError::Sensed { what, remedy: "use the robot that the mapping was read for" });
        }
        let mut add = |values: &[f64]| numbers.extend(values.iter().map(|value| *value as f32));
        let expect = |name: &str, found: usize, wanted: usize, remedy| match found == wanted {
            true => Ok(()),
            false => Err(BridgeError::Sensed { what: format!("{name} of {wanted} numbers (it has {found})"), remedy }),
        };
        match (part, &self.hands) {
            (KeyPart::Contact { width, limit }, _) => {
                let forces = sensed.hand_contact_force;
                let remedy = "leave --sensors out, or name hand_contact there";
                expect("forces on the hands", forces.len(), *width, remedy)?;
                numbers.extend(forces.iter().map(|force| force.clamp(-limit, *limit)));
            }
            (KeyPart::Lidar { sectors: count }, _) => {
                let remedy = "leave --sensors out, or name lidar there";
                expect("a scan of the LiDAR", sensed.lidar.len(), RAYS, remedy)?;
                numbers.extend(sectors(sensed.lidar, *count));
            }
            (KeyPart::Joints(joints), _) => joints.iter().for_each(|joint| add(&[q[*joint]])),
            (KeyPart::Hand(side), Some(hands)) => add(&hands.theirs(*side, q)),
            (KeyPart::Grip { side, open, closed }, Some(hands)) => {
                add(&[open + hands.grip(*side, q) * (closed - open)]);
            }
            (KeyPart::Wrist(side), _) => add(&nine(&wrist(robot, *side, q)?)),
            (KeyPart::Gravity, _) => add(&sensed.projected_gravity),
            (KeyPart::AngularVelocity, _) => add(&sensed.base_angular_velocity),
            (KeyPart::LinearVelocity, _) => add(&sensed.base_linear_velocity),
            (KeyPart::Turned(_), _) => q.iter().zip(robot.q0()).for_each(|(angle, q0)| add(&[angle - q0])),
            (KeyPart::Velocities(_), _) => add(sensed.joint_velocity),
            (KeyPart::Height, _) => add(&[sensed.base_height]),
            // The mapping's checks allow no other part in a state.
            (other, hands) => add(&vec![0.0; other.width(hands.as_ref())]),
        }
        Ok(())
    }
}
