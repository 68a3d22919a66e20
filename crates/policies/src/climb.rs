//! The policy `climb`: up the step ladder, backwards, also with a bulb, and down from its platform, by exact poses. Before it goes
//! up, the whole-body controller turns the robot's back to the ladder; a plan is played with balance over each stance, or, upwards,
//! from its first posture on by a network that follows it.

mod taking_up;
mod way;

use std::path::Path;
use std::sync::Arc;

use fiatlux_client::{Command, Policy, PolicyError};
use fiatlux_climb::{
    Arm, Body, Follower, Keyframe, Plan, Player, Reference, Tracker, approach, armed, descent, ladder,
    ladder_with_bulb, lowering_bulb, raised, stand, turn, turn_with_bulb,
};
use fiatlux_kinematics::Search;
use fiatlux_proto::v3::{Chunk, Observation, Pose, Privileged, Sensor, SessionInfo};
use fiatlux_robot::{Gains, JointGains, Robot};
use fiatlux_room::{bulb, ladder as ladder_numbers};
use fiatlux_rules::Task;
use fiatlux_skills::phases::Skill;
use fiatlux_skills::{grip, towards};
use fiatlux_wbc::{BODY, BodyCommand, MOVED, Network};
use nalgebra::{Isometry3, Point3, Vector3};

use crate::body;
use crate::entry::Entry;
use crate::whole_body::WholeBody;
use taking_up::{is_mirrored, nearest, rest_of};
use way::{Walls, Way};

/// As a program makes it.
pub(crate) const ENTRY: Entry = Entry {
    name: "climb[:FILE]",
    does: "climbs the step ladder, up (S02, climb) and down (S12), also with a bulb (S10, S04), by exact poses; climb:FILE goes up by a \
           network of your own that follows the plan",
    make: |file| Ok(Box::new(if file.is_empty() { Climb::new()? } else { Climb::with_network(file)? })),
};

/// Control steps for which the robot stands first, and before it begins to climb.
const SETTLES: u64 = 25;
/// Rate of the arms' angles before it climbs, rad/s.
const ARM_RATE: f64 = 1.0;
/// The same with a bulb in the hand, rad/s.
const CARRY_RATE: f64 = 0.3;
/// Time for which it stands still before it climbs, s.
const STILL: f64 = 0.5;
/// Speed of the plan's time for the steps on the level: a foot that comes down late tips the robot.
const STEPS: f64 = 1.5;
/// Speeds of the plans' times, up and down.
const RATES: [f64; 2] = [2.0, 1.6];
/// The ladder's top point in its frame, m.
const TOP: [f64; 3] = ladder_numbers::TOP_POINT;
/// From a ladder's height of another part on, the plan is made to fit.
const OTHER_HEIGHT: f64 = 0.002;
/// Work of a search in a control step.
const SLICE: u32 = 40_000;
/// Speed of the plan's time where a network follows it.
const NETWORK_RATE: f64 = 1.6;

/// Largest difference of the pelvis's height from that of the plan's first posture from which the robot begins at the start, m.
const LEVEL_M: f64 = 0.12;

/// Climbs by a plan.
pub struct Climb {
    name: String,
    network: Arc<Network>,
    climber: Option<Arc<fiatlux_climb::Network>>,
    /// It does not look where in its task the robot is.
    pub(crate) at_start: bool,
    arms_ahead: bool,
    episode: Option<Episode>,
}

/// State of an episode.
struct Episode {
    walker: WholeBody,
    robot: Option<Body>,
    q0: Vec<f64>,
    way: Way,
    draws_in: bool,
    /// Control steps since it arrived.
    stood: u64,
    /// The climb, from where this task begins.
    plan: Plan,
    goes_down: bool,
    /// The side of the foot that steps first on the way to its first posture, 0 for the left.
    leads: usize,
    /// Hands with a bulb.
    hold: grip::Hold,
    climbs: bool,
    /// Time in the plan at which the steps to its first posture are done, s.
    stepped: f64,
    player: Option<Player>,
    /// Time of the plan before the player took it up, s.
    skipped: f64,
    /// For the way to the plan's first posture; meanwhile the robot stands.
    search: Option<Search<Option<Plan>>>,
    /// Follows the plan in place of the player, which goes to the plan's first posture alone.
    climber: Option<Arc<fiatlux_climb::Network>>,
    follower: Option<Follower>,
    /// As of [`ClimbCommand`]; the lean is in the plan's frame.
    pace: f64,
    lean: Vector3<f64>,
    moves: Option<[Vector3<f64>; 2]>,
}

impl Climb {
    /// With the whole-body controller that comes with this version.
    ///
    /// # Errors
    /// Its weights cannot be read.
    pub fn new() -> Result<Self, PolicyError> {
        let (name, network) = body::network("climb", "", "")?;
        Ok(Self { name, network, climber: None, at_start: false, arms_ahead: false, episode: None })
    }

    /// The same, but a network follows the plan from its first posture on.
    ///
    /// # Errors
    /// A file that cannot be read or does not fit.
    pub fn with_network(file: &str) -> Result<Self, PolicyError> {
        let climber = fiatlux_climb::Network::read(Path::new(file)).map_err(PolicyError::of("climb"))?;
        let name = body::label("climb", file, &[climber.digest()]);
        Ok(Self { name, climber: Some(Arc::new(climber)), ..Self::new()? })
    }

    /// Arms stay ahead, as the plan has them: where they are drawn in, knees have less room beside the treads, too little for poses that err by
    /// a centimetre.
    #[must_use]
    pub(crate) fn with_arms_ahead(self) -> Self {
        Self { arms_ahead: true, ..self }
    }

    /// Sets how the plan is played from the next step on: at a part of its speed, and with the centre of mass elsewhere, m in the plan's
    /// frame. It has an effect while the player balances the robot.
    pub(crate) fn set_pace(&mut self, pace: f64, lean: Vector3<f64>) {
        if let Some(episode) = &mut self.episode {
            (episode.pace, episode.lean) = (pace, lean);
        }
    }

    /// Speed of the pelvis, m/s, and its rate of turn, rad/s, in the ladder's frame, as is known better than by two poses.
    pub(crate) fn set_moves(&mut self, moves: [Vector3<f64>; 2]) {
        if let Some(episode) = &mut self.episode {
            episode.moves = Some(moves);
        }
    }

    /// Accelerations that the player expects, in the order of its model's `qvel`; `None` while it walks.
    pub(crate) fn acceleration(&self) -> Option<&[f64]> {
        self.episode.as_ref()?.player.as_ref().map(Player::acceleration)
    }

    /// Which feet rest by the plan, left first: none while it walks.
    pub(crate) fn rests(&self) -> [bool; 2] {
        let player = self.episode.as_ref().and_then(|episode| episode.player.as_ref());
        player.map_or([false; 2], Player::rests)
    }

    /// Time in the plan and of the whole plan, s; `None` before the climb begins.
    pub fn progress(&self) -> Option<(f64, f64)> {
        let Episode { follower, player, skipped, .. } = self.episode.as_ref()?;
        match follower {
            Some(Follower { tracker, .. }) => Some((tracker.time(), tracker.reference().seconds())),
            None => player.as_ref().map(|player| (skipped + player.time(), skipped + player.seconds())),
        }
    }
}

impl Skill for Climb {
    fn is_over(&self) -> bool {
        let climbs = self.episode.as_ref().is_some_and(|episode| episode.climbs);
        climbs && self.progress().is_some_and(|(time, all)| time >= all)
    }

    fn phase(&self) -> String {
        let name = match &self.episode {
            None => "",
            Some(episode) if episode.player.is_none() => "Walk",
            Some(episode) if !episode.climbs => "Stand",
            Some(_) if self.is_over() => "Done",
            Some(_) => "Climb",
        };
        name.into()
    }

    fn body_command(&self) -> Option<BodyCommand> {
        let episode = self.episode.as_ref()?;
        // The player and a network command joints.
        episode.walker.commanded().filter(|_| episode.player.is_none())
    }

    fn part_done(&self) -> Option<f64> {
        let (time, all) = self.progress().filter(|_| self.episode.as_ref().is_some_and(|episode| episode.climbs))?;
        Some((time / all).clamp(0.0, 1.0))
    }
}

impl Policy for Climb {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn tasks(&self) -> &'static [Task] {
        match self.climber {
            None => &[Task::S02, Task::S04, Task::S10, Task::S12, Task::Climb],
            Some(_) => &[Task::S02, Task::Climb],
        }
    }

    fn sensors(&self) -> Vec<Sensor> {
        ["proprioception", "last_action", "privileged"].map(Sensor::from).into()
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        let unfit = |reason: String| PolicyError::Unfit { policy: "climb", reason };
        let task = info.task.as_ref().map(|task| task.task.as_str()).unwrap_or_default();
        let (plan, then, goes_down) = match task {
            "S02" | "climb" => (ladder(), Some(turn()), false),
            "S04" | "S10" | "S12" if self.climber.is_some() => {
                return Err(unfit("a network goes up with free hands alone; play climb without a file".into()));
            }
            "S10" => (ladder_with_bulb(), Some(turn_with_bulb()), false),
            "S04" | "S12" => (descent(), None, true),
            _ => {
                let reason = format!("it plays S02, S04, S10, S12 and climb, but this is {task}; use another policy");
                return Err(unfit(reason));
            }
        };
        let (walls, (world_from_plan, pelvis)) = (Walls::of(info, self.at_start), placed(first)?);
        let here = world_from_plan.inverse() * pelvis;
        let q0: Vec<f64> = info.joints.iter().map(|joint| joint.q0).collect();
        let angles = body::angles(body::sensed("climb", first)?, &q0);
        let looks = self.climber.is_none() && !self.at_start;
        let mut plan = plan.map_err(PolicyError::of("climb"))?;
        let under_way = if looks && goes_down { is_mirrored(&plan, &here, &angles) } else { None };
        let is_mirrored = goes_down && under_way.unwrap_or_else(|| walls.has_more_room_mirrored(&world_from_plan));
        if is_mirrored {
            plan = plan.mirrored();
        }
        if task == "S04" {
            plan = lowering_bulb(plan);
        }
        let then = then.filter(|_| self.climber.is_none()).transpose().map_err(PolicyError::of("climb"))?;
        let walker = WholeBody::own("climb", Arc::clone(&self.network), info, first)?;
        let robot = Robot::of_session(&info.robot, info.joints.iter().map(|joint| joint.name.as_str()));
        let robot = robot.map_err(|error| unfit(format!("{error}; use another policy")))?;
        let gains = gains_of(info, &robot);
        let carries = grip::Carrying::of_task(task);
        let hold = carries.map(|carries| grip::Hold::new(&info.joints, carries, &walker.targets)).unwrap_or_default();
        let robot = Body::new(robot, gains).ok_or_else(|| unfit("its drives do not fit the robot".into()))?;
        let height = first.privileged.as_ref().map_or(Ok(1.0), |seen| relative_height("climb", seen))?;
        let is_other = (height - 1.0).abs() >= OTHER_HEIGHT;
        let fit = |plan: Plan| {
            let plan = if is_other { raised(&robot, &plan, height) } else { Some(plan) };
            plan.ok_or_else(|| {
                unfit(format!("the ladder is {height:.2} times as high as the plan's; use another size"))
            })
        };
        let mut plan = fit(plan)?;
        let is_narrow = task == "S04" && walls.are_at_the_right_hand(&world_from_plan);
        let draws_in = self.climber.is_none() && !self.arms_ahead && (!goes_down || is_narrow);
        if draws_in {
            let unable = || unfit("its arms cannot be drawn in on this ladder; use another size".into());
            plan = match armed(&robot, &plan, &Arm::DRAWN_IN) {
                None if goes_down => plan,
                armed => armed.ok_or_else(unable)?,
            };
        }
        if let Some(then) = then {
            plan.extend(fit(then)?.keyframes);
        }
        let begins = plan.keyframes.first().map_or_else(Vector3::zeros, |first| first.pelvis.translation.vector);
        let way = Way::new(walls, &world_from_plan, &here.translation.vector, &begins);
        let is_at = |start: &Keyframe| (start.pelvis.translation.z - here.translation.z).abs();
        let taken_up = if looks { nearest(&plan, &here, &angles) } else { None };
        let (mut robot, mut player, mut skipped) = (Some(robot), None, 0.0);
        if let Some(time) = taken_up {
            let rest = rest_of(&plan, time);
            skipped = plan.seconds() - rest.seconds();
            let taken = robot.take().map(|robot| Player::new(robot, rest, world_from_plan)).transpose();
            player = taken.map_err(PolicyError::of("climb"))?;
        } else if plan.keyframes.first().is_some_and(|start| is_at(start) > LEVEL_M) && looks {
            return Err(unfit("the robot is on the ladder, in no posture of the plan; begin on the level".into()));
        }
        self.episode = Some(Episode {
            walker,
            robot,
            q0,
            way,
            draws_in,
            stood: 0,
            plan,
            goes_down,
            leads: usize::from(is_mirrored),
            hold,
            climbs: player.is_some(),
            stepped: 0.0,
            player,
            skipped,
            search: None,
            climber: self.climber.clone(),
            follower: None,
            pace: 1.0,
            lean: Vector3::zeros(),
            moves: None,
        });
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let episode = self.episode.as_mut().ok_or_else(|| PolicyError::not_reset("climb"))?;
        let (world_from_plan, pelvis) = placed(observation)?;
        let angles = body::angles(body::sensed("climb", observation)?, &episode.q0);
        if episode.player.is_none() && episode.goes_down {
            episode.stand(&world_from_plan, &pelvis, &angles)?;
        }
        if episode.player.is_none() {
            let command = episode.walk(observation.step, &world_from_plan, &(world_from_plan.inverse() * pelvis));
            let mut goes_on = episode.walker.step(observation, &command)?;
            if episode.stood <= SETTLES {
                if let Command::JointTarget(targets) = &mut goes_on {
                    episode.hold.write(&angles, targets);
                }
                return Ok(goes_on);
            }
            episode.stand(&world_from_plan, &pelvis, &angles)?;
        }
        if let Some(follower) = &mut episode.follower {
            let sensed = observation.proprioception.as_ref();
            let sensed = sensed.ok_or(PolicyError::Sensor { policy: "climb", sensor: "proprioception" })?;
            let speeds: Vec<f64> = sensed.joint_velocity.iter().map(|speed| f64::from(*speed)).collect();
            let mut targets = episode.q0.clone();
            follower.step(&(world_from_plan.inverse() * pelvis), &angles, &speeds, &mut targets);
            return Ok(Command::JointTarget(targets));
        }
        let targets = episode.climb(&world_from_plan, &pelvis, &angles)?;
        Ok(Command::JointTarget(targets))
    }

    fn source(&mut self) -> Option<Chunk> {
        // The player and a network command joints.
        let episode = self.episode.as_mut().filter(|episode| episode.player.is_none())?;
        episode.walker.record()
    }
}

/// Gains of a robot in a session.
fn gains_of(info: &SessionInfo, robot: &Robot) -> Gains {
    let own = robot.gains(Default::default());
    let gains = info.joints.iter().zip(&own.0).map(|(joint, own)| JointGains {
        stiffness: joint.stiffness,
        damping: joint.damping,
        effort_limit: joint.effort_limit,
        ..*own
    });
    Gains(gains.collect())
}

/// Where the plan's frame and the pelvis are, in the world.
fn placed(observation: &Observation) -> Result<(Isometry3<f64>, Isometry3<f64>), PolicyError> {
    let seen = observation.privileged.as_ref();
    let seen = seen.ok_or(PolicyError::Sensor { policy: "climb", sensor: "privileged" })?;
    let world_from_ladder = body::pose("climb", seen.ladder.as_ref())?;
    let world_from_plan = world_from_ladder * Isometry3::rotation(Vector3::z() * std::f64::consts::FRAC_PI_2);
    Ok((world_from_plan, body::pose("climb", seen.robot.as_ref())?))
}

/// Height of the ladder in parts of the published one, by the distance of its top point from the seat, which is above it. 1 where
/// the distance is not observed, as in `climb`.
pub(crate) fn relative_height(policy: &'static str, seen: &Privileged) -> Result<f64, PolicyError> {
    let Some(distance) = seen.distances.first() else { return Ok(1.0) };
    let pose = |pose: &Option<Pose>| body::pose(policy, pose.as_ref());
    let seat = pose(&seen.ladder)?.inverse() * pose(&seen.socket)? * Point3::new(0.0, 0.0, bulb::SEAT_Z);
    let level = (seat.x - TOP[0]).powi(2) + (seat.y - TOP[1]).powi(2);
    Ok((seat.z - (distance.powi(2) - level).max(0.0).sqrt()) / TOP[2])
}

impl Episode {
    /// The way to where the plan begins. A hand with a bulb is beside the ladder at first, and is drawn in once the robot has turned; where
    /// it is narrow, before.
    fn walk(&mut self, step: u64, world_from_plan: &Isometry3<f64>, here: &Isometry3<f64>) -> BodyCommand {
        let is_near = self.way.is_narrow || self.way.is_pushing();
        let draws_in = self.hold.is_empty() || is_near || Way::has_turned(here);
        let is_drawn_in = draws_in && self.move_arms();
        let mut command = BodyCommand::default();
        if step < SETTLES || self.way.is_narrow && !self.way.is_pushing() && !is_drawn_in {
            return command;
        }
        match if self.stood == 0 { self.way.velocity(world_from_plan, here) } else { None } {
            Some(velocity) => command.velocity = velocity,
            None => self.stood += u64::from(is_drawn_in),
        }
        command
    }

    /// Brings arms to where the plan has them. Where they are not drawn in, free ones go to where they are at the start of a task, away
    /// from the ladder: whatever played before may have left them beside the body. True once their targets are there.
    fn move_arms(&mut self) -> bool {
        let aims = match self.plan.keyframes.first() {
            Some(first) if self.draws_in => &first.angles,
            _ if self.hold.is_empty() => &self.q0,
            _ => return true,
        };
        let rate = if self.hold.is_empty() { ARM_RATE } else { CARRY_RATE };
        let mut farthest = 0.0_f64;
        for (now, to) in self.walker.targets.iter_mut().zip(aims).take(BODY).skip(MOVED) {
            *now = towards(*now, *to, rate);
            farthest = farthest.max((to - *now).abs());
        }
        farthest < 1e-6
    }

    /// Hands over to the player, which first stands still.
    fn stand(
        &mut self,
        world_from_plan: &Isometry3<f64>,
        pelvis: &Isometry3<f64>,
        angles: &[f64],
    ) -> Result<(), PolicyError> {
        let lost = || PolicyError::Unfit { policy: "climb", reason: "the robot does not stand; start again".into() };
        let (robot, first) = (self.robot.take().ok_or_else(lost)?, self.plan.keyframes.first().ok_or_else(lost)?);
        let body_angles = angles.get(..BODY).ok_or_else(lost)?;
        let plan = stand(&robot, &(world_from_plan.inverse() * pelvis), body_angles, first);
        let plan = plan.ok_or_else(lost)?;
        self.player = Some(Player::new(robot, plan, *world_from_plan).map_err(PolicyError::of("climb"))?);
        Ok(())
    }

    /// Plays on; once the robot stands still, the way to the ladder and the climb are planned.
    fn climb(
        &mut self,
        world_from_plan: &Isometry3<f64>,
        pelvis: &Isometry3<f64>,
        angles: &[f64],
    ) -> Result<Vec<f64>, PolicyError> {
        let Some(player) = &mut self.player else { return Err(PolicyError::not_reset("climb")) };
        if let Some(search) = &mut self.search {
            if let Some(found) = search.go_on(SLICE) {
                self.search = None;
                if let Some(mut plan) = found {
                    self.stepped = plan.seconds();
                    if self.climber.is_none() {
                        plan.extend(self.plan.keyframes.iter().skip(1).cloned());
                    }
                    player.play(plan);
                }
                self.climbs = true;
            }
        } else if !self.climbs && player.time() > player.seconds() + STILL {
            let (ids, first) = (&player.body().ids, self.plan.keyframes.first());
            let now: Vec<f64> = ids.joints.iter().take(BODY).map(|joint| player.state().qpos[joint.qpos]).collect();
            let here = world_from_plan.inverse() * pelvis;
            match first.cloned() {
                Some(first) => {
                    let (body, leads) = (player.body().clone(), self.leads);
                    let way = move |work| async move { approach(&body, &here, &now, &first, leads, work).await };
                    self.search = Some(Search::new(way));
                }
                None => self.climbs = true,
            }
        } else if player.time() > player.seconds() + STILL
            && let Some(climber) = self.climber.take()
        {
            let (body, until) = (player.body().clone(), climber.contract().until);
            let reference = Reference::new(&body, &self.plan, until).map_err(PolicyError::of("climb"))?;
            let mut tracker = Tracker::new(Arc::new(body), Arc::new(reference));
            tracker.restart(0.0, NETWORK_RATE);
            self.follower = Some(Follower::new(climber, tracker));
        }
        if self.climbs {
            let is_stepping = player.time() < self.stepped;
            player.rate = if is_stepping { STEPS } else { RATES[usize::from(self.goes_down)] };
        }
        player.moves = self.moves;
        (player.pace, player.lean) = (self.pace, world_from_plan.rotation * self.lean);
        let mut targets = player.step(pelvis, angles).map_err(PolicyError::of("climb"))?.to_vec();
        self.hold.write(angles, &mut targets);
        Ok(targets)
    }
}
