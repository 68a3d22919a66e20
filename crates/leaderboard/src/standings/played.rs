//! The episodes that a submission played: two submissions that share some can be compared.

use std::collections::HashMap;

use fiatlux_grading::Results;
use serde::{Deserialize, Serialize};

/// The episodes of a submission in order: task, seed, index.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(crate) struct PlayedEpisodes {
    version: u32,
    episodes: Vec<(String, u64, u64)>,
}

impl PlayedEpisodes {
    pub fn of(results: &Results) -> Self {
        let mut episodes: Vec<_> =
            results.episodes.iter().map(|row| (row.task.clone(), row.seed, row.episode)).collect();
        episodes.sort_unstable();
        Self { version: results.conditions.benchmark_version, episodes }
    }

    pub fn has(&self, task: &str, seed: u64, episode: u64) -> bool {
        let key = |(t, s, e): &(String, u64, u64)| t.as_str().cmp(task).then(s.cmp(&seed)).then(e.cmp(&episode));
        self.episodes.binary_search_by(key).is_ok()
    }

    fn keys(&self) -> impl Iterator<Item = (u32, &(String, u64, u64))> {
        self.episodes.iter().map(|episode| (self.version, episode))
    }

    /// Number of episodes that both played, in the same version of the benchmark.
    pub fn shared(&self, other: &Self) -> usize {
        if self.version != other.version {
            return 0;
        }
        let (mut a, mut b, mut count) = (self.episodes.iter().peekable(), other.episodes.iter().peekable(), 0);
        while let (Some(x), Some(y)) = (a.peek(), b.peek()) {
            let order = x.cmp(y);
            count += usize::from(order.is_eq());
            if order.is_le() {
                a.next();
            }
            if order.is_ge() {
                b.next();
            }
        }
        count
    }

    /// For each of these, true if another one shares an episode.
    pub fn any_shared(all: &[&Self]) -> Vec<bool> {
        let mut counts: HashMap<(u32, &(String, u64, u64)), usize> = HashMap::new();
        all.iter().flat_map(|played| played.keys()).for_each(|key| *counts.entry(key).or_default() += 1);
        all.iter().map(|played| played.keys().any(|key| counts.get(&key).is_some_and(|count| *count > 1))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::results;
    use super::*;

    #[test]
    fn what_two_share() {
        let (a, mut other) = (results(1), results(2));
        assert_eq!(PlayedEpisodes::of(&a).shared(&PlayedEpisodes::of(&other)), 48);
        assert!(PlayedEpisodes::of(&a).has("S12", 3, 0) && !PlayedEpisodes::of(&a).has("S12", 4, 0));
        other.episodes.iter_mut().filter(|row| row.task == "S01").for_each(|row| row.seed += 100);
        assert_eq!(PlayedEpisodes::of(&a).shared(&PlayedEpisodes::of(&other)), 44);
        let mut elsewhere = results(2);
        elsewhere.episodes.iter_mut().for_each(|row| row.seed += 200);
        let all = [&a, &elsewhere, &other].map(PlayedEpisodes::of);
        assert_eq!(PlayedEpisodes::any_shared(&all.each_ref()), [true, false, true]);
        other.conditions.benchmark_version += 1;
        assert_eq!(PlayedEpisodes::of(&a).shared(&PlayedEpisodes::of(&other)), 0);
    }
}
