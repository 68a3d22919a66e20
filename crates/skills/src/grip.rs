//! Fingers: whose a joint or a body is by its name, the robot's own grasp of a bulb, and how hard fingers press. Joints are looked up
//! once.

use std::collections::BTreeMap;

use fiatlux_proto::v3::Joint;
use fiatlux_robot::{BODY, Robot};
use fiatlux_room::grasp;
use nalgebra::Vector3;

/// Fingers, as the names of bodies and joints have them. The thumb closes first.
pub const FINGERS: [&str; 5] = ["thumb", "index", "middle", "ring", "pinky"];
/// Beginnings of the names of both sides.
const SIDES: [[&str; 2]; 2] = [["L_", "left_"], ["R_", "right_"]];
/// Share of the difference by which a held angle follows the sensed one in each control step: what is sensed is noisy.
const SENSED: f64 = 0.1;
/// Control steps in which hands that press on get used to what they hold.
const SETTLES: u32 = 100;

/// Torque from which on a joint is taken to press on what the hand holds, N m.
const IDLE: f64 = 0.06;

/// A way of carrying a bulb.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Carrying {
    /// Share of their largest effort with which fingers press at most.
    pub presses: f64,
    /// Share of its first torque that a joint keeps where it closes farther: without, what creeps in the hand slips out of it.
    pub keeps: f64,
}

impl Carrying {
    /// Of an old bulb, as it comes from the socket: the little fingers are below it. With 0.9 one that came to lie against the palm was
    /// pressed with twice the force, and broke.
    pub const OLD: Self = Self { presses: 0.9, keeps: 0.6 };
    /// Of a fresh bulb, between thumb and fingers.
    pub const FRESH: Self = Self { presses: 0.9, keeps: 0.9 };

    /// In a task, by its short name; `None` where no bulb is carried.
    pub fn of_task(task: &str) -> Option<Self> {
        match task {
            "S04" | "S05" => Some(Self::OLD),
            "S09" | "S10" => Some(Self::FRESH),
            _ => None,
        }
    }
}

/// A joint whose angles in the open and the closed hand are nearer to each other says nothing about how far it is closed, rad.
const MOVES: f64 = 0.2;

/// Angles or targets of joints by name, rad.
pub type Angles = BTreeMap<String, f64>;

/// Side of a joint or body, left first, and its name without it; `None` for what is on no side.
pub fn side(name: &str) -> Option<(usize, &str)> {
    (0..2).find_map(|side| SIDES[side].iter().find_map(|start| name.strip_prefix(start)).map(|rest| (side, rest)))
}

/// The name of the same joint or body on a side, left first.
pub fn on_side(name: &str, of_side: usize) -> String {
    let starts = SIDES.iter().flat_map(|starts| starts.iter().enumerate());
    let mut renamed =
        starts.filter_map(|(form, start)| Some([SIDES[of_side][form], name.strip_prefix(start)?].concat()));
    renamed.next_back().unwrap_or_else(|| name.into())
}

/// The finger that a joint or body is of, by its name.
pub fn finger(name: &str) -> Option<usize> {
    FINGERS.iter().position(|finger| name.contains(finger))
}

/// Targets of a hand's joints around the glass of a bulb, rad, of the left hand (0) or the right one (1): those of the robot's file, or
/// of the published room, whose right hand has the mirror image at the left.
pub fn grasp_of(robot: &Robot, of_side: usize) -> Angles {
    let own = robot.bulb_grasp().map(|grasp| &grasp.grip);
    let own = own.map(|grip| grip.iter().map(|(joint, angle)| (robot.joints()[*joint].name.clone(), *angle)).collect());
    let is_driven = |name: &str| robot.joint_index(name).is_none_or(|joint| robot.joints()[joint].follows.is_none());
    let right: Angles = own.unwrap_or_else(|| {
        let of_room = grasp::GRIP.into_iter().filter(|(name, _)| is_driven(name));
        of_room.map(|(name, angle)| (name.to_owned(), angle)).collect()
    });
    right.into_iter().map(|(name, angle)| (on_side(&name, of_side), angle)).collect()
}

/// Forces on fingers and on the rest of a hand, N.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Touch {
    /// Largest force on a body of each finger.
    pub fingers: [f64; FINGERS.len()],
    /// Largest force on any other body.
    pub palm: f64,
}

/// Side and finger of each body of a session's hands.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct HandBodies {
    /// Side and finger, `None` for another part of the hand; none at all for a body of no hand.
    places: Vec<Option<(usize, Option<usize>)>>,
}

impl HandBodies {
    /// By their names, in the order of the sensor `hand_contact`.
    pub fn new(names: &[String]) -> Self {
        Self { places: names.iter().map(|name| side(name).map(|(side, _)| (side, finger(name)))).collect() }
    }

    /// Forces on both hands, left first, by those of the sensor, N.
    pub fn touch(&self, forces: &[f32]) -> [Touch; 2] {
        let mut hands = [Touch::default(); 2];
        for (place, &[x, y, z]) in self.places.iter().zip(forces.as_chunks().0) {
            let Some((side, finger)) = *place else { continue };
            let hand = &mut hands[side];
            let largest = finger.map_or(&mut hand.palm, |finger| &mut hand.fingers[finger]);
            *largest = largest.max(Vector3::new(x, y, z).cast::<f64>().norm());
        }
        hands
    }
}

impl Touch {
    /// Largest of all.
    pub fn largest(&self) -> f64 {
        self.fingers.iter().copied().fold(self.palm, f64::max)
    }
}

/// A joint of a hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandJoint {
    /// Its index in the session.
    pub index: usize,
    /// Least and greatest angle, rad.
    pub limits: [f64; 2],
    /// Of its drive, N m/rad, above 0.
    pub stiffness: f64,
    /// Largest torque of its drive, N m.
    pub effort: f64,
}

impl HandJoint {
    /// Those of both hands that have drives, with their names, in the session's order.
    pub fn all(joints: &[Joint]) -> impl Iterator<Item = (Self, &str)> {
        let driven = joints.iter().enumerate().skip(BODY).filter(|(_, joint)| joint.follows.is_none());
        driven.map(|(index, joint)| {
            let (limits, stiffness) = ([joint.lower, joint.upper], joint.stiffness.max(1e-3));
            (Self { index, limits, stiffness, effort: joint.effort_limit }, joint.name.as_str())
        })
    }

    /// A target with which a joint at an angle, rad, presses no harder than with a torque, N m, either way.
    pub fn bounded(&self, target: f64, angle: f64, torque: f64) -> f64 {
        let bend = torque / self.stiffness;
        target.clamp(angle - bend, angle + bend)
    }
}

/// Closure of a finger.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Finger {
    /// From 0, open, to 1, closed.
    pub share: f64,
    /// Most that its joints press with, N m; `None`: what their drives can.
    pub torque: Option<f64>,
}

/// A hand that closes from one posture of its fingers to another.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Grip {
    joints: Vec<GripJoint>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct GripJoint {
    joint: HandJoint,
    finger: usize,
    open: f64,
    closed: f64,
}

impl Grip {
    /// Moves the joints of `closed`; those that `open` lacks are open at 0 rad.
    pub fn new(joints: &[Joint], open: &Angles, closed: &Angles) -> Self {
        let joint = |(joint, name): (HandJoint, &str)| {
            let open = open.get(name).copied().unwrap_or_default();
            Some(GripJoint { joint, finger: finger(name)?, open, closed: *closed.get(name)? })
        };
        Self { joints: HandJoint::all(joints).filter_map(joint).collect() }
    }

    /// Closure of each finger, from 0 to 1, by the sensed angles of all joints, rad: the mean of its joints that move.
    pub fn closure(&self, sensed: &[f64]) -> [f64; FINGERS.len()] {
        let mut sums = [(0.0, 0.0); FINGERS.len()];
        for GripJoint { joint, finger, open, closed } in &self.joints {
            let Some(angle) = sensed.get(joint.index).filter(|_| (closed - open).abs() > MOVES) else { continue };
            let (share, count) = &mut sums[*finger];
            (*share, *count) = (*share + ((angle - open) / (closed - open)).clamp(0.0, 1.0), *count + 1.0);
        }
        sums.map(|(share, count)| if count > 0.0 { share / count } else { 0.0 })
    }

    /// True where targets, rad, ask a joint at its sensed angle for all that its drive has.
    pub fn is_at_limit(&self, sensed: &[f64], targets: &[f64]) -> bool {
        self.joints.iter().any(|GripJoint { joint, .. }| {
            joint.stiffness * (targets[joint.index] - sensed[joint.index]).abs() >= joint.effort
        })
    }

    /// Writes targets, rad, of fingers in the order of [`FINGERS`]. Those with a torque do not close harder than that against what
    /// keeps their joints at the sensed angles.
    pub fn write(&self, fingers: &[Finger; FINGERS.len()], sensed: Option<&[f64]>, targets: &mut [f64]) {
        for GripJoint { joint, finger, open, closed } in &self.joints {
            let Finger { share, torque } = fingers[*finger];
            let [lower, upper] = joint.limits;
            let mut target = (open + share * (closed - open)).clamp(lower, upper);
            if let (Some(torque), Some(sensed)) = (torque, sensed) {
                let (angle, bend) = (sensed[joint.index], torque / joint.stiffness);
                target = if closed > open { target.min(angle + bend) } else { target.max(angle - bend) };
            }
            targets[joint.index] = target;
        }
    }
}

/// Hands that press on as they do at first, but not with all that their drives have.
///
/// A held bulb creeps, and fingers that follow it come nearer to their targets: such a joint presses on with much of its first torque.
#[derive(Debug, Clone, Default)]
pub struct Hold {
    joints: Vec<HeldJoint>,
    /// Control steps so far.
    steps: u32,
}

#[derive(Debug, Clone)]
struct HeldJoint {
    joint: HandJoint,
    /// The most that it presses with, N m, and the share of its first torque that it keeps.
    most: f64,
    keeps: f64,
    /// First target, rad.
    start: f64,
    /// Sensed angles, averaged: of the first control steps, and of late, rad.
    first: f64,
    now: f64,
    /// The torque that it keeps, N m, with its sign; 0 until it is known.
    kept: f64,
}

impl Hold {
    /// With these targets of all joints, rad, as far as they may press.
    pub fn new(joints: &[Joint], carrying: Carrying, start: &[f64]) -> Self {
        let joint = |(joint, _): (HandJoint, &str)| HeldJoint {
            joint,
            start: start.get(joint.index).copied().unwrap_or_default(),
            most: carrying.presses * joint.effort,
            keeps: carrying.keeps,
            first: 0.0,
            now: 0.0,
            kept: 0.0,
        };
        Self { joints: HandJoint::all(joints).map(joint).collect(), steps: 0 }
    }

    /// True where it holds no joint.
    pub fn is_empty(&self) -> bool {
        self.joints.is_empty()
    }

    /// Writes the targets of the hands' joints: the first ones as far as they may press, by what is sensed at first, rad. After that a
    /// finger that gives way presses more, or what is held would wander; and one that closes farther presses on.
    pub fn write(&mut self, sensed: &[f64], targets: &mut [f64]) {
        self.steps = self.steps.saturating_add(1);
        for held in &mut self.joints {
            let (Some(target), Some(sensed)) = (targets.get_mut(held.joint.index), sensed.get(held.joint.index)) else {
                continue;
            };
            if self.steps == 1 {
                held.now = *sensed;
            }
            held.now += SENSED * (sensed - held.now);
            if self.steps < SETTLES {
                held.first = held.now;
            }
            *target = held.joint.bounded(held.start, held.first, held.most);
            if self.steps == SETTLES {
                held.kept = held.keeps(*target);
            }
            let pressing = held.now + held.kept / held.joint.stiffness;
            if held.kept > 0.0 {
                *target = target.max(pressing);
            } else if held.kept < 0.0 {
                *target = target.min(pressing);
            }
        }
    }
}

impl HeldJoint {
    /// The torque that it keeps where this is its target, rad.
    fn keeps(&self, target: f64) -> f64 {
        let torque = self.joint.stiffness * (target - self.first);
        if torque.abs() > IDLE { self.keeps * torque } else { 0.0 }
    }
}
