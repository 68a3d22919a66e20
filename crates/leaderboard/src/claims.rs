//! Proof and rank of an entry: pure functions from facts to claims, badge and division. Nothing else decides these.
//!
//! An entry makes three claims, and each has a proof of its own:
//!
//! | claim | says | proof |
//! |---|---|---|
//! | *rows* | this motion happened in this room | the actions, simulated again; or the signature of a server of this board |
//! | *senses* | whoever acted was shown these sensors alone; refused where the bags say that a person drove | a hosted run: the server chose the room after registration and sent the sensors |
//! | *tries* | how often it was tried | hosted runs, whose servers keep a journal of every registration |
//!
//! Hosted runs have divisions by what is proven of them. Everybody else's bags share one table of proven motion, whatever
//! they claim besides: a changed label gains nothing there.

mod rooms;
#[cfg(test)]
mod tests;
mod tries;

use std::collections::{BTreeMap, BTreeSet};

use fiatlux_grading::{Conditions, OBJECTS, Results, is_of_senses};
use fiatlux_rules::{Task, pins};
use serde::{Deserialize, Serialize};

use crate::submission::{Badge, Claim, Claims, Division, Kind, Observations, Proof, Stage, Time};
pub(crate) use rooms::{FIXED_ROOMS, MIN_ROOMS};
use rooms::{check_rooms, same_rooms};
pub(crate) use tries::{GRACE_DAYS, HostedRun, Tries, tries_of};

/// Nothing is known of its bags.
const NOT_GRADED: &str = "its bags are not graded";

/// Facts that grading established about a submission. They do not change afterwards.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(crate) struct Facts {
    /// Words of [`Conditions`].
    pub observations: String,
    pub time: String,
    pub robot: String,
    pub assets: Vec<String>,
    /// Why its conditions are those of no ranking; may be empty.
    pub deviation: String,
    /// Deviations of its senses; may be empty. Only a hosted run proves its senses, so they matter there alone.
    pub odd_senses: String,
    /// Its bags say that a person drove.
    pub person: bool,
    /// A finished run in rooms that a server of this board drew, with its signature under every bag and journal.
    pub hosted: bool,
    /// Names of its runs, several if it was played in parts, and the servers that have a journal of one; empty for loose bags.
    pub runs: Vec<String>,
    pub servers: Vec<String>,
    /// Its bags belong to a run whose journal is not there.
    pub lost_journal: bool,
    /// Why it has no place among all twelve subtasks; may be empty.
    pub not_whole: String,
    /// Subtasks that it played in the rooms of a ranking.
    pub tasks: Vec<String>,
    /// Why none of them is; may be empty.
    pub odd_rooms: String,
}

impl Facts {
    /// The facts in results; `hosted` if the signatures of a hosted run are whole.
    pub fn of(results: &Results, hosted: bool) -> Self {
        let conditions = &results.conditions;
        let (odd_senses, deviation) = deviations(conditions);
        let played: Vec<Task> = Task::SUBTASKS
            .into_iter()
            .filter(|task| results.episodes.iter().any(|row| row.task == task.short_id()))
            .collect();
        let checked: Vec<_> = played.iter().map(|task| (*task, check_rooms(results, *task, hosted))).collect();
        let tasks = checked.iter().filter(|(_, checked)| checked.is_ok()).map(|(task, _)| task.short_id().to_owned());
        let odd_rooms = checked.iter().find_map(|(_, checked)| checked.clone().err());
        let tasks: Vec<String> = tasks.collect();
        let run = results.run.as_ref();
        Self {
            observations: conditions.observations.clone(),
            time: conditions.time.clone(),
            robot: conditions.robot.clone(),
            assets: conditions.assets.clone(),
            deviation,
            odd_senses,
            person: conditions.source == "person" || conditions.takes,
            hosted,
            runs: run.map(|run| run.name.split('+').map(str::to_owned).collect()).unwrap_or_default(),
            servers: run.map(|run| run.servers.clone()).unwrap_or_default(),
            lost_journal: !results.without_journal.is_empty(),
            not_whole: same_rooms(results, hosted).err().unwrap_or_default(),
            odd_rooms: if tasks.is_empty() {
                odd_rooms.unwrap_or_else(|| "no episode of a subtask".into())
            } else {
                String::new()
            },
            tasks,
        }
    }

    /// The senses that it claims, in words: `standard observations, lockstep`.
    pub fn senses(&self) -> String {
        format!("{} observations, {}", self.observations, self.time)
    }
}

/// The deviations of the senses alone, and all others, each as one text.
fn deviations(conditions: &Conditions) -> (String, String) {
    // Another robot is a division of its own, not a deviation, and so are other objects.
    let is_division = |deviation: &&String| deviation.starts_with("the robot is '") || deviation.starts_with(OBJECTS);
    let all = conditions.deviations.iter().filter(|deviation| !is_division(deviation));
    let (senses, mut others): (Vec<String>, Vec<String>) = all.cloned().partition(|deviation| is_of_senses(deviation));
    if conditions.protocol != "strict" {
        others.push("the episodes were not played by protocol strict".into());
    }
    if !pins::RANKED_ROBOTS.contains(&conditions.robot.as_str()) {
        others.push(format!("the robot '{}' is not ranked", conditions.robot));
    }
    if !["lockstep", "real time"].contains(&conditions.time.as_str()) {
        others.push(format!("its time is '{}'", conditions.time));
    }
    (senses.join("; "), others.join("; "))
}

/// Number of episodes that were simulated again, of those that have a bag.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Progress {
    pub episodes: u64,
    pub equal: u64,
    /// Servers refuse to play them.
    pub refused: u64,
}

impl Progress {
    fn is_whole(self) -> bool {
        self.episodes > 0 && self.equal == self.episodes
    }
}

/// Badge, claims and rank that follow from facts.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Standpoint {
    pub badge: Badge,
    pub claims: Claims,
    /// Where it is ranked, among all twelve subtasks or in some; `None` if nowhere.
    pub division: Option<Division>,
    /// Why it is not ranked among all twelve; empty if it is.
    pub obstacle: String,
}

/// Decides what an entry in this stage proves, and where it ranks. `reason` is that of a refusal.
pub(crate) fn decide(
    facts: &Facts,
    stage: Stage,
    reason: &str,
    progress: Progress,
    tries: Option<&Tries>,
) -> Standpoint {
    let refused = stage == Stage::Refused;
    let badge = match () {
        () if refused => Badge::SelfReported,
        () if facts.hosted => Badge::Hosted,
        () if progress.is_whole() => Badge::Replayed,
        () => Badge::SelfReported,
    };
    let claims = Claims {
        rows: if refused { Claim::new(Proof::Refused, reason) } else { rows_claim(facts, badge, progress) },
        senses: senses_claim(facts),
        tries: tries_claim(facts, tries),
    };
    let barred = obstacle(facts, stage, reason, badge, progress, tries);
    let division = barred.is_none().then(|| division(facts)).flatten();
    let obstacle = barred.unwrap_or_else(|| facts.not_whole.clone());
    Standpoint { badge, claims, division, obstacle }
}

fn rows_claim(facts: &Facts, badge: Badge, progress: Progress) -> Claim {
    let lockstep = if facts.time == "real time" { ", in lockstep" } else { "" };
    match badge {
        Badge::Hosted => Claim::new(Proof::Proven, "recorded and signed by this board's own server"),
        Badge::Replayed => {
            Claim::new(Proof::Proven, format!("every episode was simulated again{lockstep}, equal to the last bit"))
        }
        Badge::SelfReported => {
            let Progress { episodes, equal, .. } = progress;
            Claim::new(Proof::Claimed, format!("{equal} of {episodes} episodes were simulated again so far"))
        }
    }
}

fn senses_claim(facts: &Facts) -> Claim {
    if facts.time.is_empty() {
        return Claim::new(Proof::Claimed, NOT_GRADED);
    }
    let senses = facts.senses();
    match (facts.person, facts.hosted) {
        (true, _) => Claim::new(Proof::Refused, "a person drove, by what the bags say"),
        (false, true) => {
            Claim::new(Proof::Proven, format!("{senses}: the server drew the rooms and sent nothing else"))
        }
        (false, false) => Claim::new(
            Proof::Claimed,
            format!("{senses}, by what the bags say: whoever has a bag's actions can send them under another label"),
        ),
    }
}

fn tries_claim(facts: &Facts, tries: Option<&Tries>) -> Claim {
    if facts.time.is_empty() {
        return Claim::new(Proof::Claimed, NOT_GRADED);
    }
    match tries.filter(|_| facts.hosted) {
        Some(tries) => Claim::new(Proof::Proven, tries.said()),
        None if facts.hosted => Claim::new(
            Proof::Claimed,
            "this board does not read the journals of its servers, so it cannot count other runs",
        ),
        None if !facts.runs.is_empty() => {
            Claim::new(Proof::Claimed, "its journal names every episode of this run; nobody counts other runs")
        }
        None => Claim::new(Proof::Claimed, "loose bags: nobody can tell how many were left out"),
    }
}

/// Why an entry is ranked nowhere.
fn obstacle(
    facts: &Facts,
    stage: Stage,
    reason: &str,
    badge: Badge,
    progress: Progress,
    tries: Option<&Tries>,
) -> Option<String> {
    if stage == Stage::Refused {
        return Some(reason.to_owned());
    }
    if !matches!(stage, Stage::Graded | Stage::Verified) {
        return Some(NOT_GRADED.into());
    }
    if facts.person {
        return Some("a person drove it: what a person did is never ranked".into());
    }
    if !facts.deviation.is_empty() {
        return Some(facts.deviation.clone());
    }
    if facts.lost_journal {
        return Some("its journal is missing: episodes may have been left out".into());
    }
    match badge {
        Badge::SelfReported => {
            let Progress { episodes, equal, refused } = progress;
            return Some(match refused {
                0 => format!("self-reported: {equal} of {episodes} episodes were simulated again so far"),
                _ => format!("servers refuse to play {refused} of {episodes} episodes"),
            });
        }
        Badge::Hosted => {
            if let Some(odd) = odd_senses(facts) {
                return Some(odd);
            }
        }
        Badge::Replayed => {}
    }
    if facts.tasks.is_empty() {
        return Some(facts.odd_rooms.clone());
    }
    tries.filter(|_| facts.hosted).and_then(Tries::obstacle)
}

/// Why the senses of a hosted run are those of no ranking.
fn odd_senses(facts: &Facts) -> Option<String> {
    let unranked = format!("observations are '{}'", facts.observations);
    match (facts.odd_senses.as_str(), observations(facts)) {
        ("", None) => Some(unranked),
        ("", Some(_)) => None,
        // Noted by a service that did not rank these observations.
        (odd, Some(_)) if odd == unranked => None,
        (odd, _) => Some(odd.to_owned()),
    }
}

/// The observations that hosted runs are ranked by; `None` for others.
fn observations(facts: &Facts) -> Option<Observations> {
    match facts.observations.as_str() {
        "standard" => Some(Observations::Standard),
        "goal" => Some(Observations::Goal),
        "privileged" => Some(Observations::Privileged),
        _ => None,
    }
}

fn division(facts: &Facts) -> Option<Division> {
    let time = if facts.time == "real time" { Time::RealTime } else { Time::Lockstep };
    let (robot, assets) = (facts.robot.clone(), facts.assets.clone());
    match facts.hosted {
        true => observations(facts).map(|observations| Division {
            table: Kind::Hosted,
            time: Some(time),
            observations: Some(observations),
            robot,
            assets,
        }),
        false => Some(Division { table: Kind::Replayed, time: None, observations: None, robot, assets }),
    }
}

/// Meaning of a verdict on one episode for its submission.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Consequence {
    /// One episode that did not happen refuses all of them.
    Refused,
    /// The last episode was decided.
    Verified,
    Waits,
}

/// The consequence of a verdict; `waiting` episodes are left. A hosted run does not need a second run: its server saw the
/// first.
pub(crate) fn consequence(hosted: bool, differs: bool, refused: bool, waiting: u64) -> Consequence {
    match () {
        () if differs || (refused && !hosted) => Consequence::Refused,
        () if waiting == 0 => Consequence::Verified,
        () => Consequence::Waits,
    }
}

/// The labels of rows that are known, of which an equal one is a second submission of the same.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Label {
    pub policy: String,
    /// Sensors and time.
    pub senses: String,
}

/// Rows that are known already.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct KnownRow {
    pub task: String,
    pub seed: String,
    /// Id of the submission that had them first, or what an administrator called them.
    pub first: String,
    pub account: String,
    pub label: Label,
    pub person: bool,
    /// Task and seed that the new submission gives them.
    pub said: (String, u64),
}

/// Origin of a new submission's rows, by the known rows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Origin {
    /// Its rows are its own; it replaces these submissions of the same account, whose rows it has all of.
    Own { replaces: BTreeSet<String> },
    /// It has rows of somebody else, or under another name: the reason.
    Refused(String),
}

/// Compares a submission with the known rows that are among its own. `count` has the number of rows of each known submission.
pub(crate) fn origin(account: &str, label: &Label, known: &[KnownRow], count: &BTreeMap<String, u64>) -> Origin {
    let mut shared: BTreeMap<&str, u64> = BTreeMap::new();
    for row in known {
        let KnownRow { task, seed, first, account: owner, label: of, person, said: (said_task, said_seed) } = row;
        let policy = &of.policy;
        let rows = format!("{task}, seed {seed}: these rows were already submitted as {first} by {owner}");
        if *person {
            return Origin::Refused(format!("{rows}, as those of a person: what a person did is never ranked"));
        }
        if owner != account {
            return Origin::Refused(format!("{rows}, policy '{policy}'; the first submission keeps its place"));
        }
        if (task, seed) != (said_task, &said_seed.to_string()) {
            return Origin::Refused(format!("{rows}; this one says that they are of {said_task}, seed {said_seed}"));
        }
        if of != label {
            let (was, is) = (&of.senses, &label.senses);
            return Origin::Refused(format!(
                "{rows} as policy '{policy}' ({was}); this one says '{}' ({is}), and one of the two is wrong",
                label.policy
            ));
        }
        *shared.entry(first).or_default() += 1;
    }
    let part = shared.iter().find(|(first, shared)| count.get(**first).is_some_and(|count| *count > **shared));
    match part {
        Some((first, _)) => Origin::Refused(format!(
            "it has some of the episodes of your submission {first}, but not all; submit all of them together, or ask the \
             administrator to remove that one"
        )),
        None => Origin::Own { replaces: shared.into_keys().map(str::to_owned).collect() },
    }
}
