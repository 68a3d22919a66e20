//! Number of tries: every hosted run that was registered on a server of this board counts.
//!
//! Runs of one holder, policy and version are tries of the same. The first of them counts, as the first attempt at an episode
//! does. One that nobody has submitted some days after its registration counts as failures.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

/// Days after which a registered hosted run that was not submitted counts as failures.
pub(crate) const GRACE_DAYS: i64 = 7;
const DAY_MS: i64 = 24 * 3600 * 1000;

/// A hosted run in the journal of a server.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct HostedRun {
    pub server: String,
    pub run: String,
    /// The token that registered it; empty where the server has no tokens.
    pub holder: String,
    pub policy: String,
    pub version: String,
    /// ms since 1970.
    pub registered_ms: i64,
    /// Number of its episodes by subtask.
    pub episodes: BTreeMap<String, u64>,
}

/// The tries of an entry's policy, its own run among them.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct Tries {
    /// Runs of the same holder, policy and version, and those of them that were submitted.
    pub registered: u64,
    pub shown: u64,
    /// Runs that may still be submitted.
    pub open: u64,
    /// Episodes by subtask of the runs that were not: they count as failures.
    pub failed: BTreeMap<String, u64>,
    /// Name of an earlier run that was submitted, too.
    pub earlier: Option<String>,
    /// Runs of the same holder under other names or versions.
    pub others: u64,
}

impl Tries {
    /// In words.
    pub fn said(&self) -> String {
        let Self { registered, shown, open, others, .. } = self;
        let failed = registered.saturating_sub(shown + open);
        let mut said = format!("{shown} of {registered} hosted runs of this policy and version were submitted");
        if failed > 0 {
            said += &format!("; {failed} count as failures");
        }
        if *open > 0 {
            said += &format!("; {open} count as failures {GRACE_DAYS} days after registration");
        }
        if *others > 0 {
            said += &format!("; its holder has {others} more under other names or versions");
        }
        said
    }

    /// Why the entry is not ranked.
    pub fn obstacle(&self) -> Option<String> {
        let earlier = self.earlier.as_ref()?;
        Some(format!(
            "the first hosted run of a policy and version counts, and that is {earlier}; give a changed policy a new version"
        ))
    }
}

/// The tries of the policy of an entry's runs; `None` if no journal of these servers has the first of them. `shown` has the
/// runs of all entries.
pub(crate) fn tries_of(
    runs: &[String],
    servers: &[String],
    known: &[HostedRun],
    shown: &BTreeSet<String>,
    now_ms: i64,
) -> Option<Tries> {
    let is_own = |other: &HostedRun| runs.contains(&other.run) && servers.contains(&other.server);
    let first = |a: &&HostedRun, b: &&HostedRun| (a.registered_ms, &a.run).cmp(&(b.registered_ms, &b.run));
    let own = known.iter().filter(|other| is_own(other)).min_by(first)?;
    let is_same =
        |other: &&HostedRun| (&other.holder, &other.policy, &other.version) == (&own.holder, &own.policy, &own.version);
    let mut tries = Tries::default();
    // Several servers may have a journal of one run.
    let mut seen = BTreeSet::new();
    for other in known.iter().filter(|other| seen.insert(other.run.as_str())) {
        if !is_same(&other) {
            tries.others += u64::from(!own.holder.is_empty() && other.holder == own.holder);
            continue;
        }
        tries.registered += 1;
        if shown.contains(&other.run) {
            tries.shown += 1;
            let before = (other.registered_ms, &other.run) < (own.registered_ms, &own.run);
            if before && tries.earlier.is_none() {
                tries.earlier = Some(other.run.clone());
            }
        } else if !is_own(other) {
            match other.registered_ms + GRACE_DAYS * DAY_MS > now_ms {
                true => tries.open += 1,
                false => other
                    .episodes
                    .iter()
                    .for_each(|(task, count)| *tries.failed.entry(task.clone()).or_default() += count),
            }
        }
    }
    Some(tries)
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: i64 = 100 * DAY_MS;

    fn run(name: &str, holder: &str, policy: &str, days_ago: i64) -> HostedRun {
        HostedRun {
            server: "lab".into(),
            run: name.into(),
            holder: holder.into(),
            policy: policy.into(),
            version: "1".into(),
            registered_ms: NOW - days_ago * DAY_MS,
            episodes: [("S05".to_owned(), 4)].into(),
        }
    }

    fn tries(known: &[HostedRun], shown: &[&str]) -> Option<Tries> {
        let shown = shown.iter().map(|&run| run.to_owned()).collect();
        tries_of(&["b".to_owned()], &["lab".to_owned()], known, &shown, NOW)
    }

    /// Guards that of three registered hosted runs of which one is submitted, the other two count as failures once their
    /// time is over, and that the entry says so before.
    #[test]
    fn registered_runs_count() {
        let three = |days| ["a", "b", "c"].map(|name| run(name, "", "nova", days));
        let fresh = tries(&three(1), &["b"]).expect("known");
        assert_eq!((fresh.registered, fresh.shown, fresh.open, fresh.failed.len()), (3, 1, 2, 0));
        assert_eq!(
            fresh.said(),
            "1 of 3 hosted runs of this policy and version were submitted; 2 count as failures 7 days after registration"
        );
        let old = tries(&three(8), &["b"]).expect("known");
        assert_eq!((old.open, old.failed.get("S05")), (0, Some(&8)));
        assert_eq!(old.said(), "1 of 3 hosted runs of this policy and version were submitted; 2 count as failures");
        assert_eq!(old.obstacle(), None);
    }

    /// Guards that the best of several submitted runs does not lead: the first counts.
    #[test]
    fn the_first_run_counts() {
        let known = [run("a", "", "nova", 9), run("b", "", "nova", 8)];
        let second = tries(&known, &["a", "b"]).expect("known");
        assert!(second.obstacle().is_some_and(|why| why.contains("that is a;")), "{second:?}");
        assert_eq!((second.shown, second.failed.len()), (2, 0));
        let first = tries(&[run("b", "", "nova", 9), run("z", "", "nova", 8)], &["b", "z"]).expect("known");
        assert_eq!(first.obstacle(), None);
    }

    /// Guards that nobody counts the runs of another holder, policy or version as tries, and that another name is no
    /// hiding place: the entry says how many there are.
    #[test]
    fn others_runs_are_no_tries() {
        let known = [
            run("b", "token a1", "nova", 9),
            run("c", "token a2", "nova", 9),
            run("d", "token a1", "nova-2", 9),
            HostedRun { version: "2".into(), ..run("e", "token a1", "nova", 9) },
            HostedRun { server: "lab-2".into(), ..run("b", "token a1", "nova", 9) },
        ];
        let found = tries(&known, &["b"]).expect("known");
        assert_eq!((found.registered, found.failed.len(), found.others), (1, 0, 2));
        assert!(found.said().ends_with("its holder has 2 more under other names or versions"), "{}", found.said());
        assert_eq!(tries(&known[1..4], &["b"]), None, "no journal of these servers has the run");
    }
}
