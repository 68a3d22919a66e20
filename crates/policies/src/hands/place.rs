//! S06: puts the spent bulb into the crate.
//!
//! The robot steps to where its hand, right or left, is beside the crate's middle, brings the bulb above it, bends its knees and its back
//! while the hand goes down, lets the bulb rest, opens the hand, takes it up, and stands up.

use std::f64::consts::FRAC_PI_2;

use fiatlux_client::PolicyError;
use fiatlux_kinematics::at_once;
use fiatlux_proto::v3::SessionInfo;
use fiatlux_robot::{MOVED, mirrored};
use fiatlux_room::{bulb, crate_};
use fiatlux_skills::grip::{Angles, FINGERS, Finger, Grip};
use fiatlux_skills::path::wrapped;
use fiatlux_skills::phases::{Phases, Skill};
use fiatlux_skills::{heading, steps_to};
use fiatlux_wbc::{ARMS, BodyCommand, CONTROL_DT};
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};
use serde::Deserialize;

use super::arm::{Arm, Torso};
use super::parameters::parameters;
use super::side::Side;
use super::skill::{CAP, Expert, GLASS, GLASS_RADIUS, Seen};

/// Radius of the cap, m.
const CAP_RADIUS: f64 = bulb::CAP_RING_RADIUS;
/// Half extents of the crate, inside, m.
const INTERIOR: [f64; 2] = crate_::INTERIOR_HALF;
/// Places along a side that are compared, to either hand of its middle, and what a turn of the robot costs, m/rad.
const PLACES: i32 = 20;
const TURN_COST: f64 = 0.2;
/// Largest error of a posture that reaches, m, what is left where the arm has come to a posture, rad, and its fastest turn, rad/s.
const REACHED: f64 = 0.015;
const FASTEST: f64 = 2.0;
const TURNED: f64 = 0.02;

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Params {
    stand: Stand,
    bend: Bend,
    grasp: Grasp,
    motion: Motion,
    way: Vec<Waypoint>,
    close: Close,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Stand {
    ahead: f64,
    left: f64,
    margin: f64,
    right: f64,
    tolerance: f64,
    heading: f64,
    speed: f64,
    settle: f64,
    patience: f64,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Bend {
    height: f64,
    torso: [f64; 3],
    time: f64,
}

/// Where the robot is in a part of its bend, seen from where its pelvis was before, and where the glass is then.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Waypoint {
    pelvis: [f64; 3],
    turned: [f64; 3],
    waist: [f64; 3],
    glass: [f64; 3],
    down: f64,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Grasp {
    hand_from_glass: [f64; 3],
    turn: f64,
    roll: f64,
    torque: f64,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Motion {
    rest: [f64; ARMS / 2],
    rate: f64,
    low: f64,
    hand_low: f64,
    wait: f64,
    open: f64,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Close {
    open: Angles,
    #[serde(default)]
    grip: Angles,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Phase {
    /// Steps to the place from which the hand reaches into the crate.
    StepUp,
    /// Waits until the robot stands, and finds the arm's postures on the way down.
    Settle,
    /// Brings the bulb out ahead, above the crate.
    Above,
    /// Bends knees and back, and lowers the bulb. Ends where the bulb is just above the floor, or at the end of the way.
    Lower,
    /// Waits until all is at rest, by time.
    Rest,
    /// Opens the hand, by time.
    Open,
    /// Stands up with the bulb, to step to another place.
    Rise,
    /// Stands up the same way.
    StandUp,
    /// Takes the arm down: whoever walks to the bench next would have it below the top.
    TakeDown,
}

/// Part of the way down from which a robot that is already at it is taken to bend; height of a bulb's lowest point that lies on the
/// floor or in the crate, m; and closure of a hand that still holds it there.
const BENT: f64 = 0.08;
const LIES: f64 = 0.08;
const HOLDS: f64 = 0.4;

/// Where the robot stands and where the glass is wanted, on the floor.
#[derive(Debug, Clone, Copy)]
struct Spot {
    glass: Vector2<f64>,
    pelvis: Vector2<f64>,
    facing: f64,
}

impl Params {
    /// The numbers, which are given for the right hand, for one hand.
    fn on(mut self, side: Side) -> Self {
        let mirror = |numbers: &mut [f64], axes: &[usize]| {
            axes.iter().for_each(|axis| numbers[*axis] = side.mirrored(numbers[*axis]));
        };
        let Self { stand, bend, grasp, motion, way, .. } = &mut self;
        mirror(std::slice::from_mut(&mut stand.left), &[0]);
        mirror(&mut bend.torso, &[0, 2]);
        mirror(&mut grasp.hand_from_glass, &[2]);
        mirror(std::slice::from_mut(&mut grasp.turn), &[0]);
        mirror(std::slice::from_mut(&mut grasp.roll), &[0]);
        let turns: Vec<usize> = (0..motion.rest.len()).filter(|joint| mirrored(MOVED + joint).1 < 0.0).collect();
        mirror(&mut motion.rest, &turns);
        for Waypoint { pelvis, turned, waist, glass, .. } in way {
            mirror(pelvis, &[1]);
            mirror(turned, &[0, 2]);
            mirror(waist, &[0, 1]);
            mirror(glass, &[1]);
        }
        self
    }
}

/// State of an episode.
pub(super) struct Place {
    params: Params,
    /// The hand with the bulb.
    side: Side,
    phases: Phases<Phase>,
    spot: Option<Spot>,
    /// The arm's postures on the way down.
    postures: Vec<[f64; ARMS / 2]>,
    /// Part of the way down.
    share: f64,
    /// The arm hangs again.
    hangs: bool,
    fingers: [Finger; FINGERS.len()],
    grip: Grip,
}

impl Place {
    /// With parameters of the form of `place.toml`; without, those for the robot and the hand.
    pub fn new(given: Option<&str>, side: Side, info: &SessionInfo) -> Result<Self, PolicyError> {
        let params = parameters(given, "place", side, info, |params: &mut Params| vec![&mut params.close.grip])?;
        let params = params.on(side);
        Ok(Self {
            phases: Phases::new(Phase::StepUp, 0.0),
            spot: None,
            postures: Vec::new(),
            share: 0.0,
            hangs: false,
            fingers: [Finger { share: 1.0, torque: Some(params.grasp.torque) }; FINGERS.len()],
            grip: Grip::new(&info.joints, &params.close.open, &params.close.grip),
            side,
            params,
        })
    }

    /// The robot faces one of the crate's sides, and the glass comes down just behind that wall: of these places the one to which the
    /// robot has the least way.
    fn spot(&self, seen: &Seen, arm: &mut Arm) -> Spot {
        let hand_from_bulb = arm.sensed_hand().inv_mul(&seen.old_bulb);
        let stand = &self.params.stand;
        let (stance, looks) = self.stance(seen);
        let here = stance.translation.vector.xy();
        let along_x = heading(&seen.crate_);
        let crate_ = seen.crate_.translation.vector;
        let mut best: Option<(f64, Spot)> = None;
        for side in 0..4_u8 {
            let facing = along_x + f64::from(side) * FRAC_PI_2;
            let [deep, wide] = if side % 2 == 0 { INTERIOR } else { [INTERIOR[1], INTERIOR[0]] };
            let world_from_side = Isometry3::new(crate_, Vector3::z() * facing);
            for step in -PLACES..=PLACES {
                let aside = wide * f64::from(step) / f64::from(PLACES);
                let glass = world_from_side * Point3::new(stand.margin - deep, aside, 0.0);
                let pelvis = glass - world_from_side.rotation * Vector3::new(stand.ahead, stand.left, 0.0);
                let spot = Spot { glass: glass.coords.xy(), pelvis: pelvis.coords.xy(), facing };
                let cap = world_from_side.inverse() * self.cap(&spot, &hand_from_bulb);
                let outwards = self.side.mirrored(aside);
                let is_inside = outwards < wide - stand.margin
                    && outwards > stand.right - wide
                    && cap.x.abs() < deep - 0.5 * stand.margin
                    && cap.y.abs() < wide - stand.margin;
                let cost = (spot.pelvis - here).norm() + TURN_COST * wrapped(facing - looks).abs();
                if is_inside && best.is_none_or(|(least, _)| cost < least) {
                    best = Some((cost, spot));
                }
            }
        }
        let stay = Spot { glass: crate_.xy(), pelvis: here, facing: looks };
        best.map_or(stay, |(_, spot)| spot)
    }

    /// Where the cap's bottom is when the glass is there.
    fn cap(&self, spot: &Spot, hand_from_bulb: &Isometry3<f64>) -> Point3<f64> {
        let down = self.params.way.last().map_or(0.0, |last| last.down);
        let hand = self.world_from_hand_rotation(spot.facing, down);
        let axis = hand * (hand_from_bulb.rotation * Vector3::z());
        Point3::from(spot.glass.push(0.0) - axis * (GLASS - CAP))
    }

    /// Finds the arm's postures, from the last one up, so that each is near the next one; false where it does not
    /// reach the last one.
    fn plan(&mut self, seen: &Seen, spot: &Spot, arm: &mut Arm) -> Result<bool, PolicyError> {
        let (world_from_stance, _) = self.stance(seen);
        let Some(end) = self.params.way.last().map(|last| last.glass) else { return Ok(false) };
        let off = world_from_stance.inverse() * Point3::from(spot.glass.push(0.0)) - Point3::from(end);
        // The hand goes where it fits between the walls, also where the bulb has moved in it.
        self.plan_way(seen, self.params.grasp.hand_from_glass.into(), off.xy(), arm)
    }

    /// The same, with the glass at a place in the hand and as far from its way on the level.
    fn plan_way(
        &mut self,
        seen: &Seen,
        hand_from_glass: Vector3<f64>,
        off: Vector2<f64>,
        arm: &mut Arm,
    ) -> Result<bool, PolicyError> {
        let (world_from_stance, looks) = self.stance(seen);
        let last = self.params.way.len().saturating_sub(1);
        // From the end up; or, on the way, from where the arm is to either end.
        let ahead = if self.share > 0.0 { libm::ceil(self.share * last as f64) as usize } else { last + 1 };
        let now = (self.share > 0.0).then(|| arm.angles());
        let mut near = now;
        let mut at_end = None;
        self.postures = vec![[0.0; ARMS / 2]; self.params.way.len()];
        for index in (ahead..=last).chain((0..ahead.min(last + 1)).rev()) {
            let waypoint = &self.params.way[index];
            let [roll, pitch, yaw] = waypoint.turned;
            let stance_from_pelvis = Isometry3::from_parts(
                Translation3::from(waypoint.pelvis),
                UnitQuaternion::from_euler_angles(roll, pitch, yaw),
            );
            let torso = Torso { world_from_pelvis: world_from_stance * stance_from_pelvis, waist: waypoint.waist };
            let glass = Point3::from(waypoint.glass) + Vector3::new(off.x, off.y, 0.0);
            let turned = self.world_from_hand_rotation(looks, waypoint.down);
            let glass = world_from_stance * glass;
            let goal = Isometry3::from_parts((glass.coords - turned * hand_from_glass).into(), turned);
            let (posture, error) = at_once(arm.posture_of(&torso, &goal, near))?;
            near = if index == last && now.is_some() { now } else { Some(posture) };
            at_end = at_end.or((index == last).then_some(error));
            self.postures[index] = posture;
        }
        Ok(at_end.is_some_and(|error| error < REACHED))
    }

    /// Where the robot stood before it bent, on the floor, and where it looked.
    fn stance(&self, seen: &Seen) -> (Isometry3<f64>, f64) {
        let mut pelvis = seen.pelvis;
        if self.share > 0.0 {
            let (at, turned) = (self.between(|way| way.pelvis), self.between(|way| way.turned));
            let turned = UnitQuaternion::from_euler_angles(turned.x, turned.y, turned.z);
            pelvis *= Isometry3::from_parts(at.into(), turned).inverse();
        }
        let (here, looks) = (pelvis.translation.vector, heading(&pelvis));
        (Isometry3::new(Vector3::new(here.x, here.y, 0.0), Vector3::z() * looks), looks)
    }

    /// Numbers of the way at the present part of it.
    fn between(&self, numbers: impl Fn(&Waypoint) -> [f64; 3]) -> Vector3<f64> {
        let way = &self.params.way;
        let at = self.share * way.len().saturating_sub(1) as f64;
        let before = (at as usize).min(way.len().saturating_sub(2));
        let of = |index: usize| way.get(index).map_or_else(Vector3::zeros, |way| Vector3::from(numbers(way)));
        of(before).lerp(&of(before + 1), at - before as f64)
    }

    /// The hand's rotation: its fingers point below the horizontal and inwards of a direction.
    fn world_from_hand_rotation(&self, facing: f64, down: f64) -> UnitQuaternion<f64> {
        let grasp = &self.params.grasp;
        let (sin, cos) = (libm::sin(down), libm::cos(down));
        let fingers = Vector3::new(cos, 0.0, -sin);
        let thumb = Rotation3::from_scaled_axis(fingers * grasp.roll) * Vector3::new(sin, 0.0, cos);
        let mirror = self.side.mirrored(1.0);
        let axes = Matrix3::from_columns(&[fingers.cross(&thumb) * mirror, -fingers, -thumb * mirror]);
        let level = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), facing + grasp.turn);
        level * UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes))
    }

    /// The arm's posture at the present part of the way down, and the command to the body.
    fn on_way(&self) -> ([f64; ARMS / 2], BodyCommand) {
        let last = self.postures.len().saturating_sub(1);
        let at = self.share * last as f64;
        let before = (at as usize).min(last.saturating_sub(1));
        let part = at - before as f64;
        let mut posture = [0.0; ARMS / 2];
        if let (Some(from), Some(to)) = (self.postures.get(before), self.postures.get((before + 1).min(last))) {
            posture.iter_mut().zip(from.iter().zip(to)).for_each(|(q, (from, to))| *q = from + part * (to - from));
        }
        let bend = &self.params.bend;
        let upright = BodyCommand::default();
        let command = BodyCommand {
            height: upright.height + self.share * (bend.height - upright.height),
            torso: bend.torso.map(|angle| self.share * angle),
            ..upright
        };
        (posture, command)
    }

    /// Height of a bulb's lowest point, m.
    fn lowest(&self, bulb: &Isometry3<f64>) -> f64 {
        let glass = (bulb * Point3::new(0.0, 0.0, GLASS)).z - GLASS_RADIUS;
        glass.min((bulb * Point3::new(0.0, 0.0, CAP)).z - CAP_RADIUS)
    }
}

impl Expert for Place {
    fn step(&mut self, seen: &Seen, arm: &mut Arm, targets: &mut [f64]) -> Result<BodyCommand, PolicyError> {
        let params = self.params.clone();
        let (stand, motion) = (&params.stand, &params.motion);
        let mut command = BodyCommand::default();
        let elapsed = self.phases.elapsed(seen.time);
        let spot = match self.spot {
            Some(spot) => spot,
            None => *self.spot.insert(self.spot(seen, arm)),
        };
        let steps = steps_to(&seen.pelvis, &spot.pelvis, spot.facing, stand.speed);
        let off = wrapped(spot.facing - heading(&seen.pelvis)).abs();
        let on_way = CONTROL_DT / params.bend.time;
        let next = match self.phases.now() {
            Phase::StepUp => {
                command.velocity = steps.velocity;
                (steps.distance < stand.tolerance && off < stand.heading).then_some(Phase::Settle)
            }
            Phase::Settle if elapsed > stand.settle && seen.stands => {
                let is_near = steps.distance < 2.0 * stand.tolerance && off < 2.0 * stand.heading;
                let is_ready = is_near && self.plan(seen, &spot, arm)?;
                Some(if is_ready { Phase::Above } else { Phase::StepUp })
            }
            Phase::Settle => (elapsed > stand.patience).then_some(Phase::StepUp),
            Phase::Above => {
                let (posture, _) = self.on_way();
                (arm.turn_to(&posture, motion.rate) < TURNED).then_some(Phase::Lower)
            }
            Phase::Lower => {
                self.share = (self.share + on_way).min(1.0);
                let is_down = self.lowest(&seen.old_bulb) < motion.low || arm.lowest() < motion.hand_low;
                (is_down || elapsed > params.bend.time + motion.wait).then_some(Phase::Rest)
            }
            Phase::Rest => (elapsed > motion.wait).then_some(Phase::Open),
            Phase::Open => {
                self.fingers.iter_mut().for_each(|finger| finger.share -= CONTROL_DT / motion.open);
                (elapsed > motion.open + motion.wait).then_some(Phase::StandUp)
            }
            Phase::Rise => {
                self.share = (self.share - on_way).max(0.0);
                command = self.on_way().1;
                (self.share == 0.0).then_some(Phase::StepUp)
            }
            Phase::StandUp => {
                self.share = (self.share - on_way).max(0.0);
                (self.share == 0.0 && elapsed > params.bend.time + motion.wait).then_some(Phase::TakeDown)
            }
            Phase::TakeDown => {
                self.hangs = arm.turn_to(&arm.standing(), motion.rate) < TURNED;
                None
            }
        };
        if matches!(self.phases.now(), Phase::Lower | Phase::Rest | Phase::Open | Phase::StandUp) {
            let (posture, on_way) = self.on_way();
            arm.turn_to(&posture, FASTEST);
            command = on_way;
        }
        arm.write(targets);
        self.fingers.iter_mut().for_each(|finger| finger.share = finger.share.clamp(0.0, 1.0));
        arm.write_fingers(&self.grip, &self.fingers, targets);
        self.phases.enter(next, seen.time);
        Ok(command)
    }

    fn take_up(&mut self, seen: &Seen, arm: &mut Arm) -> Result<Option<BodyCommand>, PolicyError> {
        let glass = seen.old_bulb * Point3::new(0.0, 0.0, GLASS);
        let closure = arm.closure(&self.grip);
        let closed = closure.iter().sum::<f64>() / closure.len() as f64;
        let in_crate = (seen.crate_.inverse() * glass).coords;
        let is_inside = in_crate.x.abs() < INTERIOR[0] && in_crate.y.abs() < INTERIOR[1];
        let lowest = self.lowest(&seen.old_bulb);
        let (up, down) = (BodyCommand::default().height, self.params.bend.height);
        let share = ((up - seen.pelvis.translation.z) / (up - down)).clamp(0.0, 1.0);
        let is_held = lowest > LIES || closed > HOLDS;
        if !is_held && !is_inside {
            let reason = "the bulb is neither in the hand nor in the crate; begin with it in the hand".into();
            return Err(PolicyError::Unfit { policy: "hands", reason });
        }
        if is_held && share < BENT {
            return Ok(None);
        }
        arm.rest_where_it_is();
        self.share = if share < BENT { 0.0 } else { share };
        self.fingers
            .iter_mut()
            .zip(closure)
            .for_each(|(finger, share)| finger.share = if is_held { 1.0 } else { share });
        let (stance, _) = self.stance(seen);
        let phase = if is_held {
            let is_low = is_inside && lowest < self.params.motion.low;
            // On its way it goes on as it is, if that ends in the crate.
            let off = (stance.inverse() * glass).coords.xy() - self.between(|way| way.glass).xy();
            let end = self.params.way.last().map_or([0.0; 3], |last| last.glass);
            let end = seen.crate_.inverse() * (stance * Point3::new(end[0] + off.x, end[1] + off.y, 0.0));
            let margin = self.params.stand.margin / 2.0;
            let ends_inside = end.x.abs() < INTERIOR[0] - margin && end.y.abs() < INTERIOR[1] - margin;
            let hand_from_glass = (arm.sensed_hand().inverse() * glass).coords;
            let reaches = (ends_inside || is_low) && self.plan_way(seen, hand_from_glass, off, arm)?;
            match (reaches, is_low) {
                (true, true) => Phase::Rest,
                (true, false) => Phase::Lower,
                (false, _) => Phase::Rise,
            }
        } else if self.share > 0.0 {
            let held = arm.sensed_hand() * Point3::from(self.params.grasp.hand_from_glass);
            let here = stance.inverse() * held;
            let off = here.coords.xy() - self.between(|way| way.glass).xy();
            self.plan_way(seen, self.params.grasp.hand_from_glass.into(), off, arm)?;
            if closed > BENT { Phase::Open } else { Phase::StandUp }
        } else {
            Phase::TakeDown
        };
        self.phases = Phases::new(phase, seen.time);
        arm.set_pelvis(&seen.pelvis);
        Ok(Some(self.on_way().1))
    }

    fn rest(&self) -> [f64; ARMS / 2] {
        self.params.motion.rest
    }
}

impl Skill for Place {
    fn is_over(&self) -> bool {
        self.hangs
    }

    fn phase(&self) -> String {
        self.phases.name()
    }
}
