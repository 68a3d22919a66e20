//! The episode of following the plan, for snapshots.

use fiatlux_climb::TrackerMemory;
use fiatlux_rules::BodyRow;
use fiatlux_sensing::NoiseSeed;
use serde::{Deserialize, Serialize};

use super::{ARMS, Climbing, world_from_plan};
use crate::TaskError;

#[derive(Serialize, Deserialize)]
struct State {
    /// Seed and episode.
    noise: Option<(u64, u64)>,
    tracker: TrackerMemory,
    start: (f64, f64),
    arms: Option<[f64; ARMS]>,
    /// At the start.
    ladder: BodyRow,
}

impl Climbing {
    pub(super) fn state(&self) -> Result<Vec<u8>, TaskError> {
        Ok(postcard::to_allocvec(&State {
            noise: self.noise.map(|noise| (noise.seed, noise.episode)),
            tracker: self.tracker.memory(),
            start: self.start,
            arms: self.arms,
            ladder: BodyRow::at_rest(self.ladder),
        })?)
    }

    pub(super) fn set_state(&mut self, saved: &[u8]) -> Result<(), TaskError> {
        let state: State = postcard::from_bytes(saved)?;
        self.tracker.restore(state.tracker).ok_or("the snapshot is of another robot")?;
        self.noise = state.noise.map(|(seed, episode)| NoiseSeed { seed, episode });
        self.observer.restart(self.noise);
        (self.start, self.arms, self.ladder) = (state.start, state.arms, state.ladder.pose);
        self.world_from_plan = world_from_plan(&self.ladder);
        Ok(())
    }
}
