//! Retries on the way to a stance: what each failure leads to, after how many of them, and after which wait.

use fiatlux_wbc::BodyCommand;

use super::apart::Apart;
use super::lean::Lean;

/// So often the arm is held up on its way before another stance is looked for.
const MAX_BLOCKS: u32 = 2;
/// So often the time until the next look for a way doubles, where there was none or the arm was held up and the stance is kept. It bounds
/// what a search that fails again and again takes.
const MAX_DOUBLINGS: u32 = 4;
/// So often no way is found in a stance before another one is looked for.
const MAX_LOOKS: u32 = 2;
/// Preference that a stance loses in which no way was found.
const NO_WAY: f64 = 2.0;
/// Error of a posture from which it is no use to go on, m.
const LOST: f64 = 0.012;

/// Differences between an empty hand and one with the bulb.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Manner {
    /// Shapes from which its ways keep the arm apart.
    pub apart: Apart,
    /// Its ways keep the usual gap even where one of their ends is nearer to something. With a bulb in the hand this can be a long way,
    /// on which it slips.
    pub keeps_margin: bool,
    /// Where the lean is changed, the arm first goes to where nothing is in its way.
    pub clears_for_change: bool,
    /// On its way to the first posture the hand feels the bulb.
    pub touched: Touched,
    /// Where there is no way with the usual gaps to where nothing is in its way, it takes one with smaller gaps.
    pub squeezes: bool,
    /// It waits while something holds up the arm.
    pub waits: bool,
    /// A stance in which no way is found again and again is given up.
    pub gives_up: bool,
}

/// Answer to a touch on the way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Touched {
    /// Goes on.
    GoesOn,
    /// Goes back to where the way began.
    GoesBack,
    /// Looks for another way from where it is.
    LooksAgain,
}

impl Manner {
    /// Of an empty hand.
    pub const EMPTY: Self = Self {
        apart: Apart::All,
        keeps_margin: true,
        clears_for_change: true,
        touched: Touched::GoesBack,
        squeezes: false,
        waits: true,
        gives_up: true,
    };
    /// Of an empty hand that comes back from the work.
    pub const LEAVING: Self = Self { touched: Touched::LooksAgain, squeezes: true, ..Self::EMPTY };
    /// The same with a bulb in it, which it feels at all times.
    pub const CARRYING_BACK: Self = Self { apart: Apart::Carrying, touched: Touched::GoesOn, ..Self::LEAVING };
    /// Of a hand with the bulb, which feels it at all times. By way of where nothing is in the arm's way, S11 succeeds in fewer rooms.
    pub const CARRYING: Self = Self {
        apart: Apart::Carrying,
        keeps_margin: false,
        clears_for_change: false,
        touched: Touched::GoesOn,
        squeezes: false,
        waits: false,
        gives_up: false,
    };
}

/// Counts of what failed.
#[derive(Debug, Clone, Default)]
pub(super) struct Retries {
    /// Changes of the lean since the last search of the whole, or the last posture that was reached.
    changes: u32,
    /// Number of times that the whole search was made.
    searches: u32,
    /// Number of times that the arm was held up.
    blocks: u32,
    /// Number of looks for a way that found none, and of ways on which the arm was held up.
    failures: u32,
    /// Looks in the present stance that found no way, and stances that were given up for that.
    looks: u32,
    refused: Vec<BodyCommand>,
}

impl Retries {
    /// The arm does not reach, by an error in m: the lean is to be changed.
    pub fn changes_lean(&self, error: f64, lean: &Lean) -> bool {
        error > lean.reached && self.changes < lean.changes
    }

    /// The arm does not nearly reach, by an error in m: all stances are to be searched once more.
    pub fn searches_again(&self, error: f64, lean: &Lean) -> bool {
        error > LOST && self.searches < lean.searches
    }

    /// Preference that a stance loses for what failed in it.
    pub fn penalty(&self, command: &BodyCommand, lean: &Lean) -> f64 {
        if self.refused.iter().any(|refused| lean.is_near(refused, command)) { NO_WAY } else { 0.0 }
    }

    /// Until the arm's reach is looked at after the robot began to lean, s; longer with each failure, but where a stance is given up for it.
    pub fn wait(&self, lean: &Lean, manner: Manner) -> f64 {
        let doublings = self.failures.saturating_sub(1).min(if manner.gives_up { 0 } else { MAX_DOUBLINGS });
        lean.settle * f64::from(1 << doublings)
    }

    /// The whole was searched.
    pub fn searched(&mut self) {
        (self.searches, self.changes) = (self.searches + 1, 0);
    }

    /// The lean was changed.
    pub fn changed(&mut self) {
        self.changes += 1;
    }

    /// The arm reaches, and a way is looked for.
    pub fn reached(&mut self) {
        self.changes = 0;
    }

    /// There is a way.
    pub fn found_way(&mut self) {
        self.looks = 0;
    }

    /// There is no way in the stance of a command, from another posture there may be one; true where another stance is to be found.
    pub fn found_no_way(&mut self, command: BodyCommand, manner: Manner) -> bool {
        (self.failures, self.looks) = (self.failures + 1, self.looks + 1);
        let gives_up = manner.gives_up && self.looks >= MAX_LOOKS;
        if gives_up {
            self.looks = 0;
            self.refuse(command);
        }
        gives_up
    }

    /// The stance of a command is no use.
    pub fn refuse(&mut self, command: BodyCommand) {
        self.refused.push(command);
    }

    /// Something held up the arm on its way; true where another stance is to be found.
    pub fn held_up(&mut self) -> bool {
        (self.blocks, self.failures) = (self.blocks + 1, self.failures + 1);
        self.blocks.is_multiple_of(MAX_BLOCKS)
    }

    /// The stance is kept, and the way is looked for as after the first search.
    pub fn begin_again(&mut self) {
        (self.changes, self.searches) = (0, 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lean() -> Lean {
        let text = "heights = [0.6, 0.7]\nrolls = [0.0]\npitches = [0.0]\nyaws = [0.0]\nstep = 0.25\ntries = 1\nreached = 0.003\n\
                    changes = 1\nsearches = 2\nsettle = 2.0\nclear = 0.0\nmargin = 0.0\nrate = 0.5";
        toml::from_str(text).expect("a lean")
    }

    #[test]
    fn a_stance_without_a_way_is_refused_or_each_wait_doubles_up_to_a_bound() {
        let (lean, mut retries) = (lean(), Retries::default());
        let commands = [0.6, 0.7].map(|height| BodyCommand { height, ..BodyCommand::default() });
        let mut answers = Vec::new();
        for _ in 0..7 {
            answers.push((retries.found_no_way(commands[0], Manner::EMPTY), retries.wait(&lean, Manner::EMPTY)));
        }
        assert!(answers.iter().enumerate().all(|(index, answer)| *answer == (index % 2 == 1, 2.0)));
        assert_eq!(commands.map(|command| retries.penalty(&command, &lean)), [NO_WAY, 0.0]);
        // A way begins the count anew.
        retries.found_way();
        assert!(!retries.found_no_way(commands[0], Manner::EMPTY));
        retries.found_way();
        assert!(!retries.found_no_way(commands[0], Manner::EMPTY));
        let mut carries = Retries::default();
        let waits = [(); 7].map(|()| {
            assert!(!carries.found_no_way(commands[0], Manner::CARRYING));
            carries.wait(&lean, Manner::CARRYING)
        });
        assert_eq!(waits, [2.0, 4.0, 8.0, 16.0, 32.0, 32.0, 32.0]);
        assert_eq!(carries.penalty(&commands[0], &lean), 0.0);
    }

    #[test]
    fn changes_and_searches_are_as_many_as_the_parameters_say() {
        let (lean, mut retries) = (lean(), Retries::default());
        let asked =
            |retries: &Retries, error| (retries.changes_lean(error, &lean), retries.searches_again(error, &lean));
        assert_eq!(
            [0.001, 0.005, 0.02].map(|error| asked(&retries, error)),
            [(false, false), (true, false), (true, true)]
        );
        retries.changed();
        assert_eq!(asked(&retries, 0.02), (false, true));
        retries.searched();
        assert_eq!(asked(&retries, 0.02), (true, true));
        retries.searched();
        assert_eq!(asked(&retries, 0.02), (true, false));
        retries.begin_again();
        assert_eq!(asked(&retries, 0.02), (true, true));
        assert_eq!([(); 4].map(|()| retries.held_up()), [false, true, false, true]);
        assert_eq!(retries.wait(&lean, Manner::CARRYING), 16.0);
    }
}
