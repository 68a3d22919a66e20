//! The loop that plays episodes: which are wanted, which are being played, done or lost, and how far each has come.
//! [`play_each`] plays a list in one place; `driver.rs` plays a run on its servers, whose ledgers decide.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{self, Sender};
use std::thread::Scope;
use std::time::{Duration, Instant};

use fiatlux_proto::v3::EpisodeEnd;

use super::outcome::{Playing, RunProgress};
use super::scheduler::{AttemptFailure, Scheduler, Standing};
use crate::{Client, ClientError, Policy, PolicyError};

/// Time between two checks of everything.
pub(super) const TICK: Duration = Duration::from_millis(50);

/// Time between two reports of progress.
pub(super) const REPORT_PERIOD: Duration = Duration::from_millis(200);

/// The end of an attempt at an episode.
pub type AttemptEnd = Result<EpisodeEnd, ClientError>;

/// An episode to play.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WantedEpisode {
    /// Id of the task, such as `S01`.
    pub task: String,
    /// Layout seed; `None` if it is hosted and not yet disclosed.
    pub seed: Option<u64>,
    /// Largest number of its control steps.
    pub horizon_steps: u64,
}

/// An attempt at an episode, shared with the thread that plays it.
#[derive(Debug, Clone)]
pub struct Attempt {
    pub(super) server: String,
    pub(super) since: Instant,
    shared: Arc<Shared>,
}

#[derive(Debug, Default)]
struct Shared {
    broken_off: AtomicBool,
    refused: AtomicBool,
    step: AtomicU64,
}

impl Attempt {
    /// Plays the episode in a session, and closes it. An attempt that was broken off although the caller's `stop` is not set
    /// has lost its server, and closes nothing.
    ///
    /// # Errors
    /// As for [`Client::run_episode`].
    pub fn play(&self, mut client: Client, policy: &mut dyn Policy, stop: &AtomicBool) -> AttemptEnd {
        let mut has_acted = false;
        let mut note = |step| {
            has_acted = true;
            self.shared.step.store(step, Ordering::Relaxed);
        };
        let end = client.run_episode(0, policy, &mut note, &self.shared.broken_off);
        let refuses = matches!(end, Err(ClientError::Policy(PolicyError::Sensor { .. } | PolicyError::Unfit { .. })));
        self.shared.refused.store(refuses && !has_acted, Ordering::Relaxed);
        // Closing would only wait for a server that is gone.
        let is_gone = matches!(end, Err(ClientError::Stopped)) && !stop.load(Ordering::Relaxed);
        if !is_gone && let Err(error) = client.close() {
            tracing::debug!("the session of an episode was not closed: {error}");
        }
        end
    }

    /// Asks its thread to end.
    pub(super) fn break_off(&self) {
        self.shared.broken_off.store(true, Ordering::Relaxed);
    }

    pub(super) fn is_broken_off(&self) -> bool {
        self.shared.broken_off.load(Ordering::Relaxed)
    }

    /// True if the policy refused the session before its first step.
    pub(super) fn is_refused(&self) -> bool {
        self.shared.refused.load(Ordering::Relaxed)
    }

    fn step(&self) -> u64 {
        self.shared.step.load(Ordering::Relaxed)
    }
}

/// Messages from the threads that play episodes.
pub(super) enum AttemptEvent {
    Opened(usize),
    Over { index: usize, end: AttemptEnd },
}

/// Wanted episodes and the threads that play them. What becomes of each is decided by the owner, who receives the events.
pub(super) struct EpisodeLoop<'scope, 'env, E> {
    pub scheduler: Scheduler,
    pub wanted: Vec<WantedEpisode>,
    scope: &'scope Scope<'scope, 'env>,
    sender: Sender<E>,
    attempts: BTreeMap<usize, Attempt>,
    /// Steps of attempts that are over.
    steps: u64,
}

impl<'scope, 'env, E: From<AttemptEvent> + Send + 'scope> EpisodeLoop<'scope, 'env, E> {
    pub fn new(scope: &'scope Scope<'scope, 'env>, sender: Sender<E>) -> Self {
        let (scheduler, attempts) = (Scheduler::new(0, 0), BTreeMap::new());
        Self { scheduler, wanted: Vec::new(), scope, sender, attempts, steps: 0 }
    }

    /// Sets what to play, and the largest number of episodes at once.
    pub fn want(&mut self, wanted: Vec<WantedEpisode>, parallel: usize) {
        self.scheduler = Scheduler::new(wanted.len(), parallel);
        self.wanted = wanted;
    }

    /// Begins episodes, each in a thread of its own, while there is room. `play` gets the episode's index and calls its last
    /// argument when the session is open.
    pub fn begin(&mut self, play: impl Fn(usize, &Attempt, &dyn Fn()) -> AttemptEnd + Copy + Send + 'scope) {
        while let Some((index, server)) = self.scheduler.next() {
            let attempt = Attempt { server, since: Instant::now(), shared: Arc::default() };
            self.attempts.insert(index, attempt.clone());
            let sender = self.sender.clone();
            self.scope.spawn(move || {
                let opened = || drop(sender.send(AttemptEvent::Opened(index).into()));
                let panicked = |_| {
                    let source = "it panicked; its message is on stderr".into();
                    Err(PolicyError::Failed { policy: "of this episode", source }.into())
                };
                let end = catch_unwind(AssertUnwindSafe(|| play(index, &attempt, &opened))).unwrap_or_else(panicked);
                let _ = sender.send(AttemptEvent::Over { index, end }.into());
            });
        }
    }

    /// Removes an attempt that is over.
    pub fn over(&mut self, index: usize) -> Option<Attempt> {
        let attempt = self.attempts.remove(&index)?;
        self.steps += attempt.step();
        Some(attempt)
    }

    pub fn attempts(&self) -> impl Iterator<Item = &Attempt> {
        self.attempts.values()
    }

    pub fn break_off(&self, index: usize) {
        self.attempts.get(&index).into_iter().for_each(Attempt::break_off);
    }

    pub fn progress(&self) -> RunProgress {
        let mut progress = RunProgress {
            episodes: self.wanted.len(),
            steps: self.steps,
            servers: self.scheduler.live().map(str::to_owned).collect(),
            ..RunProgress::default()
        };
        for (index, ((standing, _), wanted)) in self.scheduler.standings().zip(&self.wanted).enumerate() {
            match standing {
                Standing::Waiting => progress.steps_left += wanted.horizon_steps,
                Standing::Playing { server, .. } => {
                    let step = self.attempts.get(&index).map_or(0, Attempt::step);
                    progress.steps += step;
                    progress.steps_left += wanted.horizon_steps.saturating_sub(step);
                    let (task, seed) = (wanted.task.clone(), wanted.seed);
                    progress.playing.push(Playing { task, seed, server: server.clone(), step });
                }
                Standing::Held { .. } => {
                    progress.held += 1;
                    progress.steps_left += wanted.horizon_steps;
                }
                Standing::Ended { .. } => {}
                Standing::Decided { entry, .. } => {
                    progress.done += 1;
                    progress.successes += usize::from(entry.success);
                }
                Standing::Unplayable => progress.done += 1,
                Standing::Lost => progress.lost += 1,
                Standing::Elsewhere => progress.episodes -= 1,
            }
        }
        progress
    }
}

/// Plays each episode once, several at a time, and returns its end, in the order of `wanted`; `None` for those that were
/// broken off or not begun because `stop` was set. `play` makes an attempt, which is asked to end when `stop` is set.
/// `progress` is called a few times a second, and at the end.
pub fn play_each(
    wanted: Vec<WantedEpisode>,
    parallel: usize,
    play: impl Fn(usize, &Attempt) -> AttemptEnd + Sync,
    progress: &mut dyn FnMut(&RunProgress),
    stop: &AtomicBool,
) -> Vec<Option<AttemptEnd>> {
    let mut ends: Vec<_> = wanted.iter().map(|_| None).collect();
    let play = &play;
    std::thread::scope(|scope| {
        let (sender, events) = mpsc::channel::<AttemptEvent>();
        let mut episodes = EpisodeLoop::new(scope, sender);
        episodes.want(wanted, parallel);
        episodes.scheduler.server_joins("", parallel);
        let mut reported = Instant::now();
        loop {
            if stop.load(Ordering::Relaxed) {
                episodes.attempts().for_each(Attempt::break_off);
            } else {
                episodes.begin(move |index, attempt, _| play(index, attempt));
            }
            if episodes.attempts.is_empty() {
                break;
            }
            if let Ok(AttemptEvent::Over { index, end }) = events.recv_timeout(TICK) {
                episodes.over(index);
                match &end {
                    Ok(end) => episodes.scheduler.played(index, end.success),
                    Err(ClientError::Stopped) => episodes.scheduler.set_back(index, AttemptFailure::BrokenOff),
                    Err(error) => episodes.scheduler.set_back(index, AttemptFailure::Hopeless(error.to_string())),
                }
                ends[index] = (!matches!(end, Err(ClientError::Stopped))).then_some(end);
            }
            if reported.elapsed() >= REPORT_PERIOD {
                reported = Instant::now();
                progress(&episodes.progress());
            }
        }
        progress(&episodes.progress());
    });
    ends
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wanted(count: u64) -> Vec<WantedEpisode> {
        (0..count).map(|seed| WantedEpisode { task: "S01".into(), seed: Some(seed), horizon_steps: 100 }).collect()
    }

    /// Each is played once; one that fails, or whose policy panics, costs the others nothing.
    #[test]
    fn each_episode_is_played_once() {
        let tries = [const { AtomicU64::new(0) }; 6];
        let play = |index: usize, _: &Attempt| {
            tries[index].fetch_add(1, Ordering::Relaxed);
            match index {
                1 => Err(ClientError::SeveralServers { found: Vec::new() }),
                2 => panic!("a fault of the policy"),
                index => Ok(EpisodeEnd { success: index == 3, ..EpisodeEnd::default() }),
            }
        };
        let mut last = RunProgress::default();
        let ends = play_each(wanted(6), 2, play, &mut |progress| last = progress.clone(), &AtomicBool::new(false));
        assert!(tries.iter().all(|tries| tries.load(Ordering::Relaxed) == 1));
        let is_played = |end: &Option<AttemptEnd>| end.as_ref().map(Result::is_ok);
        assert_eq!(ends.iter().map(is_played).collect::<Vec<_>>(), [1, 0, 0, 1, 1, 1].map(|ok| Some(ok == 1)));
        assert!(matches!(&ends[2], Some(Err(ClientError::Policy(PolicyError::Failed { .. })))), "{:?}", ends[2]);
        assert_eq!((last.episodes, last.done, last.successes, last.lost), (6, 4, 1, 2), "{last:?}");
        assert!(last.playing.is_empty() && last.steps_left == 0, "{last:?}");
    }

    /// A stop breaks off the episodes that run, and does not begin the rest.
    #[test]
    fn a_stop_leaves_the_rest_for_the_next_call() {
        let stop = AtomicBool::new(false);
        let begun = AtomicU64::new(0);
        let play = |index: usize, attempt: &Attempt| {
            begun.fetch_add(1, Ordering::Relaxed);
            if index == 0 {
                return Ok(EpisodeEnd::default());
            }
            attempt.shared.step.store(30, Ordering::Relaxed);
            while !attempt.is_broken_off() {
                std::thread::sleep(Duration::from_millis(1));
            }
            Err(ClientError::Stopped)
        };
        let mut progress = |progress: &RunProgress| {
            if !progress.playing.is_empty() {
                // Two of three that are left are at step 30 of 100.
                assert_eq!((progress.done, progress.steps, progress.steps_left), (1, 60, 240), "{progress:?}");
                stop.store(true, Ordering::Relaxed);
            }
        };
        let ends = play_each(wanted(4), 2, play, &mut progress, &stop);
        assert!(matches!(ends[..], [Some(Ok(_)), None, None, None]), "{ends:?}");
        assert_eq!(begun.load(Ordering::Relaxed), 3);
    }
}
