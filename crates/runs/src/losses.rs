//! Explains why episodes have no bag.

use super::Job;

/// Fates of the episodes that were played.
#[derive(Debug, Default)]
pub(super) struct Played {
    /// Episodes that have ended, with the reason if their client failed.
    pub ended: Vec<(Job, Option<String>)>,
    /// Bags that could not be written whole, with the reasons.
    pub unwritten: Vec<(Job, String)>,
}

impl Played {
    /// Why a played episode is not recorded whole. The client's reason comes first, since it explains what happened to
    /// the bag.
    pub(super) fn reason(&self, job: Job) -> Option<&str> {
        let failed = self.ended.iter().filter_map(|(ended, reason)| Some((ended, reason.as_ref()?)));
        let unwritten = self.unwritten.iter().map(|(job, reason)| (job, reason));
        failed.chain(unwritten).find(|(other, _)| **other == job).map(|(_, reason)| reason.as_str())
    }

    /// A line for each episode that was played but has no bag; none for episodes that a stop prevented.
    pub(super) fn lost(&self, missing: &[Job]) -> Vec<String> {
        let has_ended = |job: &Job| self.ended.iter().any(|(ended, _)| ended == job);
        let played = missing.iter().filter(|job| has_ended(job) || self.reason(**job).is_some());
        let line = |job: &Job| {
            let reason = self.reason(*job).unwrap_or("its bag was not written; check the disk and its free space");
            format!("{} seed {}: {reason}", job.task, job.seed)
        };
        played.map(line).collect()
    }
}

#[cfg(test)]
mod tests {
    use fiatlux_rules::Task;

    use super::*;

    /// On a full disk every episode without a bag gets a line, however its bag was lost.
    #[test]
    fn every_episode_without_a_bag_is_named() {
        let jobs = [0, 1, 2, 3, 4].map(|seed| Job { task: Task::S01, seed });
        let reasons = [None, Some("silence"), None, Some("a refusal")].map(|reason| reason.map(String::from));
        let played = Played {
            ended: jobs.into_iter().zip(reasons).collect(),
            unwritten: vec![(jobs[0], "no space left".into()), (jobs[1], "it is aborted".into())],
        };
        let expected = [
            "S01 seed 0: no space left",
            "S01 seed 1: silence",
            "S01 seed 2: its bag was not written; check the disk and its free space",
            "S01 seed 3: a refusal",
        ];
        assert_eq!(played.lost(&jobs), expected, "and the last one was never begun");
        assert!(Played::default().lost(&jobs).is_empty());
    }
}
