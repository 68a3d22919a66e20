//! The outcome of a run.

use fiatlux_bag::run::{ABANDONED, NOT_RUN};
use fiatlux_proto::v3::run_episode::State as Ledger;

use super::super::episodes::WantedEpisode;
use super::super::outcome::{EpisodeFate, EpisodeOutcome, RunOutcome};
use super::super::scheduler::Standing;
use super::RunDriver;

impl RunDriver<'_, '_> {
    pub(super) fn outcome(&self, stopped: bool) -> RunOutcome {
        let unplayed = self.ending.as_deref().unwrap_or("it was not played");
        let outcome = |((standing, problem), wanted): ((&Standing, Option<&str>), &WantedEpisode)| {
            let mut outcome = EpisodeOutcome {
                task: wanted.task.clone(),
                seed: wanted.seed,
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
        let is_own = |(index, _): &(usize, _)| self.options.shard.is_none_or(|shard| shard.has(*index));
        let standings = self.episodes.scheduler.standings().zip(&self.episodes.wanted).enumerate().filter(is_own);
        let took_part = self.servers.iter().filter(|(_, state)| state.took_part);
        RunOutcome {
            run: self.options.file.run.clone(),
            episodes: standings.map(|(_, standing)| outcome(standing)).collect(),
            finished: self.finished,
            stopped,
            servers: took_part.map(|(name, _)| name.clone()).collect(),
            protocol: self.options.file.protocol().into(),
        }
    }
}
