//! The subtasks within an errand that a relay played, each judged by its own gate from the state in which it was begun.

use std::collections::BTreeMap;

use fiatlux_rules::{Geometry, Judge, JudgeOptions, Protocol, Rate, Relay, Row, Task, Thresholds};

use crate::results::{EpisodeRow, PartResult, PartRow};

/// End of a subtask that its policy left for another one, or that the episode's end cut short.
const LEFT: &str = "left";

/// The subtasks of an episode, as the recorded actions tell them apart.
#[derive(Debug)]
pub(crate) struct Parts {
    protocol: Protocol,
    thresholds: Thresholds,
    geometry: Geometry,
    /// Begins with the next row.
    due: Option<Task>,
    played: Option<Played>,
    rows: Vec<PartRow>,
}

#[derive(Debug)]
struct Played {
    task: Task,
    judge: Judge,
    first_step: u64,
    last_step: u64,
}

impl Parts {
    pub(crate) fn new(protocol: Protocol, thresholds: Thresholds, geometry: Geometry) -> Self {
        Self { protocol, thresholds, geometry, due: None, played: None, rows: Vec::new() }
    }

    /// Takes the subtask that the action in answer to the next row belongs to. One that is begun again at once goes on.
    pub(crate) fn play(&mut self, task: Option<Task>) {
        self.due = task;
    }

    pub(crate) fn push(&mut self, row: &Row) {
        // The row that a subtask leaves is judged, and is the first one of the next.
        if let Some(played) = &mut self.played {
            played.judge.advance(row);
            played.last_step = row.step;
        }
        if self.played.as_ref().map(|played| played.task) == self.due {
            return;
        }
        self.leave();
        self.played = self.due.map(|task| {
            let (thresholds, geometry) = (self.thresholds.clone(), self.geometry.clone());
            let mut judge = Judge::new(self.protocol, task, thresholds, geometry, JudgeOptions::default());
            judge.start(row);
            Played { task, judge, first_step: row.step, last_step: row.step }
        });
    }

    fn leave(&mut self) {
        let Some(Played { task, judge, first_step, last_step }) = self.played.take() else { return };
        let verdict = judge.verdict();
        self.rows.push(PartRow {
            task: task.to_string(),
            first_step,
            steps: last_step.saturating_sub(first_step),
            success: verdict.success,
            end: verdict.end.as_ref().map_or(LEFT, |end| end.cause().name()).into(),
        });
    }

    pub(crate) fn finish(mut self) -> Vec<PartRow> {
        self.leave();
        self.rows
    }
}

/// Sums up the subtasks of all episodes of a policy; nothing for one that is not a relay.
pub(crate) fn summed(policy: &str, episodes: &[EpisodeRow]) -> Vec<PartResult> {
    let Some(relay) = Relay::of(policy) else { return Vec::new() };
    let of = |task: Task| {
        let rows = || episodes.iter().flat_map(|episode| &episode.parts).filter(|part| part.task == task.short_id());
        let rate = Rate::of(rows().map(|part| part.success));
        let guest = relay.guests.iter().find(|guest| guest.task == task);
        let mut ends = BTreeMap::new();
        rows().for_each(|part| *ends.entry(part.end.clone()).or_insert(0) += 1);
        PartResult {
            id: task.to_string(),
            name: task.name().into(),
            policy: guest.map_or(&relay.host, |guest| &guest.policy).clone(),
            reached: rate.trials,
            successes: rate.hits,
            success_rate: rate.value().unwrap_or_default(),
            success_interval: rate.interval().unwrap_or([0.0, 1.0]),
            ends,
        }
    };
    Task::SUBTASKS.into_iter().map(of).collect()
}
