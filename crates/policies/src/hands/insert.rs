//! S11: puts the fresh bulb, which the hand holds, into the socket.
//!
//! The robot leans so that its right arm reaches the socket with room to spare, brings the bulb before the mouth, and moves the
//! plug, not the hand, along the socket's axis. Once the socket holds it, the hand opens and leaves.

use fiatlux_client::PolicyError;
use fiatlux_kinematics::at_once;
use fiatlux_proto::v3::Joint;
use fiatlux_room::fixture;
use fiatlux_skills::grip::{Angles, FINGERS, Finger, Grip};
use fiatlux_skills::phases::{Phases, Skill};
use fiatlux_wbc::{BodyCommand, CONTROL_DT};
use nalgebra::{Isometry3, Translation3, Vector3};
use serde::Deserialize;

use super::arm::{RightArm, ToolGoal};
use super::lean::Lean;
use super::parameters::parameters;
use super::plan::ArmAngles;
use super::retries::Manner;
use super::skill::{CAP, Expert, Seen};
use super::socket::Plug;
use super::stance::{Judge, REST, Stance, Taking, leans};

/// Heights above the seat: of the stop for the plug, and of the mouth, m.
const STOP: f64 = fixture::STOP_HEIGHT;
const MOUTH: f64 = fixture::MOUTH_HEIGHT;
/// Length of a step along the way in that is checked beforehand, m.
const CHECKED: f64 = 0.01;
/// Distance at which the hand has arrived, m.
const ARRIVED: f64 = 0.002;
/// Closure of a hand that holds the bulb, and distance of its frame from the bulb's up to which it is at the bulb, m.
const HOLDS: f64 = 0.3;
const HAND_M: f64 = 0.25;

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Params {
    lean: Lean,
    hold: Option<Holding>,
    align: Align,
    insert: Inserting,
    open: Opening,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Holding {
    felt: f64,
    torque: f64,
    settle: f64,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Align {
    before: f64,
    gain: f64,
    lead: f64,
    aside: f64,
    tilt: f64,
    stray: f64,
    back: f64,
    back_time: f64,
    calm: f64,
    patience: f64,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Inserting {
    speed: f64,
    ahead: f64,
    press: f64,
    lead: f64,
    stuck: f64,
    circle: f64,
    turn_rate: f64,
    turns: f64,
    stray: f64,
    patience: f64,
    seated: f64,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Opening {
    relax: f64,
    time: f64,
    hold: f64,
    back: Vec<[f64; 3]>,
    speed: f64,
    wait: f64,
    open: Angles,
    #[serde(default)]
    grip: Angles,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Phase {
    /// Leans and brings the bulb before the mouth.
    Take,
    /// Brings the plug onto the socket's axis. Ends where it is there and straight.
    Align,
    /// Takes it back from the mouth along the axis, by time; then the way there is looked for again.
    Back,
    /// Moves it in; in circles where it catches. Ends where the socket has held it for a while; else goes back to align.
    Insert,
    /// Lets go of what the arm presses with, by time.
    Relax,
    /// Opens the hand, which stays where it is, by time.
    Open,
    /// Takes the hand away.
    Retreat,
    /// Waits; then stands up.
    Done,
}

/// State of an episode.
pub(super) struct Insert {
    params: Params,
    phases: Phases<Phase>,
    taking: Taking,
    /// Pose of the bulb in the hand.
    hand_from_plug: Isometry3<f64>,
    /// Where the plug is wanted on the axis, from the seat, m.
    gap: f64,
    /// Since when what ends the phase has held, s.
    held_since: Option<f64>,
    /// Least gap of this phase, m, and when, s.
    deepest: (f64, f64),
    /// Where the hand is wanted once the bulb is seated.
    goal: Isometry3<f64>,
    fingers: [Finger; FINGERS.len()],
    grip: Grip,
    /// The grip is loosened, since at first it presses hard.
    loosens: Option<bool>,
}

impl Insert {
    /// With parameters of the form of `insert.toml`; without, those for the robot.
    pub fn new(given: Option<&str>, joints: &[Joint]) -> Result<Self, PolicyError> {
        let params = parameters(given, "insert", joints, |params: &mut Params| vec![&mut params.open.grip])?;
        Ok(Self {
            phases: Phases::new(Phase::Take, 0.0),
            taking: Taking::new(params.lean.clone(), Manner::CARRYING),
            hand_from_plug: Isometry3::identity(),
            gap: 0.0,
            held_since: None,
            deepest: (0.0, 0.0),
            goal: Isometry3::identity(),
            fingers: [Finger { share: 1.0, torque: None }; FINGERS.len()],
            grip: Grip::new(joints, &params.open.open, &params.open.grip),
            loosens: None,
            params,
        })
    }

    /// Leans and brings the bulb before the mouth; true where it is there.
    fn take(&mut self, seen: &Seen, arm: &mut RightArm) -> Result<bool, PolicyError> {
        let world_from_plug = seen.fresh_bulb * Translation3::new(0.0, 0.0, CAP);
        self.hand_from_plug = arm.sensed_hand().inv_mul(&world_from_plug);
        let (hand_from_plug, before) = (self.hand_from_plug, self.params.align.before);
        self.taking.step(seen, arm, || WaysIn { seen: seen.clone(), hand_from_plug, before })
    }

    /// True if something has held for a time, s.
    fn has_held(&mut self, holds: bool, seen: &Seen, time: f64) -> bool {
        let since = self.held_since.filter(|_| holds);
        self.held_since = holds.then(|| since.unwrap_or(seen.time));
        since.is_some_and(|since| seen.time - since > time)
    }

    /// Where the plug is wanted beside the axis: on it, or, where it has caught, on circles that grow.
    fn search(&self, seen: &Seen, plug: &Plug) -> Vector3<f64> {
        let insert = &self.params.insert;
        let stuck = seen.time - self.deepest.1 - insert.stuck;
        if stuck < 0.0 || seen.seated[1] {
            return Vector3::zeros();
        }
        let across = plug.axis.cross(&if plug.axis.z.abs() > 0.5 { Vector3::x() } else { Vector3::z() });
        let turn = insert.turn_rate * stuck;
        let radius = insert.circle * (turn / (insert.turns * std::f64::consts::TAU)).min(1.0);
        radius * (libm::cos(turn) * across + libm::sin(turn) * plug.axis.cross(&across))
    }
}

/// Ways from before the mouth to the seat.
struct WaysIn {
    seen: Seen,
    hand_from_plug: Isometry3<f64>,
    /// Where the plug is before the mouth, from the seat, m.
    before: f64,
}

impl Judge for WaysIn {
    /// The turn about the socket's axis is the arm's choice.
    async fn judge(
        &self,
        arm: &mut RightArm,
        command: &BodyCommand,
        from: &ArmAngles,
        tries: usize,
        least: f64,
    ) -> Result<Option<Stance>, PolicyError> {
        let Self { seen, hand_from_plug, before } = self;
        let mut stance = Stance::of(command);
        if stance.score() <= least {
            return Ok(None);
        }
        let free = Some(seen.socket.rotation * Vector3::z());
        let goal = |gap: f64| ToolGoal {
            hand_from_tool: *hand_from_plug,
            world_from_tool: seen.socket * Translation3::new(0.0, 0.0, CAP + gap),
            free,
        };
        arm.assume(command, from);
        let (mut angles, _) = arm.find(true, &goal(STOP), from, tries).await?;
        arm.assume(command, &angles);
        (stance.world_from_hand, stance.gap) = (arm.place(&angles), arm.body_gap().await);
        let steps = libm::ceil((before - STOP) / CHECKED);
        for step in 0..=steps as usize {
            if stance.score() <= least {
                return Ok(None);
            }
            angles = stance.go_on(arm, &goal(STOP + (before - STOP) * step as f64 / steps), &angles).await?;
            stance.postures.push(angles);
        }
        stance.postures.reverse();
        Ok(Some(stance).filter(|stance| stance.score() > least))
    }
}

/// Where the hand goes from a pose: by the first of these moves that the arm reaches, or by the one that it reaches best.
fn way_out(arm: &mut RightArm, from: &Isometry3<f64>, moves: &[[f64; 3]]) -> Result<Isometry3<f64>, PolicyError> {
    let angles = arm.angles();
    let mut best = (f64::INFINITY, *from);
    for change in moves {
        let away = from * Translation3::from(*change);
        let goal = ToolGoal { hand_from_tool: Isometry3::identity(), world_from_tool: away, free: None };
        let (_, error) = at_once(arm.find(false, &goal, &angles, 1))?;
        if error < best.0 {
            best = (error, away);
        }
        if error < ARRIVED {
            break;
        }
    }
    Ok(best.1)
}

impl Expert for Insert {
    fn step(&mut self, seen: &Seen, arm: &mut RightArm, targets: &mut [f64]) -> Result<BodyCommand, PolicyError> {
        let params = self.params.clone();
        let (align, insert, open) = (&params.align, &params.insert, &params.open);
        let elapsed = self.phases.elapsed(seen.time);
        let plug = Plug::measure(&seen.socket, &seen.fresh_bulb);
        let next = match self.phases.now() {
            Phase::Take => self.take(seen, arm)?.then(|| {
                self.gap = align.before;
                Phase::Align
            }),
            Phase::Align => {
                arm.nudge(
                    true,
                    &plug.change(self.gap, &Vector3::zeros(), align.gain),
                    self.hand_from_plug,
                    plug.axis,
                    align.lead,
                )?;
                let is_there = plug.aside.norm() < align.aside && plug.turn.angle() < align.tilt;
                if self.has_held(is_there, seen, align.calm) {
                    self.deepest = (plug.gap, seen.time);
                    Some(Phase::Insert)
                } else if elapsed > align.patience || elapsed > 1.0 && plug.aside.norm() > align.stray {
                    Some(Phase::Back)
                } else {
                    None
                }
            }
            Phase::Back => {
                self.gap = align.back;
                arm.nudge(
                    true,
                    &plug.change(self.gap, &Vector3::zeros(), align.gain),
                    self.hand_from_plug,
                    plug.axis,
                    align.lead,
                )?;
                (plug.gap > self.gap - 0.01 || elapsed > align.back_time).then(|| {
                    self.taking.again();
                    Phase::Take
                })
            }
            Phase::Insert => {
                if plug.gap < self.deepest.0 - 1e-3 {
                    self.deepest = (plug.gap, seen.time);
                }
                if plug.gap - self.gap < insert.ahead {
                    self.gap = (self.gap - insert.speed * CONTROL_DT).max(insert.press);
                }
                let aside = self.search(seen, &plug);
                arm.nudge(
                    true,
                    &plug.change(self.gap, &aside, align.gain),
                    self.hand_from_plug,
                    plug.axis,
                    insert.lead,
                )?;
                let is_outside = plug.gap > MOUTH / 2.0;
                if self.has_held(seen.seated[1], seen, insert.seated) {
                    self.goal = arm.sensed_hand();
                    Some(Phase::Relax)
                } else if is_outside && (elapsed > insert.patience || plug.aside.norm() > insert.stray) {
                    self.gap = align.before;
                    Some(Phase::Align)
                } else {
                    None
                }
            }
            Phase::Relax | Phase::Open => {
                let goal = self.goal;
                arm.move_to(false, &goal, open.speed)?;
                if self.phases.now() == Phase::Relax {
                    (elapsed > open.relax).then_some(Phase::Open)
                } else {
                    let opening = CONTROL_DT / open.time;
                    self.fingers.iter_mut().for_each(|finger| finger.share = (finger.share - opening).max(0.0));
                    if elapsed > open.time + open.hold {
                        self.goal = way_out(arm, &self.goal, &open.back)?;
                        Some(Phase::Retreat)
                    } else {
                        None
                    }
                }
            }
            Phase::Retreat => {
                let goal = self.goal;
                (arm.move_to(false, &goal, open.speed)? < ARRIVED).then_some(Phase::Done)
            }
            Phase::Done => None,
        };
        arm.write(targets);
        RightArm::put_left_arm(targets, self.phases.now() != Phase::Done);
        let is_opening = matches!(self.phases.now(), Phase::Open | Phase::Retreat | Phase::Done);
        let presses = |hold: &Holding| seen.touch.fingers.iter().any(|force| *force > hold.felt);
        let loosens = *self.loosens.get_or_insert(params.hold.as_ref().is_some_and(presses));
        if is_opening || loosens && params.hold.as_ref().is_some_and(|hold| seen.time < hold.settle) {
            let torque = params.hold.as_ref().map(|hold| hold.torque);
            self.fingers.iter_mut().for_each(|finger| finger.torque = torque);
            arm.write_fingers(&self.grip, &self.fingers, targets);
        }
        if self.phases.enter(next, seen.time) {
            self.held_since = None;
        }
        let stands_up = self.phases.now() == Phase::Done && self.phases.elapsed(seen.time) > open.wait;
        Ok(if stands_up { self.taking.upright } else { self.taking.command() })
    }

    fn take_up(&mut self, seen: &Seen, arm: &mut RightArm) -> Result<Option<BodyCommand>, PolicyError> {
        let plug = Plug::measure(&seen.socket, &seen.fresh_bulb);
        let closure = arm.closure(&self.grip);
        let closed = closure.iter().sum::<f64>() / closure.len() as f64;
        let hand = arm.sensed_hand();
        let is_near = hand.inv_mul(&seen.fresh_bulb).translation.vector.norm() < HAND_M;
        let (align, open) = (&self.params.align, &self.params.open);
        let is_before = plug.gap < align.before + HAND_M / 10.0 && plug.aside.norm() < align.stray;
        let command = arm.stands_by(&seen.pelvis);
        let is_on_way = !seen.seated[1] && (!is_before || closed < HOLDS);
        if is_on_way && !leans(&command) {
            return Ok(None);
        }
        arm.rest_where_it_is();
        self.taking.stays(command);
        self.hand_from_plug = hand.inv_mul(&(seen.fresh_bulb * Translation3::new(0.0, 0.0, CAP)));
        (self.gap, self.deepest, self.goal) = (plug.gap, (plug.gap, seen.time), hand);
        let phase = if is_on_way {
            Phase::Take
        } else if !seen.seated[1] {
            let is_straight = plug.aside.norm() < align.aside && plug.turn.angle() < align.tilt;
            self.gap = if is_straight { plug.gap } else { plug.gap.max(align.before) };
            if is_straight { Phase::Insert } else { Phase::Align }
        } else if closed > HOLDS {
            Phase::Relax
        } else {
            self.fingers.iter_mut().zip(closure).for_each(|(finger, share)| finger.share = share);
            if is_near {
                self.goal = way_out(arm, &hand, &open.back)?;
            }
            if is_near { Phase::Retreat } else { Phase::Done }
        };
        self.phases = Phases::new(phase, seen.time);
        Ok(Some(command))
    }

    fn rest(&self) -> ArmAngles {
        REST
    }
}

impl Skill for Insert {
    fn is_over(&self) -> bool {
        self.phases.now() == Phase::Done
    }

    fn phase(&self) -> String {
        if self.phases.now() == Phase::Take { self.taking.stage() } else { self.phases.name() }
    }
}
