//! The tasks by name.

use std::fmt;
use std::str::FromStr;

use fiatlux_judge::ScoredTask;
use thiserror::Error;

use crate::parts::Bulb;
use crate::spec::TaskSpec;
use crate::tasks;

/// A task of the benchmark.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[allow(missing_docs)] // S01 to S12 are named in their files.
pub enum Task {
    S01,
    S02,
    S03,
    S04,
    S05,
    S06,
    S07,
    S08,
    S09,
    S10,
    S11,
    S12,
    /// The full errand, from moving the ladder to throwing the spent bulb away.
    Replace,
    /// Climbing alone, in a scene of its own.
    Climb,
}

/// Summary of one episode.
pub type Summary = fiatlux_judge::Summary<Task>;
/// An episode of the benchmark.
pub type Episode = fiatlux_judge::Episode<Task>;
/// All scores of a policy.
pub type Benchmark = fiatlux_judge::Benchmark<Task>;
/// The benchmark under one layout seed.
pub type SeedScore = fiatlux_judge::SeedScore<Task>;
/// All episodes of one task.
pub type SubtaskScore = fiatlux_judge::SubtaskScore<Task>;

impl ScoredTask for Task {
    const ALL: &'static [Self] = &Task::ALL;

    fn weight(self) -> f64 {
        self.spec().weight
    }
}

/// No task has this name.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("there is no task '{0}'; known ones are {names}, or their full ids such as {example}",
    names = Task::ALL.map(Task::short_id).join(", "), example = Task::S01.id())]
pub struct UnknownTask(String);

impl Task {
    /// The twelve subtasks that the benchmark score is made of, in order.
    pub const SUBTASKS: [Task; 12] = [
        Task::S01,
        Task::S02,
        Task::S03,
        Task::S04,
        Task::S05,
        Task::S06,
        Task::S07,
        Task::S08,
        Task::S09,
        Task::S10,
        Task::S11,
        Task::S12,
    ];

    /// The twelve subtasks, `replace` and `climb`.
    pub const ALL: [Task; 14] = {
        let mut all = [Task::Climb; 14];
        let mut i = 0;
        while i < 12 {
            all[i] = Task::SUBTASKS[i];
            i += 1;
        }
        all[12] = Task::Replace;
        all
    };

    /// Everything that defines the task.
    pub fn spec(self) -> &'static TaskSpec {
        match self {
            Task::S01 => &tasks::s01_move_ladder::SPEC,
            Task::S02 => &tasks::s02_climb_ladder::SPEC,
            Task::S03 => &tasks::s03_remove_old_bulb::SPEC,
            Task::S04 => &tasks::s04_descend_with_bulb::SPEC,
            Task::S05 => &tasks::s05_carry_to_disposal::SPEC,
            Task::S06 => &tasks::s06_dispose_bulb::SPEC,
            Task::S07 => &tasks::s07_approach_new_bulb::SPEC,
            Task::S08 => &tasks::s08_grab_new_bulb::SPEC,
            Task::S09 => &tasks::s09_carry_to_ladder::SPEC,
            Task::S10 => &tasks::s10_climb_with_bulb::SPEC,
            Task::S11 => &tasks::s11_screw_in_bulb::SPEC,
            Task::S12 => &tasks::s12_climb_down::SPEC,
            Task::Replace => &tasks::replace::SPEC,
            Task::Climb => &tasks::climb::SPEC,
        }
    }

    /// Short name, such as `S01` or `replace`.
    pub fn short_id(self) -> &'static str {
        self.spec().short_id
    }

    /// Full id, such as `Fiatlux-S01-MoveLadder-v1`.
    pub fn id(self) -> &'static str {
        self.spec().id
    }

    /// Name for people, such as `Move Ladder`.
    pub fn name(self) -> &'static str {
        self.spec().name
    }

    /// Weight in the benchmark score; 0 for `replace` and `climb`.
    pub fn weight(self) -> f64 {
        self.spec().weight
    }

    /// Instruction that the robot gets.
    pub fn instruction(self) -> &'static str {
        self.spec().instruction
    }

    /// Control steps until time-out.
    pub fn horizon_steps(self) -> u64 {
        self.spec().horizon_steps
    }

    /// The one bulb that the task handles; `None` if it handles none, or both.
    pub fn carried(self) -> Option<Bulb> {
        match self.spec().bulbs {
            [bulb] => Some(*bulb),
            _ => None,
        }
    }
}

impl fmt::Display for Task {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.short_id())
    }
}

impl FromStr for Task {
    type Err = UnknownTask;

    /// Parses `S01`, `s1`, `replace`, `climb` and full ids, in upper or lower case.
    fn from_str(name: &str) -> Result<Self, UnknownTask> {
        let number = name.strip_prefix(['S', 's']).filter(|rest| rest.bytes().all(|b| b.is_ascii_digit()));
        if let Some(number) = number.and_then(|rest| rest.parse::<usize>().ok()) {
            let task = number.checked_sub(1).and_then(|i| Task::SUBTASKS.get(i));
            return task.copied().ok_or_else(|| UnknownTask(name.into()));
        }
        let is_named = |task: &Task| task.short_id().eq_ignore_ascii_case(name) || task.id().eq_ignore_ascii_case(name);
        Task::ALL.into_iter().find(is_named).ok_or_else(|| UnknownTask(name.into()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{MAX_CRITERIA, Protocol};

    #[test]
    fn names_read_back() {
        for task in Task::ALL {
            for name in [task.short_id(), task.id(), &task.short_id().to_lowercase(), &task.to_string()] {
                assert_eq!(name.parse(), Ok(task));
            }
        }
        assert_eq!("s1".parse(), Ok(Task::S01));
        assert_eq!("S9".parse(), Ok(Task::S09));
        for name in ["S00", "S13", "s", "S1x", "", "Fiatlux-S01-MoveLadder-v0", "S99999999999999999999"] {
            let error = name.parse::<Task>().expect_err(name).to_string();
            let expected = format!("there is no task '{name}'; known ones are S01, S02, ");
            assert!(error.starts_with(&expected) && error.contains("S12, replace, climb, or"), "{error}");
        }
    }

    /// The paper's weights and their sum.
    #[test]
    fn weights() {
        for task in Task::SUBTASKS {
            let product: f64 = task.spec().factors.iter().map(|factor| factor.multiplier()).product();
            assert!((product - task.weight()).abs() < 1e-12, "{task}: {product}");
        }
        let sum: f64 = Task::SUBTASKS.into_iter().map(Task::weight).sum();
        assert!((sum - 34.05).abs() < 1e-12, "{sum}");
    }

    #[test]
    fn specs_are_sound() {
        for task in Task::ALL {
            let spec = task.spec();
            assert!(spec.start_count < spec.gate.n(Protocol::Published), "{task}");
            let names: Vec<_> = spec.gate.criteria_of(Protocol::Strict).map(|c| c.name).collect();
            assert!(names.len() <= MAX_CRITERIA && names.last() == Some(&"upright"), "{task}: {names:?}");
            assert!((1..=spec.gate.criteria.len()).contains(&spec.gate.goals), "{task}");
            assert!(names.iter().enumerate().all(|(i, name)| !names[..i].contains(name)), "{task}: {names:?}");
            assert!(spec.gate.strict_steps >= 50 && spec.gate.strict_steps >= spec.gate.sustain_steps, "{task}");
            assert!(spec.id.starts_with("Fiatlux-") && spec.id.ends_with("-v1"), "{task}");
            assert_eq!(spec.instruction, spec.instruction.to_lowercase());
            assert!(!spec.modes.is_empty(), "{task}");
        }
    }

    /// Two control modes at once in S03, S04, S10 and S11 only.
    #[test]
    fn control_modes() {
        let twofold = Task::SUBTASKS.into_iter().filter(|task| task.spec().modes.len() == 2);
        assert_eq!(twofold.collect::<Vec<_>>(), [Task::S03, Task::S04, Task::S10, Task::S11]);
    }
}
