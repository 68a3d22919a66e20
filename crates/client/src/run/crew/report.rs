//! Reports on a run: its progress, and its outcome.

use std::sync::atomic::Ordering;

use fiatlux_bag::run::{ABANDONED, NOT_RUN};
use fiatlux_proto::v3::RunEpisode;
use fiatlux_proto::v3::run_episode::State as Ledger;

use super::super::outcome::{EpisodeFate, EpisodeOutcome, Playing, RunOutcome, RunProgress};
use super::super::scheduler::Standing;
use super::Crew;

impl Crew<'_, '_> {
    pub(super) fn look(&self) -> RunProgress {
        let mut look = RunProgress {
            episodes: self.episodes.len(),
            steps: self.steps,
            servers: self.scheduler.live().map(str::to_owned).collect(),
            ..RunProgress::default()
        };
        for (index, ((standing, _), episode)) in self.scheduler.standings().zip(&self.episodes).enumerate() {
            let horizon = self.horizons.get(&episode.task).copied().unwrap_or(0);
            match standing {
                Standing::Waiting => look.steps_left += horizon,
                Standing::Playing { server, .. } => {
                    let step = self.jobs.get(&index).map_or(0, |job| job.step.load(Ordering::Relaxed));
                    look.steps += step;
                    look.steps_left += horizon.saturating_sub(step);
                    let (task, seed) = (episode.task.clone(), self.seed(episode));
                    look.playing.push(Playing { task, seed, server: server.clone(), step });
                }
                Standing::Held { .. } => {
                    look.held += 1;
                    look.steps_left += horizon;
                }
                Standing::Ended { .. } => {}
                Standing::Decided { entry, .. } => {
                    look.done += 1;
                    look.successes += usize::from(entry.success);
                }
                Standing::Unplayable => look.done += 1,
                Standing::Lost => look.lost += 1,
            }
        }
        look
    }

    fn seed(&self, episode: &RunEpisode) -> Option<u64> {
        (self.finished || self.options.file.spec.hosted_seeds == 0).then_some(episode.seed)
    }

    pub(super) fn outcome(&self, stopped: bool) -> RunOutcome {
        let unplayed = self.ending.as_deref().unwrap_or("it was not played");
        let outcome = |((standing, problem), episode): ((&Standing, Option<&str>), &RunEpisode)| {
            let mut outcome = EpisodeOutcome {
                task: episode.task.clone(),
                seed: self.seed(episode),
                fate: EpisodeFate::Lost,
                cause: problem.unwrap_or(unplayed).into(),
                success: false,
                digest: String::new(),
                attempts: 0,
                server: None,
            };
            if *standing == Standing::Unplayable {
                outcome.fate = EpisodeFate::Failed;
            }
            if let Standing::Decided { server, entry } = standing {
                outcome.fate = if entry.state() == Ledger::Played { EpisodeFate::Played } else { EpisodeFate::Failed };
                // The client knows more about an attempt that it ended itself.
                let is_bare = [ABANDONED, NOT_RUN].contains(&entry.cause.as_str());
                outcome.cause = problem.filter(|_| is_bare).unwrap_or(&entry.cause).into();
                outcome.digest.clone_from(&entry.digest);
                (outcome.success, outcome.attempts, outcome.server) =
                    (entry.success, entry.attempts, Some(server.clone()));
            }
            outcome
        };
        let took_part = self.servers.iter().filter(|(_, known)| known.took_part);
        RunOutcome {
            run: self.options.file.run.clone(),
            episodes: self.scheduler.standings().zip(&self.episodes).map(outcome).collect(),
            finished: self.finished,
            stopped,
            servers: took_part.map(|(name, _)| name.clone()).collect(),
            protocol: self.options.file.protocol().into(),
        }
    }
}
