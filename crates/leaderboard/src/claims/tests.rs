//! Claims, badge and division by the facts.

use super::*;
use crate::standings::tests::{hosted, results};

/// A change of the facts, of the stage, of the episodes simulated again; and what follows: the badge, the proofs of rows,
/// senses and tries in their first letters, the table, and a part of the obstacle.
type Case = (&'static str, fn(&mut Results), bool, Stage, [u64; 3], Badge, &'static str, Option<Kind>, &'static str);

const ALL: [u64; 3] = [48, 48, 0];

/// The one table of what an entry proves. Nothing that is only claimed gives a division, and what cannot be compared is
/// not ranked.
#[test]
#[rustfmt::skip]
fn what_an_entry_proves() {
    use Badge::{Hosted, Replayed, SelfReported};
    use Stage::{Graded, Received, Refused, Verified};
    let nothing: fn(&mut Results) = |_| {};
    let cases: &[Case] = &[
        ("replayed", nothing, false, Verified, ALL, Replayed, "pcc", Some(Kind::Replayed), ""),
        ("hosted", nothing, true, Verified, ALL, Hosted, "ppc", Some(Kind::Hosted), ""),
        ("hosted, not replayed", nothing, true, Graded, [48, 0, 0], Hosted, "ppc", Some(Kind::Hosted), ""),
        ("hosted, servers refuse", nothing, true, Verified, [48, 0, 48], Hosted, "ppc", Some(Kind::Hosted), ""),
        ("waiting", nothing, false, Graded, [48, 47, 0], SelfReported, "ccc", None, "47 of 48 episodes"),
        ("refused by servers", nothing, false, Verified, [48, 47, 1], SelfReported, "ccc", None, "refuse to play 1 of 48"),
        ("no bag", nothing, false, Verified, [0, 0, 0], SelfReported, "ccc", None, "self-reported"),
        ("refused", nothing, false, Refused, ALL, SelfReported, "rcc", None, "because"),
        ("refused, hosted", nothing, true, Refused, ALL, SelfReported, "rpc", None, "because"),
        ("not graded", nothing, false, Received, [0, 0, 0], SelfReported, "ccc", None, "not graded"),
        ("real time", |r| r.conditions.time = "real time".into(), false, Verified, ALL, Replayed, "pcc", Some(Kind::Replayed), ""),
        ("privileged", |r| r.conditions.observations = "privileged".into(), false, Verified, ALL, Replayed, "pcc", Some(Kind::Replayed), ""),
        ("exact sensors", exact, false, Verified, ALL, Replayed, "pcc", Some(Kind::Replayed), ""),
        ("exact sensors, hosted", exact, true, Verified, ALL, Hosted, "ppc", None, "sensors are exact"),
        ("other sensors, hosted", |r| r.conditions.observations = "other".into(), true, Verified, ALL, Hosted, "ppc", None, "observations are 'other'"),
        ("goal, hosted", |r| r.conditions.observations = "goal".into(), true, Verified, ALL, Hosted, "ppc", Some(Kind::Hosted), ""),
        ("goal, exact, hosted", exact_goal, true, Verified, ALL, Hosted, "ppc", None, "sensors are exact"),
        ("goal", |r| r.conditions.observations = "goal".into(), false, Verified, ALL, Replayed, "pcc", Some(Kind::Replayed), ""),
        ("one hosted room", |r| keep(r, |_, room| room == 1 << 40), true, Verified, ALL, Hosted, "ppc", None, "1 hosted room; a ranking"),
        ("person", |r| r.conditions.source = "person".into(), false, Verified, ALL, Replayed, "prc", None, "a person"),
        ("person, hosted", |r| r.conditions.source = "person".into(), true, Verified, ALL, Hosted, "prc", None, "a person"),
        ("take", |r| r.conditions.takes = true, false, Verified, ALL, Replayed, "prc", None, "a person"),
        ("delay", |r| r.conditions.deviations.push("actions are delayed by 20 ms".into()), false, Verified, ALL, Replayed, "pcc", None, "delayed"),
        ("delay, hosted", |r| r.conditions.deviations.push("actions are delayed by 20 ms".into()), true, Verified, ALL, Hosted, "ppc", None, "delayed"),
        ("published", |r| r.conditions.protocol = "published".into(), false, Verified, ALL, Replayed, "pcc", None, "protocol strict"),
        ("robot", |r| r.conditions.robot = "g1_bare".into(), false, Verified, ALL, Replayed, "pcc", None, "g1_bare"),
        ("time", |r| r.conditions.time = "no time".into(), false, Verified, ALL, Replayed, "pcc", None, "no time"),
        ("objects", objects, false, Verified, ALL, Replayed, "pcc", Some(Kind::Replayed), ""),
        ("no journal", |r| r.without_journal = vec!["run".into()], false, Verified, ALL, Replayed, "pcc", None, "journal is missing"),
        ("one subtask", |r| keep(r, |task, _| task == "S06"), false, Verified, [4, 4, 0], Replayed, "pcc", Some(Kind::Replayed), "it played only S06"),
        ("eleven subtasks", |r| keep(r, |task, _| task != "S01"), false, Verified, [44, 44, 0], Replayed, "pcc", Some(Kind::Replayed), "no episode of S01"),
        ("one room less in S09", |r| keep(r, |task, room| (task, room) != ("S09", 3)), false, Verified, ALL, Replayed, "pcc", Some(Kind::Replayed), "S01 and S09"),
        ("three rooms", |r| keep(r, |_, room| room < 3), false, Verified, ALL, Replayed, "pcc", None, "at least 4"),
        ("three hosted rooms", |r| keep(r, |_, room| room != 1 << 40), true, Verified, ALL, Hosted, "ppc", None, "3 hosted rooms"),
        ("chosen rooms", |r| move_rooms(r, |room| room + 64), false, Verified, ALL, Replayed, "pcc", None, "without a gap"),
        ("a gap", |r| move_rooms(r, |room| if room == 3 { 64 } else { room }), false, Verified, ALL, Replayed, "pcc", None, "without a gap"),
        ("rooms for training", |r| move_rooms(r, |room| room + 5000), false, Verified, ALL, Replayed, "pcc", None, "without a gap"),
        ("second episodes", |r| r.episodes.iter_mut().for_each(|row| row.episode = 1), false, Verified, ALL, Replayed, "pcc", None, "only the first"),
        ("hosted rooms, unsigned", |r| r.conditions.seeds = "hosted".into(), false, Verified, ALL, Replayed, "pcc", None, "not signed"),
    ];
    for (name, change, is_hosted, stage, [episodes, equal, refused], badge, proofs, table, obstacle) in cases {
        let mut results = if *is_hosted { hosted(4) } else { results(4) };
        change(&mut results);
        let progress = Progress { episodes: *episodes, equal: *equal, refused: *refused };
        let found = decide(&Facts::of(&results, *is_hosted), *stage, "because", progress, None);
        let Claims { rows, senses, tries } = &found.claims;
        let letters: String = [rows, senses, tries].map(|claim| crate::submission::word_to(claim.proof).remove(0)).into_iter().collect();
        assert_eq!((found.badge, &*letters), (*badge, *proofs), "{name}: {found:?}");
        assert_eq!(found.division.as_ref().map(|division| division.table), *table, "{name}: {found:?}");
        assert!(found.obstacle.contains(obstacle) && found.obstacle.is_empty() == obstacle.is_empty(), "{name}: {found:?}");
        assert!([rows, senses, tries].iter().all(|claim| !claim.reason.is_empty()), "{name}: {found:?}");
    }
}

fn exact(results: &mut Results) {
    results.conditions.observations = "other".into();
    results.conditions.deviations.push("sensors are exact".into());
}

fn exact_goal(results: &mut Results) {
    exact(results);
    results.conditions.observations = "goal".into();
}

fn objects(results: &mut Results) {
    results.conditions.assets = vec!["crate abc".into()];
    results.conditions.deviations.push(format!("{OBJECTS}crate abc"));
}

fn keep(results: &mut Results, is_kept: fn(&str, u64) -> bool) {
    results.episodes.retain(|row| is_kept(&row.task, row.seed));
}

fn move_rooms(results: &mut Results, to: fn(u64) -> u64) {
    results.episodes.iter_mut().for_each(|row| row.seed = to(row.seed));
}

/// Guards entries that a service noted before it ranked `goal`: their stored sentence bars them no longer, and that of others does.
#[test]
fn facts_of_before_the_goal_division_are_ranked() {
    let noted = |observations: &str| {
        let mut results = hosted(4);
        results.conditions.observations = observations.into();
        let odd_senses = format!("observations are '{observations}'");
        let facts = Facts { odd_senses, ..Facts::of(&results, true) };
        decide(&facts, Stage::Verified, "", Progress::default(), None)
    };
    assert_eq!(noted("goal").division.and_then(|division| division.observations), Some(Observations::Goal));
    assert_eq!((noted("other").division, &*noted("other").obstacle), (None, "observations are 'other'"));
}

/// Guards that a relabelled entry has the division of the honest one, so that no label gains a place.
#[test]
fn labels_gain_nothing() {
    let place = |change: fn(&mut Results)| {
        let mut changed = results(4);
        change(&mut changed);
        let progress = Progress { episodes: 48, equal: 48, refused: 0 };
        decide(&Facts::of(&changed, false), Stage::Verified, "", progress, None).division
    };
    let honest = place(|r| r.conditions.observations = "privileged".into());
    assert!(honest.is_some());
    let labels: [fn(&mut Results); 5] = [
        |r| r.policy = "nova-vla".into(),
        |r| r.conditions.observations = "standard".into(),
        |r| r.conditions.observations = "goal".into(),
        |r| r.conditions.time = "real time".into(),
        exact,
    ];
    assert!(labels.into_iter().all(|label| place(label) == honest));
}

#[test]
fn one_episode_decides_for_all() {
    use Consequence::{Refused, Verified, Waits};
    let cases = [
        (false, true, false, 7, Refused),
        (true, true, false, 0, Refused),
        (false, false, true, 7, Refused),
        (true, false, true, 7, Waits),
        (true, false, true, 0, Verified),
        (false, false, false, 1, Waits),
        (false, false, false, 0, Verified),
    ];
    for (hosted, differs, refused, waiting, expected) in cases {
        assert_eq!(consequence(hosted, differs, refused, waiting), expected, "{hosted} {differs} {refused} {waiting}");
    }
}

fn label(policy: &str) -> Label {
    Label { policy: policy.into(), senses: "lockstep".into() }
}

/// Guards that rows have one owner and one name.
#[test]
fn rows_have_one_owner() {
    let row = |first: &str, account: &str, policy: &str, person: bool| KnownRow {
        task: "S05".into(),
        seed: "0".into(),
        first: first.into(),
        account: account.into(),
        label: label(policy),
        person,
        said: ("S05".into(), 0),
    };
    let count = BTreeMap::from([("one".to_owned(), 2)]);
    let of = |known: &[KnownRow]| origin("lab", &label("zero"), known, &count);
    let own = row("one", "lab", "zero", false);
    assert_eq!(of(&[]), Origin::Own { replaces: BTreeSet::new() });
    assert_eq!(of(&[own.clone(), own.clone()]), Origin::Own { replaces: BTreeSet::from(["one".into()]) });
    let refused = [
        (vec![own.clone()], "some of the episodes of your submission one"),
        (vec![row("one", "other", "zero", false)], "S05, seed 0: these rows were already submitted as one by other"),
        (vec![own.clone(), row("two", "other", "zero", false)], "submitted as two by other"),
        (vec![row("one", "lab", "best", false)], "as policy 'best'"),
        (vec![row("one", "lab", "zero", true)], "a person"),
        (vec![KnownRow { seed: "1".into(), ..own.clone() }], "this one says that they are of S05, seed 0"),
        (vec![KnownRow { task: "S06".into(), ..own.clone() }], "this one says that they are of S05, seed 0"),
    ];
    for (known, expected) in refused {
        let Origin::Refused(reason) = of(&known) else { panic!("{expected}") };
        assert!(reason.contains(expected), "{reason}");
    }
}
