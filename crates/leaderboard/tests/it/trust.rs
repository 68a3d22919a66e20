//! Forged bags with digests made anew, as far as no simulator is needed to tell. `tests/tests/it/leaderboard/trust.rs` has the
//! others, with servers that play.

use std::path::PathBuf;

use serde_json::{Value, json};

use crate::common::bags::{self, Story};
use crate::common::{Board, bag, manifest};
use fiatlux_bag::Bag;
use fiatlux_leaderboard::ServiceOptions;
use fiatlux_proto::v3;
use fiatlux_rules::Task;

/// Writes a bag whose header is changed, with all digests made anew.
fn forged(board: &Board, name: &str, seed: u64, change: impl FnOnce(&mut v3::EpisodeHeader)) -> PathBuf {
    let mut header = bags::requested(bags::header(Task::S01, seed));
    change(&mut header);
    let header = bags::sealed(header);
    let rows = bags::rows(Task::S01, seed, Story::Succeeds(30));
    let path = board.folder.0.join(format!("{name}.mcap"));
    let _ = std::fs::remove_file(&path);
    bags::begin(&path, &header, &rows).finish(&bags::result(&header, &rows)).unwrap();
    path
}

/// Guards that a bag whose request no server would have played is refused by the grader, with the server's reason.
#[test]
fn what_no_server_plays_is_refused() {
    let board = Board::start("unplayable", ServiceOptions::default());
    let token = board.token("lab");
    let sent = |name: &str, change: fn(&mut v3::EpisodeHeader)| {
        let id = board.submit(&token, &manifest(), &[forged(&board, name, 3, change)]);
        board.decided(&id, &token)
    };
    let narrow = sent("narrow", |header| {
        header.image_width = 7;
        header.request.as_mut().unwrap().image_width = 7;
    });
    assert_eq!((&narrow["state"], &narrow["division"]), (&json!("refused"), &Value::Null), "{narrow}");
    let reason = narrow["reason"].as_str().unwrap();
    assert!(reason.contains("image_width is 7 pixels; it must be from 16 to 640"), "{reason}");
    let whole = sent("whole", |_| {});
    assert_eq!(whole["state"], "graded", "{whole}");
}

/// Guards that a take's rows are known: it is refused, and so are its rows under another label, whoever sends them.
#[test]
fn a_take_under_another_label_is_refused() {
    let board = Board::start("take", ServiceOptions::default());
    let [person, other] = ["person", "other"].map(|account| board.token(account));
    let take = forged(&board, "take", 3, |header| {
        header.end_on = vec!["success".into(), "diverged".into()];
        header.end_on_overridden = true;
        let request = header.request.as_mut().unwrap();
        (request.take, request.end_on) = (true, vec!["success".into()]);
    });
    let first = board.submit(&person, &manifest(), &[take]);
    let refused = board.decided(&first, &person);
    assert!(refused["reason"].as_str().unwrap().contains("it is a take, which a person drove"), "{refused}");
    for token in [&person, &other] {
        let relabelled = forged(&board, "relabelled", 3, |_| {});
        let id = board.submit(token, &manifest(), &[relabelled]);
        let entry = board.decided(&id, token);
        let reason = entry["reason"].as_str().unwrap();
        assert_eq!((&entry["state"], &entry["division"]), (&json!("refused"), &Value::Null), "{entry}");
        assert!(reason.contains(&format!("already submitted as {first} by person, as those of a person")), "{reason}");
    }
}

/// Guards that a policy which follows a tracked person has no rank, and that its rows have none under another name.
#[test]
fn a_tracked_person_has_no_rank() {
    const TRACKED: &str = "sonic:models,stream=tcp://192.0.2.1:5555";
    let board = Board::start("tracked", ServiceOptions::default());
    let token = board.token("lab");
    let bag = forged(&board, "tracked", 3, |header| {
        header.policy = TRACKED.into();
        header.request.as_mut().unwrap().policy = TRACKED.into();
    });
    let id = board.submit(&token, &json!({ "policy": TRACKED }), &[bag]);
    let entry = board.decided(&id, &token);
    assert_eq!((&entry["division"], &entry["claims"]["senses"]["proof"]), (&Value::Null, &json!("refused")), "{entry}");
    assert!(entry["not_ranked"].as_str().unwrap().contains("a person drove it"), "{entry}");
    let id = board.submit(&token, &manifest(), &[forged(&board, "renamed", 3, |_| {})]);
    assert!(board.decided(&id, &token)["reason"].as_str().unwrap().contains("those of a person"));
}

/// Guards that the same rows have one name and one room, also within an account and within a submission.
#[test]
fn the_same_rows_have_one_label() {
    let board = Board::start("labels", ServiceOptions::default());
    let token = board.token("lab");
    let first = board.submit(&token, &manifest(), &[forged(&board, "honest", 3, |_| {})]);
    assert_eq!(board.decided(&first, &token)["state"], "graded");
    type Change = fn(&mut v3::EpisodeHeader);
    let cases: [(&str, &str, Change, &str); 4] = [
        (
            "nova",
            "nova",
            |header| {
                header.policy = "nova".into();
                header.request.as_mut().unwrap().policy = "nova".into();
            },
            "as policy 'zero'",
        ),
        (
            "sensors",
            "zero",
            |header| {
                header.sensors = vec![v3::Sensor { name: "lidar".into(), rate_hz: 50.0, ..v3::Sensor::default() }];
            },
            "one of the two is wrong",
        ),
        (
            "time",
            "zero",
            |header| {
                header.mode = v3::Mode::RealTime.into();
                header.command_timeout_s = 0.5;
                header.request.as_mut().unwrap().mode = v3::Mode::RealTime.into();
            },
            "(lockstep",
        ),
        (
            "room",
            "zero",
            |header| {
                header.seed = 4;
                header.request.as_mut().unwrap().seed = 4;
            },
            "this one says that they are of S01, seed 4",
        ),
    ];
    for (name, policy, change, expected) in cases {
        let id = board.submit(&token, &json!({ "policy": policy }), &[forged(&board, name, 3, change)]);
        let entry = board.decided(&id, &token);
        let reason = entry["reason"].as_str().unwrap();
        assert_eq!(entry["state"], "refused", "{name}: {entry}");
        assert!(reason.contains(&first) && reason.contains(expected), "{name}: {reason}");
    }
    let entries = board.runtime.block_on(board.store.entries()).unwrap();
    assert_eq!(entries.iter().map(|entry| entry.id.to_string()).collect::<Vec<_>>(), [first], "the honest one alone");
}

/// Guards that one run of one account fills one row, whatever its notes say, and that a part of it does not take its place.
#[test]
fn one_run_has_one_row() {
    let board = Board::start("notes", ServiceOptions::default());
    let token = board.token("lab");
    let files = [bag(&board.folder.0, 3), bag(&board.folder.0, 4)];
    let ids = ["a", "b", "c"].map(|note| {
        let id = board.submit(&token, &json!({ "policy": "zero", "note": note }), &files);
        assert_eq!(board.decided(&id, &token)["state"], "graded");
        id
    });
    let part = board.submit(&token, &manifest(), &files[..1]);
    let reason = board.decided(&part, &token)["reason"].as_str().unwrap().to_owned();
    assert!(reason.contains(&format!("some of the episodes of your submission {}", ids[2])), "{reason}");
    let page = board.ask("GET", "/", None, b"").1;
    assert_eq!(page.matches("class=\"l who\"").count(), 1, "{page}");
    assert!(page.contains(&ids[2]));
    // More episodes with the same ones among them take their place.
    let more = [files.to_vec(), vec![bag(&board.folder.0, 5)]].concat();
    let id = board.submit(&token, &manifest(), &more);
    assert_eq!(board.decided(&id, &token)["state"], "graded");
    let entries = board.runtime.block_on(board.store.entries()).unwrap();
    assert_eq!(entries.iter().map(|entry| entry.id.to_string()).collect::<Vec<_>>(), [id]);
}

/// Guards that recordings an administrator has noted belong to nobody.
#[test]
fn known_recordings_are_refused() {
    let board = Board::start("known", ServiceOptions::default());
    let token = board.token("lab");
    let demonstration = bag(&board.folder.0, 3);
    assert_eq!(Bag::open(&demonstration).unwrap().header().policy, "zero");
    let known = board
        .runtime
        .block_on(board.store.know_bags("the demonstrations", std::slice::from_ref(&demonstration)))
        .unwrap();
    assert_eq!((known.new, known.bags, known.unread.len()), (1, 1, 0));
    let id = board.submit(&token, &manifest(), &[demonstration]);
    let reason = board.decided(&id, &token)["reason"].as_str().unwrap().to_owned();
    assert!(reason.contains("already submitted as the demonstrations by the administrator"), "{reason}");
}
