//! S08: takes the fresh bulb from the bench.
//!
//! The robot raises its right hand, steps up to the bench, brings the open hand beside the glass, moves it sideways around the
//! glass, closes the fingers and then the thumb, and lifts. If the bulb does not follow, it opens the hand and tries again. A bulb
//! that lies on its side is taken from above, with the palm down.

mod moves;
mod params;

use fiatlux_client::PolicyError;
use fiatlux_kinematics::Search;
use fiatlux_proto::v3::SessionInfo;
use fiatlux_room::bench;
use fiatlux_skills::grip::{FINGERS, Finger, Grip};
use fiatlux_skills::phases::{Phases, Skill};
use fiatlux_skills::{Steps, heading, steps_to};
use fiatlux_wbc::{ARMS, BodyCommand, CONTROL_DT};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use super::arm::Arm;
use super::parameters::parameters;
use super::plan::{ArmAngles, SLICE};
use super::side::Side;
use super::skill::{CAP, Expert, GLASS, Seen};
use params::{Lying, Motion, Params, Turns};

/// Error of a posture that reaches, m.
const REACHED: f64 = 0.003;
/// Distance at which the hand has arrived, m, and angle at which the arm has reached a posture, rad.
const ARRIVED: f64 = 0.002;
const TURNED: f64 = 0.01;
/// Least and largest size of a bulb that is believed: the published range is 0.9 to 1.1.
const SIZES: [f64; 2] = [0.85, 1.15];
/// Distances of the glass from its place in the hand up to which the hand holds it, or is around it, and up to which it is so near that
/// it must not be moved in another way, m; how far a bulb has risen that is held, m; and closure of a hand that closes.
const HOLDS_M: f64 = 0.06;
const AROUND_M: f64 = 0.025;
const NEAR_M: f64 = 0.22;
const RISEN_M: f64 = 0.015;
const CLOSES: f64 = 0.15;
/// Cosine of the tilt at which a bulb still stands.
const UPRIGHT: f64 = 0.9;
/// The same at which it lies, or will. Between the two it may be on its way, or tilted in the hand.
const LIES: f64 = 0.5;

/// So many loose grips are tried again.
const MAX_LOOSE: u32 = 3;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Phase {
    /// Steps back where the hand, as it comes up, would catch on the bench's edge. Ends where it is clear.
    StepBack,
    /// Brings the hand up where it will be clear of bench and bulb. Ends in the posture.
    Raise,
    /// Steps until the bulb is at its place before the pelvis.
    StepUp,
    /// Waits until the robot stands, and chooses from where the hand comes.
    Settle,
    /// Brings the open hand beside the glass. Ends where the hand is felt to be there.
    PreGrasp,
    /// Moves it around the glass. Ends likewise; or the hand retreats.
    Approach,
    /// Closes the thumb and then the fingers, by time. A finger that feels the bulb presses no harder than it must. Where the thumb presses
    /// less than it could, it meets the glass askew: the hand opens.
    Close,
    /// Lifts. Ends where the bulb has risen with the hand, or has not.
    Lift,
    /// Holds the bulb where it is.
    Hold,
    /// Opens the hand, by time.
    Open,
    /// Takes the hand aside, and tries again.
    Retreat,
}

/// State of an episode.
pub(super) struct Grab {
    params: Params,
    phases: Phases<Phase>,
    /// The bulb's size, as a factor of the published one.
    size: f64,
    /// Height of the bulb before it was lifted, m.
    bulb_height: f64,
    /// Goal of the hand in the phase.
    goal: Isometry3<f64>,
    /// Posture in which the arm waits until the robot stands, then the one before the grasp; none before it is found.
    posture: Option<[f64; ARMS / 2]>,
    /// The arm still turns to that posture.
    turning: bool,
    /// Turn of the fingers from straight ahead, to the left, rad.
    turn: f64,
    /// The grasp of a bulb that lies: the hand's turn as for one that stands, its roll about the fingers from palm down, and how far
    /// the fingers point down, rad; none where it stands.
    from_above: Option<[f64; 3]>,
    /// Where the robot looked first, rad, and keeps looking.
    heading: f64,
    fingers: [Finger; FINGERS.len()],
    /// Number of grips that were too loose to lift with.
    loose: u32,
    /// The hand around a bulb that stands, and around one that lies.
    grip: Grip,
    lying_grip: Grip,
    /// Chooses how the hand comes to the bulb.
    search: Option<Search<Result<Option<Choice>, PolicyError>>>,
}

/// A way of the hand to the bulb.
#[derive(Debug, Clone, Copy)]
struct Choice {
    turn: f64,
    from_above: Option<[f64; 3]>,
    /// Posture before the grasp.
    posture: ArmAngles,
}

impl Grab {
    /// With parameters of the form of `grab.toml`; without, those for the robot.
    pub fn new(given: Option<&str>, info: &SessionInfo) -> Result<Self, PolicyError> {
        let params = parameters(given, "grab", Side::Right, info, |params: &mut Params| {
            let lying = params.lying.as_mut().map(|lying| &mut lying.grip);
            [&mut params.close.grip].into_iter().chain(lying).collect()
        })?;
        let grip = |closed| Grip::new(&info.joints, &params.close.open, closed);
        Ok(Self {
            phases: Phases::new(Phase::Raise, 0.0),
            size: 1.0,
            bulb_height: 0.0,
            goal: Isometry3::identity(),
            posture: None,
            turning: false,
            turn: params.grasp.turn,
            from_above: None,
            heading: 0.0,
            fingers: Default::default(),
            loose: 0,
            grip: grip(&params.close.grip),
            lying_grip: params.lying.as_ref().map(|lying| grip(&lying.grip)).unwrap_or_default(),
            search: None,
            params,
        })
    }

    /// Size of a bulb that stands on the bench: its origin is below its cap, the farther the larger it is.
    fn size_of(&self, bulb: &Isometry3<f64>) -> f64 {
        let size = (bench::SURFACE_HEIGHT - bulb.translation.z) / CAP;
        if is_upright(bulb) { size.clamp(SIZES[0], SIZES[1]) } else { 1.0 }
    }

    /// Of the pelvis: as low above the glass of a small bulb as above that of a published one. Higher, the knees would be straight.
    fn height(&self) -> f64 {
        self.params.stand.height + (self.size.min(1.0) - 1.0) * (GLASS - CAP)
    }

    /// Centre of the glass.
    fn glass(&self, seen: &Seen) -> Point3<f64> {
        seen.fresh_bulb * Point3::new(0.0, 0.0, GLASS * self.size)
    }

    /// The hand around the glass of a bulb that lies.
    fn world_from_palm_down(&self, seen: &Seen, lying: &Lying, [turn, roll, pitch]: [f64; 3]) -> Isometry3<f64> {
        let palm_down = UnitQuaternion::from_basis_unchecked(&[Vector3::z(), -Vector3::x(), -Vector3::y()]);
        let turned = UnitQuaternion::from_euler_angles(roll, pitch, heading(&seen.pelvis) + turn) * palm_down;
        let offset = turned * Vector3::from(lying.hand_from_glass);
        Isometry3::from_parts((self.glass(seen) - offset).into(), turned)
    }

    /// The hand around the bulb, its fingers pointing where the robot looks.
    fn world_from_grasp(&self, seen: &Seen) -> Isometry3<f64> {
        let grasp = &self.params.grasp;
        if let (Some(angles), Some(lying)) = (self.from_above, &self.params.lying) {
            return self.world_from_palm_down(seen, lying, angles);
        }
        let glass = self.glass(seen);
        let turn = heading(&seen.pelvis) + self.turn - std::f64::consts::FRAC_PI_2;
        let world_from_glass = Isometry3::new(glass.coords, Vector3::z() * turn);
        let [about_x, about_y] = grasp.tilt;
        let hand_from_glass = Isometry3::from_parts(
            Translation3::from(Vector3::from(grasp.hand_from_glass) + (self.size - 1.0) * Vector3::from(grasp.growth)),
            UnitQuaternion::from_euler_angles(std::f64::consts::PI + about_x, about_y, 0.0),
        );
        world_from_glass * hand_from_glass.inverse()
    }

    /// The same once the bulb is at a place before the pelvis, for a robot that has not moved yet.
    fn grasp_from(&self, seen: &Seen, [ahead, left]: [f64; 2]) -> Isometry3<f64> {
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading(&seen.pelvis));
        let there = seen.pelvis.translation.vector + turned * Vector3::new(ahead, left, 0.0);
        let mut grasp = self.world_from_grasp(seen);
        let change = there - seen.fresh_bulb.translation.vector;
        grasp.translation.vector += Vector3::new(change.x, change.y, seen.pelvis.translation.z - self.height());
        grasp
    }

    /// Begins to choose how the hand comes to the bulb.
    fn ask(&mut self, seen: &Seen, arm: &Arm) {
        let params = self.params.clone();
        let (phases, grip, lying_grip) = (self.phases.clone(), Grip::default(), Grip::default());
        let mut grab = Self { params, phases, grip, lying_grip, search: None, ..*self };
        let (seen, arm) = (seen.clone(), arm.clone());
        self.search = Some(Search::new(move |work| {
            let mut arm = arm.searching(work);
            async move {
                let is_found = match lies(&seen.fresh_bulb) {
                    true => grab.choose_from_above(&seen, &mut arm).await?,
                    false => grab.choose(&seen, &mut arm).await?,
                };
                let Self { turn, from_above, posture, .. } = grab;
                Ok(posture.filter(|_| is_found).map(|posture| Choice { turn, from_above, posture }))
            }
        }));
    }

    /// Goes on to choose; where that has ended, the next phase.
    fn choose_on(&mut self, seen: &Seen) -> Result<Option<Phase>, PolicyError> {
        let Some(found) = self.search.as_mut().and_then(|search| search.go_on(SLICE)) else { return Ok(None) };
        self.search = None;
        let lies = lies(&seen.fresh_bulb);
        // Meanwhile it may have fallen over.
        let Some(choice) = found?.filter(|choice| choice.from_above.is_some() == lies) else {
            (self.turn, self.from_above) = (self.params.grasp.turn, None);
            return Ok(Some(Phase::StepUp));
        };
        (self.turn, self.from_above) = (choice.turn, choice.from_above);
        (self.posture, self.turning) = (Some(choice.posture), true);
        Ok(Some(Phase::PreGrasp))
    }

    /// Chooses the turn of the fingers at which the arm has the most room, and the posture before the grasp; false where it cannot
    /// reach.
    async fn choose(&mut self, seen: &Seen, arm: &mut Arm) -> Result<bool, PolicyError> {
        let back_off = Translation3::from(self.params.motion.pre_grasp);
        let mut best: Option<(f64, f64)> = None;
        let Turns { first, last, count } = self.params.grasp.turns;
        for step in 0..count {
            self.turn = first + (last - first) * f64::from(step) / f64::from(count.max(2) - 1);
            let grasp = self.world_from_grasp(seen);
            let (at, before) = (arm.posture(&grasp).await?, arm.posture(&(grasp * back_off)).await?);
            let margin = at.margin.min(before.margin);
            if at.error.max(before.error) < REACHED && best.is_none_or(|(_, most)| margin > most) {
                best = Some((self.turn, margin));
                (self.posture, self.turning) = (Some(before.angles), true);
            }
        }
        self.turn = best.map_or(self.params.grasp.turn, |(turn, _)| turn);
        Ok(best.is_some())
    }

    /// The same for a bulb that lies: chooses how the hand comes from above, by the room that the arm has and by where the neck is.
    async fn choose_from_above(&mut self, seen: &Seen, arm: &mut Arm) -> Result<bool, PolicyError> {
        let Some(lying) = self.params.lying.clone() else { return Ok(false) };
        let neck = seen.fresh_bulb.rotation * -Vector3::z();
        let mut most = f64::NEG_INFINITY;
        self.from_above = None;
        let from = lying.rolls.iter().flat_map(|&roll| lying.pitches.iter().map(move |&pitch| [roll, pitch]));
        let from: Vec<[f64; 2]> = from.collect();
        for [roll, pitch] in from {
            for &turn in &lying.turns {
                let grasp = self.world_from_palm_down(seen, &lying, [turn, roll, pitch]);
                let off = (grasp.rotation.inverse() * neck).angle(&Vector3::from(lying.neck));
                let (at, before) = (arm.posture(&grasp).await?, arm.posture(&above(&grasp, lying.above)).await?);
                let margin = at.margin.min(before.margin);
                let score = margin.min(lying.margin) - lying.neck_weight * off;
                if at.error.max(before.error) < REACHED && margin > lying.least_margin && score > most {
                    most = score;
                    self.from_above = Some([turn, roll, pitch]);
                    (self.posture, self.turning) = (Some(before.angles), true);
                }
            }
        }
        Ok(self.from_above.is_some())
    }

    /// Distance of the bulb from the pelvis on the level, m.
    fn away(&self, seen: &Seen) -> f64 {
        (seen.fresh_bulb.translation.vector - seen.pelvis.translation.vector).xy().norm()
    }

    /// Steps that bring the bulb to its place before the robot.
    fn step_up(&self, seen: &Seen) -> Steps {
        let stand = &self.params.stand;
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading(&seen.pelvis));
        let bulb = if lies(&seen.fresh_bulb) { self.glass(seen).coords } else { seen.fresh_bulb.translation.vector };
        let place = bulb - turned * Vector3::new(stand.ahead, stand.left, 0.0);
        steps_to(&seen.pelvis, &place.xy(), self.heading, stand.speed)
    }
}

/// A pose so far above another one, m.
fn above(pose: &Isometry3<f64>, height: f64) -> Isometry3<f64> {
    Translation3::new(0.0, 0.0, height) * pose
}

fn lies(bulb: &Isometry3<f64>) -> bool {
    (bulb.rotation * Vector3::z()).z < LIES
}

fn is_upright(bulb: &Isometry3<f64>) -> bool {
    (bulb.rotation * Vector3::z()).z > UPRIGHT
}

/// The next phase once the hand is where it should be, or back if it does not get there.
fn arrival(left: f64, elapsed: f64, distance: f64, motion: &Motion, next: Phase) -> Option<Phase> {
    if left < ARRIVED && distance < motion.error {
        Some(next)
    } else {
        (elapsed > motion.patience).then_some(Phase::Retreat)
    }
}

impl Expert for Grab {
    fn step(&mut self, seen: &Seen, arm: &mut Arm, targets: &mut [f64]) -> Result<BodyCommand, PolicyError> {
        let params = self.params.clone();
        let (motion, close) = (&params.motion, &params.close);
        let mut command = BodyCommand { height: self.height(), ..BodyCommand::default() };
        let elapsed = self.phases.elapsed(seen.time);
        let back_off = Translation3::from(motion.pre_grasp);
        let closing = CONTROL_DT / close.time;
        let closed = 1.0 + close.excess * (1.0 - self.size);
        let lies = lies(&seen.fresh_bulb);
        // It was to be taken standing.
        let has_fallen = lies && self.from_above.is_none() && params.lying.is_some();
        let next = match self.phases.now() {
            Phase::StepBack => {
                (command.velocity, command.height) = ([-params.stand.speed, 0.0, 0.0], params.stand.walk_height);
                (self.away(seen) > params.stand.clear).then_some(Phase::Raise)
            }
            Phase::Raise if self.posture.is_none() && self.away(seen) < params.stand.close => Some(Phase::StepBack),
            Phase::Raise => self.raise(&params, seen, arm)?,
            Phase::StepUp => {
                let Steps { velocity, distance } = self.step_up(seen);
                (command.velocity, command.height) = (velocity, params.stand.walk_height);
                // Where a bulb lies far from the edge, the bench is in the way.
                (distance < params.stand.tolerance || lies && elapsed > params.stand.patience).then_some(Phase::Settle)
            }
            Phase::Settle if self.search.is_some() => self.choose_on(seen)?,
            Phase::Settle if elapsed > params.stand.settle && seen.stands && lies && params.lying.is_some() => {
                self.ask(seen, arm);
                None
            }
            Phase::Settle if elapsed > params.stand.settle && seen.stands && is_upright(&seen.fresh_bulb) => {
                self.from_above = None;
                let is_near = self.step_up(seen).distance < 2.0 * params.stand.tolerance;
                if is_near {
                    self.ask(seen, arm);
                }
                (!is_near).then_some(Phase::StepUp)
            }
            Phase::Settle => {
                let is_over = elapsed > params.stand.patience && is_upright(&seen.fresh_bulb);
                is_over.then_some(Phase::StepUp)
            }
            Phase::PreGrasp | Phase::Approach | Phase::Close if has_fallen => Some(Phase::Open),
            Phase::PreGrasp => self.pre_grasp(&params, seen, arm)?,
            Phase::Approach => {
                let goal = self.goal;
                let left = arm.move_to(false, &goal, motion.approach_speed)?;
                arrival(left, elapsed, arm.distance_to(&goal), motion, Phase::Close)
            }
            Phase::Close => self.close(&params, seen, arm)?,
            Phase::Lift | Phase::Hold => {
                let goal = self.goal;
                let left = arm.move_to(false, &goal, motion.lift_speed)?;
                let risen = self.glass(seen).z - self.bulb_height;
                let next = if risen > close.risen { Phase::Hold } else { Phase::Open };
                (left < ARRIVED && elapsed > close.verify && next != self.phases.now()).then_some(next)
            }
            Phase::Open => {
                // Their torques stay bounded until they are open, or they would press on at first.
                self.fingers.iter_mut().for_each(|finger| finger.share -= closing);
                self.fingers.iter().all(|finger| finger.share <= 0.0).then(|| {
                    self.fingers = Default::default();
                    Phase::Retreat
                })
            }
            Phase::Retreat => {
                let goal = if lies { above(&self.goal, motion.lift) } else { self.goal * back_off };
                (arm.move_to(false, &goal, motion.speed)? < ARRIVED || elapsed > motion.patience)
                    .then_some(Phase::Settle)
            }
        };
        arm.write(targets);
        self.fingers.iter_mut().for_each(|finger| finger.share = finger.share.clamp(0.0, closed));
        let grip = match (self.from_above, &params.lying) {
            (Some(_), Some(_)) => &self.lying_grip,
            _ => &self.grip,
        };
        arm.write_fingers(grip, &self.fingers, targets);
        self.phases.enter(next, seen.time);
        Ok(command)
    }

    fn take_up(&mut self, seen: &Seen, arm: &mut Arm) -> Result<Option<BodyCommand>, PolicyError> {
        let hand = arm.sensed_hand();
        let at = hand.inverse() * self.glass(seen);
        let off = (at - Point3::from(self.params.grasp.hand_from_glass)).norm();
        let closure = arm.closure(&self.grip);
        let closed = closure.iter().sum::<f64>() / closure.len() as f64;
        let stands_at = bench::SURFACE_HEIGHT + GLASS - CAP;
        let risen = self.glass(seen).z - stands_at;
        if risen < -GLASS {
            let reason = "the bulb is no longer on the bench; begin with it there".into();
            return Err(PolicyError::Unfit { policy: "hands", reason });
        }
        if off > NEAR_M {
            return Ok(None);
        }
        arm.rest_where_it_is();
        self.heading = heading(&seen.pelvis);
        self.fingers.iter_mut().zip(closure).for_each(|(finger, share)| finger.share = share);
        let is_held = off < HOLDS_M && closed > CLOSES && risen > RISEN_M;
        if !is_held {
            self.size = self.size_of(&seen.fresh_bulb);
        }
        self.goal = hand;
        let phase = if is_held {
            self.bulb_height = stands_at;
            self.goal.translation.vector.z += (self.params.motion.lift - risen).max(0.0);
            self.fingers
                .iter_mut()
                .for_each(|finger| *finger = Finger { share: 1.0, torque: Some(self.params.close.torque) });
            Phase::Lift
        } else if off < AROUND_M && !lies(&seen.fresh_bulb) {
            Phase::Close
        } else if closed > CLOSES {
            Phase::Open
        } else {
            Phase::Retreat
        };
        self.phases = Phases::new(phase, seen.time);
        Ok(Some(BodyCommand { height: seen.pelvis.translation.z, ..BodyCommand::default() }))
    }

    fn rest(&self) -> [f64; ARMS / 2] {
        self.params.motion.rest
    }
}

impl Skill for Grab {
    fn is_over(&self) -> bool {
        self.phases.now() == Phase::Hold
    }

    fn phase(&self) -> String {
        self.phases.name()
    }
}
