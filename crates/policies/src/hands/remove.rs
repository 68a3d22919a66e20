//! S03: takes the spent bulb out of the socket, and keeps it.
//!
//! The robot leans so that its right arm reaches the glass and can pull, brings the open hand beside it, moves it around the glass,
//! closes the thumb and the fingers, and pulls along the socket's axis. If the bulb stays, it opens the hand and tries again. Then it
//! stands up.

mod ways;

use fiatlux_client::PolicyError;
use fiatlux_proto::v3::SessionInfo;
use fiatlux_skills::grip::{Angles, FINGERS, Finger, Grip, Touch};
use fiatlux_skills::phases::{Phases, Skill};
use fiatlux_wbc::{BodyCommand, CONTROL_DT};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;

use super::arm::{Arm, MakesArm};
use super::judge::Standing;
use super::lean::{Lean, leans};
use super::parameters::parameters;
use super::plan::ArmAngles;
use super::retries::Manner;
use super::room;
use super::side::Side;
use super::skill::{Expert, Seen, TOUCHED};
use super::socket::Plug;
use super::stance::{REST, Taking};
use ways::{Grasp, Ways, glass};

/// Distance at which the hand has arrived, m.
const ARRIVED: f64 = 0.002;

/// So often the hand does not get beside the glass or around it before another stance is looked for.
const MAX_MISSED: u32 = 3;

/// Distances of the glass from its place in the hand up to which the hand is around it, and up to which it is so near that it must not be
/// moved in another way, m; and closure of a hand that closes.
const AROUND_M: f64 = 0.02;
const NEAR_M: f64 = 0.12;
const CLOSES: f64 = 0.15;

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Params {
    lean: Lean,
    grasp: Grasp,
    close: Close,
    pull: Pull,
    leave: Leaving,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Close {
    thumb_delay: f64,
    finger_delay: f64,
    time: f64,
    touch: f64,
    torque: f64,
    hold: f64,
    lead: f64,
    bears: Option<Bears>,
    open: Angles,
    #[serde(default)]
    grip: Angles,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Bears {
    fingers: Vec<String>,
    force: f64,
    tries: u32,
}

impl Bears {
    /// Each of these fingers is felt: those of a hand that closed on the fixture are not.
    fn is_felt(&self, touch: &Touch) -> bool {
        let is_named = |finger: &str| self.fingers.iter().any(|name| name == finger);
        FINGERS.iter().zip(touch.fingers).all(|(finger, force)| !is_named(finger) || force > self.force)
    }
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Pull {
    speed: f64,
    lead: f64,
    out: f64,
    stays: f64,
    patience: f64,
    hold: f64,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Leaving {
    arm: ArmAngles,
    torque: f64,
    patience: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Phase {
    /// Leans and brings the open hand beside the glass.
    Take,
    /// Waits until the hand is felt to be there. Where it does not get there, it goes back, and the third time another stance is looked for.
    PreGrasp,
    /// Moves it around the glass. Ends where it is felt to be there; else it goes back, and the third time another stance is looked for.
    Approach,
    /// Closes the thumb and the fingers, by time. A finger that feels the bulb presses no harder than it must. A grip that would not bear
    /// the bulb is opened again.
    Close,
    /// Pulls along the axis. Ends where the bulb is out; where it stays behind, the hand opens.
    Pull,
    /// Keeps the bulb where it is, by time.
    Hold,
    /// Stands up with it, on a way that strikes nothing.
    Leave,
    /// Keeps it there.
    Done,
    /// Opens the hand, by time.
    Open,
    /// Takes it back from the glass, and tries again.
    Retreat,
}

/// State of an episode.
pub(super) struct Remove {
    params: Params,
    phases: Phases<Phase>,
    taking: Taking,
    /// The way back from the socket.
    leaving: Option<Taking>,
    /// Makes the arm for that: the bulb is then in the hand.
    carrying: Option<MakesArm>,
    glass_from_hand: Isometry3<f64>,
    /// The hand's target is at the end of its way.
    has_arrived: bool,
    fingers: [Finger; FINGERS.len()],
    grip: Grip,
    /// Number of grips that would not bear the bulb, and of times that the hand did not get beside the glass or around it.
    loose: u32,
    missed: u32,
    /// It takes another stance once the hand is back.
    gives_up: bool,
}

impl Remove {
    /// With parameters of the form of `remove.toml`; without, those for the robot. `carrying` makes the arm that has the bulb in its hand.
    pub fn new(given: Option<&str>, info: &SessionInfo, carrying: MakesArm) -> Result<Self, PolicyError> {
        let params =
            parameters(given, "remove", Side::Right, info, |params: &mut Params| vec![&mut params.close.grip])?;
        if params.grasp.tilts.is_empty() {
            let reason = "grasp.tilts is empty; name one at least".into();
            return Err(PolicyError::Unfit { policy: "hands", reason });
        }
        let named = params.close.bears.iter().flat_map(|bears| &bears.fingers);
        if let Some(unknown) = named.into_iter().find(|name| !FINGERS.contains(&name.as_str())) {
            let reason = format!("close.bears: there is no finger {unknown}; name some of {}", FINGERS.join(", "));
            return Err(PolicyError::Unfit { policy: "hands", reason });
        }
        Ok(Self {
            phases: Phases::new(Phase::Take, 0.0),
            taking: Taking::new(params.lean.clone(), Manner::EMPTY),
            leaving: None,
            carrying: Some(carrying),
            glass_from_hand: Isometry3::identity(),
            has_arrived: false,
            fingers: Default::default(),
            grip: Grip::new(&info.joints, &params.close.open, &params.close.grip),
            loose: 0,
            missed: 0,
            gives_up: false,
            params,
        })
    }

    /// Leans and brings the hand beside the glass; true where it is there.
    fn take(&mut self, seen: &Seen, arm: &mut Arm) -> Result<bool, PolicyError> {
        let Params { grasp, pull, .. } = &self.params;
        let ways = || Ways { seen: seen.clone(), grasp: grasp.clone(), out: pull.out };
        let is_there = self.taking.step(seen, arm, ways)?;
        if is_there && let Some(stance) = self.taking.stance() {
            self.glass_from_hand = glass(seen).inv_mul(&stance.world_from_hand);
        }
        Ok(is_there)
    }

    /// Where the hand is beside the glass.
    fn beside(&self, seen: &Seen) -> Isometry3<f64> {
        glass(seen) * self.glass_from_hand * Translation3::from(self.params.grasp.back)
    }

    /// Counts that the hand missed the glass; true every few times, when another stance is due.
    fn misses_often(&mut self) -> bool {
        self.missed += 1;
        self.missed.is_multiple_of(MAX_MISSED)
    }

    /// Brings the open hand beside the glass, and around it.
    fn approach(&mut self, params: &Params, seen: &Seen, arm: &mut Arm) -> Result<Option<Phase>, PolicyError> {
        let (grasp, elapsed) = (&params.grasp, self.phases.elapsed(seen.time));
        let is_near = self.phases.now() == Phase::Approach;
        let (goal, next) = match is_near {
            true => (glass(seen) * self.glass_from_hand, Phase::Close),
            false => (self.beside(seen), Phase::Approach),
        };
        if self.has_arrived {
            let off = goal * arm.sensed_hand().inverse();
            arm.nudge(true, &share_of(&off, grasp.gain), Isometry3::identity(), None, grasp.lead)?;
        } else {
            self.has_arrived = arm.move_to(true, &goal, grasp.speed)? < ARRIVED;
        }
        let off = arm.distance_to(&goal);
        let strays = is_near && self.has_arrived && off > grasp.stray;
        Ok(if !is_near && seen.is_touched() {
            if self.misses_often() {
                self.taking.another();
            } else {
                self.taking.goes_back();
            }
            Some(Phase::Take)
        } else if strays {
            // The robot sways, or the hand has caught on something: it would sweep the bulb out, or the robot falls.
            self.gives_up = self.misses_often();
            Some(Phase::Retreat)
        } else if is_near && self.has_arrived && seen.touch.palm > TOUCHED {
            // The glass is at the palm.
            Some(Phase::Close)
        } else if self.has_arrived && off < grasp.error && (is_near || arm.lag() < grasp.stray / 2.0) {
            // Not before it has caught up: else it would be a way behind as it sets out.
            Some(next)
        } else if elapsed > grasp.patience {
            let gives_up = !is_near && self.misses_often();
            if gives_up {
                self.taking.another();
            }
            Some(if gives_up { Phase::Take } else { Phase::Retreat })
        } else {
            None
        })
    }
}

/// A share of a change of poses in the world, about the world's origin.
fn share_of(change: &Isometry3<f64>, share: f64) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(share * change.rotation.scaled_axis());
    Isometry3::from_parts(Translation3::from(share * change.translation.vector), turn)
}

impl Expert for Remove {
    fn step(&mut self, seen: &Seen, arm: &mut Arm, targets: &mut [f64]) -> Result<BodyCommand, PolicyError> {
        let params = self.params.clone();
        let (grasp, close, pull) = (&params.grasp, &params.close, &params.pull);
        let elapsed = self.phases.elapsed(seen.time);
        let closing = CONTROL_DT / close.time;
        let plug = Plug::measure(&seen.socket, &seen.old_bulb);
        let hand_from_glass = self.glass_from_hand.inverse();
        let next = match self.phases.now() {
            Phase::Take => self.take(seen, arm)?.then_some(Phase::PreGrasp),
            Phase::PreGrasp | Phase::Approach => self.approach(&params, seen, arm)?,
            Phase::Close => {
                arm.nudge(true, &Isometry3::identity(), hand_from_glass, Some(plug.axis), close.lead)?;
                for (index, (finger, force)) in self.fingers.iter_mut().zip(seen.touch.fingers).enumerate() {
                    let delay = if index == 0 { close.thumb_delay } else { close.finger_delay };
                    finger.share += if elapsed > delay { closing } else { 0.0 };
                    finger.torque = finger.torque.or((force > close.touch).then_some(close.torque));
                }
                (elapsed > close.time + close.thumb_delay.max(close.finger_delay) + close.hold).then(|| {
                    let is_loose =
                        |bears: &Bears| seen.seated[0] && self.loose < bears.tries && !bears.is_felt(&seen.touch);
                    if close.bears.as_ref().is_some_and(is_loose) {
                        self.loose += 1;
                        return Phase::Open;
                    }
                    Phase::Pull
                })
            }
            Phase::Pull => {
                let step = Translation3::from(plug.axis.scale(pull.speed * CONTROL_DT));
                arm.nudge(true, &Isometry3::from(step), hand_from_glass, Some(plug.axis), pull.lead)?;
                let pulled = pull.speed * elapsed;
                if plug.gap > pull.out {
                    Some(Phase::Hold)
                } else {
                    let stays = pulled > plug.gap + pull.stays || elapsed > pull.patience;
                    (stays && seen.seated[0]).then_some(Phase::Open)
                }
            }
            Phase::Hold => {
                arm.nudge(true, &Isometry3::identity(), hand_from_glass, Some(plug.axis), pull.lead)?;
                if elapsed > pull.hold
                    && let Some(carrying) = self.carrying.take()
                {
                    let hand_from_bulb = arm.sensed_hand().inv_mul(&seen.old_bulb);
                    *arm = carrying(room::with_bulb_in_hand(seen, hand_from_bulb))?.going_on_from(arm);
                    Some(Phase::Leave)
                } else {
                    None
                }
            }
            Phase::Leave => {
                let leaving = self.leaving.get_or_insert_with(|| self.taking.back(Manner::CARRYING_BACK));
                self.fingers.iter_mut().for_each(|finger| finger.torque = Some(params.leave.torque));
                let is_up = leaving.step(seen, arm, || Standing(params.leave.arm))?;
                (is_up || elapsed > params.leave.patience).then_some(Phase::Done)
            }
            Phase::Done => None,
            Phase::Open => {
                // Bounded, since those that closed less than they were to would press on at first.
                self.fingers.iter_mut().for_each(|finger| {
                    *finger = Finger { share: finger.share - closing, torque: Some(close.torque) };
                });
                (elapsed > close.time).then_some(Phase::Retreat)
            }
            Phase::Retreat => {
                let left = arm.move_to(true, &self.beside(seen), grasp.speed)?;
                (left < ARRIVED || elapsed > grasp.patience).then(|| {
                    self.fingers = Default::default();
                    if std::mem::take(&mut self.gives_up) {
                        self.taking.another();
                    } else {
                        self.taking.again();
                    }
                    Phase::Take
                })
            }
        };
        self.fingers.iter_mut().for_each(|finger| finger.share = finger.share.clamp(0.0, 1.0));
        arm.write(targets);
        arm.put_left_arm(targets, true);
        arm.write_fingers(&self.grip, &self.fingers, targets);
        if self.phases.enter(next, seen.time) {
            self.has_arrived = false;
        }
        Ok(self.leaving.as_ref().unwrap_or(&self.taking).command())
    }

    fn take_up(&mut self, seen: &Seen, arm: &mut Arm) -> Result<Option<BodyCommand>, PolicyError> {
        let closure = arm.closure(&self.grip);
        let closed = closure.iter().sum::<f64>() / closure.len() as f64;
        let hand = arm.sensed_hand();
        let at = (hand.inverse() * glass(seen)).translation.vector;
        let off = (at - Vector3::from(self.params.grasp.hand_from_glass)).norm();
        let command = arm.stands_by(&seen.pelvis);
        if off > NEAR_M && !seen.seated[0] {
            let reason = "the bulb is neither in the socket nor in the hand; begin with it in the socket".into();
            return Err(PolicyError::Unfit { policy: "hands", reason });
        }
        // At the start the hand may be near the glass as well; the robot then neither leans nor holds anything.
        if seen.seated[0] && !leans(&command) && closed < CLOSES {
            return Ok(None);
        }
        if off > NEAR_M {
            arm.rest_where_it_is();
            self.taking.stays(command);
            return Ok(Some(command));
        }
        arm.rest_where_it_is();
        self.taking.stays(command);
        self.glass_from_hand = glass(seen).inv_mul(&hand);
        let torque = Some(self.params.close.torque);
        self.fingers.iter_mut().zip(closure).for_each(|(finger, share)| *finger = Finger { share, torque: None });
        let phase = match (seen.seated[0], off < AROUND_M) {
            (false, _) => {
                self.fingers = [Finger { share: 1.0, torque }; FINGERS.len()];
                let plug = Plug::measure(&seen.socket, &seen.old_bulb);
                if plug.gap > self.params.pull.out { Phase::Hold } else { Phase::Pull }
            }
            (true, true) => Phase::Close,
            (true, false) if closed > CLOSES => Phase::Open,
            (true, false) => Phase::Retreat,
        };
        self.phases = Phases::new(phase, seen.time);
        Ok(Some(command))
    }

    fn rest(&self) -> ArmAngles {
        REST
    }
}

impl Skill for Remove {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grip_is_loose_where_a_finger_that_bears_feels_nothing() {
        let bears = Bears { fingers: ["thumb", "ring"].map(str::to_owned).into(), force: 0.7, tries: 3 };
        let touch = |fingers: [f64; FINGERS.len()]| Touch { fingers, palm: 0.0 };
        assert!(bears.is_felt(&touch([8.0, 0.0, 0.0, 2.0, 0.0])));
        assert!(!bears.is_felt(&touch([8.0, 4.0, 5.0, 0.0, 0.0])), "as a thumb at the fixture leaves them");
        assert!(!bears.is_felt(&touch([0.0, 4.0, 5.0, 2.0, 0.0])));
    }
}
