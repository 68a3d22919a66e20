//! The policy `climb`: walks to the ladder with the whole-body controller, turns its back to it, puts its feet where the plan
//! begins, and climbs backwards along the plan, balanced by contact forces.

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

use fiatlux_client::{Command, Policy, PolicyError};
use fiatlux_climb::{Body, Foothold, JOINTS, Keyframe, Plan, Planner, Player};
use fiatlux_kinematics::Mechanics;
use fiatlux_proto::v3::{Chunk, Observation, Pose, SessionInfo};
use fiatlux_robot::{Gains, JointGains, Robot};
use fiatlux_rules::Task;
use fiatlux_wbc::Network;
use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};

use crate::body;
use crate::entry::Entry;
use crate::whole_body::WholeBody;

/// As a program makes it.
pub(crate) const ENTRY: Entry = Entry {
    name: "climb",
    does: "walks to the ladder, turns and climbs it backwards by exact poses: two steps in S02, to the platform in climb",
    make: |_| Ok(Box::new(Climb::new()?)),
};

/// Distance from the ladder's middle at which it turns, m.
const TURNS_AT: f64 = 1.0;
/// Largest speed of the walk, m/s and rad/s.
const FASTEST: (f64, f64) = (0.2, 0.6);
/// Error at which it stands, m and rad, and beyond which it does not begin to climb, m.
const ARRIVED: (f64, f64) = (0.03, 0.1);
const TOO_FAR: f64 = 0.1;
/// Control steps for which it stands before it climbs.
const SETTLES: u64 = 75;
/// A foot is set anew if it is farther from its place than this, m or rad.
const SET_ANEW: (f64, f64) = (0.01, 0.03);
/// Part by which the angles of the joints go to what is sensed in each control step, while it stands.
const SHARE: f64 = 0.05;
/// Landings after which both feet are on the second tread.
const S02_LANDINGS: usize = 4;
const FLOOR: [f64; 2] = [-0.1, 0.1];

/// Walks up and climbs. It sees where robot and ladder are.
pub struct Climb {
    network: Arc<Network>,
    trip: Option<Trip>,
}

/// State of one episode.
struct Trip {
    walker: WholeBody,
    body: Body,
    plan: Plan,
    q0: Vec<f64>,
    staged: Vec<f64>,
    /// Of the joints while it stands, averaged, rad.
    angles: Vec<f64>,
    stage: Stage,
}

enum Stage {
    /// Away from the ladder until there is room to turn.
    Leaves,
    Turns,
    Approaches,
    /// Stands for so many control steps.
    Settles(u64),
    Climbs(Box<Player>),
}

impl Climb {
    /// With the controller that comes with this version.
    ///
    /// # Errors
    /// A controller that does not fit.
    pub fn new() -> Result<Self, PolicyError> {
        Ok(Self { network: body::network("climb", "", "")?.1, trip: None })
    }
}

fn unfit(reason: String) -> PolicyError {
    PolicyError::Unfit { policy: "climb", reason }
}

impl Policy for Climb {
    fn name(&self) -> String {
        "climb".into()
    }

    fn tasks(&self) -> &'static [Task] {
        &[Task::S02, Task::Climb]
    }

    fn sensors(&self) -> Vec<fiatlux_proto::v3::Sensor> {
        ["proprioception", "last_action", "privileged"].map(fiatlux_proto::v3::Sensor::from).into()
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        let plan = fiatlux_climb::ladder().map_err(PolicyError::of("climb"))?;
        let plan = match info.task.as_ref().map(|task| task.task.as_str()) {
            Some("S02") => plan.until_landing(S02_LANDINGS),
            _ => plan,
        };
        let robot = Robot::with_joints(info.joints.iter().map(|joint| joint.name.as_str()));
        let robot = robot.map_err(|error| unfit(format!("{error}; use another policy")))?;
        let gain = |(joint, own): (&fiatlux_proto::v3::Joint, &JointGains)| JointGains {
            stiffness: joint.stiffness,
            damping: joint.damping,
            effort_limit: joint.effort_limit,
            ..*own
        };
        let own = robot.gains(Default::default());
        let gains = Gains(info.joints.iter().zip(&own.0).map(gain).collect());
        let body = Body::new(robot, gains).ok_or_else(|| unfit("the session's drives do not fit its robot".into()))?;
        poses(first)?;
        self.trip = Some(Trip {
            walker: WholeBody::own("climb", Arc::clone(&self.network), info, first)?,
            q0: info.joints.iter().map(|joint| joint.q0).collect(),
            staged: body::staged("climb", info, first)?,
            angles: Vec::new(),
            body,
            plan,
            stage: Stage::Leaves,
        });
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let trip = self.trip.as_mut().ok_or_else(|| PolicyError::not_reset("climb"))?;
        trip.act(observation)
    }

    fn source(&mut self) -> Option<Chunk> {
        match self.trip.as_ref()? {
            Trip { stage: Stage::Climbs(_), .. } => None,
            trip => trip.walker.record(),
        }
    }
}

impl Trip {
    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let (pelvis, ladder) = poses(observation)?;
        let sensed = observation.proprioception.as_ref();
        let sensed = sensed.ok_or(PolicyError::Sensor { policy: "climb", sensor: "proprioception" })?;
        let angles = self.q0.iter().zip(&sensed.joint_position).map(|(q0, angle)| q0 + f64::from(*angle));
        let angles: Vec<f64> = angles.collect();
        let speeds: Vec<f64> = sensed.joint_velocity.iter().map(|speed| f64::from(*speed)).collect();
        if let Stage::Settles(SETTLES..) = self.stage {
            let player = self.begin(&pelvis, &ladder)?;
            self.stage = Stage::Climbs(Box::new(player));
        }
        if let Stage::Climbs(player) = &mut self.stage {
            let targets = player.step(&pelvis, &angles, &speeds).map_err(PolicyError::of("climb"))?;
            // Hands stay as they are.
            let hands = self.staged.iter().skip(JOINTS);
            return Ok(Command::JointTarget(targets.iter().take(JOINTS).chain(hands).copied().collect()));
        }
        let command = self.walk(&pelvis, &ladder, &angles);
        self.walker.step(observation, &command)
    }

    /// The next command of the walk.
    fn walk(&mut self, pelvis: &Isometry3<f64>, ladder: &Isometry3<f64>, angles: &[f64]) -> fiatlux_wbc::BodyCommand {
        let mut command = fiatlux_wbc::BodyCommand::default();
        let Some(first) = self.plan.keyframes.first() else { return command };
        let place = ladder * first.pelvis;
        let off = pelvis.inverse_transform_vector(&(place.translation.vector - pelvis.translation.vector));
        let turn = heading(&(pelvis.rotation.inverse() * place.rotation));
        let away = (pelvis.translation.vector - ladder.translation.vector).xy().norm();
        match self.stage {
            Stage::Leaves if away >= TURNS_AT => self.stage = Stage::Turns,
            Stage::Leaves => command.velocity = [-FASTEST.0, 0.0, 0.0],
            Stage::Turns if turn.abs() < 0.3 => self.stage = Stage::Approaches,
            Stage::Turns => command.velocity = [0.0, 0.0, FASTEST.1.copysign(turn)],
            Stage::Approaches if off.xy().norm() < ARRIVED.0 && turn.abs() < ARRIVED.1 => {
                self.angles = angles.to_vec();
                self.stage = Stage::Settles(0);
            }
            Stage::Approaches => {
                let speed = (0.08 + 0.8 * off.xy().norm()).min(FASTEST.0);
                let way = off.xy() / off.xy().norm().max(1e-6) * speed;
                command.velocity = [way.x, way.y, (1.5 * turn).clamp(-FASTEST.1, FASTEST.1)];
            }
            Stage::Settles(_) if off.xy().norm() > TOO_FAR => self.stage = Stage::Approaches,
            Stage::Settles(steps) => {
                self.stage = Stage::Settles(steps + 1);
                self.angles.iter_mut().zip(angles).for_each(|(mean, angle)| *mean += SHARE * (angle - *mean));
            }
            Stage::Climbs(_) => {}
        }
        command
    }

    /// Plans from where the robot stands to where the plan of the ladder begins.
    fn begin(&self, pelvis: &Isometry3<f64>, ladder: &Isometry3<f64>) -> Result<Player, PolicyError> {
        let body = &self.body;
        let mut mechanics = Mechanics::new(&body.model);
        let mut feet_of = |pelvis: &Isometry3<f64>, angles: &[f64]| {
            let state = body.state(pelvis, angles);
            mechanics.update(&body.model, &state);
            let foot = |side: usize| {
                let sole = mechanics.world_from_site(&body.ids.site(&body.robot.soles()[side].site));
                let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading(&sole.rotation));
                let at = Vector3::new(sole.translation.x, sole.translation.y, 0.0);
                Foothold { sole: Isometry3::from_parts(at.into(), turn), range: FLOOR, surface: 0 }
            };
            (state, [foot(0), foot(1)])
        };
        let first = self.plan.keyframes.first().ok_or_else(|| unfit("the plan is empty".into()))?;
        let (_, places) = feet_of(&first.pelvis, &first.angles);
        let here = ladder.inverse() * pelvis;
        let (state, mut feet) = feet_of(&here, &self.angles);
        let stuck = || unfit("it finds no steps to where the climb begins".into());
        let mut planner = Planner::new(&body.model, &body.robot, &body.ids, Box::new(|_| Vec::new()));
        let (mut state, stands) = planner.stand(&state, feet).ok_or_else(stuck)?;
        let now = Keyframe { seconds: 0.02, pelvis: here, angles: self.angles[..JOINTS].to_vec(), ..stands.clone() };
        let mut plan = Plan::default();
        plan.extend([now, Keyframe { seconds: 1.5, ..stands }]);
        for side in 0..2 {
            let off = feet[side].sole.inverse() * places[side].sole;
            if off.translation.vector.norm() > SET_ANEW.0 || off.rotation.angle() > SET_ANEW.1 {
                let (next, keyframes) = planner.step(&state, feet, side, places[side]).ok_or_else(stuck)?;
                plan.extend(keyframes);
                (state, feet[side]) = (next, places[side]);
            }
        }
        let mut keyframes = self.plan.keyframes.clone();
        keyframes[0].seconds = 2.0;
        plan.extend(keyframes);
        Player::new(body.clone(), plan, *ladder).map_err(PolicyError::of("climb"))
    }
}

/// Angle about the vertical, rad.
fn heading(rotation: &UnitQuaternion<f64>) -> f64 {
    let ahead = rotation * Vector3::x();
    libm::atan2(ahead.y, ahead.x)
}

/// Pelvis, and the ladder's frame as the plan has it: x from the steps into it.
fn poses(observation: &Observation) -> Result<(Isometry3<f64>, Isometry3<f64>), PolicyError> {
    let seen = observation.privileged.as_ref().ok_or(PolicyError::Sensor { policy: "climb", sensor: "privileged" })?;
    let pose = |pose: &Option<Pose>| {
        let (&[x, y, z], &[w, i, j, k]) = pose.as_ref().map(|pose| (&pose.position[..], &pose.quaternion[..]))? else {
            return None;
        };
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
        Some(Isometry3::from_parts(Vector3::new(x, y, z).into(), rotation))
    };
    let missing = || unfit("the privileged observation lacks a pose".into());
    let (pelvis, ladder) = (pose(&seen.robot).ok_or_else(missing)?, pose(&seen.ladder).ok_or_else(missing)?);
    Ok((pelvis, ladder * Isometry3::rotation(Vector3::z() * FRAC_PI_2)))
}
