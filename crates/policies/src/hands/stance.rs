//! Where the robot leans and the arm goes before the hand does something at the socket.
//!
//! The lean is searched: height, roll, pitch and yaw, by how well the arm reaches what follows. Then the arm goes to where nothing
//! is in its way while the robot leans, the robot leans, and the arm goes on to the first posture of what follows. While something is
//! searched, a slice in each control step, robot and arm stay where they are.

use fiatlux_client::PolicyError;
use fiatlux_kinematics::Search;
use fiatlux_wbc::{BodyCommand, CONTROL_DT};

use super::arm::Arm;
use super::judge::{Judge, Stance};
use super::lean::Lean;
use super::plan::{ArmAngles, SLICE};
use super::retries::{Manner, Retries, Touched};
use super::skill::Seen;

/// Where the arm's joints rest while a stance is searched, rad.
pub(super) const REST: ArmAngles = [-0.8, -1.2, 0.0, 0.0, 0.5, 0.6, 0.5];
/// Shares of the margin with which a way is looked for, one after the other.
const MARGINS: [f64; 3] = [1.0, 0.3, 0.0];
/// Postures of the arm from which it is searched where a lean is changed.
const IMPROVES: usize = 2;
/// Gap that the arm keeps while the robot leans otherwise, m.
const SWEPT: f64 = 0.02;

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
    /// The robot leant already when this began.
    leans: bool,
    /// Corners of the way that are left, the last first; and those that are behind, from where it began.
    way: Vec<ArmAngles>,
    passed: Vec<ArmAngles>,
    leans_since: f64,
    /// Part of the way that the robot has gone from `before` to the stance: 0 to 1.
    bent: f64,
    retries: Retries,
    manner: Manner,
    /// The search under way; robot and arm wait for it.
    search: Option<Search<Result<Found, PolicyError>>>,
}

/// A question to a search.
#[derive(Debug, Clone, Copy)]
enum Question {
    /// A stance, from the very beginning, and the way to where the robot may lean from a command.
    Stance(BodyCommand),
    /// The way to the first posture from a stance as the robot now stands, or a better stance.
    Way,
    /// The way to where the robot may go to the stance.
    Haven,
}

/// The answer of a search.
enum Found {
    Stance(BodyCommand, Option<(Stance, Vec<ArmAngles>)>),
    /// A change of the lean; without a way to where the robot may go there, it goes at once.
    Change(BodyCommand, Stance, Option<Vec<ArmAngles>>),
    /// A way to the first posture, if there is one.
    Way(Stance, Option<Vec<ArmAngles>>),
    Haven(Vec<ArmAngles>),
}

/// Searches for stances and ways to them.
struct Thinker<J> {
    lean: Lean,
    judge: J,
    retries: Retries,
    manner: Manner,
    /// The stance that was chosen before, and the command from which the robot goes there.
    stance: Option<Stance>,
    before: BodyCommand,
}

impl<J: Judge> Thinker<J> {
    async fn answer(&self, question: Question, arm: &mut Arm) -> Result<Found, PolicyError> {
        match question {
            Question::Stance(before) => self.search(arm, before).await,
            Question::Haven => Ok(match &self.stance {
                Some(stance) => Found::Haven(self.way_to_haven(arm, &self.before, stance).await),
                None => Found::Haven(Vec::new()),
            }),
            Question::Way => match &self.stance {
                Some(stance) => self.look(arm, stance).await,
                None => self.search(arm, self.before).await,
            },
        }
    }

    /// Looks for the stance from the very beginning, and for the way to where the robot may lean from `before`.
    async fn search(&self, arm: &mut Arm, before: BodyCommand) -> Result<Found, PolicyError> {
        let Some(stance) = self.choose(arm).await? else { return Ok(Found::Stance(before, None)) };
        let way = self.way_to_haven(arm, &before, &stance).await;
        Ok(Found::Stance(before, Some((stance, way))))
    }

    /// Looks for the way to the first posture of a stance that the robot has taken; where the arm does not reach it now, for another
    /// stance.
    async fn look(&self, arm: &mut Arm, before: &Stance) -> Result<Found, PolicyError> {
        let from = arm.angles();
        let judged = self.judge.judge(arm, &before.command, &before.last(), self.lean.tries, f64::NEG_INFINITY).await?;
        let mut stance = judged.unwrap_or_else(|| before.clone());
        if self.retries.changes_lean(stance.error, &self.lean) {
            stance = self.improve(arm, stance).await?;
            if stance.command != before.command {
                let clears = self.manner.clears_for_change
                    || !self.sweeps_clear(arm, &before.command, &stance.command, &from).await;
                let way = if clears { Some(self.way_to_haven(arm, &before.command, &stance).await) } else { None };
                return Ok(Found::Change(before.command, stance, way));
            }
        }
        if self.retries.searches_again(stance.error, &self.lean) {
            return self.search(arm, before.command).await;
        }
        arm.assume(&stance.command, &from);
        for share in MARGINS {
            let way = arm.way(&from, &stance.postures[0], share * self.lean.margin, self.manner).await;
            if way.is_some() {
                return Ok(Found::Way(stance, way));
            }
        }
        Ok(Found::Way(stance, None))
    }

    /// The stance that suits the arm best: the best of the combinations, then of its neighbours.
    async fn choose(&self, arm: &mut Arm) -> Result<Option<Stance>, PolicyError> {
        let from = arm.angles();
        let mut best: Option<(f64, Stance)> = None;
        for command in self.lean.commands() {
            let penalty = self.retries.penalty(&command, &self.lean);
            let least = best.as_ref().map_or(f64::NEG_INFINITY, |(best, _)| best + penalty);
            if let Some(stance) = self.judge.judge(arm, &command, &from, self.lean.tries, least).await? {
                best = Some((stance.score() - penalty, stance));
            }
        }
        match best {
            Some((_, best)) => self.improve(arm, best).await.map(Some),
            None => Ok(None),
        }
    }

    /// The best that is found from a stance by changes of its command, each on its own.
    async fn improve(&self, arm: &mut Arm, mut best: Stance) -> Result<Stance, PolicyError> {
        let mut step = self.lean.step;
        while step > self.lean.step / 4.0 {
            let mut is_better = false;
            for (axis, sign) in (0..4).flat_map(|axis| [(axis, 1.0), (axis, -1.0)]) {
                let mut numbers = best.command.numbers();
                let [low, high] = self.lean.range(axis);
                let number = &mut numbers[3 + axis];
                *number = (*number + sign * step * (high - low)).clamp(low, high);
                if let Some(stance) =
                    self.judge.judge(arm, &numbers.into(), &best.last(), IMPROVES, best.score()).await?
                {
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

    /// The arm, as it is, strikes nothing while the robot goes from one command to another.
    async fn sweeps_clear(&self, arm: &mut Arm, from: &BodyCommand, to: &BodyCommand, angles: &ArmAngles) -> bool {
        arm.assume(from, angles);
        let began = arm.gap(angles, self.manner.apart).await;
        let least = began.min(SWEPT) - 1e-3;
        for share in [0.25, 0.5, 0.75, 1.0] {
            arm.assume(&between(from, to, share), angles);
            if arm.gap(angles, self.manner.apart).await < least {
                return false;
            }
        }
        true
    }

    async fn way_to_haven(&self, arm: &mut Arm, before: &BodyCommand, stance: &Stance) -> Vec<ArmAngles> {
        let (from, to) = (arm.angles(), stance.postures[0]);
        let stances = [0.0, 0.25, 0.5, 0.75, 1.0].map(|share| between(before, &stance.command, share));
        let mut haven = None;
        for share in [1.0, 0.5, 0.2] {
            haven = arm.haven(&stances, [&from, &to], share * self.lean.clear, self.manner.apart).await;
            if haven.is_some() {
                break;
            }
        }
        arm.assume(before, &from);
        // Back from the work there is no other place to begin from, and the arm may hang before the robot stands up.
        let (to, margins) = match self.manner.squeezes {
            true => (haven.unwrap_or(stance.postures[0]), &MARGINS[..]),
            false => (haven.unwrap_or(from), &MARGINS[..1]),
        };
        for share in margins {
            if let Some(mut way) = arm.way(&from, &to, share * self.lean.margin, self.manner).await {
                way.reverse();
                return way;
            }
        }
        Vec::new()
    }
}

/// A command on the way from one to another.
fn between(from: &BodyCommand, to: &BodyCommand, share: f64) -> BodyCommand {
    let (from, to) = (from.numbers(), to.numbers());
    std::array::from_fn(|index| from[index] + share * (to[index] - from[index])).into()
}

impl Taking {
    pub fn new(lean: Lean, manner: Manner) -> Self {
        Self {
            lean,
            stage: Stage::Clear,
            upright: BodyCommand::default(),
            stance: None,
            before: BodyCommand::default(),
            leans: false,
            way: Vec::new(),
            passed: Vec::new(),
            leans_since: 0.0,
            bent: 0.0,
            retries: Retries::default(),
            manner,
            search: None,
        }
    }

    /// Back to where the robot stood at first.
    pub fn back(&self, manner: Manner) -> Self {
        let (before, upright) = (self.command(), self.upright);
        Self { leans: true, before, upright, ..Self::new(self.lean.only(&upright), manner) }
    }

    /// The robot stays as it leans, and has not chosen a stance.
    pub fn stays(&mut self, command: BodyCommand) {
        (self.before, self.leans) = (command, true);
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
        (self.stage, self.leans_since) = (Stage::Lean, f64::NEG_INFINITY);
        self.retries.begin_again();
        self.search = None;
    }

    /// Looks for another stance, from where the robot is: in this one the arm does not get to the work.
    pub fn another(&mut self) {
        self.stays(self.command());
        if let Some(stance) = self.stance.take() {
            self.retries.refuse(stance.command);
        }
        (self.stage, self.search) = (Stage::Clear, None);
    }

    pub fn stage(&self) -> String {
        format!("{:?}", self.stage)
    }

    /// One control step; true once the arm is in the first posture.
    pub fn step<J: Judge>(
        &mut self,
        seen: &Seen,
        arm: &mut Arm,
        judge: impl FnOnce() -> J,
    ) -> Result<bool, PolicyError> {
        if let Some(search) = &mut self.search {
            let Some(found) = search.go_on(SLICE) else { return Ok(false) };
            self.search = None;
            if let Some(question) = self.take_up(found?, seen, arm)? {
                self.ask(question, arm, judge());
            }
            return Ok(false);
        }
        match self.stage {
            Stage::Clear if self.stance.is_none() && self.leans => {
                self.ask(Question::Stance(self.before), arm, judge());
            }
            Stage::Clear if self.stance.is_none() => {
                self.upright.height = seen.pelvis.translation.z - arm.floor;
                self.ask(Question::Stance(self.upright), arm, judge());
            }
            Stage::Clear if arm.gives_way() => self.ask(Question::Haven, arm, judge()),
            Stage::Clear => {
                if self.goes(arm) {
                    (self.stage, self.leans_since, self.bent) = (Stage::Lean, seen.time, 0.0);
                }
            }
            Stage::Lean if self.bent < 1.0 => {
                self.bent = if self.lean.bend > 0.0 { (self.bent + CONTROL_DT / self.lean.bend).min(1.0) } else { 1.0 };
            }
            Stage::Lean
                if seen.time - self.leans_since < self.lean.bend + self.retries.wait(&self.lean, self.manner) => {}
            Stage::Lean => self.ask(Question::Way, arm, judge()),
            Stage::Reach if self.manner.touched == Touched::GoesBack && seen.is_touched() => self.goes_back(),
            Stage::Reach if self.manner.touched == Touched::LooksAgain && seen.is_touched() => {
                arm.rest_where_it_is();
                (self.stage, self.leans_since) = (Stage::Lean, seen.time);
            }
            Stage::Reach if arm.gives_way() => {
                (self.stage, self.leans_since) = (Stage::Lean, seen.time);
                if self.retries.held_up() {
                    self.ask(Question::Stance(self.command()), arm, judge());
                }
            }
            Stage::Reach => return Ok(self.goes(arm)),
        }
        Ok(false)
    }

    /// Begins a search; until it ends, nothing moves.
    fn ask<J: Judge>(&mut self, question: Question, arm: &Arm, judge: J) {
        let thinker = Thinker {
            lean: self.lean.clone(),
            judge,
            retries: self.retries.clone(),
            manner: self.manner,
            stance: self.stance.clone(),
            before: self.before,
        };
        let arm = arm.clone();
        self.search = Some(Search::new(move |work| {
            let mut arm = arm.searching(work);
            async move { thinker.answer(question, &mut arm).await }
        }));
    }

    /// Goes on with what a search found; what is to be searched for next, if anything.
    fn take_up(&mut self, found: Found, seen: &Seen, arm: &mut Arm) -> Result<Option<Question>, PolicyError> {
        match found {
            Found::Stance(before, found) => {
                self.before = before;
                self.retries.searched();
                if let Some((stance, way)) = found {
                    (self.stance, self.stage, self.way) = (Some(stance), Stage::Clear, way);
                }
            }
            Found::Change(before, stance, way) => {
                self.retries.changed();
                self.stance = Some(stance);
                match way {
                    Some(way) => (self.before, self.stage, self.way) = (before, Stage::Clear, way),
                    None => self.leans_since = seen.time,
                }
            }
            Found::Way(stance, way) => {
                self.retries.reached();
                arm.rest_at(&stance.postures[stance.postures.len() / 2])?;
                let command = stance.command;
                self.stance = Some(stance);
                match way {
                    Some(mut way) => {
                        way.reverse();
                        (self.way, self.stage, self.passed) = (way, Stage::Reach, vec![arm.angles()]);
                        self.retries.found_way();
                    }
                    None => {
                        self.leans_since = seen.time;
                        if self.retries.found_no_way(command, self.manner) {
                            return Ok(Some(Question::Stance(command)));
                        }
                    }
                }
            }
            Found::Haven(way) => self.way = way,
        }
        Ok(None)
    }

    /// Takes the arm back as it came, to where the way to the first posture began; it is looked for again there. The short way may sweep
    /// the bulb out of the socket.
    pub fn goes_back(&mut self) {
        self.before = self.command();
        (self.stage, self.search) = (Stage::Clear, None);
        self.way = std::mem::take(&mut self.passed);
    }

    /// Moves the arm along the way; true at its end.
    fn goes(&mut self, arm: &mut Arm) -> bool {
        if let Some(corner) = self.way.last()
            && arm.go_to(corner, self.lean.rate, self.manner.waits)
        {
            self.passed.extend(self.way.pop());
        }
        self.way.is_empty()
    }
}
