//! Two runs compared: pairs, closed-form p-values, and refusals.

use std::path::PathBuf;

use crate::common::Folder;
use fiatlux_grading::{CompareError, RESULTS_VERSION, compare};
use serde_json::{Value, json};

/// An episode of `results.json`, with the fields that a comparison reads.
fn episode(task: &str, seed: u64, success: bool, gate_progress: f64) -> Value {
    json!({ "task": task, "seed": seed, "episode": 0, "success": success, "gate_progress": gate_progress })
}

fn results(policy: &str, episodes: Vec<Value>) -> Value {
    json!({
        "policy": policy,
        "episodes": episodes,
        "conditions": { "protocol": "published", "time": "lockstep", "sensors": [policy] },
        "versions": { "results": RESULTS_VERSION },
    })
}

/// Writes `results.json` into a folder named after the run.
fn written(folder: &Folder, name: &str, results: &Value) -> PathBuf {
    let path = folder.0.join(name);
    std::fs::create_dir_all(&path).unwrap();
    std::fs::write(path.join("results.json"), results.to_string()).unwrap();
    path
}

/// A succeeds in 9 of 48 rooms and B in one other; A is ahead by a quarter of the gate in 12 and behind in 3.
#[test]
fn p_values_are_those_of_closed_forms() {
    let folder = Folder::new("compare");
    let pair = |seed: u64| {
        let task = if seed < 24 { "S01" } else { "S02" };
        let progress = if seed < 12 { [0.75, 0.5] } else { [0.25, if seed < 15 { 0.5 } else { 0.25 }] };
        [(seed < 9, progress[0]), (seed == 20, progress[1])].map(|(success, p)| episode(task, seed, success, p))
    };
    let [a, b] = [0, 1].map(|side| (0..48).map(|seed| pair(seed)[side].clone()).collect());
    let (a, b) = (written(&folder, "a", &results("one", a)), written(&folder, "b", &results("two", b)));
    let compared = compare(&a, &b, false).unwrap();
    let all = compared.overall.clone().unwrap();
    assert_eq!((all.pairs, all.successes_a, all.successes_b, all.only_a, all.only_b), (48, 9, 1, 9, 1));
    // 2 (C(10, 0) + C(10, 1)) / 2^10.
    assert_eq!(all.success_p, 22.0 / 1024.0);
    // 2 (C(15, 0) + C(15, 1) + C(15, 2) + C(15, 3)) / 2^15.
    assert_eq!(all.progress_p, 2.0 * (1.0 + 15.0 + 105.0 + 455.0) / 32768.0);
    let [s01, s02] = &compared.tasks[..] else { panic!("{:?}", compared.tasks) };
    assert_eq!((s01.task.as_str(), s01.pairs, s01.success_p), ("S01", 24, 22.0 / 1024.0));
    assert_eq!((s02.pairs, s02.success_p, s02.progress_p, s02.score_difference), (24, 1.0, 1.0, 0.0));
    // Half of 8 successes and half of 9 quarters more in 24 pairs; S01 weighs 2.25 and S02 3.
    let expected = 0.5 * (8.0 + 2.25) / 24.0;
    assert!((s01.score_difference - expected).abs() < 1e-12);
    assert!((all.score_difference - expected * 2.25 / 5.25).abs() < 1e-12);
    assert_eq!(compared.success, "published");
    let text = compared.to_text();
    assert!(text.contains("A: one") && text.contains("published successes") && text.contains("0.0215"), "{text}");
    // With A and B swapped, the p-values are the same.
    let turned = compare(&b, &a, false).unwrap().overall.unwrap();
    assert_eq!((turned.success_p, turned.progress_p), (all.success_p, all.progress_p));
    assert_eq!(turned.score_difference, -all.score_difference);
}

/// Guards that the strict gate decides only if every episode has a strict verdict.
#[test]
fn strict_successes_count_where_all_episodes_have_them() {
    let folder = Folder::new("compare-strict");
    let strict = |strict: bool| {
        let mut row = episode("S02", 0, true, 1.0);
        row["strict_success"] = json!(strict);
        row["strict_progress"] = json!(if strict { 1.0 } else { 0.25 });
        row
    };
    let a = written(&folder, "a", &results("one", vec![strict(true)]));
    let b = written(&folder, "b", &results("two", vec![strict(false)]));
    let plain = written(&folder, "plain", &results("three", vec![episode("S02", 0, true, 1.0)]));
    let compared = compare(&a, &b, false).unwrap();
    assert_eq!((compared.success.as_str(), compared.tasks[0].successes_b), ("strict", 0));
    // Both halves of the score come from the strict judge.
    assert_eq!((compared.tasks[0].progress_b, compared.tasks[0].score_difference), (0.25, 0.5 * (1.0 + 0.75)));
    let compared = compare(&b, &plain, false).unwrap();
    assert_eq!((compared.success.as_str(), compared.tasks[0].successes_a), ("published", 1));
}

#[test]
fn what_does_not_compare_is_refused_by_name() {
    let folder = Folder::new("compare-refused");
    let of = |seeds: &[u64]| results("one", seeds.iter().map(|seed| episode("S01", *seed, false, 0.0)).collect());
    let a = written(&folder, "a", &of(&[0, 1]));
    let refused =
        |name: &str, results: &Value| compare(&a, &written(&folder, name, results), false).expect_err(name).to_string();
    let mut other = of(&[0]);
    other["conditions"]["time"] = json!("real time");
    let message = refused("time", &other);
    assert!(message.starts_with("time is \"lockstep\" in A and \"real time\" in B"), "{message}");
    let mut lacks = of(&[0]);
    lacks["conditions"].as_object_mut().unwrap().remove("protocol");
    assert!(refused("lacks", &lacks).starts_with("protocol is \"published\" in A and null in B"));
    assert!(refused("apart", &of(&[2])).contains("play both on the same seeds"));
    assert!(refused("twice", &of(&[0, 0])).contains("has S01, seed 0, episode 0 twice"));
    let mut old = of(&[0]);
    old["versions"]["results"] = json!(1);
    assert!(refused("old", &old).contains("form 1 of results.json"));
    assert!(refused("nothing", &json!({})).contains("is not a results.json of this scorer"));
    assert!(matches!(compare(&folder.0, &a, false), Err(CompareError::Read { .. })));

    let compared = compare(&a, &folder.0.join("time"), true).unwrap();
    assert_eq!(compared.different_conditions, ["time"]);
    assert_eq!((compared.a.unpaired, compared.b.unpaired), (1, 0));
}
