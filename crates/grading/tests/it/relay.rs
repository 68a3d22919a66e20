//! Relays: the subtasks within an errand, and whom a result belongs to.

use fiatlux_bag::{BagWriter, topic};
use fiatlux_grading::{GradeOptions, Results, ScoreError, grade, report, tables};
use fiatlux_proto::{Message, v3};
use fiatlux_rules::{Row, Task};
use fiatlux_wire::state_message;

use crate::common::room::{goal_of, row_at, start_of, topple};
use crate::common::{Folder, header, requested, result, sealed};

const RELAY: &str = "expert with S07=zero";

/// An errand that begins at S07 and ends with a fall: each row's state, and the phase of the action that answers it.
fn write(folder: &Folder, policy: &str, seed: u64, course: &[(Row, &str)]) {
    let header = requested(sealed(v3::EpisodeHeader { policy: policy.into(), ..header(Task::Replace, seed) }));
    let mut rows: Vec<Row> = course.iter().zip(0..).map(|((state, _), step)| row_at(step, state)).collect();
    topple(rows.last_mut().unwrap());
    let mut writer = BagWriter::create(&folder.0.join(format!("{seed}.mcap")), &header).unwrap();
    for (row, (_, phase)) in rows.iter().zip(course) {
        writer.message(topic::STATE, row.step, &state_message(row).encode_to_vec()).unwrap();
        if row.step + 1 < rows.len() as u64 {
            let chunk = v3::Chunk { phase: (*phase).into(), ..v3::Chunk::default() };
            let action = v3::Action { step: row.step, chunk: Some(chunk), ..v3::Action::default() };
            let record = v3::ActionRecord { action: Some(action), ..v3::ActionRecord::default() };
            writer.message(topic::ACTION, row.step, &record.encode_to_vec()).unwrap();
        }
    }
    writer.finish(&result(&header, &rows)).unwrap();
}

fn course(parts: &[(Row, &'static str, usize)]) -> Vec<(Row, &'static str)> {
    parts.iter().flat_map(|(row, phase, count)| std::iter::repeat_n((row.clone(), *phase), *count)).collect()
}

fn graded(folder: &Folder) -> Result<Results, ScoreError> {
    grade(
        std::slice::from_ref(&folder.0),
        &GradeOptions { relative_to: folder.0.clone(), ..GradeOptions::default() },
        &|_| {},
    )
}

/// A part succeeds by its own gate, and not by that of the errand; what the same policy begins again at once goes on.
#[test]
fn parts_are_judged_from_where_they_begin() {
    let folder = Folder::new("parts");
    let (start, goal, next) = (start_of(Task::S07), goal_of(Task::S07), start_of(Task::S08));
    write(
        &folder,
        RELAY,
        1,
        &course(&[(start.clone(), "S07", 20), (goal.clone(), "S07", 40), (next, "S08: Reach", 30)]),
    );
    // It stands, and another part is played between its two tries.
    let stands = [(start.clone(), "S07", 30), (start.clone(), "S06: Lean", 10), (start.clone(), "S07", 30)];
    write(&folder, RELAY, 2, &course(&stands));
    // The goal of a part is reached by the next one alone, and while nobody plays it.
    let late =
        [(start.clone(), "S07", 20), (start, "S08: Reach", 1), (goal.clone(), "S08: Reach", 29), (goal, "Stand", 20)];
    write(&folder, RELAY, 3, &course(&late));
    let results = graded(&folder).unwrap();
    let parts: Vec<_> =
        results.episodes[0].parts.iter().map(|part| (part.task.as_str(), part.first_step, part.success)).collect();
    assert_eq!(parts, [("S07", 0, true), ("S08", 60, false)]);
    let of = |id: &str| results.parts.iter().find(|part| part.id == id).unwrap();
    assert_eq!((of("S07").reached, of("S07").successes, of("S07").policy.as_str()), (4, 1, "zero"));
    assert_eq!((of("S08").reached, of("S08").successes, of("S08").policy.as_str()), (2, 0, "expert"));
    assert_eq!(
        (of("S03").reached, &of("S07").ends),
        (0, &[("fall".into(), 1), ("left".into(), 2), ("success".into(), 1)].into())
    );
    assert!(results.episodes.iter().all(|episode| !episode.success && episode.end == "fall"));
    let (text, page) = (tables::text(&results), report::html(&results));
    assert!(
        text.lines().any(|line| line.starts_with("S07") && line.contains(" 4     1  0.25") && line.ends_with("zero")),
        "{text}"
    );
    assert!(page.contains("Subtasks within the errand"));
    let back: Results = serde_json::from_str(&results.to_json().unwrap()).unwrap();
    assert_eq!(back.parts, results.parts);
}

/// A relay is never ranked, and never shares a table with the policy that it begins with, nor with another relay.
#[test]
fn a_relay_is_a_policy_of_its_own() {
    let falls = course(&[(start_of(Task::S07), "S07", 10)]);
    let folder = Folder::new("relay");
    write(&folder, RELAY, 1, &falls);
    let conditions = graded(&folder).unwrap().conditions;
    assert_eq!((conditions.ranked, conditions.relay), (false, vec!["S07=zero".to_owned()]));
    assert!(
        conditions.deviations.iter().any(|deviation| deviation.contains("S07=zero")),
        "{:?}",
        conditions.deviations
    );
    for (seed, other) in [(2, "expert"), (3, "zero"), (4, "expert with S07=stand")] {
        write(&folder, other, seed, &falls);
        assert!(matches!(graded(&folder), Err(ScoreError::Mixed { field, .. }) if field == "policy"), "{other}");
        std::fs::remove_file(folder.0.join(format!("{seed}.mcap"))).unwrap();
    }
    let plain = Folder::new("plain");
    write(&plain, "expert", 1, &falls);
    let results = graded(&plain).unwrap();
    assert!(results.conditions.relay.is_empty() && results.parts.is_empty() && results.episodes[0].parts.is_empty());
    assert!(!results.to_json().unwrap().contains("\"parts\"") && results.conditions.ranked);
}
