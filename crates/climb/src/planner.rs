//! Steps from foothold to foothold.

use std::collections::BTreeMap;

use fiatlux_dynamics::{Mechanics, Model, Site, State};
use fiatlux_kinematics::{Clearance, Goal, InverseKinematics, Outcome, SearchOptions, Work};
use fiatlux_robot::{BODY, Robot, RobotIds};
use nalgebra::{Isometry3, Point3, Unit, UnitQuaternion, Vector3};

use crate::body::pelvis;
use crate::plan::Keyframe;

/// Largest change of a joint between two postures, rad: more is another posture and no step on the way.
const JUMP: f64 = 0.35;
/// Ways of the centre of mass and of a foot between two postures, m, and turn of a foot, rad.
const SHIFT: f64 = 0.01;
const STRIDE: f64 = 0.02;
const TURN: f64 = 0.1;
/// Time of a shift of the weight by one such way, between treads and on the level, and of the shortest shift, s.
const PACE: f64 = 0.3;
const LEVEL_PACE: f64 = 0.22;
const SHORTEST: f64 = 1.5;
/// Part of the way of the weight after which a heel may rise.
const HEEL_RISES: f64 = 0.35;
/// Where the weight is, along x from the point of the sole that it is brought over, m: tried in this order.
const AHEAD: [f64; 3] = [0.0, -0.01, 0.01];
/// Bend of the knee that bears, rad, and how far a foot is pulled out from under the next tread, m: tried in this order.
const BENDS: [f64; 5] = [0.9, 1.3, 1.7, 2.1, 0.5];
const BACK: [f64; 3] = [0.02, 0.03, 0.01];
/// Part of these bends that both knees have while the robot turns round.
const LEVEL_BEND: f64 = 0.45;
/// Point of a sole that the weight is brought over, ahead of its middle, m.
const BEARING: f64 = -0.03;
/// Distances that the rolls of the ankles keep from their limits, rad, tried in this order: what is left there is what balance
/// has across a foot.
const ROLLS: [f64; 3] = [0.1, 0.06, 0.0];
/// Distance that the pitches of the ankles keep from their limits while the robot turns round, rad.
const PITCH: f64 = 0.25;
/// Largest tilt of the pelvis, rad.
const TILT: f64 = 0.4;
/// Height of a foot above what it steps over, and above where it comes down, m.
const OVER: f64 = 0.05;
const ABOVE: f64 = 0.02;

/// Where a foot may stand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Foothold {
    /// The sole, level.
    pub sole: Isometry3<f64>,
    /// Its bearing part: from its rear to its front, from its middle, m.
    pub range: [f64; 2],
    /// Which surface it is on; 0 is the floor.
    pub surface: usize,
}

impl Foothold {
    /// Where the weight is on this foot alone.
    fn bearing(&self) -> Vector3<f64> {
        (self.sole * Point3::new(BEARING.clamp(self.range[0], self.range[1]), 0.0, 0.0)).coords
    }
}

/// Angles of an arm, rad; its other joints are at 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arm {
    /// Of the shoulder.
    pub pitch: f64,
    /// Outwards.
    pub roll: f64,
    /// Outwards.
    pub yaw: f64,
    /// Of the elbow.
    pub elbow: f64,
}

impl Arm {
    /// All joints at 0.
    pub const ZERO: Self = Self { pitch: 0.0, roll: 0.0, yaw: 0.0, elbow: 0.0 };

    /// On the way up: upper arms ahead, hands before the shoulders, so that they reach 0.3 m ahead of the pelvis.
    pub const DRAWN_IN: Self = Self { pitch: -0.8, roll: 0.2, elbow: -0.4, ..Self::ZERO };

    /// Angle of a joint of shoulder or elbow, rad; `None` for another joint's name.
    pub fn reaching(&self, joint: &str) -> Option<f64> {
        let (side, joint) = joint.split_once('_')?;
        let outwards = outwards(side);
        Some(match joint {
            "shoulder_pitch_joint" => self.pitch,
            "shoulder_roll_joint" => outwards * self.roll,
            "shoulder_yaw_joint" => outwards * self.yaw,
            "elbow_joint" => self.elbow,
            _ => return None,
        })
    }
}

/// Sign of an angle outwards, by the name of a side.
fn outwards(side: &str) -> f64 {
    if side == "left" { 1.0 } else { -1.0 }
}

/// Surfaces under the feet; `None` for a foot in the air.
pub type Places = [Option<usize>; 2];
/// Shapes that are to keep apart with the feet on these surfaces.
pub type Apart<'a> = dyn Fn(Places) -> Vec<Clearance> + Send + 'a;

/// Constraint of a foot.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Hold {
    Flat,
    /// Its heel and toes may rise.
    Free,
    /// It turns about a line across the sole, so far ahead of its middle, m.
    Edge(f64),
}

/// Plans steps in one scene. States are of that model.
pub struct Planner<'a> {
    model: &'a Model,
    robot: &'a Robot,
    ids: &'a RobotIds,
    apart: Box<Apart<'a>>,
    mechanics: Mechanics,
    inverse: BTreeMap<Places, InverseKinematics>,
    /// Joints that move: legs and waist, and on request the arms.
    moving: Vec<usize>,
    /// Turn of the toes outwards, rad.
    pub out: f64,
    /// The arms at rest, left first: by default they are ahead.
    pub arms: [Arm; 2],
    /// Distance that the rolls of the ankles keep from their limits, rad.
    roll: f64,
    /// Heading of the pelvis before a step and when its weight has moved, and now, rad, where the robot turns round.
    turn: Option<([f64; 2], f64)>,
    /// Budget of its searches; unlimited by default.
    pub work: Work,
}

/// The state that a plan has reached, and its postures so far.
#[derive(Debug, Clone)]
struct Walked {
    state: State,
    keyframes: Vec<Keyframe>,
    holds: [(Isometry3<f64>, Hold); 2],
    bends: [f64; 2],
}

impl<'a> Planner<'a> {
    /// A planner that keeps these shapes apart.
    pub fn new(model: &'a Model, robot: &'a Robot, ids: &'a RobotIds, apart: Box<Apart<'a>>) -> Self {
        let moves = |name: &str| ["hip", "knee", "ankle", "waist"].iter().any(|part| name.contains(part));
        let moving = robot.joints().iter().enumerate().filter(|(_, joint)| moves(&joint.name));
        let moving = moving.map(|(index, _)| index).collect();
        let (mechanics, inverse) = (Mechanics::new(model), BTreeMap::new());
        let arms = [Arm { pitch: -0.8, roll: 0.3, elbow: 0.6, ..Arm::ZERO }; 2];
        Self {
            model,
            robot,
            ids,
            apart,
            mechanics,
            inverse,
            moving,
            out: 0.1,
            arms,
            roll: ROLLS[0],
            turn: None,
            work: Work::unlimited(),
        }
    }

    /// Lets shoulders and elbows move out of the way from here on. Hands stay as they are.
    pub fn move_arms(&mut self) {
        let moves = |name: &str| name.contains("shoulder") || name.ends_with("elbow_joint");
        let arms = self.robot.joints().iter().enumerate().filter(|(_, joint)| moves(&joint.name));
        self.moving.extend(arms.map(|(index, _)| index));
        self.inverse.clear();
    }

    /// From here on the toes point where the footholds have them, and the pelvis turns from one heading to another one, rad, while the
    /// weight of the next step moves. A step then lets no heel rise.
    pub fn turn(&mut self, from: f64, to: f64) {
        self.turn = Some(([from, to], from));
    }

    /// Angles that all joints rest at, the knees bent by so much, rad.
    pub fn rest(&self, bends: [f64; 2]) -> Vec<f64> {
        self.rest_with(bends, [self.out; 2])
    }

    fn rest_with(&self, bends: [f64; 2], outs: [f64; 2]) -> Vec<f64> {
        let angle = |name: &str| {
            let (side, joint) = name.split_once('_').unwrap_or_default();
            let (outwards, side) = (outwards(side), usize::from(side != "left"));
            let (bend, out, arm) = (bends[side], outs[side], self.arms[side]);
            match joint {
                "hip_pitch_joint" => -0.6 * bend * libm::cos(out),
                "hip_roll_joint" => outwards * 0.6 * bend * libm::sin(out),
                "hip_yaw_joint" => outwards * out,
                "knee_joint" => bend,
                "ankle_pitch_joint" => -0.4 * bend,
                _ => arm.reaching(name).unwrap_or(0.0),
            }
        };
        self.robot.joints().iter().map(|joint| angle(&joint.name)).collect()
    }

    /// A posture on two footholds, the weight between them, and its keyframe; `from` is where the search begins.
    pub async fn stand(&mut self, from: &State, feet: [Foothold; 2]) -> Option<(State, Keyframe)> {
        let com = (feet[0].bearing() + feet[1].bearing()) / 2.0;
        let holds = feet.map(|foot| (foot.sole, Hold::Flat));
        let places = feet.map(|foot| Some(foot.surface));
        let state = self.solve(from, holds, places, com, [0.3; 2], true).await?;
        let key = self.keyframe(&state, 1.0, [1.0; 2], feet.map(|foot| foot.range));
        Some((state, key))
    }

    /// Moves the weight over the other foot, and this foot to its next hold.
    pub async fn step(
        &mut self,
        from: &State,
        feet: [Foothold; 2],
        side: usize,
        to: Foothold,
    ) -> Option<(State, Vec<Keyframe>)> {
        let turns = self.turn.is_some();
        let ways = ROLLS.into_iter().flat_map(|roll| [(roll, false), (roll, true)]);
        for (roll, heel_rises) in ways.filter(|(_, heel_rises)| !(turns && *heel_rises)) {
            self.roll = roll;
            for ahead in AHEAD {
                let over = feet[1 - side].bearing() + Vector3::x() * ahead;
                for bend in BENDS {
                    let shifted = self.shift(from, feet, side, over, bend, heel_rises).await;
                    let Some(shifted) = shifted else { continue };
                    for back in BACK {
                        if let Some(done) = self.swing(shifted.clone(), feet, side, to, over, back).await {
                            return Some((done.state, done.keyframes));
                        }
                    }
                }
            }
        }
        None
    }

    async fn shift(
        &mut self,
        from: &State,
        feet: [Foothold; 2],
        side: usize,
        over: Vector3<f64>,
        bend: f64,
        heel_rises: bool,
    ) -> Option<Walked> {
        let other = 1 - side;
        let mut bends = [if self.turn.is_some() { LEVEL_BEND * bend } else { 0.4 }; 2];
        if feet[other].surface > feet[side].surface {
            bends = [0.05; 2];
            bends[other] = bend;
        }
        let holds = feet.map(|foot| (foot.sole, Hold::Flat));
        let mut walked = Walked { state: from.clone(), keyframes: Vec::new(), holds, bends };
        let places = feet.map(|foot| Some(foot.surface));
        let mut ranges = feet.map(|foot| foot.range);
        self.mechanics.update(self.model, from);
        let com = self.mechanics.center_of_mass(self.model, self.ids.root).1;
        let shifts = libm::ceil((com - over).xy().norm() / SHIFT).max(1.0) as usize;
        for shift in 1..=shifts {
            let part = shift as f64 / shifts as f64;
            if heel_rises && part > HEEL_RISES {
                let front = feet[side].range[1];
                walked.holds[side].1 = Hold::Edge(front - 0.01);
                ranges[side] = [front - 0.02, front];
            }
            if let Some(([from, to], now)) = &mut self.turn {
                *now = *from + part * (*to - *from);
            }
            let com = com.lerp(&over, part);
            walked.state = self.solve(&walked.state, walked.holds, places, com, bends, false).await?;
            let seconds = ease(part) - ease((shift - 1) as f64 / shifts as f64);
            let pace = if feet[0].surface == feet[1].surface { LEVEL_PACE } else { PACE };
            let seconds = seconds * (pace * shifts as f64).max(SHORTEST);
            walked.keyframes.push(self.keyframe(&walked.state, seconds, [1.0; 2], ranges));
        }
        let mut bears = [1.0; 2];
        bears[side] = 0.0;
        walked.keyframes.push(self.keyframe(&walked.state, 0.9, bears, ranges));
        Some(walked)
    }

    /// Moves a foot that bears nothing.
    async fn swing(
        &mut self,
        mut walked: Walked,
        mut feet: [Foothold; 2],
        side: usize,
        to: Foothold,
        over: Vector3<f64>,
        back: f64,
    ) -> Option<Walked> {
        let other = 1 - side;
        let mut places = feet.map(|foot| Some(foot.surface));
        let is_up = feet[other].surface > feet[side].surface;
        let mut bends = walked.bends;
        if self.turn.is_some() {
            bends[side] += 0.3;
        } else {
            bends[side] = 1.5;
            bends[other] = if is_up { bends[other].min(0.8) } else { 0.3 };
        }
        let mut bears = [1.0; 2];
        bears[side] = 0.0;
        let mut ranges = feet.map(|foot| foot.range);
        ranges[side] = to.range;
        let site = self.ids.site(&self.robot.soles()[side].site);
        self.mechanics.update(self.model, &walked.state);
        let start = self.mechanics.world_from_site(&site);
        let is_level = feet[side].surface == to.surface;
        let mut rotation = if is_level { start.rotation } else { to.sole.rotation };
        let mut at = start.translation.vector;
        let path = path(at, to.sole.translation.vector, if to.surface > 0 { back } else { 0.0 }, is_level);
        let last = path.len() - 1;
        for (index, via) in path.into_iter().enumerate() {
            places[side] = if index == 0 { places[side] } else { None };
            if index == last {
                self.mechanics.update(self.model, &walked.state);
                rotation = self.mechanics.world_from_site(&site).rotation;
                let turns = libm::ceil(rotation.angle_to(&to.sole.rotation) / TURN) as usize;
                for turn in 1..=turns {
                    let rotation = rotation.slerp(&to.sole.rotation, turn as f64 / turns as f64);
                    walked.holds[side] = (Isometry3::from_parts(at.into(), rotation), Hold::Flat);
                    walked.state = self.solve(&walked.state, walked.holds, places, over, bends, false).await?;
                    walked.keyframes.push(self.keyframe(&walked.state, 0.15, bears, ranges));
                }
                rotation = to.sole.rotation;
            }
            let hold = if index == last || is_level { Hold::Flat } else { Hold::Free };
            let strides = libm::ceil((via - at).norm() / STRIDE).max(1.0) as usize;
            for stride in 1..=strides {
                let place = at.lerp(&via, stride as f64 / strides as f64);
                walked.holds[side] = (Isometry3::from_parts(place.into(), rotation), hold);
                walked.state = self.solve(&walked.state, walked.holds, places, over, bends, false).await?;
                walked.keyframes.push(self.keyframe(&walked.state, 0.15, bears, ranges));
            }
            at = via;
        }
        feet[side] = to;
        walked.holds[side] = (to.sole, Hold::Flat);
        let places = feet.map(|foot| Some(foot.surface));
        walked.state = self.solve(&walked.state, walked.holds, places, over, bends, false).await?;
        walked.keyframes.push(self.keyframe(&walked.state, 0.75, bears, ranges));
        walked.keyframes.push(self.keyframe(&walked.state, 0.75, [1.0; 2], ranges));
        Some(walked)
    }

    pub(crate) fn keyframe(&self, state: &State, seconds: f64, bears: [f64; 2], ranges: [[f64; 2]; 2]) -> Keyframe {
        let angles = self.ids.joints.iter().take(BODY).map(|joint| state.qpos[joint.qpos]).collect();
        Keyframe { seconds, bears, ranges, pelvis: pelvis(self.ids, state), angles }
    }

    /// A posture near another one.
    async fn solve(
        &mut self,
        from: &State,
        holds: [(Isometry3<f64>, Hold); 2],
        places: Places,
        com: Vector3<f64>,
        bends: [f64; 2],
        is_first: bool,
    ) -> Option<State> {
        let soles = self.robot.soles();
        let goal = |side: usize| {
            let (mut pose, hold) = holds[side];
            let mut site: Site = self.ids.site(&soles[side].site);
            if let Hold::Edge(front) = hold {
                let edge = Isometry3::translation(front, 0.0, 0.0);
                (site.body_from_site, pose) = (site.body_from_site * edge, pose * edge);
            }
            let mut goal = Goal::pose(site, pose);
            if hold != Hold::Flat {
                // About the line across the sole.
                goal.rotation[usize::from(self.out < std::f64::consts::FRAC_PI_4)] = 0.0;
            }
            goal
        };
        let mut goals = vec![goal(0), goal(1), Goal::com_over(com.x, com.y)];
        let root = Site { body: self.ids.root, body_from_site: Isometry3::identity() };
        if let Some((_, facing)) = self.turn {
            let mut heading = Goal::pose(root, Isometry3::rotation(Vector3::z() * facing));
            (heading.position, heading.rotation) = ([0.0; 3], [0.0, 0.0, 0.3]);
            goals.push(heading);
        }
        let outs = match self.turn {
            None => [self.out; 2],
            Some((_, facing)) => [0, 1].map(|side| {
                let toes = heading(&holds[side].0.rotation) - facing;
                [1.0, -1.0][side] * libm::atan2(libm::sin(toes), libm::cos(toes))
            }),
        };
        let rest = self.rest_with(bends, outs);
        let rest: Vec<f64> = self.moving.iter().map(|index| rest[*index]).collect();
        let inverse = match self.inverse.entry(places) {
            std::collections::btree_map::Entry::Occupied(entry) => entry.into_mut(),
            std::collections::btree_map::Entry::Vacant(entry) => {
                let joints: Vec<_> = self.moving.iter().map(|index| self.ids.joints[*index].body).collect();
                let mut inverse = InverseKinematics::new(self.model, self.ids.root, &joints, true).ok()?;
                inverse.options = SearchOptions {
                    steps: 60,
                    limit_margin: 0.005,
                    spread: 0.4,
                    rest_pull: 0.1,
                    position_tolerance: 3e-3,
                    rotation_tolerance: 1e-2,
                    ..SearchOptions::default()
                };
                inverse.set_clearances(self.model, &(self.apart)(places)).ok()?;
                entry.insert(inverse)
            }
        };
        inverse.options.tries = if is_first { 8 } else { 1 };
        inverse.set_rest(&rest).ok()?;
        let joints = self.robot.joints();
        let margin = |index: &usize| match joints[*index].name.split_once("_ankle_") {
            Some((_, "roll_joint")) => self.roll,
            Some(_) if self.turn.is_some() => PITCH,
            _ => 0.0,
        };
        inverse.set_margins(&self.moving.iter().map(margin).collect::<Vec<_>>()).ok()?;
        let mut state = from.clone();
        let mut found = inverse.solve_in_slices(self.model, &mut state, &goals, &self.work).await.ok()?;
        let (rotation, most) = (pelvis(self.ids, &state).rotation, TILT);
        let up = rotation * Vector3::z();
        let tilt = up.angle(&Vector3::z());
        if tilt > most {
            // The same again, less tilted.
            let axis = Unit::try_new(up.cross(&Vector3::z()), 1e-6)?;
            let rotation = UnitQuaternion::from_axis_angle(&axis, tilt - most) * rotation;
            let mut upright = Goal::pose(root, Isometry3::from_parts(Vector3::zeros().into(), rotation));
            (upright.position, upright.rotation) = ([0.0; 3], [0.3, 0.3, 0.0]);
            goals.push(upright);
            found = inverse.solve_in_slices(self.model, &mut state, &goals, &self.work).await.ok()?;
        }
        let jump = self.ids.joints.iter().map(|joint| (from.qpos[joint.qpos] - state.qpos[joint.qpos]).abs());
        let is_near = is_first || jump.fold(0.0, f64::max) < JUMP;
        (found.outcome == Outcome::Reached && is_near).then_some(state)
    }
}

/// Direction of the x axis on the level, rad.
pub(crate) fn heading(rotation: &UnitQuaternion<f64>) -> f64 {
    let ahead = rotation * Vector3::x();
    libm::atan2(ahead.y, ahead.x)
}

/// Part of the time of a way after which that part of it is done, if it begins and ends at rest.
fn ease(part: f64) -> f64 {
    0.5 - libm::sin(libm::asin(1.0 - 2.0 * part) / 3.0)
}

/// Where a foot passes: out from under the next tread by `back`, up, over and down; on the level, up, over and down.
fn path(from: Vector3<f64>, to: Vector3<f64>, back: f64, is_level: bool) -> Vec<Vector3<f64>> {
    let high = from.z.max(to.z) + OVER;
    let above = Vector3::new(to.x, to.y, to.z + ABOVE);
    if is_level {
        return vec![Vector3::new(from.x, from.y, high), Vector3::new(to.x, to.y, high), above];
    }
    let out = from.x.min(to.x) - back;
    vec![
        Vector3::new(from.x - 0.02, from.y, from.z + 0.03),
        Vector3::new(out, from.y, from.z + 0.08),
        Vector3::new(out, to.y, high),
        Vector3::new(to.x, to.y, high),
        above,
    ]
}
