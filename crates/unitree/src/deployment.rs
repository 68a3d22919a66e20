//! A policy on a robot: its states become observations, the policy's targets become commands.

use std::net::IpAddr;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use fiatlux_client::{Command, Policy, PolicyError};
use fiatlux_proto::v3::{Observation, Proprioception, SessionInfo};
use fiatlux_robot::{Robot, RobotError};
use thiserror::Error;

use crate::dds::{Bus, DdsError, LOW_CMD, LOW_STATE};
use crate::estimate::{Estimate, Estimator};
use crate::guard::{Drive, Guard, Limits, Reason, Targets};
use crate::messages::{LowCmd, LowState};
use crate::motors::{Motors, MotorsError};
use crate::record::{Record, RecordError};
use crate::ticks::{PERIOD, Ticks};

/// Time in which the robot must be heard, and in which nobody else may command it.
const LISTENING: Duration = Duration::from_secs(5);
const ALONE: Duration = Duration::from_millis(200);
/// Damping is sent for so long: one that is lost, or the writer's end, is not the last that the robot hears.
const LETTING_DOWN: Duration = Duration::from_secs(1);

/// The way in which a policy is put on a robot.
#[derive(Debug, Clone, Copy)]
pub struct Deployment<'a> {
    /// Domain of DDS; a robot is in 0.
    pub domain: u16,
    /// Address of this machine on the robot's network.
    pub address: Option<IpAddr>,
    /// Bounds that let the robot down.
    pub limits: Limits,
    /// Everything is computed, and no command is sent.
    pub dry: bool,
    /// File for all states and commands.
    pub record: Option<&'a Path>,
    /// Time for which the policy drives, s.
    pub seconds: f64,
}

/// The end of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Deployed {
    /// Why the robot was let down.
    pub reason: Reason,
    /// States that were heard.
    pub states: u64,
    /// Of these with a wrong checksum.
    pub unsound: u64,
    /// Commands that were sent, or would have been.
    pub commands: u64,
    /// Targets of the policy.
    pub steps: u64,
}

/// Why a policy does not drive a robot.
#[derive(Debug, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum DeployError {
    #[error(transparent)]
    Dds(#[from] DdsError),
    #[error(transparent)]
    Motors(#[from] MotorsError),
    #[error(transparent)]
    Policy(#[from] PolicyError),
    #[error(transparent)]
    Record(#[from] RecordError),
    #[error("the robot's posture cannot be computed")]
    Robot(#[from] RobotError),
    #[error(
        "no state on rt/lowstate within {} s in domain {domain}: is the robot on, and the address on its network?",
        LISTENING.as_secs()
    )]
    Silent { domain: u16 },
    #[error(
        "another program commands the robot on rt/lowcmd; end it first, and release the robot's own walking (L2+R2)"
    )]
    Taken,
    #[error("stopped before the policy drove")]
    Stopped,
}

/// Reads states as observations of a session.
struct Senses<'a> {
    robot: &'a Robot,
    motors: Motors,
    info: &'a SessionInfo,
    /// Joint targets in force, rad.
    targets: Vec<f64>,
    estimator: Estimator,
    measured: Option<Measured>,
}

/// The last state.
struct Measured {
    /// Of all joints, rad and rad/s.
    q: Vec<f64>,
    dq: Vec<f64>,
    /// Of the pelvis in its own frame, rad/s.
    angular_velocity: [f64; 3],
    pelvis: Estimate,
}

impl Senses<'_> {
    fn measure(&mut self, state: &LowState) -> Result<(), RobotError> {
        // Fingers are not measured here: they are taken to be where they are told to be.
        let mut q = self.targets.clone();
        let mut dq = vec![0.0; q.len()];
        for (motor, joint) in state.motor_state.iter().zip(self.motors.body) {
            (q[joint], dq[joint]) = (f64::from(motor.q), f64::from(motor.dq));
        }
        let pelvis = self.estimator.follow(self.robot, &q, &dq, &state.imu_state, state.tick)?;
        let angular_velocity = state.imu_state.gyroscope.map(f64::from);
        self.measured = Some(Measured { q, dq, angular_velocity, pelvis });
        Ok(())
    }

    /// The last state; `None` before the first one.
    fn observe(&self, step: u64) -> Option<Observation> {
        let Measured { q, dq, angular_velocity, pelvis } = self.measured.as_ref()?;
        let numbers = |numbers: &[f64]| numbers.iter().map(|number| *number as f32).collect::<Vec<f32>>();
        let relative = |angles: &[f64], scale: f64| {
            (angles.iter().zip(&self.info.joints)).map(|(angle, joint)| ((angle - joint.q0) / scale) as f32).collect()
        };
        let sensed = Proprioception {
            base_angular_velocity: numbers(angular_velocity),
            projected_gravity: numbers(&pelvis.gravity),
            base_linear_velocity: numbers(&pelvis.linear_velocity),
            base_height: pelvis.height as f32,
            joint_position: relative(q, 1.0),
            joint_velocity: numbers(dq),
        };
        let last_action = relative(&self.targets, self.info.action_scale);
        Some(Observation { step, proprioception: Some(sensed), last_action, ..Observation::default() })
    }

    /// Takes a command over; targets of the body's motors.
    fn follow(&mut self, command: &Command) -> Result<Targets, PolicyError> {
        let unfit = |reason: String| Err(PolicyError::Unfit { policy: "unitree", reason });
        match command {
            Command::JointTarget(numbers) | Command::Action(numbers) if numbers.len() != self.targets.len() => {
                return unfit(format!("its command has {} numbers for {} joints", numbers.len(), self.targets.len()));
            }
            Command::JointTarget(targets) => self.targets.clone_from(targets),
            Command::Action(action) => {
                for ((target, action), joint) in self.targets.iter_mut().zip(action).zip(&self.info.joints) {
                    *target = joint.q0 + self.info.action_scale * action;
                }
            }
            Command::WholeBody(..) => {
                let remedy = "put the controller itself on the robot: wbc";
                return unfit(format!("it leaves the whole-body controller to a server; {remedy}"));
            }
        }
        Ok(std::array::from_fn(|motor| self.targets[self.motors.body[motor]]))
    }
}

/// Drives a robot by a policy until the time is over, `stop` is set or a limit is passed; then lets it down. `info` is that of a
/// session of the same robot.
///
/// # Errors
/// [`DeployError`]; a robot that was driven has been let down.
pub fn deploy(
    deployment: &Deployment<'_>,
    robot: &Robot,
    info: &SessionInfo,
    policy: &mut dyn Policy,
    stop: &AtomicBool,
) -> Result<Deployed, DeployError> {
    let bus = Bus::open(deployment.domain, deployment.address)?;
    let mut states = bus.reader::<LowState>(LOW_STATE)?;
    let mut others = bus.reader::<LowCmd>(LOW_CMD)?;
    let mut record = deployment.record.map(Record::create).transpose()?;
    let mut done = Deployed { reason: Reason::TimeOver, states: 0, unsound: 0, commands: 0, steps: 0 };

    let began = Instant::now();
    let first = loop {
        if stop.load(Ordering::Relaxed) {
            return Err(DeployError::Stopped);
        }
        if others.take().is_some() {
            return Err(DeployError::Taken);
        }
        let state = states.take().filter(|state| state.crc == state.checksum());
        match state {
            Some(state) if began.elapsed() > ALONE => break state,
            None if began.elapsed() > LISTENING => return Err(DeployError::Silent { domain: deployment.domain }),
            _ => std::thread::sleep(PERIOD),
        }
    };
    drop(others);

    let names: Vec<&str> = info.joints.iter().map(|joint| joint.name.as_str()).collect();
    let motors = Motors::of(&names)?;
    let drives = motors.body.map(|joint| Drive::of(&info.joints[joint]));
    let targets = info.joints.iter().map(|joint| joint.q0).collect();
    let mut senses = Senses { robot, motors, info, targets, estimator: Estimator::default(), measured: None };
    senses.measure(&first)?;
    policy.reset(info, &senses.observe(0).unwrap_or_default())?;

    let commands = bus.writer::<LowCmd>(LOW_CMD)?;
    let clock = Instant::now();
    let now = || clock.elapsed().as_secs_f64();
    let mut guard = Guard::new(deployment.limits, drives, first, now());
    let (to_policy, asked) = mpsc::sync_channel::<Observation>(1);
    let (answers, from_policy) = mpsc::channel();
    let driven = std::thread::scope(|scope| {
        scope.spawn(move || {
            while let Ok(observation) = asked.recv() {
                let answer = policy.act(&observation);
                if answers.send(answer).is_err() {
                    break;
                }
            }
        });
        let (mut due, mut measured, mut failure, mut let_down) = (0.0, None, None, None);
        let mut ticks = Ticks::begin();
        loop {
            // What fails here lets the robot down, and is said at the end.
            let mut fails = |guard: &mut Guard, error: DeployError| {
                guard.stop(Reason::Program);
                failure.get_or_insert(error);
            };
            let mut is_new = false;
            while let Some(state) = states.take() {
                done.states += 1;
                if let Some(Err(error)) = record.as_mut().map(|record| record.add(LOW_STATE, &state, clock.elapsed())) {
                    record = None;
                    fails(&mut guard, error.into());
                }
                if state.crc == state.checksum() {
                    is_new |= measured.replace(state.motor_state) != Some(state.motor_state);
                    guard.measure(state.clone(), now());
                    // What is not finite is past a bound already.
                    if guard.down().is_none()
                        && let Err(error) = senses.measure(&state)
                    {
                        fails(&mut guard, error.into());
                    }
                } else {
                    done.unsound += 1;
                }
            }
            for answer in from_policy.try_iter() {
                match answer.and_then(|command| senses.follow(&command)) {
                    Ok(targets) => {
                        done.steps += 1;
                        guard.aim(&targets, now());
                    }
                    Err(error) => fails(&mut guard, error.into()),
                }
            }
            if stop.load(Ordering::Relaxed) {
                guard.stop(Reason::Stopped);
            }
            if now() > deployment.limits.ramp + deployment.seconds {
                guard.stop(Reason::TimeOver);
            }
            // A policy that is still at work is asked again with a later state; one that is not, with a state that has just been measured,
            // if the robot measures less often than it speaks.
            let late = now() - due;
            if (late >= 0.0 && is_new || late > deployment.limits.period)
                && guard.down().is_none()
                && let Some(observation) = senses.observe(done.steps)
                && to_policy.try_send(observation).is_ok()
            {
                due = (due + deployment.limits.period).max(now() - deployment.limits.period);
            }
            let command = guard.command(now());
            if let Some(Err(error)) = record.as_mut().map(|record| record.add(LOW_CMD, &command, clock.elapsed())) {
                record = None;
                fails(&mut guard, error.into());
            }
            if !deployment.dry {
                commands.write(&command);
            }
            done.commands += 1;
            if guard.down().is_some() && *let_down.get_or_insert(now()) + LETTING_DOWN.as_secs_f64() < now() {
                break;
            }
            ticks.wait();
        }
        // The policy's thread ends by it.
        drop(to_policy);
        failure
    });
    done.reason = guard.down().unwrap_or(Reason::TimeOver);
    let closed = record.map_or(Ok(()), Record::finish);
    match driven {
        Some(failure) => Err(failure),
        None => closed.map(|()| done).map_err(DeployError::from),
    }
}
