//! Where the robot leans and the arm goes before the hand does something at the socket.
//!
//! The lean is searched: height, roll, pitch and yaw, by how well the arm reaches what follows. Then the arm goes to where nothing
//! is in its way while the robot leans, the robot leans, and the arm goes on to the first posture of what follows.

use fiatlux_client::PolicyError;
use fiatlux_wbc::{BodyCommand, CONTROL_DT};
use nalgebra::Isometry3;
use serde::Deserialize;

use super::arm::{Apart, RightArm, ToolGoal};
use super::plan::ArmAngles;
use super::skill::Seen;

/// Where the arm's joints rest while a stance is searched, rad.
pub(super) const REST: ArmAngles = [-0.8, -1.2, 0.0, 0.0, 0.5, 0.6, 0.5];
/// Shares of the margin with which a way is looked for, one after the other.
const MARGINS: [f64; 3] = [1.0, 0.3, 0.0];
/// So often the arm is held up on its way before another stance is looked for.
const MAX_BLOCKS: u32 = 2;
/// So often the time until the next look for a way doubles, where there was none or the arm was held up. It bounds what a search
/// that fails again and again takes.
const MAX_DOUBLINGS: u32 = 4;
/// So often no way is found in a stance before another one is looked for.
const MAX_LOOKS: u32 = 2;
/// Preference that a stance loses in which no way was found.
const NO_WAY: f64 = 2.0;
/// Error of a posture from which it is no use to go on, m.
const LOST: f64 = 0.012;

/// Stances that are compared: all combinations, then steps from the best.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Lean {
    heights: Vec<f64>,
    rolls: Vec<f64>,
    pitches: Vec<f64>,
    yaws: Vec<f64>,
    step: f64,
    tries: usize,
    reached: f64,
    changes: u32,
    searches: u32,
    #[serde(default)]
    bend: f64,
    settle: f64,
    clear: f64,
    margin: f64,
    rate: f64,
}

/// A stance, with the arm's postures from the one before the work to the one of the work.
#[derive(Debug, Clone)]
pub(super) struct Stance {
    pub command: BodyCommand,
    pub postures: Vec<ArmAngles>,
    /// Pose of the hand at the work.
    pub world_from_hand: Isometry3<f64>,
    /// Least room of the joints, rad.
    pub room: f64,
    /// Smallest gap to what surrounds the robot, m.
    pub gap: f64,
    /// Farthest that the hand stays from where it is wanted, m.
    pub error: f64,
}

/// Judges the arm in a stance: given the command, a posture from which it is searched, and how often it is tried.
pub(super) type Judge<'a> = dyn Fn(&mut RightArm, &BodyCommand, &ArmAngles, usize) -> Result<Stance, PolicyError> + 'a;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Stage {
    /// Brings the arm to where nothing is in its way while the robot leans.
    Clear,
    /// Leans, by time; changes the lean where the arm now does not reach.
    Lean,
    /// Brings the arm to the first posture.
    Reach,
}

/// On its way to a stance.
pub(super) struct Taking {
    lean: Lean,
    stage: Stage,
    /// As the robot stands at first.
    pub upright: BodyCommand,
    stance: Option<Stance>,
    /// The command from which the robot goes on to lean.
    before: BodyCommand,
    /// Number of times that the whole search was made.
    searches: u32,
    /// Corners of the way that are left, the last first.
    way: Vec<ArmAngles>,
    /// Where the way to the first posture began.
    reaches_from: ArmAngles,
    leans_since: f64,
    /// Part of the way that the robot has gone from `before` to the stance: 0 to 1.
    bent: f64,
    changes: u32,
    /// Number of times that the arm was held up.
    blocks: u32,
    /// Number of looks for a way that found none, and of ways on which the arm was held up.
    failures: u32,
    /// Looks in the present stance that found no way, and stances that were given up for that.
    looks: u32,
    refused: Vec<BodyCommand>,
    /// The hand holds the bulb.
    holds: bool,
}

impl Lean {
    /// Of height, roll, pitch and yaw: the smallest and the largest that are compared.
    fn range(&self, axis: usize) -> [f64; 2] {
        let values = [&self.heights, &self.rolls, &self.pitches, &self.yaws][axis];
        let low = values.iter().copied().fold(f64::INFINITY, f64::min);
        [low, values.iter().copied().fold(low, f64::max)]
    }

    fn commands(&self) -> Vec<BodyCommand> {
        let mut all = Vec::new();
        for &height in &self.heights {
            for &roll in &self.rolls {
                for &pitch in &self.pitches {
                    for &yaw in &self.yaws {
                        all.push(BodyCommand { velocity: [0.0; 3], height, torso: [roll, pitch, yaw] });
                    }
                }
            }
        }
        all
    }

    /// The stance that suits the arm best: the best of the combinations, then of its neighbours.
    fn choose(
        &self,
        arm: &mut RightArm,
        judge: &Judge<'_>,
        refused: &[BodyCommand],
    ) -> Result<Option<Stance>, PolicyError> {
        let from = arm.angles();
        let mut best: Option<(f64, Stance)> = None;
        for command in self.commands() {
            let stance = judge(arm, &command, &from, self.tries)?;
            let is_refused = refused.iter().any(|refused| self.is_near(refused, &command));
            let score = stance.score() - if is_refused { NO_WAY } else { 0.0 };
            if best.as_ref().is_none_or(|(best, _)| score > *best) {
                best = Some((score, stance));
            }
        }
        best.map(|(_, best)| self.improve(arm, best, judge)).transpose()
    }

    /// No other combination is nearer to a command.
    fn is_near(&self, command: &BodyCommand, combination: &BodyCommand) -> bool {
        let (of_command, of_combination) = (command.numbers(), combination.numbers());
        [&self.heights, &self.rolls, &self.pitches, &self.yaws].into_iter().enumerate().all(|(axis, values)| {
            let off = |value: f64| (of_command[3 + axis] - value).abs();
            values.iter().all(|value| off(of_combination[3 + axis]) <= off(*value))
        })
    }

    /// The best that is found from a stance by changes of its command, each on its own.
    fn improve(&self, arm: &mut RightArm, mut best: Stance, judge: &Judge<'_>) -> Result<Stance, PolicyError> {
        let mut step = self.step;
        while step > self.step / 4.0 {
            let mut is_better = false;
            for (axis, sign) in (0..4).flat_map(|axis| [(axis, 1.0), (axis, -1.0)]) {
                let mut numbers = best.command.numbers();
                let [low, high] = self.range(axis);
                let number = &mut numbers[3 + axis];
                *number = (*number + sign * step * (high - low)).clamp(low, high);
                let stance = judge(arm, &numbers.into(), &best.last(), 2)?;
                if stance.score() > best.score() {
                    best = stance;
                    is_better = true;
                }
            }
            if !is_better {
                step /= 2.0;
            }
        }
        Ok(best)
    }
}

impl Stance {
    /// Preference among stances: being there counts most, then room to the limits and to what is around, then a small lean.
    pub fn score(&self) -> f64 {
        let lean: f64 = self.command.torso.iter().map(|angle| angle.abs()).sum();
        let short = (self.error - 1e-3).max(0.0);
        self.room.min(0.35) + 10.0 * self.gap.min(0.02) - 50.0 * short - 0.1 * lean
    }

    /// Goes on to a goal from a posture; room, gap and error are those of the worst so far.
    pub fn go_on(&mut self, arm: &mut RightArm, goal: &ToolGoal, from: &ArmAngles) -> Result<ArmAngles, PolicyError> {
        let (angles, error) = arm.reach(goal, from, 1)?;
        self.error = self.error.max(error);
        self.room = self.room.min(arm.room(&angles));
        self.gap = self.gap.min(arm.gap(&angles, Apart::Working));
        Ok(angles)
    }

    /// Posture of the work.
    fn last(&self) -> ArmAngles {
        self.postures.last().copied().unwrap_or_default()
    }
}

/// A command on the way from one to another.
fn between(from: &BodyCommand, to: &BodyCommand, share: f64) -> BodyCommand {
    let (from, to) = (from.numbers(), to.numbers());
    std::array::from_fn(|index| from[index] + share * (to[index] - from[index])).into()
}

impl Taking {
    pub fn new(lean: Lean, holds: bool) -> Self {
        Self {
            lean,
            stage: Stage::Clear,
            upright: BodyCommand::default(),
            stance: None,
            before: BodyCommand::default(),
            searches: 0,
            way: Vec::new(),
            reaches_from: REST,
            leans_since: 0.0,
            bent: 0.0,
            changes: 0,
            blocks: 0,
            failures: 0,
            looks: 0,
            refused: Vec::new(),
            holds,
        }
    }

    /// The command in force.
    pub fn command(&self) -> BodyCommand {
        match &self.stance {
            Some(stance) if self.stage != Stage::Clear => between(&self.before, &stance.command, self.bent),
            _ => self.before,
        }
    }

    /// The chosen stance, as it was last judged.
    pub fn stance(&self) -> Option<&Stance> {
        self.stance.as_ref()
    }

    /// Looks for the way to the first posture once more, from where the arm is.
    pub fn again(&mut self) {
        (self.stage, self.leans_since, self.changes, self.searches) = (Stage::Lean, f64::NEG_INFINITY, 0, 1);
    }

    pub fn stage(&self) -> String {
        format!("{:?}", self.stage)
    }

    /// One control step; true once the arm is in the first posture.
    pub fn step(&mut self, seen: &Seen, arm: &mut RightArm, judge: &Judge<'_>) -> Result<bool, PolicyError> {
        match self.stage {
            Stage::Clear => {
                if self.stance.is_none() {
                    self.upright.height = seen.pelvis.translation.z - arm.floor;
                    self.search(arm, self.upright, judge)?;
                    return Ok(false);
                }
                if arm.gives_way() {
                    self.way = self.way_to_haven(arm);
                }
                if self.goes(arm) {
                    (self.stage, self.leans_since, self.bent) = (Stage::Lean, seen.time, 0.0);
                }
            }
            Stage::Lean if self.bent < 1.0 => {
                self.bent = if self.lean.bend > 0.0 { (self.bent + CONTROL_DT / self.lean.bend).min(1.0) } else { 1.0 };
            }
            Stage::Lean if seen.time - self.leans_since < self.lean.bend + self.wait() => {}
            Stage::Lean => {
                let Some(before) = self.stance.clone() else { return Ok(false) };
                let from = arm.angles();
                let mut stance = judge(arm, &before.command, &before.last(), self.lean.tries)?;
                if stance.error > self.lean.reached && self.changes < self.lean.changes {
                    self.changes += 1;
                    stance = self.lean.improve(arm, stance, judge)?;
                    if stance.command != before.command {
                        if self.holds {
                            // With the bulb in the hand, S11 succeeds in fewer rooms by way of `Clear`.
                            (self.stance, self.leans_since) = (Some(stance), seen.time);
                        } else {
                            self.clear_for(arm, before.command, stance);
                        }
                        return Ok(false);
                    }
                }
                if stance.error > LOST && self.searches < self.lean.searches {
                    self.search(arm, before.command, judge)?;
                    return Ok(false);
                }
                self.changes = 0;
                arm.assume(&stance.command, &from);
                let middle = stance.postures[stance.postures.len() / 2];
                arm.rest_at(&middle)?;
                let way = MARGINS
                    .into_iter()
                    .find_map(|share| arm.way(&from, &stance.postures[0], share * self.lean.margin, self.apart()));
                let command = stance.command;
                self.stance = Some(stance);
                match way {
                    Some(mut way) => {
                        way.reverse();
                        (self.way, self.stage, self.reaches_from, self.looks) = (way, Stage::Reach, from, 0);
                    }
                    // From another posture there may be one.
                    None => {
                        (self.leans_since, self.failures) = (seen.time, self.failures + 1);
                        self.looks += 1;
                        if !self.holds && self.looks >= MAX_LOOKS {
                            self.looks = 0;
                            self.refused.push(command);
                            self.search(arm, command, judge)?;
                        }
                    }
                }
            }
            Stage::Reach if !self.holds && seen.is_touched() => self.goes_back(),
            Stage::Reach if arm.gives_way() => {
                (self.blocks, self.failures) = (self.blocks + 1, self.failures + 1);
                (self.stage, self.leans_since) = (Stage::Lean, seen.time);
                if self.blocks.is_multiple_of(MAX_BLOCKS) {
                    self.search(arm, self.command(), judge)?;
                }
            }
            Stage::Reach => return Ok(self.goes(arm)),
        }
        Ok(false)
    }

    /// Until the arm's reach is looked at after the robot began to lean, s; longer with each failure.
    fn wait(&self) -> f64 {
        let doublings = self.failures.saturating_sub(1).min(MAX_DOUBLINGS);
        self.lean.settle * f64::from(1 << doublings)
    }

    /// Takes the arm back to where the way to the first posture began; it is looked for again there.
    pub fn goes_back(&mut self) {
        self.before = self.command();
        (self.stage, self.way) = (Stage::Clear, vec![self.reaches_from]);
    }

    /// Looks for the stance from the very beginning, and for the way to where the robot may lean from `before`.
    fn search(&mut self, arm: &mut RightArm, before: BodyCommand, judge: &Judge<'_>) -> Result<(), PolicyError> {
        (self.searches, self.changes) = (self.searches + 1, 0);
        self.before = before;
        if let Some(stance) = self.lean.choose(arm, judge, &self.refused)? {
            self.clear_for(arm, before, stance);
        }
        Ok(())
    }

    /// Looks for the way to where the robot may go from a command to a stance.
    fn clear_for(&mut self, arm: &mut RightArm, before: BodyCommand, stance: Stance) {
        (self.before, self.stance, self.stage) = (before, Some(stance), Stage::Clear);
        self.way = self.way_to_haven(arm);
    }

    fn way_to_haven(&self, arm: &mut RightArm) -> Vec<ArmAngles> {
        let Some(stance) = &self.stance else { return Vec::new() };
        let (from, to) = (arm.angles(), stance.postures[0]);
        let stances = [0.0, 0.25, 0.5, 0.75, 1.0].map(|share| between(&self.before, &stance.command, share));
        let mut margins = [1.0, 0.5, 0.2].into_iter().map(|share| share * self.lean.clear);
        let haven = margins.find_map(|margin| arm.haven(&stances, [&from, &to], margin, self.apart())).unwrap_or(from);
        arm.assume(&self.before, &from);
        let mut way = arm.way(&from, &haven, self.lean.margin, self.apart()).unwrap_or_default();
        way.reverse();
        way
    }

    /// Shapes from which its ways keep the arm apart.
    fn apart(&self) -> Apart {
        if self.holds { Apart::Carrying } else { Apart::All }
    }

    /// Moves the arm along the way; true at its end.
    fn goes(&mut self, arm: &mut RightArm) -> bool {
        if let Some(corner) = self.way.last()
            && arm.go_to(corner, self.lean.rate, !self.holds)
        {
            self.way.pop();
        }
        self.way.is_empty()
    }
}
