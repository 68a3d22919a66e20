//! S11: puts the fresh bulb, which the hand holds, into the socket.
//!
//! The robot leans so that its right arm reaches the socket with room to spare, brings the bulb before the mouth, and moves the
//! plug, not the hand, along the socket's axis. Once the socket holds it, the hand opens and leaves.

mod ways;

use fiatlux_client::PolicyError;
use fiatlux_kinematics::Search;
use fiatlux_proto::v3::SessionInfo;
use fiatlux_room::fixture;
use fiatlux_skills::grip::{Angles, FINGERS, Finger, Grip};
use fiatlux_skills::phases::{Phases, Skill};
use fiatlux_wbc::{BodyCommand, CONTROL_DT};
use nalgebra::{Isometry3, Translation3, Vector3};
use serde::Deserialize;

use super::arm::{Arm, MakesArm};
use super::judge::Standing;
use super::lean::{Lean, leans};
use super::parameters::parameters;
use super::plan::{ArmAngles, SLICE};
use super::retries::Manner;
use super::room;
use super::side::Side;
use super::skill::{CAP, Expert, Seen};
use super::socket::Plug;
use super::stance::{REST, Taking};
use ways::{WaysIn, way_out};

/// Height of the mouth above the seat, m.
const MOUTH: f64 = fixture::MOUTH_HEIGHT;
/// Off the bulb: way along the socket's axis after which the hand is beyond its end, m, and rate of the joints, rad/s.
const OUT: f64 = 0.12;
const LEAVES_AT: f64 = 0.3;
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
    askew: f64,
    off: f64,
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
    /// Opens the hand, by time; the arm stays where it is.
    Open,
    /// Takes the hand off the bulb.
    Retreat,
    /// Stands up and lets the arm hang, on ways that strike nothing.
    Leave,
    /// Nothing is left to do.
    Done,
}

/// State of an episode.
pub(super) struct Insert {
    params: Params,
    phases: Phases<Phase>,
    taking: Taking,
    /// The way back from the socket, once the hand is off the bulb.
    leaving: Option<Taking>,
    /// The search for the way off the bulb, and the postures on it that are left, the last first.
    search: Option<Search<Result<Vec<ArmAngles>, PolicyError>>>,
    way: Vec<ArmAngles>,
    /// Makes the arm for that: the bulb is then in the socket, not in the hand.
    empty: Option<MakesArm>,
    /// Pose of the bulb in the hand.
    hand_from_plug: Isometry3<f64>,
    /// Where the plug is wanted on the axis, from the seat, m.
    gap: f64,
    /// Since when what ends the phase has held, s.
    held_since: Option<f64>,
    /// Least gap of this phase, m, and when, s.
    deepest: (f64, f64),
    fingers: [Finger; FINGERS.len()],
    grip: Grip,
    /// The grip is loosened, since at first it presses hard, by drives that give all that they have. A climb's grip has less, and once
    /// loosened it would lose the bulb.
    loosens: Option<bool>,
}

impl Insert {
    /// With parameters of the form of `insert.toml`; without, those for the robot. `empty` makes the arm with nothing in its hand.
    pub fn new(given: Option<&str>, info: &SessionInfo, empty: MakesArm) -> Result<Self, PolicyError> {
        let params = parameters(given, "insert", Side::Right, info, |params: &mut Params| vec![&mut params.open.grip])?;
        Ok(Self {
            phases: Phases::new(Phase::Take, 0.0),
            taking: Taking::new(params.lean.clone(), Manner::CARRYING),
            leaving: None,
            empty: Some(empty),
            search: None,
            way: Vec::new(),
            hand_from_plug: Isometry3::identity(),
            gap: 0.0,
            held_since: None,
            deepest: (0.0, 0.0),
            fingers: [Finger { share: 1.0, torque: None }; FINGERS.len()],
            grip: Grip::new(&info.joints, &params.open.open, &params.open.grip),
            loosens: None,
            params,
        })
    }

    /// Leans and brings the bulb before the mouth; true where it is there.
    fn take(&mut self, seen: &Seen, arm: &mut Arm) -> Result<bool, PolicyError> {
        let world_from_plug = seen.fresh_bulb * Translation3::new(0.0, 0.0, CAP);
        self.hand_from_plug = arm.sensed_hand().inv_mul(&world_from_plug);
        let (hand_from_plug, carries_at, before) = (self.hand_from_plug, arm.angles(), self.params.align.before);
        self.taking.step(seen, arm, || WaysIn { seen: seen.clone(), hand_from_plug, carries_at, before })
    }

    /// The bulb is in the socket, and the hand around it open: looks for the way off it.
    fn backs_off(&mut self, seen: &Seen, arm: &mut Arm, plug: &Plug) -> Result<Phase, PolicyError> {
        self.empties(seen, arm)?;
        let from = arm.world_from_hand();
        let mut moves: Vec<_> = self.params.open.back.iter().copied().map(Vector3::from).collect();
        // Out as it came in, too, where the arm struck nothing.
        let out = from.inverse_transform_vector(&plug.axis.scale(OUT));
        moves.extend([Vector3::zeros()].iter().chain(&moves.clone()).map(|aside| out + 0.5 * aside));
        let arm = arm.clone();
        self.search = Some(Search::new(move |work| {
            let mut arm = arm.searching(work);
            async move { way_out(&mut arm, &from, &moves).await }
        }));
        Ok(Phase::Retreat)
    }

    /// From now on the bulb is in the socket.
    fn empties(&mut self, seen: &Seen, arm: &mut Arm) -> Result<(), PolicyError> {
        if let Some(empty) = self.empty.take() {
            *arm = empty(room::with_bulb_in_socket(seen))?.going_on_from(arm);
        }
        Ok(())
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

impl Insert {
    /// Brings the plug before the mouth and straight.
    fn align(
        &mut self,
        params: &Params,
        seen: &Seen,
        arm: &mut Arm,
        plug: &Plug,
    ) -> Result<Option<Phase>, PolicyError> {
        let (align, elapsed) = (&params.align, self.phases.elapsed(seen.time));
        arm.nudge(
            true,
            &plug.change(self.gap, &Vector3::zeros(), align.gain),
            self.hand_from_plug,
            Some(plug.axis),
            align.lead,
        )?;
        let is_there = plug.aside.norm() < align.aside && plug.turn.angle() < align.tilt;
        Ok(if self.has_held(is_there, seen, align.calm) {
            self.deepest = (plug.gap, seen.time);
            Some(Phase::Insert)
        } else if elapsed > align.patience || elapsed > 1.0 && plug.aside.norm() > align.stray {
            Some(Phase::Back)
        } else {
            None
        })
    }

    /// Moves it in, and out again where it is askew or beside the mouth.
    fn insert(
        &mut self,
        params: &Params,
        seen: &Seen,
        arm: &mut Arm,
        plug: &Plug,
    ) -> Result<Option<Phase>, PolicyError> {
        let Params { align, insert, .. } = params;
        let elapsed = self.phases.elapsed(seen.time);
        if plug.gap < self.deepest.0 - 1e-3 {
            self.deepest = (plug.gap, seen.time);
        }
        let is_outside = plug.gap > MOUTH / 2.0;
        // Askew in the mouth, or pressed on its rim, it would turn in the hand: it comes out until it is straight and in front of the mouth.
        let is_off = plug.turn.angle() > insert.askew || is_outside && plug.aside.norm() > insert.off;
        if is_off && !seen.seated[1] {
            self.gap = (plug.gap.max(self.gap) + insert.speed * CONTROL_DT).min(align.before);
            // On its way out it has not caught: circles would keep it beside the mouth.
            self.deepest = (plug.gap, seen.time);
        } else if plug.gap - self.gap < insert.ahead {
            self.gap = (self.gap - insert.speed * CONTROL_DT).max(insert.press);
        }
        let aside = self.search(seen, plug);
        arm.nudge(true, &plug.change(self.gap, &aside, align.gain), self.hand_from_plug, Some(plug.axis), insert.lead)?;
        Ok(if self.has_held(seen.seated[1], seen, insert.seated) {
            arm.rest_where_it_is();
            Some(Phase::Relax)
        } else if is_outside && (elapsed > insert.patience || plug.aside.norm() > insert.stray) {
            self.gap = align.before;
            Some(Phase::Align)
        } else {
            None
        })
    }
}

impl Expert for Insert {
    fn step(&mut self, seen: &Seen, arm: &mut Arm, targets: &mut [f64]) -> Result<BodyCommand, PolicyError> {
        let params = self.params.clone();
        let (align, open) = (&params.align, &params.open);
        let elapsed = self.phases.elapsed(seen.time);
        let plug = Plug::measure(&seen.socket, &seen.fresh_bulb);
        let next = match self.phases.now() {
            Phase::Take => self.take(seen, arm)?.then(|| {
                self.gap = align.before;
                Phase::Align
            }),
            Phase::Align => self.align(&params, seen, arm, &plug)?,
            Phase::Back => {
                self.gap = align.back;
                arm.nudge(
                    true,
                    &plug.change(self.gap, &Vector3::zeros(), align.gain),
                    self.hand_from_plug,
                    Some(plug.axis),
                    align.lead,
                )?;
                (plug.gap > self.gap - 0.01 || elapsed > align.back_time).then(|| {
                    self.taking.again();
                    Phase::Take
                })
            }
            Phase::Insert => self.insert(&params, seen, arm, &plug)?,
            Phase::Relax => (elapsed > open.relax).then_some(Phase::Open),
            Phase::Open => {
                let opening = CONTROL_DT / open.time;
                self.fingers.iter_mut().for_each(|finger| finger.share = (finger.share - opening).max(0.0));
                (elapsed > open.time + open.hold).then(|| self.backs_off(seen, arm, &plug)).transpose()?
            }
            Phase::Retreat => {
                if let Some(search) = &mut self.search {
                    if let Some(found) = search.go_on(SLICE) {
                        (self.search, self.way) = (None, found?);
                        self.way.reverse();
                    }
                } else if let Some(posture) = self.way.last()
                    && arm.go_to(posture, LEAVES_AT, true)
                {
                    self.way.pop();
                }
                let is_held_up = arm.gives_way();
                (self.search.is_none() && (self.way.is_empty() || is_held_up)).then_some(Phase::Leave)
            }
            Phase::Leave => {
                let leaving = self.leaving.get_or_insert_with(|| self.taking.back(Manner::LEAVING));
                let hanging = arm.standing();
                leaving.step(seen, arm, || Standing(hanging))?.then_some(Phase::Done)
            }
            Phase::Done => None,
        };
        arm.write(targets);
        arm.put_left_arm(targets, self.phases.now() != Phase::Done);
        let is_opening = matches!(self.phases.now(), Phase::Open | Phase::Retreat | Phase::Leave | Phase::Done);
        let loosens = *self.loosens.get_or_insert_with(|| {
            let felt = params.hold.as_ref().map_or(f64::INFINITY, |hold| hold.felt);
            seen.touch.fingers.iter().any(|force| *force > felt) && arm.is_at_limit(&self.grip, targets)
        });
        if is_opening || loosens && params.hold.as_ref().is_some_and(|hold| seen.time < hold.settle) {
            let torque = params.hold.as_ref().map(|hold| hold.torque);
            self.fingers.iter_mut().for_each(|finger| finger.torque = torque);
            arm.write_fingers(&self.grip, &self.fingers, targets);
        }
        if self.phases.enter(next, seen.time) {
            self.held_since = None;
        }
        Ok(self.leaving.as_ref().unwrap_or(&self.taking).command())
    }

    fn take_up(&mut self, seen: &Seen, arm: &mut Arm) -> Result<Option<BodyCommand>, PolicyError> {
        let plug = Plug::measure(&seen.socket, &seen.fresh_bulb);
        let closure = arm.closure(&self.grip);
        let closed = closure.iter().sum::<f64>() / closure.len() as f64;
        let hand = arm.sensed_hand();
        let is_near = hand.inv_mul(&seen.fresh_bulb).translation.vector.norm() < HAND_M;
        let align = &self.params.align;
        let is_before = plug.gap < align.before + HAND_M / 10.0 && plug.aside.norm() < align.stray;
        let command = arm.stands_by(&seen.pelvis);
        let is_on_way = !seen.seated[1] && (!is_before || closed < HOLDS);
        if is_on_way && !leans(&command) {
            return Ok(None);
        }
        arm.rest_where_it_is();
        self.taking.stays(command);
        self.hand_from_plug = hand.inv_mul(&(seen.fresh_bulb * Translation3::new(0.0, 0.0, CAP)));
        (self.gap, self.deepest) = (plug.gap, (plug.gap, seen.time));
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
            self.empties(seen, arm)?;
            if is_near { self.backs_off(seen, arm, &plug)? } else { Phase::Leave }
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
        match (self.phases.now(), &self.leaving) {
            (Phase::Take, _) => self.taking.stage(),
            (Phase::Leave, Some(leaving)) => format!("Leave{}", leaving.stage()),
            _ => self.phases.name(),
        }
    }
}
