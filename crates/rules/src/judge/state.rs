//! What a judge remembers of an episode, for snapshots.

use serde::{Deserialize, Serialize};

use super::Judge;
use crate::bulb_motion::BulbMotion;
use crate::cause::Cause;
use crate::evidence::Evidence;
use crate::gate::MAX_CRITERIA;
use crate::verdict::Verdict;

/// What a judge remembers of an episode. Published counting is left out: only gradings use it.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct JudgeState {
    first_step: u64,
    start_count: Option<u32>,
    motion: BulbMotion,
    evidence: Evidence,
    held_for: [u32; MAX_CRITERIA],
    squared_actions: f64,
    first_met: [Option<u64>; Cause::ALL.len()],
    verdict: Verdict,
}

impl Judge {
    pub(crate) fn state(&self) -> JudgeState {
        JudgeState {
            first_step: self.first_step,
            start_count: self.start_count,
            motion: self.motion.clone(),
            evidence: self.evidence,
            held_for: self.held_for,
            squared_actions: self.squared_actions,
            first_met: self.first_met,
            verdict: self.verdict,
        }
    }

    pub(crate) fn set_state(&mut self, state: JudgeState) {
        self.first_row = None;
        self.first_step = state.first_step;
        self.start_count = state.start_count;
        self.motion = state.motion;
        self.evidence = state.evidence;
        self.held_for = state.held_for;
        self.squared_actions = state.squared_actions;
        self.first_met = state.first_met;
        self.verdict = state.verdict;
    }
}
