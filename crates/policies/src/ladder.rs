//! The policy `ladder`: carries the step ladder under the lamp (S01) on the robot's head, by exact poses.
//!
//! Its platform is 0.29 m above its centre of mass. The robot walks in between the rear legs, bent, stands up below the
//! platform until the ladder hangs on its head, walks to the lamp, and bends its knees. Where the episode goes on, it comes out and
//! stands before the steps.

mod posture;
mod site;

use std::sync::Arc;

use fiatlux_client::{Command, Policy, PolicyError};
use fiatlux_proto::v3::{Chunk, Observation, Pose, Privileged, Sensor, SessionInfo};
use fiatlux_room::ladder;
use fiatlux_rules::Task;
use fiatlux_skills::path::{Map, Point, distance, planar, rectangle, turn, wrapped};
use fiatlux_skills::phases::{Phases, Skill};
use fiatlux_skills::{GAIN, Slew, towards};
use fiatlux_wbc::{ARMS, BODY, BodyCommand, CONTROL_DT, MOVED, Network};
use serde::Deserialize;

use self::posture::{PLATFORM_Z, Posture, Postures, UPRIGHT};
use self::site::{choose_site, outside};
use crate::body;
use crate::climb::relative_height;
use crate::entry::Entry;
use crate::hands::of_robot;
use crate::whole_body::WholeBody;

/// As a program makes it.
pub(crate) const ENTRY: Entry = Entry {
    name: "ladder[:FILE]",
    does: "carries the step ladder under the lamp (S01) by exact poses; ladder:FILE with weights of your own",
    make: |file| Ok(Box::new(Ladder::new(file)?)),
};

/// Half extents of the ladder on the floor, x and y of its own frame, m.
const HALF: [f64; 2] = [0.304, 0.490];
/// Where the robot stands before it walks in, and where below the platform, y of the ladder's frame, m.
const BEFORE_Y: f64 = 0.95;
const BELOW_Y: f64 = 0.05;
/// Where it comes out, x to either side and y, and where it stands before the steps, y, m.
const OUT_X: f64 = 0.95;
const OUT_Y: f64 = 0.20;
const STEPS_Y: f64 = -0.95;
/// Top point of the ladder, y of its frame, and its distance from the fixture, m, and the ladder's tilt, rad, at which all is well.
const TOP_Y: f64 = ladder::TOP_POINT[1];
const REACH_M: f64 = 0.66;
const FLAT: f64 = 0.02;
/// So much nearer to the fixture than its place it does not stand well, m: a robot that turns on it meets the lamp. It is lifted and put
/// down again, which moves it by some centimetres.
const NEARER_M: f64 = 0.035;
/// Distance from these places, m, and turn, rad, at which it is there.
const ARRIVED: [(f64, f64); 2] = [(0.08, 0.15), (0.03, 0.08)];
/// Where the pelvis may be when it stands low below the platform: x either way, and y, m.
const ALIGNED: (f64, [f64; 2]) = (0.06, [-0.07, 0.09]);
/// Where the head bears the ladder: below its centre of mass, y of its frame, m.
const BEARS_Y: f64 = -0.018;
/// Height of the head above the waist, m: how far a lean takes it. Largest lean for that, rad, and its rate, rad/s.
const HEAD_M: f64 = 0.45;
const MAX_LEAN: f64 = 0.2;
const LEAN_RATE: f64 = 0.15;
/// Pitch from which its head does not lift the ladder when it comes out, rad.
const STOOPS: f64 = 0.45;
/// Rates of height, m/s, and of roll and pitch, rad/s.
const RATES: (f64, f64) = (0.07, 0.5);
/// Preferred distances from obstacles, m: of the robot alone, and of the ladder's centre.
const CLEAR_M: [f64; 2] = [0.45, 1.2];
/// Heights between which things are in the way of the robot and of the ladder on its head, m.
const IN_THE_WAY: [[f64; 2]; 2] = [[0.05, 1.3], [0.05, 1.95]];
/// Control steps between plans, and for which the robot stands before and after it moves.
const REPLAN: u64 = 25;
const SETTLES: u64 = 25;
const CALMS: u64 = 75;
/// Control steps after which it gives up walking in, and steps out to try again.
const MAX_ENTER: u64 = 600;
/// The same until it puts the ladder down although it swings, and after which a ladder that should stand well does not.
const MAX_CALM: u64 = 300;
const MAX_DONE: u64 = 100;
/// Tilt of the ladder, averaged over so many seconds, at which it is put down and taken up anew, rad, where its place is still so
/// far away, m.
const MAX_TILT: f64 = 0.15;
const AVERAGE_S: f64 = 1.0;
const TILT_M: f64 = 1.0;
/// Distance ahead on its path at which the robot aims, m.
const AHEAD_M: f64 = 0.35;
/// Largest changes of the velocity without the ladder.
const SLEW: Slew = Slew { linear: 0.6, turn: 1.2 };
/// Largest speeds, m/s and rad/s, and their changes: alone, walking in, and with the ladder.
const ALONE: Pace = Pace { speed: 0.45, turn: 0.7, slew: SLEW };
const INSIDE: Pace = Pace { speed: 0.25, turn: 0.4, slew: SLEW };
const LOADED: Pace = Pace { speed: 0.30, turn: 0.3, slew: Slew { linear: 0.3, turn: 0.6 } };
/// Distance to the goal from which the robot turns to its heading there, m.
const NEAR_M: f64 = 0.4;
/// Distance from the ladder's place, m, and turn, rad, at which it is put down; and where it waits until it is turned, m.
const PLACED: (f64, f64) = (0.05, 0.1);
const WAITS_M: f64 = 0.5;
/// Distance at which it goes back there instead of putting the ladder down, m.
const MAX_OFF_M: f64 = 0.07;
/// Angles of both arms, as `hands/ladder.toml` has them.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct Forearms {
    roll: f64,
    yaw: f64,
    elbow: f64,
}

/// Roll and yaw of a shoulder, outwards, and angle of an elbow, rad, all other angles of an arm being zero: hanging beside the body.
const HANGING: Forearms = Forearms { roll: 0.12, yaw: 0.0, elbow: 1.2 };
/// Rate of the arms' angles, rad/s.
const ARM_RATE: f64 = 1.0;

/// Height of the ladder's origin from which the robot has lifted it, m; where a robot is that is at work below the ladder: x either way and y,
/// m, and turn, rad; and the pelvis's height below which it does not walk, m.
const LIFTED_M: f64 = 0.015;
const BETWEEN: (f64, [f64; 2], f64) = (0.25, [-0.15, 0.9], 0.5);
const STANDS_M: f64 = 0.64;
const WAIST_PITCH: usize = MOVED - 1;

/// Bounds of each part of the velocity, m/s and rad/s.
const SPEEDS: [f64; 2] = [-0.3, 0.45];

/// Bounds of the robot's velocity.
#[derive(Debug, Clone, Copy)]
struct Pace {
    speed: f64,
    turn: f64,
    slew: Slew,
}

/// Position and heading on the floor.
type Place = (Point, f64);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// Walks to the side of the ladder's rear legs.
    Approach,
    /// Bends, and walks in below the platform.
    Enter,
    /// Straightens its back and bends its knees.
    Crouch,
    /// Stands up with the ladder on its head.
    Lift,
    /// Walks to the ladder's place.
    Carry,
    /// Stands until the ladder has stopped swinging.
    Calm,
    /// Bends its knees until the ladder stands.
    Lower,
    /// Stands below the ladder.
    Done,
    /// Walks out backwards, to try again.
    Leave,
    /// Walks out between a rail and a rear leg: behind the ladder may be a wall.
    ComeOut,
    /// Walks around the ladder to its steps.
    Around,
    /// Stands before the steps.
    Away,
}

/// Carries the ladder to the lamp.
pub struct Ladder {
    name: String,
    network: Arc<Network>,
    /// It does not look where in its task the robot is.
    pub(crate) at_start: bool,
    /// Distance of the ladder's middle from a lamp at the ceiling, m, in place of the usual one.
    pub(crate) standoff: Option<f64>,
    episode: Option<Episode>,
}

/// State of an episode.
struct Episode {
    body: WholeBody,
    arms: [f64; ARMS],
    /// Where they press against the front rails.
    holding: Forearms,
    /// The arms are where they are wanted.
    is_ready: bool,
    /// Obstacles that never move, for the robot alone and for the ladder.
    maps: [Map; 2],
    socket: Pose,
    standoff: Option<f64>,
    phases: Phases<Phase, u64>,
    /// Control steps for which height and pitch have been those of the phase.
    held: u64,
    /// Where the ladder goes.
    site: Option<Place>,
    path: Vec<Point>,
    planned: Option<u64>,
    command: BodyCommand,
    postures: Postures,
    /// Roll and pitch of the torso by the phase, and those on top of it that take the head below the ladder's centre of mass, rad.
    torso: [f64; 2],
    lean: [f64; 2],
    /// Averages of the ladder's up along x and y of the world, and the tilt that they come to, rad.
    up: [f64; 2],
    tilt: f64,
}

impl Ladder {
    /// Uses the controller in a file, or the one that comes with this version if the file's name is empty.
    ///
    /// # Errors
    /// A file that cannot be read or does not fit.
    pub fn new(file: &str) -> Result<Self, PolicyError> {
        let (name, network) = body::network("ladder", file, file)?;
        Ok(Self { name, network, at_start: false, standoff: None, episode: None })
    }

    /// Takes in what the robot has learned since the first observation: what stands in the room, and where the lamp is.
    pub(crate) fn learn(&mut self, info: &SessionInfo, socket: Pose) {
        let Some(episode) = &mut self.episode else { return };
        for (map, heights) in episode.maps.iter_mut().zip(IN_THE_WAY) {
            for (name, corners) in Map::outlines(info, heights) {
                map.set(&name, corners);
            }
        }
        episode.socket = socket;
    }

    /// Control step at which an episode first came into a phase of this name; `None` where it has not.
    pub fn entered(&self, phase: &str) -> Option<u64> {
        self.episode.as_ref()?.phases.entered(phase)
    }
}

impl Skill for Ladder {
    fn is_over(&self) -> bool {
        self.episode.as_ref().is_some_and(|episode| episode.phases.now() == Phase::Away)
    }

    fn phase(&self) -> String {
        self.episode.as_ref().map(|episode| episode.phases.name()).unwrap_or_default()
    }

    fn body_command(&self) -> Option<BodyCommand> {
        self.episode.as_ref()?.body.commanded()
    }
}

impl Policy for Ladder {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn tasks(&self) -> &'static [Task] {
        &[Task::S01]
    }

    fn sensors(&self) -> Vec<Sensor> {
        ["proprioception", "last_action", "privileged"].map(Sensor::from).into()
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        let task = info.task.as_ref().map(|task| task.task.as_str()).unwrap_or_default();
        if task != "S01" {
            return Err(unfit(format!("it plays S01, but this is {task}; use another policy")));
        }
        let seen = privileged(first)?;
        let socket = seen.socket.clone().filter(|socket| planar(Some(socket)).is_some()).ok_or_else(lacks_pose)?;
        let body = WholeBody::own("ladder", Arc::clone(&self.network), info, first)?.holding_arms(info)?;
        let mut arms = [0.0; ARMS];
        arms.copy_from_slice(
            body.targets.get(MOVED..BODY).ok_or_else(|| unfit("the robot has too few joints".into()))?,
        );
        let stands = rectangle(place(seen.ladder.as_ref())?, HALF);
        let maps = [
            Map::new(Map::outlines(info, IN_THE_WAY[0]).chain([("ladder".into(), stands)]), CLEAR_M[0]),
            Map::new(Map::outlines(info, IN_THE_WAY[1]), CLEAR_M[1]),
        ];
        let mut episode = Episode {
            body,
            arms,
            holding: of_robot("ladder", info)?,
            is_ready: false,
            maps,
            socket,
            standoff: self.standoff,
            phases: Phases::new(Phase::Approach, first.step),
            held: 0,
            site: None,
            path: Vec::new(),
            planned: None,
            command: BodyCommand::default(),
            postures: Postures::new(relative_height("ladder", seen)?),
            torso: [0.0; 2],
            lean: [0.0; 2],
            up: [0.0; 2],
            tilt: 0.0,
        };
        if !self.at_start {
            episode.take_up(first)?;
        }
        self.episode = Some(episode);
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let episode = self.episode.as_mut().ok_or_else(|| PolicyError::not_reset("ladder"))?;
        let seen = privileged(observation)?;
        let (robot, stands) = (place(seen.robot.as_ref())?, place(seen.ladder.as_ref())?);
        let up = upwards(seen.ladder.as_ref())?;
        // Where it would stand if it hung straight from its platform.
        let ladder = ([0, 1].map(|axis| stands.0[axis] + episode.postures.platform * up[axis]), stands.1);
        episode.up = [0, 1].map(|axis| episode.up[axis] + (up[axis] - episode.up[axis]) * CONTROL_DT / AVERAGE_S);
        episode.tilt = libm::hypot(episode.up[0], episode.up[1]);
        episode.decide(observation.step, robot, ladder);
        let holds = match episode.phases.now() {
            Phase::Approach | Phase::Enter | Phase::Leave | Phase::ComeOut | Phase::Around | Phase::Away => false,
            Phase::Crouch => episode.held > 0,
            Phase::Lift | Phase::Carry | Phase::Calm | Phase::Lower | Phase::Done => true,
        };
        episode.is_ready = episode.move_arms(if holds { episode.holding } else { HANGING });
        episode.body.step(observation, &episode.command)
    }

    fn source(&mut self) -> Option<Chunk> {
        self.episode.as_mut()?.body.record()
    }
}

impl Episode {
    /// Finds from the first observation where in its task a robot is that is already at it, and goes on from there.
    fn take_up(&mut self, first: &Observation) -> Result<(), PolicyError> {
        let seen = privileged(first)?;
        let (robot, ladder) = (place(seen.robot.as_ref())?, place(seen.ladder.as_ref())?);
        let height =
            |pose: &Option<Pose>| pose.as_ref().and_then(|pose| pose.position.get(2)).copied().unwrap_or_default();
        self.up = upwards(seen.ladder.as_ref())?;
        self.tilt = libm::hypot(self.up[0], self.up[1]);
        let here = inside(ladder, robot.0);
        let turned = wrapped(robot.1 - ladder.1 + std::f64::consts::FRAC_PI_2);
        let is_lifted = height(&seen.ladder) > LIFTED_M;
        let is_between = (BETWEEN.1[0]..BETWEEN.1[1]).contains(&here[1]);
        let is_below = here[0].abs() < BETWEEN.0 && is_between && turned.abs() < BETWEEN.2;
        let phase = match (self.is_placed(ladder), is_below) {
            (_, true) if is_lifted => Phase::Carry,
            (false, true) => Phase::Enter,
            (true, true) => Phase::ComeOut,
            (true, false) if here[0].abs() < OUT_X && is_between && turned.abs() < BETWEEN.2 => Phase::ComeOut,
            (true, false) => Phase::Around,
            (false, false) => return Ok(()),
        };
        self.phases = Phases::new(phase, first.step);
        let bent = first.proprioception.as_ref().and_then(|body| body.joint_position.get(WAIST_PITCH));
        self.torso[1] = bent.map_or(0.0, |angle| f64::from(*angle)).clamp(0.0, self.postures.bent.1[1]);
        self.command.height = height(&seen.robot).clamp(self.postures.low.0, UPRIGHT.0);
        self.command.torso = [0.0, self.torso[1], 0.0];
        if self.command.height < STANDS_M {
            self.body.stand_by(self.command);
        }
        Ok(())
    }

    /// The command of this control step, and the phase after it.
    fn decide(&mut self, step: u64, robot: Place, ladder: Place) {
        let spent = step.saturating_sub(self.phases.since());
        let Postures { bent, low, carrying, .. } = self.postures;
        let here = inside(ladder, robot.0);
        let turned = wrapped(robot.1 - ladder.1 + std::f64::consts::FRAC_PI_2);
        let is_at = |y: f64, (off, angle): (f64, f64)| distance(here, [0.0, y]) < off && turned.abs() < angle;
        let next = match self.phases.now() {
            Phase::Approach => {
                self.pose(if distance(here, [0.0, BEFORE_Y]) < NEAR_M { bent } else { UPRIGHT });
                if step < SETTLES {
                    self.stop();
                } else {
                    let heading = ladder.1 - std::f64::consts::FRAC_PI_2;
                    self.walk(step, robot, outside(ladder, [0.0, BEFORE_Y]), heading);
                }
                is_at(BEFORE_Y, ARRIVED[0]).then_some(Phase::Enter)
            }
            // Below a lower platform it stoops before it stands up.
            Phase::Enter if self.postures.platform < PLATFORM_Z && self.torso[1] < STOOPS => {
                self.stop();
                self.straighten();
                self.pose((low.0, bent.1));
                None
            }
            Phase::Enter => {
                self.straighten();
                self.pose(bent);
                self.go(robot, outside(ladder, [0.0, BELOW_Y]), -turned, INSIDE);
                let is_late = spent > MAX_ENTER;
                if is_at(BELOW_Y, ARRIVED[1]) { Some(Phase::Crouch) } else { is_late.then_some(Phase::Leave) }
            }
            Phase::Crouch => {
                self.stop();
                if spent > SETTLES {
                    // Below a lower platform it straightens its back once it is down.
                    let comes_down = self.postures.platform < PLATFORM_Z && self.command.height > low.0;
                    self.pose(if comes_down { (low.0, bent.1) } else { low });
                    self.lean(here);
                }
                let is_aligned = here[0].abs() < ALIGNED.0 && (ALIGNED.1[0]..ALIGNED.1[1]).contains(&here[1]);
                let next = if is_aligned { Phase::Lift } else { Phase::Enter };
                (self.held > CALMS && self.is_ready).then_some(next)
            }
            Phase::Lift => {
                self.stop();
                self.pose(carrying);
                (self.held > CALMS).then_some(Phase::Carry)
            }
            Phase::Carry => {
                self.straighten();
                self.pose(carrying);
                let is_there = self.carry(step, robot, ladder);
                let slips =
                    self.tilt > MAX_TILT && self.site.is_some_and(|(goal, _)| distance(ladder.0, goal) > TILT_M);
                if slips { Some(Phase::Lower) } else { is_there.then_some(Phase::Calm) }
            }
            Phase::Calm => {
                self.stop();
                self.pose(carrying);
                let is_off = self.site.is_some_and(|(goal, _)| distance(ladder.0, goal) > MAX_OFF_M);
                let is_calm = self.body.is_standing() && spent > CALMS;
                if is_off { Some(Phase::Carry) } else { (is_calm || spent > MAX_CALM).then_some(Phase::Lower) }
            }
            Phase::Lower => {
                self.stop();
                self.pose(low);
                let is_placed = self.site.is_some_and(|(goal, _)| distance(ladder.0, goal) < NEAR_M);
                let next = if is_placed { Phase::Done } else { Phase::Enter };
                (self.held > CALMS).then_some(next)
            }
            Phase::Done => {
                self.stop();
                let next = if self.is_placed(ladder) { Phase::ComeOut } else { Phase::Enter };
                (spent > MAX_DONE).then_some(next)
            }
            Phase::ComeOut if self.torso[1] < STOOPS => {
                self.stop();
                self.straighten();
                self.pose((low.0, bent.1));
                None
            }
            Phase::ComeOut => {
                self.straighten();
                self.pose(bent);
                let side = [1.0, -1.0].map(|side| outside(ladder, [side * OUT_X, OUT_Y]));
                let [left, right] = side.map(|place| self.maps[1].clearance(place));
                let is_inside = here[0].abs() < HALF[0];
                let x = if is_inside { left >= right } else { here[0] > 0.0 };
                let aim = if is_inside && here[0].abs() < ALIGNED.0 && (here[1] - OUT_Y).abs() > ARRIVED[1].0 {
                    outside(ladder, [0.0, OUT_Y])
                } else {
                    side[usize::from(!x)]
                };
                self.go(robot, aim, -turned, INSIDE);
                (here[0].abs() > OUT_X - ARRIVED[0].0).then_some(Phase::Around)
            }
            Phase::Around => {
                self.pose(UPRIGHT);
                self.maps[0].set("ladder", rectangle(ladder, HALF));
                self.walk(step, robot, outside(ladder, [0.0, STEPS_Y]), ladder.1 + std::f64::consts::FRAC_PI_2);
                let faces = turned.abs() > std::f64::consts::PI - ARRIVED[0].1;
                (distance(here, [0.0, STEPS_Y]) < ARRIVED[0].0 && faces).then_some(Phase::Away)
            }
            Phase::Away => {
                self.stop();
                None
            }
            Phase::Leave => {
                self.straighten();
                self.pose(bent);
                self.go(robot, outside(ladder, [0.0, BEFORE_Y]), -turned, INSIDE);
                is_at(BEFORE_Y, ARRIVED[0]).then_some(Phase::Enter)
            }
        };
        if self.phases.enter(next, step) {
            (self.held, self.planned) = (0, None);
        }
    }

    /// Walks to a place by the map of the robot alone, and turns to a heading there.
    fn walk(&mut self, step: u64, robot: Place, goal: Point, heading: f64) {
        self.plan(step, 0, robot.0, goal);
        let ahead = self.ahead(robot.0).unwrap_or(goal);
        let left = distance(robot.0, goal);
        let way = turn(robot.1, robot.0, ahead);
        let look = if left < NEAR_M { wrapped(heading - robot.1) } else { way };
        let pace = Pace { speed: ALONE.speed * if look.abs() > 0.6 { 0.25 } else { 1.0 }, ..ALONE };
        self.go(robot, if left < NEAR_M { goal } else { ahead }, look, pace);
    }

    /// The ladder stands where it belongs.
    fn is_placed(&self, ladder: Place) -> bool {
        let socket = [self.socket.position[0], self.socket.position[1]];
        let is_far = |(goal, _): Place| distance(ladder.0, socket) > distance(goal, socket) - NEARER_M;
        distance(outside(ladder, [0.0, TOP_Y]), socket) < REACH_M && self.tilt < FLAT && self.site.is_none_or(is_far)
    }

    /// Walks with the ladder; true once it is where it is put down.
    fn carry(&mut self, step: u64, robot: Place, ladder: Place) -> bool {
        let (socket, map) = (&self.socket, &self.maps[1]);
        let (goal, yaw) = *self.site.get_or_insert_with(|| choose_site(socket, map, ladder, self.standoff));
        self.plan(step, 1, ladder.0, goal);
        let (left, error) = (distance(ladder.0, goal), wrapped(yaw - ladder.1));
        let waits = left < WAITS_M && error.abs() > 3.0 * PLACED.1;
        let aim = if left < NEAR_M { goal } else { self.ahead(ladder.0).unwrap_or(goal) };
        let away = [aim[0] - ladder.0[0], aim[1] - ladder.0[1]];
        let aim = if waits { robot.0 } else { [robot.0[0] + away[0], robot.0[1] + away[1]] };
        let pace = Pace { speed: if left < NEAR_M { LOADED.speed / 2.0 } else { LOADED.speed }, ..LOADED };
        self.go(robot, aim, error, pace);
        left < PLACED.0 && error.abs() < PLACED.1
    }

    fn plan(&mut self, step: u64, map: usize, from: Point, goal: Point) {
        if self.planned.is_none_or(|planned| step >= planned + REPLAN) {
            self.path = self.maps[map].path(from, |at| distance(at, goal) < 0.04);
            self.planned = Some(step);
        }
    }

    fn ahead(&self, here: Point) -> Option<Point> {
        self.path.iter().copied().find(|point| distance(here, *point) > AHEAD_M)
    }

    /// Sets the velocity towards a point and a turn, in bounds.
    fn go(&mut self, (here, heading): Place, aim: Point, turn: f64, pace: Pace) {
        let way = fiatlux_skills::path::turn(heading, here, aim);
        let speed = (GAIN * distance(here, aim)).min(pace.speed);
        let wanted = [speed * libm::cos(way), speed * libm::sin(way), (GAIN * turn).clamp(-pace.turn, pace.turn)];
        let wanted = wanted.map(|part| part.clamp(SPEEDS[0], SPEEDS[1]));
        self.command.velocity = pace.slew.step(self.command.velocity, wanted);
    }

    fn stop(&mut self) {
        self.command.velocity = [0.0; 3];
    }

    /// Goes on to a posture.
    fn pose(&mut self, (height, torso): Posture) {
        self.command.height = towards(self.command.height, height, RATES.0);
        self.torso = [0, 1].map(|axis| towards(self.torso[axis], torso[axis], RATES.1));
        self.command.torso = [self.torso[0] + self.lean[0], self.torso[1] + self.lean[1], 0.0];
        let is_there = self.command.height == height && self.torso == torso;
        self.held = if is_there { self.held + 1 } else { 0 };
    }

    /// Leans so that the head comes below the ladder's centre of mass. The robot faces the steps: its left is the ladder's x.
    fn lean(&mut self, here: Point) {
        let wanted = [here[0] / HEAD_M, (here[1] - BEARS_Y) / HEAD_M];
        for (lean, wanted) in self.lean.iter_mut().zip(wanted) {
            *lean = towards(*lean, wanted.clamp(-MAX_LEAN, MAX_LEAN), LEAN_RATE);
        }
    }

    fn straighten(&mut self) {
        self.lean = self.lean.map(|lean| towards(lean, 0.0, LEAN_RATE));
    }

    /// Moves both arms on; true once they are there.
    fn move_arms(&mut self, Forearms { roll, yaw, elbow }: Forearms) -> bool {
        let mut wanted = [0.0; ARMS];
        let (left, right) = wanted.split_at_mut(ARMS / 2);
        left[1..4].copy_from_slice(&[roll, yaw, elbow]);
        right[1..4].copy_from_slice(&[-roll, -yaw, elbow]);
        for (now, wanted) in self.arms.iter_mut().zip(wanted) {
            *now = towards(*now, wanted, ARM_RATE);
        }
        self.body.targets[MOVED..BODY].copy_from_slice(&self.arms);
        self.arms == wanted
    }
}

/// x and y of a body's upwards axis in the world.
fn upwards(pose: Option<&Pose>) -> Result<Point, PolicyError> {
    let &[w, i, j, k] = pose.map(|pose| pose.quaternion.as_slice()).unwrap_or_default() else {
        return Err(lacks_pose());
    };
    Ok([2.0 * (i * k + w * j), 2.0 * (j * k - w * i)])
}

/// A point in the ladder's frame.
fn inside((origin, yaw): Place, at: Point) -> Point {
    let ([x, y], sin, cos) = ([at[0] - origin[0], at[1] - origin[1]], libm::sin(yaw), libm::cos(yaw));
    [cos * x + sin * y, cos * y - sin * x]
}

fn privileged(observation: &Observation) -> Result<&Privileged, PolicyError> {
    observation.privileged.as_ref().ok_or(PolicyError::Sensor { policy: "ladder", sensor: "privileged" })
}

fn place(pose: Option<&Pose>) -> Result<Place, PolicyError> {
    planar(pose).ok_or_else(lacks_pose)
}

fn lacks_pose() -> PolicyError {
    unfit("the privileged observation lacks a pose".into())
}

fn unfit(reason: String) -> PolicyError {
    PolicyError::Unfit { policy: "ladder", reason }
}
