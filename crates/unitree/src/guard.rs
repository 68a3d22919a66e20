//! All that may reach a robot's motors: targets of a policy, bounded and watched, or damping for good.
//!
//! Time is given, in s, so that each rule can be tried without a clock.

use std::fmt;

use fiatlux_proto::v3::Joint;
use fiatlux_rules::CONTROL_DT;

use crate::messages::{LowCmd, LowState, MotorCmd};
use crate::motors::MOTORS;
use crate::remote::Remote;

/// Damping of a robot that is let down, N m s/rad, as in the maker's own programs.
pub(crate) const DAMPING: f32 = 8.0;
/// Without commands for so long a robot is let down, s, and without states, too.
pub(crate) const MAX_SILENCE: f64 = 0.1;

/// Beyond these a robot is let down. The defaults are the maker's own, where it names any.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Between the pelvis's axis and the vertical, rad.
    pub tilt: f64,
    /// Of any motor, rad/s. The maker's examples stop at 10, which a swinging leg passes; rated speeds begin at 20.
    pub joint_speed: f64,
    /// Of the pelvis, rad/s.
    pub turn_rate: f64,
    /// Of a motor's casing and winding, degrees Celsius.
    pub temperatures: [i16; 2],
    /// Without a state, or without targets, s.
    pub silence: f64,
    /// Largest change of a target from one command to the next, rad.
    pub jump: f64,
    /// Time from the measured posture to the policy's first one, s.
    pub ramp: f64,
    /// The policy's period, s.
    pub period: f64,
    /// Time over which a new target is reached, s.
    pub reach: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            tilt: 1.0,
            joint_speed: 20.0,
            turn_rate: 6.0,
            temperatures: [85, 120],
            silence: MAX_SILENCE,
            jump: 0.1,
            ramp: 3.0,
            period: CONTROL_DT,
            // Half a period: targets that are late by all of it make a robot fall that walks at its limit of delay.
            reach: CONTROL_DT / 2.0,
        }
    }
}

/// Why a robot was let down.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(missing_docs)] // Their text says it.
pub enum Reason {
    TimeOver,
    Stopped,
    Program,
    Remote,
    Tilt(f64),
    TurnRate(f64),
    JointSpeed { motor: usize, speed: f64 },
    Hot { motor: usize, celsius: i16 },
    StateLost(f64),
    TargetsLost(f64),
    Targets,
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TimeOver => f.write_str("the time is over"),
            Self::Stopped => f.write_str("stopped by the operator"),
            Self::Program => f.write_str("this program failed"),
            Self::Remote => f.write_str("stopped by the remote: B or select"),
            Self::Tilt(tilt) => write!(f, "the pelvis leans by {tilt:.2} rad"),
            Self::TurnRate(rate) => write!(f, "the pelvis turns at {rate:.1} rad/s"),
            Self::JointSpeed { motor, speed } => write!(f, "{} moves at {speed:.1} rad/s", MOTORS[*motor]),
            Self::Hot { motor, celsius } => write!(f, "the motor of {} has {celsius} degrees Celsius", MOTORS[*motor]),
            Self::StateLost(age) => write!(f, "no sound state on rt/lowstate for {:.0} ms", age * 1e3),
            Self::TargetsLost(age) => write!(f, "no targets of the policy for {:.0} ms", age * 1e3),
            Self::Targets => f.write_str("a target of the policy is not finite"),
        }
    }
}

/// A motor's drive and its joint.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Drive {
    /// N m/rad.
    pub stiffness: f64,
    /// N m s/rad.
    pub damping: f64,
    /// N m.
    pub effort_limit: f64,
    /// rad.
    pub lower: f64,
    /// rad.
    pub upper: f64,
}

impl Drive {
    /// Of a session's joint.
    pub(crate) fn of(joint: &Joint) -> Self {
        let Joint { stiffness, damping, effort_limit, lower, upper, .. } = *joint;
        Self { stiffness, damping, effort_limit, lower, upper }
    }
}

/// Targets of all motors, rad.
pub type Targets = [f64; MOTORS.len()];

/// Turns targets into commands. Once it lets the robot down, every command damps, for ever.
#[derive(Debug, Clone)]
pub struct Guard {
    limits: Limits,
    drives: [Drive; MOTORS.len()],
    began: f64,
    measured: (LowState, f64),
    /// Targets before and after the newest ones came, and when they came.
    from: Targets,
    to: Targets,
    aimed: f64,
    sent: Targets,
    down: Option<Reason>,
}

impl Guard {
    /// Takes a robot over in the posture that it has.
    pub fn new(limits: Limits, drives: [Drive; MOTORS.len()], state: LowState, now: f64) -> Self {
        let mut posture = [0.0; MOTORS.len()];
        for (angle, motor) in posture.iter_mut().zip(&state.motor_state) {
            *angle = f64::from(motor.q);
        }
        Self {
            limits,
            drives,
            began: now,
            measured: (state, now),
            from: posture,
            to: posture,
            aimed: now,
            sent: posture,
            down: None,
        }
    }

    /// Why the robot is let down, if it is.
    pub fn down(&self) -> Option<Reason> {
        self.down
    }

    /// True while the robot is still brought to the policy's first posture.
    pub fn is_ramping(&self, now: f64) -> bool {
        now - self.began < self.limits.ramp
    }

    /// Lets the robot down.
    pub fn stop(&mut self, reason: Reason) {
        self.down.get_or_insert(reason);
    }

    /// A sound state came in.
    pub fn measure(&mut self, state: LowState, now: f64) {
        self.measured = (state, now);
        if let Some(reason) = self.found() {
            self.stop(reason);
        }
    }

    /// Limits that the last state is beyond.
    fn found(&self) -> Option<Reason> {
        let (state, limits) = (&self.measured.0, &self.limits);
        if Remote::read(&state.wireless_remote).stops() {
            return Some(Reason::Remote);
        }
        let [w, x, y, z] = state.imu_state.quaternion.map(f64::from);
        // The cosine of the tilt is the vertical part of the pelvis's own axis.
        let tilt = ((w * w - x * x - y * y + z * z) / (w * w + x * x + y * y + z * z)).acos();
        let beyond = |number: f64, limit: f64| number.is_nan() || number > limit;
        if beyond(tilt, limits.tilt) {
            return Some(Reason::Tilt(tilt));
        }
        let rate = state.imu_state.gyroscope.iter().map(|rate| f64::from(*rate).powi(2)).sum::<f64>().sqrt();
        if beyond(rate, limits.turn_rate) {
            return Some(Reason::TurnRate(rate));
        }
        let mut motors = state.motor_state[..MOTORS.len()].iter().enumerate();
        motors.find_map(|(index, motor)| {
            let speed = f64::from(motor.dq).abs();
            if beyond(speed, limits.joint_speed) || !motor.q.is_finite() {
                return Some(Reason::JointSpeed { motor: index, speed });
            }
            let hot = motor.temperature.into_iter().zip(limits.temperatures).find(|(celsius, most)| celsius > most);
            hot.map(|(celsius, _)| Reason::Hot { motor: index, celsius })
        })
    }

    /// New targets of the policy, rad.
    pub fn aim(&mut self, targets: &Targets, now: f64) {
        if targets.iter().all(|target| target.is_finite()) {
            self.from = self.on_the_way(now);
            (self.to, self.aimed) = (*targets, now);
        } else {
            self.stop(Reason::Targets);
        }
    }

    /// Between the last targets and the newest ones.
    fn on_the_way(&self, now: f64) -> Targets {
        let share = ((now - self.aimed) / self.limits.reach).clamp(0.0, 1.0);
        std::array::from_fn(|motor| self.from[motor] + share * (self.to[motor] - self.from[motor]))
    }

    /// The command to send now.
    pub fn command(&mut self, now: f64) -> LowCmd {
        let silent = |since: f64| now - since > self.limits.silence;
        if silent(self.measured.1) {
            self.stop(Reason::StateLost(now - self.measured.1));
        } else if silent(self.aimed) {
            self.stop(Reason::TargetsLost(now - self.aimed));
        }
        let state = &self.measured.0;
        let mut cmd = LowCmd { mode_machine: state.mode_machine, ..LowCmd::default() };
        if self.down.is_some() {
            cmd.motor_cmd[..MOTORS.len()].fill(MotorCmd { mode: 1, kd: DAMPING, ..MotorCmd::default() });
            return cmd.sealed();
        }
        let wanted = self.on_the_way(now);
        // A share of the way to the policy's posture, which goes on moving meanwhile.
        let share = ((now - self.began) / self.limits.ramp).clamp(0.0, 1.0);
        for motor in 0..MOTORS.len() {
            let (drive, measured) = (&self.drives[motor], f64::from(state.motor_state[motor].q));
            let before = self.sent[motor];
            let target = if share < 1.0 {
                // What is left of the ramp is walked evenly.
                let left = ((1.0 - share) * self.limits.ramp / crate::PERIOD_S).max(1.0);
                before + (wanted[motor] - before) / left
            } else {
                wanted[motor]
            };
            let reach = drive.effort_limit / drive.stiffness;
            let target = target.clamp(measured - reach, measured + reach).clamp(drive.lower, drive.upper);
            let target = target.clamp(before - self.limits.jump, before + self.limits.jump);
            self.sent[motor] = target;
            let (kp, kd) = (drive.stiffness as f32, drive.damping as f32);
            cmd.motor_cmd[motor] = MotorCmd { mode: 1, q: target as f32, kp, kd, ..MotorCmd::default() };
        }
        cmd.sealed()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DRIVE: Drive = Drive { stiffness: 100.0, damping: 2.0, effort_limit: 50.0, lower: -2.0, upper: 2.0 };

    fn state() -> LowState {
        let mut state = LowState { mode_machine: 5, ..LowState::default() };
        state.imu_state.quaternion[0] = 1.0;
        state
    }

    fn guard() -> Guard {
        Guard::new(Limits { ramp: 0.0, ..Limits::default() }, [DRIVE; 29], state(), 0.0)
    }

    fn damps(cmd: &LowCmd) -> bool {
        cmd.crc == cmd.checksum()
            && cmd.motor_cmd[..29].iter().all(|motor| *motor == MotorCmd { mode: 1, kd: 8.0, ..MotorCmd::default() })
    }

    #[test]
    fn targets_are_reached_within_half_a_period() {
        let mut guard = guard();
        guard.aim(&[0.04; 29], 0.0);
        let angles: Vec<f32> = (1..=7).map(|tick| guard.command(0.002 * f64::from(tick)).motor_cmd[3].q).collect();
        assert!((angles[0] - 0.008).abs() < 1e-6 && (angles[3] - 0.032).abs() < 1e-6, "{angles:?}");
        assert_eq!(angles[4..], [0.04, 0.04, 0.04]);
        let cmd = guard.command(0.03);
        assert_eq!((cmd.mode_pr, cmd.mode_machine, cmd.crc), (0, 5, cmd.checksum()));
        assert_eq!((cmd.motor_cmd[3].mode, cmd.motor_cmd[3].kp, cmd.motor_cmd[3].kd), (1, 100.0, 2.0));
        assert_eq!(cmd.motor_cmd[29], MotorCmd::default(), "slots without a motor are empty");
    }

    #[test]
    fn every_limit_lets_the_robot_down_for_good() {
        let with = |change: &dyn Fn(&mut LowState)| {
            let mut state = state();
            change(&mut state);
            state
        };
        let cases = [
            (with(&|state| state.imu_state.quaternion = [0.6_f32.cos(), 0.6_f32.sin(), 0.0, 0.0]), "leans by 1.20"),
            (with(&|state| state.imu_state.quaternion = [f32::NAN; 4]), "leans by NaN"),
            (with(&|state| state.imu_state.quaternion = [0.0; 4]), "leans by NaN"),
            (with(&|state| state.imu_state.gyroscope = [0.0, 4.5, 4.5]), "turns at 6.4"),
            (with(&|state| state.motor_state[3].dq = -20.5), "left_knee_joint moves at 20.5"),
            (with(&|state| state.motor_state[28].dq = f32::NAN), "right_wrist_yaw_joint moves"),
            (with(&|state| state.motor_state[0].q = f32::INFINITY), "left_hip_pitch_joint moves"),
            (with(&|state| state.motor_state[9].temperature = [86, 20]), "right_knee_joint has 86"),
            (with(&|state| state.motor_state[9].temperature = [20, 121]), "right_knee_joint has 121"),
            (with(&|state| state.wireless_remote = Remote::with_keys(&["B"])), "remote"),
            (with(&|state| state.wireless_remote = Remote::with_keys(&["select", "A"])), "remote"),
        ];
        for (bad, says) in cases {
            let mut guard = guard();
            guard.aim(&[0.0; 29], 0.01);
            assert!(!damps(&guard.command(0.01)));
            guard.measure(bad, 0.012);
            assert!(damps(&guard.command(0.012)), "{says}");
            assert!(guard.down().expect("a reason").to_string().contains(says), "{:?} {says}", guard.down());
            // What is well again stays down.
            guard.measure(state(), 0.014);
            guard.aim(&[0.0; 29], 0.014);
            assert!(damps(&guard.command(0.014)));
        }
    }

    #[test]
    fn just_within_its_limits_a_robot_goes_on() {
        let mut within = state();
        within.imu_state.quaternion = [0.49_f32.cos(), 0.49_f32.sin(), 0.0, 0.0];
        within.imu_state.gyroscope = [5.9, 0.0, 0.0];
        within.motor_state[0].dq = 19.9;
        within.motor_state[1].temperature = [85, 120];
        within.wireless_remote = Remote::with_keys(&["A", "start", "L2"]);
        let mut guard = guard();
        guard.measure(within, 0.0);
        assert_eq!(guard.down(), None);
    }

    #[test]
    fn a_dead_peer_is_known_within_100_ms() {
        // States that end, with targets that go on.
        let mut guard = guard();
        let ended = (1..).map(|tick| 0.002 * f64::from(tick)).find(|&now| {
            guard.aim(&[0.0; 29], now);
            damps(&guard.command(now))
        });
        assert!((ended.expect("it ends") - 0.1).abs() < 0.0041, "{ended:?}");
        assert!(matches!(guard.down(), Some(Reason::StateLost(_))));
        // Targets that end, with states that go on.
        let mut guard = self::guard();
        let ended = (1..).map(|tick| 0.002 * f64::from(tick)).find(|&now| {
            guard.measure(state(), now);
            damps(&guard.command(now))
        });
        assert!((ended.expect("it ends") - 0.1).abs() < 0.0041, "{ended:?}");
        assert!(matches!(guard.down(), Some(Reason::TargetsLost(_))));
        let mut guard = self::guard();
        guard.aim(&[f64::NAN; 29], 0.0);
        assert_eq!(guard.down(), Some(Reason::Targets));
    }

    #[test]
    fn no_target_jumps_whatever_the_policy_says() {
        let mut guard = guard();
        let mut last = 0.0_f32;
        for tick in 1..500 {
            let now = 0.002 * f64::from(tick);
            guard.measure(state(), now);
            // From one end to the other, in each step of the policy.
            if tick % 10 == 0 {
                guard.aim(&[if tick % 20 == 0 { 9.0 } else { -9.0 }; 29], now);
            }
            let q = guard.command(now).motor_cmd[0].q;
            assert!((q - last).abs() <= 0.1 + 1e-6, "{q} after {last}");
            // The drive's effort is bounded by 50 N m at 100 N m/rad.
            assert!(q.abs() <= 0.5, "{q}");
            last = q;
        }
        assert_eq!(guard.down(), None);
    }

    #[test]
    fn lost_and_late_states_and_targets_do_not_let_it_down() {
        // 1 % of states lost, targets up to 20 ms late: as a network does it.
        let mut guard = guard();
        let (mut last, mut drawn) = (0.0_f32, 12345_u64);
        let mut draw = || {
            drawn = drawn.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (drawn >> 33) as f64 / f64::from(1_u32 << 31)
        };
        let mut due = 0.02;
        for tick in 1..30_000 {
            let now = 0.002 * f64::from(tick);
            if draw() > 0.01 {
                guard.measure(state(), now);
            }
            if now >= due {
                guard.aim(&[0.3 * (6.0 * now).sin(); 29], now);
                due += 0.02 + 0.02 * draw();
            }
            let q = guard.command(now).motor_cmd[0].q;
            assert!((q - last).abs() <= 0.1);
            last = q;
        }
        assert_eq!(guard.down(), None);
    }

    #[test]
    fn the_start_is_walked_evenly() {
        let mut start = state();
        start.motor_state.iter_mut().for_each(|motor| motor.q = 0.6);
        let mut guard = Guard::new(Limits::default(), [DRIVE; 29], start.clone(), 0.0);
        let mut last = 0.6;
        for tick in 1..=1500 {
            let now = 0.002 * f64::from(tick);
            let mut now_at = start.clone();
            now_at.motor_state.iter_mut().for_each(|motor| motor.q = last as f32);
            guard.measure(now_at, now);
            guard.aim(&[0.0; 29], now);
            let q = f64::from(guard.command(now).motor_cmd[0].q);
            assert!(q <= last + 1e-6 && last - q < 0.6 / 1500.0 * 1.5 + 1e-6, "{tick}: {last} to {q}");
            last = q;
        }
        assert!(last.abs() < 1e-3, "{last}");
        assert!(!guard.is_ramping(3.0));
    }
}
