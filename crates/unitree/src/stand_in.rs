//! A session of ours as a robot: its controllers take commands, its sensors answer.
#![cfg_attr(not(feature = "dds"), allow(dead_code))] // Used where there is DDS, and by tests.

use fiatlux_proto::v3::{Observation, SessionInfo};
use fiatlux_rules::GRAVITY;

use crate::guard::{DAMPING, Drive, MAX_SILENCE};
use crate::messages::{HandCmds, ImuState, LowCmd, LowState, MotorState};
use crate::motors::{LINKED, MOTORS, Motors, MotorsError};

/// `mode_machine` of a G1 with 29 joints.
const MACHINE: u8 = 5;

/// Our robot as the maker's programs know it.
#[derive(Debug, Clone)]
pub(crate) struct Body {
    motors: Motors,
    drives: Vec<Drive>,
    /// Angles of the standing posture, rad.
    q0: Vec<f64>,
    action_scale: f64,
    control_dt: f64,
    /// Measured angles and velocities, rad and rad/s.
    q: Vec<f64>,
    dq: Vec<f64>,
    /// Joint targets in force, rad.
    targets: Vec<f64>,
    yaw: f64,
    linear_velocity: Option<[f64; 3]>,
    state: LowState,
}

impl Body {
    /// For a session, at its observation 0.
    pub fn new(info: &SessionInfo) -> Result<Self, MotorsError> {
        let names: Vec<&str> = info.joints.iter().map(|joint| joint.name.as_str()).collect();
        let drives: Vec<Drive> = info.joints.iter().map(Drive::of).collect();
        let q0: Vec<f64> = info.joints.iter().map(|joint| joint.q0).collect();
        Ok(Self {
            motors: Motors::of(&names)?,
            q: vec![0.0; drives.len()],
            dq: vec![0.0; drives.len()],
            targets: q0.clone(),
            drives,
            q0,
            action_scale: info.action_scale,
            control_dt: info.control_dt,
            yaw: 0.0,
            linear_velocity: None,
            state: LowState { mode_machine: MACHINE, ..LowState::default() },
        })
    }

    /// Reads an observation; false if it lacks what a robot senses.
    pub fn sense(&mut self, observation: &Observation) -> bool {
        let Some(sensed) = &observation.proprioception else { return false };
        let count = self.drives.len();
        let (&[wx, wy, wz], &[gx, gy, gz], &[vx, vy, vz]) = (
            sensed.base_angular_velocity.as_slice(),
            sensed.projected_gravity.as_slice(),
            sensed.base_linear_velocity.as_slice(),
        ) else {
            return false;
        };
        if [sensed.joint_position.len(), sensed.joint_velocity.len(), observation.last_action.len()] != [count; 3] {
            return false;
        }
        let before = self.dq.clone();
        for (index, q0) in self.q0.iter().enumerate() {
            self.q[index] = q0 + f64::from(sensed.joint_position[index]);
            self.dq[index] = f64::from(sensed.joint_velocity[index]);
            self.targets[index] = q0 + self.action_scale * f64::from(observation.last_action[index]);
        }
        let [w, g, v] = [[wx, wy, wz], [gx, gy, gz], [vx, vy, vz]].map(|vector| vector.map(f64::from));
        self.state.imu_state = self.imu(w, g, v);
        self.linear_velocity = Some(v);
        let is_first = observation.step == 0;
        for (slot, joint) in self.state.motor_state.iter_mut().zip(self.motors.body) {
            let drive = self.drives[joint];
            let effort = drive.stiffness * (self.targets[joint] - self.q[joint]) - drive.damping * self.dq[joint];
            *slot = MotorState {
                mode: 1,
                q: self.q[joint] as f32,
                dq: self.dq[joint] as f32,
                ddq: if is_first { 0.0 } else { ((self.dq[joint] - before[joint]) / self.control_dt) as f32 },
                tau_est: effort.clamp(-drive.effort_limit, drive.effort_limit) as f32,
                temperature: [40, 50],
                vol: 48.0,
                ..MotorState::default()
            };
        }
        self.state.tick = (observation.step as f64 * self.control_dt * 1000.0).round() as u32;
        true
    }

    /// Roll and pitch from gravity, yaw by integration, as an inertial unit without a compass has them.
    fn imu(&mut self, w: [f64; 3], g: [f64; 3], v: [f64; 3]) -> ImuState {
        let (roll, pitch) = ((-g[1]).atan2(-g[2]), g[0].atan2(g[1].hypot(g[2])));
        if self.linear_velocity.is_some() {
            self.yaw += self.control_dt * (w[1] * roll.sin() + w[2] * roll.cos()) / pitch.cos().max(1e-3);
        }
        let [(sr, cr), (sp, cp), (sy, cy)] = [roll, pitch, self.yaw].map(|angle| (angle / 2.0).sin_cos());
        let quaternion = [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ];
        let before = self.linear_velocity.unwrap_or(v);
        let turns = [w[1] * v[2] - w[2] * v[1], w[2] * v[0] - w[0] * v[2], w[0] * v[1] - w[1] * v[0]];
        let force = |axis: usize| (v[axis] - before[axis]) / self.control_dt + turns[axis] - GRAVITY * g[axis];
        ImuState {
            quaternion: quaternion.map(|number| number as f32),
            gyroscope: w.map(|number| number as f32),
            accelerometer: [force(0), force(1), force(2)].map(|number| number as f32),
            rpy: [roll, pitch, self.yaw].map(|number| number as f32),
            temperature: 30,
        }
    }

    /// The last state, some time after it was measured, ms.
    pub fn state(&self, later_ms: u32) -> LowState {
        LowState { tick: self.state.tick.wrapping_add(later_ms), ..self.state.clone() }.sealed()
    }

    /// Joint targets, rad, with which our drives have the efforts that commands ask for at what was measured last. `silence` is
    /// the time since the body's last command, s; without any, or after too long a silence, motors only damp.
    pub fn follow(&mut self, command: Option<&LowCmd>, hands: Option<&HandCmds>, silence: f64) -> &[f64] {
        for (motor, joint) in self.motors.body.into_iter().enumerate() {
            let (drive, q, dq) = (self.drives[joint], self.q[joint], self.dq[joint]);
            let wanted = match command {
                Some(_) if silence > MAX_SILENCE => -f64::from(DAMPING) * dq,
                // What a linkage makes of its motors' own angles is not known here: the last target stays in force.
                Some(command) if command.mode_pr != 0 && LINKED.contains(&motor) => continue,
                Some(command) => {
                    let motor = command.motor_cmd[motor];
                    let [tau, kp, kd] = [motor.tau, motor.kp, motor.kd].map(f64::from);
                    let spring = kp * (f64::from(motor.q) - q) + kd * (f64::from(motor.dq) - dq);
                    if motor.mode == 0 { 0.0 } else { tau + spring }
                }
                None => continue,
            };
            let effort = wanted.clamp(-drive.effort_limit, drive.effort_limit);
            self.targets[joint] = q + (effort + drive.damping * dq) / drive.stiffness;
        }
        for (cmd, joints) in hands.map_or([].as_slice(), |hands| &hands.cmds).iter().zip(&self.motors.hands) {
            // The first joint's whole way: 1 is open.
            let closed = self.drives[joints[0].0].upper * (1.0 - f64::from(cmd.q).clamp(0.0, 1.0));
            for &(joint, turn) in joints {
                self.targets[joint] = (turn * closed).min(self.drives[joint].upper);
            }
        }
        &self.targets
    }
}

/// A command that a robot accepts: with the right checksum and finite numbers.
pub(crate) fn is_sound(command: &LowCmd) -> bool {
    let finite = |motor: &crate::messages::MotorCmd| {
        [motor.q, motor.dq, motor.tau, motor.kp, motor.kd].iter().all(|number| number.is_finite())
    };
    command.crc == command.checksum() && command.motor_cmd[..MOTORS.len()].iter().all(finite)
}

#[cfg(test)]
mod tests {
    use fiatlux_proto::v3::{Joint, Proprioception};
    use fiatlux_robot::Robot;

    use super::*;
    use crate::messages::MotorCmd;

    fn info() -> SessionInfo {
        let robot = Robot::benchmark().expect("a robot");
        let gains = robot.gains(Default::default());
        let joint = |((joint, gains), q0): ((&fiatlux_robot::Joint, &fiatlux_robot::JointGains), &f64)| Joint {
            name: joint.name.clone(),
            lower: joint.lower,
            upper: joint.upper,
            q0: *q0,
            stiffness: gains.stiffness,
            damping: gains.damping,
            effort_limit: gains.effort_limit,
            ..Joint::default()
        };
        let joints = robot.joints().iter().zip(&gains.0).zip(robot.q0()).map(joint).collect();
        SessionInfo { joints, action_scale: 0.5, control_dt: 0.02, ..SessionInfo::default() }
    }

    fn observation(step: u64, gravity: [f32; 3], velocity: f32) -> Observation {
        let sensed = Proprioception {
            base_angular_velocity: vec![0.0, 0.0, 0.5],
            projected_gravity: gravity.into(),
            base_linear_velocity: vec![0.0; 3],
            base_height: 0.79,
            joint_position: vec![0.1; 53],
            joint_velocity: vec![velocity; 53],
        };
        Observation { step, proprioception: Some(sensed), last_action: vec![0.0; 53], ..Observation::default() }
    }

    fn body() -> Body {
        let mut body = Body::new(&info()).expect("a G1");
        assert!(body.sense(&observation(0, [0.0, 0.0, -1.0], 0.2)));
        body
    }

    #[test]
    fn at_rest_an_inertial_unit_feels_the_floor() {
        let state = body().state(0);
        assert_eq!(state.imu_state.quaternion, [1.0, 0.0, 0.0, 0.0]);
        assert_eq!(state.imu_state.accelerometer, [0.0, 0.0, 9.81]);
        assert_eq!(state.mode_machine, 5);
        assert_eq!(state.crc, state.checksum());
    }

    #[test]
    fn orientation_is_of_gravity_and_of_what_was_turned() {
        let mut body = body();
        // Rolled by 0.3 rad to the right: gravity leans to the left, +y being left.
        let (sin, cos) = (0.3_f32.sin(), 0.3_f32.cos());
        for step in 1..=50 {
            assert!(body.sense(&observation(step, [0.0, -sin, -cos], 0.0)));
        }
        let [roll, pitch, yaw] = body.state(0).imu_state.rpy;
        assert!((roll - 0.3).abs() < 1e-5 && pitch.abs() < 1e-6, "{roll} {pitch}");
        // 0.5 rad/s about the body's own axis for 1 s; its part about the vertical is cos(0.3).
        assert!((yaw - 0.5 * cos).abs() < 1e-4, "{yaw}");
        assert_eq!(body.state(3).tick, 1003);
    }

    #[test]
    fn targets_give_the_effort_that_was_asked_for() {
        let mut body = body();
        let mut command = LowCmd::default();
        command.motor_cmd[3] = MotorCmd { mode: 1, q: 0.5, dq: 0.1, tau: 3.0, kp: 100.0, kd: 2.0, reserve: 0 };
        let knee = 3;
        let drive = body.drives[body.motors.body[knee]];
        let joint = body.motors.body[knee];
        let (q, dq) = (body.q[joint], body.dq[joint]);
        assert!((q - body.q0[joint] - 0.1).abs() < 1e-6 && (dq - 0.2).abs() < 1e-6);
        let asked = 3.0 + 100.0 * (0.5 - q) + 2.0 * (0.1 - dq);
        let target = body.follow(Some(&command), None, 0.0)[joint];
        let effort = drive.stiffness * (target - q) - drive.damping * dq;
        assert!((effort - asked).abs() < 1e-5, "{effort} {asked}");
        // A motor that is not enabled is limp, and no effort is beyond the drive's.
        command.motor_cmd[3].mode = 0;
        let target = body.follow(Some(&command), None, 0.0)[joint];
        assert!((drive.stiffness * (target - q) - drive.damping * dq).abs() < 1e-9);
        command.motor_cmd[3] = MotorCmd { mode: 1, tau: 1e6, ..MotorCmd::default() };
        let target = body.follow(Some(&command), None, 0.0)[joint];
        assert!((drive.stiffness * (target - q) - drive.damping * dq - drive.effort_limit).abs() < 1e-9);
    }

    #[test]
    fn a_silent_program_leaves_a_robot_that_only_damps() {
        let mut body = body();
        let command =
            LowCmd { motor_cmd: [MotorCmd { mode: 1, kp: 100.0, ..MotorCmd::default() }; 35], ..LowCmd::default() };
        let targets = body.follow(Some(&command), None, 0.11).to_vec();
        for joint in body.motors.body {
            let drive = body.drives[joint];
            let effort = drive.stiffness * (targets[joint] - body.q[joint]) - drive.damping * 0.2;
            assert!((effort + 8.0 * f64::from(0.2_f32)).abs() < 1e-6, "{effort}");
        }
        // Before the first command the posture of the start stays.
        let mut body = self::body();
        let before = body.targets.clone();
        assert_eq!(body.follow(None, None, 1e9), before);
    }

    #[test]
    fn linkages_motors_keep_the_joints_last_targets() {
        let mut body = body();
        let command = LowCmd {
            mode_pr: 1,
            motor_cmd: [MotorCmd { mode: 1, q: 0.3, kp: 40.0, ..MotorCmd::default() }; 35],
            ..LowCmd::default()
        };
        let (before, targets) = (body.targets.clone(), body.follow(Some(&command), None, 0.0).to_vec());
        let kept: Vec<usize> =
            (0..29).filter(|&motor| before[body.motors.body[motor]] == targets[body.motors.body[motor]]).collect();
        assert_eq!(kept, LINKED);
    }

    #[test]
    fn a_hands_motor_bends_all_its_finger() {
        let mut body = body();
        let cmd = |q| crate::messages::HandMotorCmd { q, ..Default::default() };
        let hands = HandCmds { cmds: vec![cmd(0.0), cmd(0.5), cmd(1.0), cmd(7.0), cmd(0.0), cmd(0.5)] };
        let targets = body.follow(None, Some(&hands), 0.0).to_vec();
        let angle = |name: &str| targets[info().joints.iter().position(|joint| joint.name == name).expect("a joint")];
        assert_eq!([angle("R_pinky_proximal_joint"), angle("R_pinky_intermediate_joint")], [1.7, 1.7]);
        assert_eq!(angle("R_ring_intermediate_joint"), 0.85);
        assert_eq!([angle("R_middle_proximal_joint"), angle("R_index_proximal_joint")], [0.0, 0.0]);
        // The thumb's last joint meets its stop first.
        assert_eq!([angle("R_thumb_proximal_pitch_joint"), angle("R_thumb_distal_joint")], [0.6, 1.2]);
    }

    #[test]
    fn commands_with_a_wrong_checksum_or_no_number_are_not_sound() {
        let sealed = LowCmd::default().sealed();
        assert!(is_sound(&sealed));
        assert!(!is_sound(&LowCmd { crc: sealed.crc ^ 1, ..sealed.clone() }));
        let mut broken = LowCmd::default();
        broken.motor_cmd[28].q = f32::NAN;
        assert!(!is_sound(&broken.sealed()));
    }
}
