//! Phases of a skill: which one it is in, since when, and how it came there.

use std::fmt::Debug;

use fiatlux_wbc::BodyCommand;

/// A player of a task in phases, until nothing is left to do.
pub trait Skill {
    /// Nothing is left to do: the robot stands with what it has.
    fn is_over(&self) -> bool;

    /// Name of what it does now, one of a few; empty before an episode.
    fn phase(&self) -> String;

    /// The command that legs and waist followed in the last step; `None` where the skill itself commands their joints.
    fn body_command(&self) -> Option<BodyCommand> {
        None
    }

    /// Part of a plan that is done, from 0 to 1; `None` where none is played.
    fn part_done(&self) -> Option<f64> {
        None
    }
}

/// Entries of a log that are kept: the first ones. Retries without end would make it grow without end.
const MAX_LOG: usize = 1024;

/// The phase that a skill is in, with the times at which it entered each. A time is in s or in control steps, since the episode began.
#[derive(Debug, Clone, PartialEq)]
pub struct Phases<P, T = f64> {
    now: P,
    since: T,
    log: Vec<(P, T)>,
}

impl<P: Copy + Debug + PartialEq, T: Copy> Phases<P, T> {
    /// Begins with a phase.
    pub fn new(first: P, time: T) -> Self {
        Self { now: first, since: time, log: vec![(first, time)] }
    }

    /// The phase that it is in.
    pub fn now(&self) -> P {
        self.now
    }

    /// When the phase began.
    pub fn since(&self) -> T {
        self.since
    }

    /// The phase begins to count anew.
    pub fn restart(&mut self, time: T) {
        self.since = time;
    }

    /// Enters a phase, where there is a next one; true where there is.
    pub fn enter(&mut self, next: Option<P>, time: T) -> bool {
        let Some(next) = next else { return false };
        (self.now, self.since) = (next, time);
        if self.log.len() < MAX_LOG {
            self.log.push((next, time));
        }
        true
    }

    /// When it first entered a phase of this name; `None` where it has not.
    pub fn entered(&self, name: &str) -> Option<T> {
        self.log.iter().find(|(phase, _)| format!("{phase:?}") == name).map(|(_, time)| *time)
    }

    /// Name of the phase.
    pub fn name(&self) -> String {
        format!("{:?}", self.now)
    }
}

impl<P: Copy + Debug + PartialEq> Phases<P> {
    /// Time since the phase began, s.
    pub fn elapsed(&self, time: f64) -> f64 {
        time - self.since
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, Clone, Copy, PartialEq)]
    enum Phase {
        Reach,
        Hold,
    }

    #[test]
    fn a_phase_counts_from_its_entry_and_the_first_one_is_remembered() {
        let mut phases = Phases::new(Phase::Reach, 1.0);
        assert!(!phases.enter(None, 2.0) && phases.elapsed(3.0) == 2.0);
        assert!(phases.enter(Some(Phase::Hold), 3.0));
        phases.enter(Some(Phase::Reach), 4.0);
        phases.enter(Some(Phase::Hold), 5.0);
        assert_eq!((phases.now(), phases.name(), phases.elapsed(5.5)), (Phase::Hold, "Hold".into(), 0.5));
        assert_eq!(
            (phases.entered("Hold"), phases.entered("Reach"), phases.entered("Lift")),
            (Some(3.0), Some(1.0), None)
        );
        phases.restart(6.0);
        assert_eq!(phases.elapsed(6.5), 0.5);
    }
}
