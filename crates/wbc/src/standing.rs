//! Standing on both feet, quieter than the network does.
//!
//! The network steps and catches pushes, but it sees no more than its last frames, and shifts its weight with their noise.
//! Once both feet are down and the robot is at rest, this takes over: the feet stay where they are, the angles of legs and
//! waist follow from where pelvis and torso are wanted, and [`Balance`] keeps the centre of mass over the feet. A push that
//! takes it too far from there gives the robot back to the network.

use std::sync::Arc;

use fiatlux_robot::{GainSet, Gains, JointGains, Robot};
use fiatlux_rules::GRAVITY;
use nalgebra::{Isometry3, Matrix6, Point3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3, Vector6};

use crate::balance::{Balance, Pendulum};
use crate::setpoint::towards;
use crate::{BODY, BodyCommand, CONTROL_DT, Joint, LEGS, MOVED, Sensed, WbcError};

/// Farthest that the capture point may be from the middle between the soles, fore and aft and sideways, m: while the robot
/// comes to rest, and afterwards. The sole is 0.101 m long either way.
const CALM: [f64; 2] = [0.035, 0.035];
const HELD: [f64; 2] = [0.055, 0.055];
/// Control steps of calm before it takes over.
const CALM_STEPS: u32 = 30;
/// Share of the difference by which the average of the joints' angles follows in each control step.
const AVERAGE_GAIN: f64 = 0.1;
/// Fastest movement of the pelvis, m/s and rad/s, and of the torso, rad/s.
const PELVIS_RATE: [f64; 2] = [0.15, 0.3];
const TORSO_RATE: f64 = 0.5;
/// Share of the wanted centre of mass's distance from the middle by which the pelvis goes there in each control step, and the
/// fastest that it goes, m/s.
const CENTRE_GAIN: f64 = 0.05;
const CENTRE_RATE: f64 = 0.1;
/// Share that the pelvis has in the torso's roll and pitch, as in training.
const PELVIS_SHARE: [f64; 2] = [0.2, 0.25];
/// Largest share of the waist in the torso's pitch, rad: just below its stop.
const WAIST_PITCH: f64 = 0.5;
/// Nearer to their stop than the first number the ankles make the pelvis lean forwards, farther than the second back, rad.
const ANKLE_ROOM: [f64; 2] = [0.08, 0.14];
/// Rate of the lean, rad/s, and its bound, rad.
const LEAN_RATE: f64 = 0.3;
const MAX_LEAN: f64 = 0.45;
const ANKLE_PITCH: usize = 4;
/// Least distance from the ends of the joints' ranges, rad.
const RANGE_MARGIN: f64 = 0.02;
/// Damping of the legs' inverse kinematics, and the largest turn of a joint in a control step, rad.
const DAMPING: f64 = 1e-5;
const LARGEST_TURN: f64 = 0.05;

/// Stands in place of the network.
#[derive(Debug, Clone)]
pub(crate) struct Standing {
    robot: Arc<Robot>,
    gains: Gains,
    balance: Balance,
    /// Height of the soles' centres above the floor that they stand on, and of the feet's links where soles are flat on it, m.
    sole_thickness: f64,
    foot_height: f64,
    /// Angles of all joints, averaged, rad; `None` before the first observation.
    average: Option<Vec<f64>>,
    /// Control steps for which the robot has been calm.
    calm: u32,
    stance: Option<Stance>,
    /// It never gives the robot to the network.
    is_alone: bool,
    /// It takes over in the next control step, calm or not.
    is_at_once: bool,
    posture: Vec<f64>,
}

/// Where the feet are, and where pelvis and torso are wanted now. The frame's origin is the middle between the soles; x points
/// where the feet point, z up.
#[derive(Debug, Clone)]
struct Stance {
    from_foot: [Isometry3<f64>; 2],
    pelvis: Vector3<f64>,
    /// Roll, pitch and yaw of the pelvis, rad.
    turned: [f64; 3],
    /// Roll, pitch and yaw of the torso from upright axes that point where the pelvis points, rad.
    torso: [f64; 3],
    /// Pitch of the pelvis that the ankles' range asks for, rad.
    lean: f64,
}

impl Standing {
    /// For the joints of a contract: legs, waist and arms.
    pub fn new(joints: &[Joint]) -> Result<Self, WbcError> {
        let robot = Robot::by_name("g1_bare").map_err(|error| WbcError::Arms(error.to_string()))?;
        let gain = |(joint, own): (&Joint, &JointGains)| JointGains {
            stiffness: joint.stiffness,
            damping: joint.damping,
            effort_limit: joint.effort_limit,
            ..*own
        };
        let own = robot.gains(GainSet::default());
        let gains = Gains(joints.iter().zip(&own.0).map(gain).collect());
        let q0: Vec<f64> = joints.iter().map(|joint| joint.q0).collect();
        let level = Isometry3::translation(0.0, 0.0, robot.standing_height());
        let poses = robot.forward_kinematics(&q0, &level).map_err(crate::BalanceError::from)?;
        let foot_height = poses[robot.feet()[0]].translation.z;
        let robot = Arc::new(robot);
        let mut balance = Balance::new(Arc::clone(&robot), gains.clone(), &q0)?;
        let zeros = vec![0.0; q0.len()];
        let upright = balance.observe(&Sensed::upright(&zeros, &[]))?;
        let sole_thickness = robot.standing_height() + upright.soles[0].z;
        balance.restart();
        Ok(Self {
            robot,
            gains,
            balance,
            sole_thickness,
            foot_height,
            average: None,
            calm: 0,
            stance: None,
            is_alone: false,
            is_at_once: false,
            posture: q0,
        })
    }

    /// Takes over at once, and never gives the robot to the network.
    pub fn stand_alone(&mut self) {
        self.is_alone = true;
    }

    /// Takes over in the next control step.
    pub fn stand_at_once(&mut self) {
        self.is_at_once = true;
    }

    /// Gives the robot back to the network.
    pub fn restart(&mut self) {
        self.balance.restart();
        (self.average, self.calm, self.stance, self.is_at_once) = (None, 0, None, false);
    }

    /// True if it has taken over.
    pub fn has_taken_over(&self) -> bool {
        self.stance.is_some()
    }

    /// Takes what is sensed and commanded in a control step in which both feet are due down; targets of all joints, rad, where
    /// it has taken over.
    pub fn step(&mut self, sensed: &Sensed<'_>, command: &BodyCommand) -> Result<Option<&[f64]>, WbcError> {
        let sensed = Sensed { joint_position: &sensed.joint_position[..BODY], ..*sensed };
        let pendulum = self.balance.observe(&sensed)?;
        let q = self.balance.joint_position();
        let average = self.average.get_or_insert_with(|| q.to_vec());
        average.iter_mut().zip(q).for_each(|(average, q)| *average += AVERAGE_GAIN * (q - *average));
        let capture_point = pendulum.capture_point();
        let is_within = |reach: [f64; 2]| capture_point.x.abs() < reach[0] && capture_point.y.abs() < reach[1];
        if self.stance.is_none() {
            self.calm = if is_within(CALM) { self.calm + 1 } else { 0 };
            let is_at_once = std::mem::take(&mut self.is_at_once);
            if self.calm >= CALM_STEPS || self.is_alone || is_at_once {
                self.posture.copy_from_slice(average);
                self.stance = Some(Stance::of(&self.robot, average, &pendulum, self.sole_thickness, self.foot_height)?);
            }
        } else if !is_within(HELD) && !self.is_alone {
            (self.calm, self.stance) = (0, None);
        }
        let Some(stance) = &mut self.stance else {
            self.balance.rest(&pendulum);
            return Ok(None);
        };
        self.posture[MOVED..].copy_from_slice(&average[MOVED..]);
        stance.advance(command);
        stance.bend(&self.robot, &mut self.posture)?;
        let targets = self.balance.push(&pendulum, &self.posture);
        // The waist carries the trunk, and what a leg weighs itself does not press on its hip.
        let down = stance.middle_from_pelvis().rotation.inverse() * Vector3::new(0.0, 0.0, -GRAVITY);
        let efforts = self.robot.holding_efforts(&self.posture, down.into()).map_err(crate::BalanceError::from)?;
        for joint in 0..MOVED {
            let gains = &self.gains.0[joint];
            targets[joint] += efforts[joint].clamp(-gains.effort_limit, gains.effort_limit) / gains.stiffness;
        }
        Ok(Some(targets))
    }
}

/// Turn about the vertical.
fn heading(rotation: &UnitQuaternion<f64>) -> f64 {
    let ahead = rotation * Vector3::x();
    libm::atan2(ahead.y, ahead.x)
}

impl Stance {
    /// Of a robot that stands with these angles of its joints, rad.
    fn of(
        robot: &Robot,
        q: &[f64],
        pendulum: &Pendulum,
        sole_thickness: f64,
        foot_height: f64,
    ) -> Result<Self, WbcError> {
        let level_from_pelvis = Isometry3::from_parts(Translation3::identity(), pendulum.level_from_pelvis);
        let poses = robot.forward_kinematics(q, &level_from_pelvis).map_err(crate::BalanceError::from)?;
        let feet = [robot.feet()[0], robot.feet()[1]].map(|foot| poses[foot]);
        let ahead = feet.map(|foot| heading(&foot.rotation));
        let yaw = 0.5 * (ahead[0] + ahead[1]);
        let mut middle = (pendulum.soles[0] + pendulum.soles[1]) / 2.0;
        middle.z -= sole_thickness;
        let level_from_middle = Isometry3::new(middle, Vector3::z() * yaw);
        let middle_from_level = level_from_middle.inverse();
        // The soles are flat on one floor, whatever the joints' noise says, and whatever edges the network stood on.
        let flat = |side: usize| {
            let mut pose = middle_from_level * feet[side];
            pose.translation.z = foot_height;
            pose.rotation = UnitQuaternion::from_euler_angles(0.0, 0.0, heading(&pose.rotation));
            pose
        };
        let pelvis = middle_from_level * level_from_pelvis;
        let (roll, pitch, yaw) = pelvis.rotation.euler_angles();
        let torso =
            robot.link_index("torso_link").map_or(pelvis.rotation, |link| (middle_from_level * poses[link]).rotation);
        let (torso_roll, torso_pitch, torso_yaw) = torso.euler_angles();
        Ok(Self {
            from_foot: [flat(0), flat(1)],
            pelvis: pelvis.translation.vector,
            turned: [roll, pitch, yaw],
            torso: [torso_roll, torso_pitch, torso_yaw - yaw],
            lean: 0.0,
        })
    }

    fn middle_from_pelvis(&self) -> Isometry3<f64> {
        let [roll, pitch, yaw] = self.turned;
        Isometry3::from_parts(self.pelvis.into(), UnitQuaternion::from_euler_angles(roll, pitch, yaw))
    }

    /// Goes on by a control step towards a command.
    fn advance(&mut self, command: &BodyCommand) {
        self.pelvis.z = towards(self.pelvis.z, command.height, PELVIS_RATE[0]);
        let [roll, pitch, _] = command.torso;
        self.turned[0] = towards(self.turned[0], PELVIS_SHARE[0] * roll, PELVIS_RATE[1]);
        let bow = (PELVIS_SHARE[1] * pitch).max(pitch - WAIST_PITCH);
        self.turned[1] = towards(self.turned[1], bow + self.lean, PELVIS_RATE[1]);
        for (now, wanted) in self.torso.iter_mut().zip(command.torso) {
            *now = towards(*now, wanted, TORSO_RATE);
        }
    }

    /// Brings a posture nearer to the wanted one, by Newton's method.
    fn bend(&mut self, robot: &Robot, posture: &mut [f64]) -> Result<(), WbcError> {
        let poses = robot.forward_kinematics(posture, &Isometry3::identity()).map_err(crate::BalanceError::from)?;
        let pelvis = self.middle_from_pelvis();
        for (side, from_foot) in self.from_foot.iter().enumerate() {
            let first = side * (LEGS / 2);
            let (foot, wanted) = (&poses[robot.feet()[side]], pelvis.inverse() * from_foot);
            let off = wanted.translation.vector - foot.translation.vector;
            let turn = (wanted.rotation * foot.rotation.inverse()).scaled_axis();
            let error = Vector6::new(off.x, off.y, off.z, turn.x, turn.y, turn.z);
            let mut jacobian = Matrix6::zeros();
            for (column, joint) in robot.joints()[first..first + LEGS / 2].iter().enumerate() {
                let pose = &poses[joint.link];
                let axis = pose.rotation * joint.axis.into_inner();
                let arm = axis.cross(&(foot.translation.vector - pose.translation.vector));
                jacobian.set_column(column, &Vector6::new(arm.x, arm.y, arm.z, axis.x, axis.y, axis.z));
            }
            let square = jacobian * jacobian.transpose() + Matrix6::identity() * DAMPING;
            let Some(solved) = square.lu().solve(&error) else { continue };
            let turns = jacobian.transpose() * solved;
            for (index, turn) in turns.iter().enumerate() {
                let joint = &robot.joints()[first + index];
                let q = &mut posture[first + index];
                *q = (*q + turn.clamp(-LARGEST_TURN, LARGEST_TURN))
                    .clamp(joint.lower + RANGE_MARGIN, joint.upper - RANGE_MARGIN);
            }
        }
        let room = [ANKLE_PITCH, LEGS / 2 + ANKLE_PITCH].map(|joint| posture[joint] - robot.joints()[joint].lower);
        let room = room[0].min(room[1]) - RANGE_MARGIN;
        let lean = if room < ANKLE_ROOM[0] {
            MAX_LEAN
        } else if room > ANKLE_ROOM[1] {
            0.0
        } else {
            self.lean
        };
        self.lean = towards(self.lean, lean, LEAN_RATE);

        // The waist turns about z, then x, then y.
        let [roll, pitch, yaw] = self.torso;
        let torso = Rotation3::from_euler_angles(roll, pitch, yaw + self.turned[2]);
        let [roll, pitch, yaw] = self.turned;
        let waist = Rotation3::from_euler_angles(roll, pitch, yaw).inverse() * torso;
        let waist = waist.matrix();
        let angles = [
            libm::atan2(-waist[(0, 1)], waist[(1, 1)]),
            libm::asin(waist[(2, 1)].clamp(-1.0, 1.0)),
            libm::atan2(-waist[(2, 0)], waist[(2, 2)]),
        ];
        for ((q, joint), angle) in posture[LEGS..MOVED].iter_mut().zip(&robot.joints()[LEGS..]).zip(angles) {
            *q = angle.clamp(joint.lower, joint.upper);
        }

        let moments = robot.links().iter().zip(&poses);
        let moment: Vector3<f64> = moments.map(|(link, pose)| link.mass * (pose * Point3::from(link.com)).coords).sum();
        let centre = pelvis * Point3::from(moment / robot.total_mass());
        let step: Vector2<f64> = (-CENTRE_GAIN * centre.coords.xy())
            .map(|part| part.clamp(-CENTRE_RATE * CONTROL_DT, CENTRE_RATE * CONTROL_DT));
        self.pelvis.x += step.x;
        self.pelvis.y += step.y;
        Ok(())
    }
}
