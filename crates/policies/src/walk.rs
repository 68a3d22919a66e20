//! The policy `walk`: walks to the crate, the fresh bulb or the ladder with the whole-body controller, and stands
//! there. Arms whose hand holds nothing hang and swing.

use std::sync::Arc;

use fiatlux_proto::v3::{Chunk, Observation, Pose, Privileged, Sensor, SessionInfo};
use fiatlux_rules::Task;
use fiatlux_skills::GAIN;
use fiatlux_skills::path::{Map, Point, distance, planar, rectangle, turn};
use fiatlux_skills::phases::Skill;
use fiatlux_wbc::{BodyCommand, Network};

use super::body;
use fiatlux_client::{Command, Policy, PolicyError};

use crate::entry::Entry;
use crate::gait::{self, Gait};

/// As a program makes it.
pub(crate) const ENTRY: Entry = Entry {
    name: "walk[:FILE]",
    does: "walks to the crate (S05), the fresh bulb (S07) or the ladder (S09) by their exact poses, and stands there; \
           walk:FILE with weights of your own",
    make: |file| Ok(Box::new(Walk::new(file)?)),
};

/// Preferred distance from obstacles, m.
const CLEAR_M: f64 = 0.45;
/// Control steps between plans.
const REPLAN: u64 = 25;
/// Distance ahead on its path at which the robot aims, m.
const AHEAD_M: f64 = 0.35;
/// Largest speed along the path, m/s, and about the vertical, rad/s.
const FASTEST: (f64, f64) = (0.45, 0.7);
/// Room around the robot before it turns, m, and the control steps after which it turns all the same: its hands reach ahead, and
/// what they hold would hit what it stands at.
const ROOM_M: f64 = 0.65;
const LEAVES: u64 = 250;
/// Half extents of the ladder on the floor, x and y of its own frame, m: to the middle of its rails, 0.29 and 0.48, and 0.12
/// more for the bulb that the robot carries ahead of it. So it comes to the rails straight and not past a corner.
const LADDER_HALF: [f64; 2] = [0.41, 0.60];
/// It stands at the ladder's rails, within this cosine of their direction: what it holds would hit the legs elsewhere. Where it goes on
/// to climb, it stands at the steps, on -y.
const AT_RAILS: f64 = 0.25;
/// Room from walls and things that it prefers there, m: between steps and wall, what it holds hits the ladder. And slack once it stands.
const ROOM_AT_LADDER_M: f64 = 0.45;
const ROOM_SLACK_M: f64 = 0.1;
/// Speed at which it steps away, m/s.
const LEAVES_M_S: f64 = 0.3;
/// Distance to the goal at which the robot begins to turn towards the target, m.
const NEAR_M: f64 = 0.4;
/// Where the right hand takes the bulb from the bench, ahead of the pelvis and to the left: `[stand]` of `hands/grab.toml`; where its
/// elbow is then, to the right; and room that pelvis and elbow need there from the bench, m.
pub(crate) const GRAB: [f64; 2] = [0.38, -0.08];
const ELBOW_M: f64 = 0.25;
const BENCH_ROOM_M: [f64; 2] = [0.18, 0.31];
/// Facing error at which it stops within reach, rad, and slack beyond which it moves again, m.
const FACING: (f64, f64) = (0.15, 0.35);
const SLACK_M: f64 = 0.025;

/// The target of a task.
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

    /// Distance at which the pelvis stops, to the crate's footprint or to the target's origin, m. The gates require
    /// 0.50, 0.63 and 0.85.
    fn stop_m(self) -> f64 {
        match self {
            Self::Crate => 0.42,
            Self::FreshBulb => 0.57,
            Self::Ladder => 0.845,
        }
    }
}

/// Places at which it stops, the next ones if no way leads to these.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd)]
enum Choice {
    /// Where the skill that comes next can work, at the ladder with room.
    Best,
    /// At the ladder: at either rail, with room.
    Roomy,
    /// Anywhere: at the ladder, also beside its legs, which was tried in rooms whose rails both have less room.
    Any,
}

/// Walks to a goal and stands there. An arm whose hand holds something keeps the staged posture.
pub struct Walk {
    name: String,
    network: Arc<Network>,
    /// It stops only where the skill that comes next can work.
    works: bool,
    state: Option<EpisodeState>,
}

/// State of one episode: the body, the goal, and the path to it.
struct EpisodeState {
    gait: Gait,
    goal: Goal,
    map: Map,
    /// Without the ladder.
    walls: Map,
    path: Vec<Point>,
    planned: Option<u64>,
    has_room: bool,
    choice: Choice,
    works: bool,
    has_arrived: bool,
}

impl Walk {
    /// Uses the controller in a file, or the one that comes with this version if the file's name is empty.
    ///
    /// # Errors
    /// A file that cannot be read or does not fit.
    pub fn new(file: &str) -> Result<Self, PolicyError> {
        let (name, network) = body::network("walk", file, file)?;
        Ok(Self { name, network, works: false, state: None })
    }

    /// As a part of the errand: it stops only where the skill that comes next can work.
    pub(crate) fn for_work(self) -> Self {
        Self { works: true, ..self }
    }
}

impl Skill for Walk {
    fn is_over(&self) -> bool {
        self.state.as_ref().is_some_and(|state| state.has_arrived)
    }

    fn phase(&self) -> String {
        self.state.as_ref().map_or("", |state| if state.has_arrived { "Stand" } else { "Walk" }).into()
    }

    fn body_command(&self) -> Option<BodyCommand> {
        self.state.as_ref()?.gait.commanded()
    }
}

impl Policy for Walk {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn tasks(&self) -> &'static [Task] {
        &[Task::S05, Task::S07, Task::S09]
    }

    fn sensors(&self) -> Vec<Sensor> {
        gait::SENSORS.into_iter().chain(["privileged"]).map(Sensor::from).collect()
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        let task = info.task.as_ref().map(|task| task.task.as_str()).unwrap_or_default();
        let Some(goal) = Goal::of(task) else {
            let reason = format!("it walks in S05, S07 and S09, but this is {task}; use another policy");
            return Err(PolicyError::Unfit { policy: "walk", reason });
        };
        let seen = privileged(first)?;
        // The ladder has no footprint, because it can be moved.
        let ladder = ("ladder".into(), rectangle(known(seen.ladder.as_ref())?, LADDER_HALF));
        let things = || Map::outlines(info, [0.05, 1.3]);
        let (map, walls) = (Map::new(things().chain([ladder]), CLEAR_M), Map::new(things(), CLEAR_M));
        self.state = Some(EpisodeState {
            gait: Gait::new("walk", Arc::clone(&self.network), info, first)?,
            goal,
            map,
            walls,
            path: Vec::new(),
            planned: None,
            has_room: false,
            choice: Choice::Best,
            works: self.works,
            has_arrived: false,
        });
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let state = self.state.as_mut().ok_or_else(|| PolicyError::not_reset("walk"))?;
        let wanted = state.command(observation.step, privileged(observation)?)?;
        state.gait.step(observation, wanted)
    }

    fn source(&mut self) -> Option<Chunk> {
        self.state.as_mut()?.gait.record()
    }
}

impl EpisodeState {
    fn command(&mut self, step: u64, seen: &Privileged) -> Result<BodyCommand, PolicyError> {
        let mut command = BodyCommand::default();
        let (here, heading) = known(seen.robot.as_ref())?;
        let (thing, turned) = match self.goal {
            Goal::Crate => known(seen.crate_.as_ref())?,
            Goal::FreshBulb => known(seen.fresh_bulb.as_ref())?,
            Goal::Ladder => known(seen.ladder.as_ref())?,
        };
        let stop = self.goal.stop_m();
        let (map, walls, goal, choice, works) = (&self.map, &self.walls, self.goal, self.choice, self.works);
        let room = ROOM_AT_LADDER_M - if self.has_arrived { ROOM_SLACK_M } else { 0.0 };
        let is_good_side = |at: Point| match goal {
            Goal::Ladder => {
                let side = turn(turned, thing, at);
                let is_at_steps = || !works || choice > Choice::Best || libm::sin(side) < 0.0;
                let is_at_rails = libm::cos(side).abs() <= AT_RAILS && is_at_steps();
                choice == Choice::Any || is_at_rails && walls.clearance(at) > room
            }
            _ => !works || choice == Choice::Any || has_room_to_reach(map, thing, at),
        };
        // A search for a path asks this of tens of thousands of places: their distance first, which most of them fail.
        let is_within = |at: Point, most: f64| match goal {
            Goal::Crate => map.distance_to("crate", at).unwrap_or_else(|| distance(at, thing)) < most,
            Goal::FreshBulb | Goal::Ladder => distance(at, thing) < most && is_good_side(at),
        };
        let faces = turn(heading, here, thing);
        let is_near = is_within(here, stop + if self.has_arrived { SLACK_M } else { 0.0 });
        self.has_arrived = is_near && faces.abs() < if self.has_arrived { FACING.1 } else { FACING.0 };
        if self.has_arrived {
            return Ok(command);
        }
        if is_near {
            command.velocity[2] = (GAIN * faces).clamp(-0.5, 0.5);
            return Ok(command);
        }
        let leaves = self.goal != Goal::Ladder && !self.has_room && step <= LEAVES;
        let way_out = if leaves { map.way_out(here, ROOM_M) } else { None };
        self.has_room = way_out.is_none();
        if let Some(angle) = way_out {
            let [ahead, left] = [libm::cos(angle - heading), libm::sin(angle - heading)];
            command.velocity = [LEAVES_M_S * ahead, LEAVES_M_S * left, 0.0];
            return Ok(command);
        }
        if self.planned.is_none_or(|planned| step >= planned + REPLAN) {
            self.path = map.path(here, |at| is_within(at, stop - 0.02));
            self.planned = Some(step);
            if self.path.is_empty() && choice != Choice::Any {
                let is_next = choice == Choice::Best && goal == Goal::Ladder;
                self.choice = if is_next { Choice::Roomy } else { Choice::Any };
                self.planned = None;
            }
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
            (GAIN * look).clamp(-FASTEST.1, FASTEST.1),
        ];
        Ok(command)
    }
}

/// From there, steps towards the bulb lead to where the hand reaches it, and pelvis and elbow are clear of the bench.
fn has_room_to_reach(map: &Map, bulb: Point, at: Point) -> bool {
    let away = distance(at, bulb).max(1e-6);
    let ahead = [0, 1].map(|axis| (bulb[axis] - at[axis]) / away);
    let left = [-ahead[1], ahead[0]];
    let pelvis = [0, 1].map(|axis| bulb[axis] - GRAB[0] * ahead[axis] - GRAB[1] * left[axis]);
    let elbow = [0, 1].map(|axis| pelvis[axis] - ELBOW_M * left[axis]);
    let mut rooms = [pelvis, elbow].into_iter().zip(BENCH_ROOM_M);
    rooms.all(|(place, least)| map.distance_to("bench", place).is_none_or(|room| room > least))
}

fn privileged(observation: &Observation) -> Result<&Privileged, PolicyError> {
    observation.privileged.as_ref().ok_or(PolicyError::Sensor { policy: "walk", sensor: "privileged" })
}

/// Position and heading of a pose on the floor.
fn known(pose: Option<&Pose>) -> Result<(Point, f64), PolicyError> {
    let reason = "the privileged observation lacks a pose".into();
    planar(pose).ok_or(PolicyError::Unfit { policy: "walk", reason })
}
