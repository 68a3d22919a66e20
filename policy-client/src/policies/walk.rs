//! Policy `walk`: goes to the crate, the fresh bulb or the ladder on the whole-body controller, and stands there.

mod path;

use std::sync::Arc;

use fiatlux_proto::v3::{Chunk, Observation, Pose, Privileged, Sensor, SessionInfo};
use fiatlux_wbc::Network;

use self::path::{Map, Point, distance};
use super::carrier::Body;
use crate::{Command, Policy, PolicyError};

/// Control steps between plans.
const REPLAN: u64 = 25;
/// How far ahead on its path the robot looks, m.
const AHEAD_M: f64 = 0.35;
/// Largest velocity along the path, m/s, and about the vertical, rad/s.
const FASTEST: (f64, f64) = (0.45, 0.7);
/// How fast the velocity changes, m/s^2 and rad/s^2: what is in the hand is not to be jerked.
const GAIN: (f64, f64) = (0.6, 1.2);
/// The robot stands this long before it goes, control steps: the controller takes over a staged posture.
const SETTLES: u64 = 25;
/// From this distance to the goal on the robot turns to what it goes to, m.
const NEAR_M: f64 = 0.4;
/// Facing so well and standing within reach it stops; beyond the slack it goes on, rad and m.
const FACING: (f64, f64) = (0.15, 0.35);
const SLACK_M: f64 = 0.025;

/// Where a task goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Goal {
    Crate,
    FreshBulb,
    Ladder,
}

impl Goal {
    fn of(task: &str) -> Option<Self> {
        match task {
            "S05" => Some(Self::Crate),
            "S07" => Some(Self::FreshBulb),
            "S09" => Some(Self::Ladder),
            _ => None,
        }
    }

    /// How near the pelvis stops: to the crate's footprint, or to the thing's origin, m. The gates ask for 0.50, 0.63 and
    /// 0.85.
    fn stop_m(self) -> f64 {
        match self {
            Self::Crate => 0.42,
            Self::FreshBulb => 0.57,
            Self::Ladder => 0.82,
        }
    }
}

/// Goes to a goal and stands there; the arms keep the posture of the start.
pub struct Walk {
    network: Arc<Network>,
    trip: Option<Trip>,
}

/// An episode's way.
struct Trip {
    body: Body,
    goal: Goal,
    map: Map,
    path: Vec<Point>,
    planned: Option<u64>,
    has_arrived: bool,
    velocity: [f64; 3],
}

impl Walk {
    /// On the controller that comes with this version.
    ///
    /// # Errors
    /// A controller that does not load; a test guards that it does.
    pub fn new() -> Result<Self, PolicyError> {
        Ok(Self { network: Arc::new(Network::shipped()?), trip: None })
    }
}

impl Policy for Walk {
    fn name(&self) -> String {
        "walk".into()
    }

    fn sensors(&self) -> Vec<Sensor> {
        ["proprioception", "hand_contact", "last_action", "privileged"].map(Sensor::from).into()
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        let task = info.task.as_ref().map(|task| task.task.as_str()).unwrap_or_default();
        let Some(goal) = Goal::of(task) else {
            let reason = format!("it walks in S05, S07 and S09, and this is {task}; use another policy");
            return Err(PolicyError::Unfit { policy: "walk", reason });
        };
        privileged(first)?;
        let body = Body::own("walk", Arc::clone(&self.network), info, first)?;
        let outlines = info.footprints.iter().filter(|print| print.bottom < 1.3 && print.top > 0.05);
        let map = Map::new(outlines.map(|print| (print.name.clone(), path::corners(&print.outline))));
        self.trip =
            Some(Trip { body, goal, map, path: Vec::new(), planned: None, has_arrived: false, velocity: [0.0; 3] });
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let trip = self.trip.as_mut().ok_or_else(|| PolicyError::not_reset("walk"))?;
        let wanted = trip.command(observation.step, privileged(observation)?)?;
        let command = trip.gently(wanted, observation.step);
        trip.body.step(observation, &command)
    }

    fn source(&mut self) -> Option<Chunk> {
        self.trip.as_ref()?.body.record()
    }
}

impl Trip {
    /// Bounds how fast the velocity changes, but for a stop.
    fn gently(&mut self, wanted: fiatlux_wbc::Command, step: u64) -> fiatlux_wbc::Command {
        let rates = [GAIN.0, GAIN.0, GAIN.1].map(|rate| rate * fiatlux_wbc::CONTROL_DT);
        let goes = wanted.walks() && step >= SETTLES;
        for (axis, rate) in rates.into_iter().enumerate() {
            let change = (wanted.velocity[axis] - self.velocity[axis]).clamp(-rate, rate);
            self.velocity[axis] = if goes { self.velocity[axis] + change } else { 0.0 };
        }
        fiatlux_wbc::Command { velocity: self.velocity, ..wanted }
    }

    fn command(&mut self, step: u64, seen: &Privileged) -> Result<fiatlux_wbc::Command, PolicyError> {
        let mut command = fiatlux_wbc::Command::default();
        let (here, heading) = planar(seen.robot.as_ref())?;
        let thing = match self.goal {
            Goal::Crate => planar(seen.crate_.as_ref())?,
            Goal::FreshBulb => planar(seen.fresh_bulb.as_ref())?,
            Goal::Ladder => planar(seen.ladder.as_ref())?,
        };
        let thing = thing.0;
        let stop = self.goal.stop_m();
        let crate_only = self.goal == Goal::Crate;
        let map = &self.map;
        let apart = |at: Point| match crate_only {
            true => map.distance_to("crate", at).unwrap_or_else(|| distance(at, thing)),
            false => distance(at, thing),
        };
        let faces = turn(heading, here, thing);
        let is_near = apart(here) < stop + if self.has_arrived { SLACK_M } else { 0.0 };
        self.has_arrived = is_near && faces.abs() < if self.has_arrived { FACING.1 } else { FACING.0 };
        if self.has_arrived {
            return Ok(command);
        }
        if is_near {
            command.velocity[2] = (1.5 * faces).clamp(-0.5, 0.5);
            return Ok(command);
        }
        if self.planned.is_none_or(|planned| step >= planned + REPLAN) {
            self.path = map.path(here, |at| apart(at) < stop - 0.02);
            self.planned = Some(step);
        }
        let ahead = self.path.iter().copied().find(|point| distance(here, *point) > AHEAD_M);
        let ahead = ahead.or(self.path.last().copied()).unwrap_or(thing);
        let left = self.path.last().map_or(0.0, |last| distance(here, *last));
        let way = turn(heading, here, ahead);
        let look = if left < NEAR_M { faces } else { way };
        let speed = (0.1 + 0.8 * left).min(FASTEST.0) * if look.abs() > 0.6 { 0.25 } else { 1.0 };
        command.velocity = [
            (speed * libm::cos(way)).max(-0.3),
            (speed * libm::sin(way)).clamp(-0.3, 0.3),
            (1.5 * look).clamp(-FASTEST.1, FASTEST.1),
        ];
        Ok(command)
    }
}

fn privileged(observation: &Observation) -> Result<&Privileged, PolicyError> {
    observation.privileged.as_ref().ok_or(PolicyError::Sensor { policy: "walk", sensor: "privileged" })
}

/// Angle from where the robot looks to a point, rad.
fn turn(heading: f64, here: Point, there: Point) -> f64 {
    let angle = libm::atan2(there[1] - here[1], there[0] - here[0]) - heading;
    libm::atan2(libm::sin(angle), libm::cos(angle))
}

/// Place and heading of a pose.
fn planar(pose: Option<&Pose>) -> Result<(Point, f64), PolicyError> {
    let missing = || PolicyError::Unfit { policy: "walk", reason: "the privileged observation lacks a pose".into() };
    let pose = pose.ok_or_else(missing)?;
    let (&[x, y, _], &[w, i, j, k]) = (pose.position.as_slice(), pose.quaternion.as_slice()) else {
        return Err(missing());
    };
    let heading = libm::atan2(2.0 * (w * k + i * j), 1.0 - 2.0 * (j * j + k * k));
    Ok(([x, y], heading))
}
