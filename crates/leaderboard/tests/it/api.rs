//! Tests a submission from its announcement to its results, and uploads over broken connections.

use std::path::PathBuf;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crate::common::{Board, PATIENCE, bag, manifest, place, sha256, wish};
use fiatlux_bag::{Unsimulated, convert, simulate_with};
use fiatlux_leaderboard::{Place, Quota, ServiceOptions, Store, StoreError};
use serde_json::{Value, json};

/// Guards the course of a submission: announced, sent, graded, listed, with the grader's results and the bag that was
/// sent.
#[test]
fn a_submission_is_graded_and_listed() {
    let board = Board::start("graded", ServiceOptions::default());
    let token = board.token("lab");
    let files = [3, 4].map(|seed| bag(&board.folder.0, seed));
    let id = board.submit(&token, &manifest(), &files);
    let entry = board.decided(&id, &token);
    assert_eq!((&entry["state"], &entry["badge"]), (&json!("graded"), &json!("self_reported")), "{entry}");
    // Two episodes of one task are not ranked.
    assert_eq!(entry["division"], Value::Null);
    let (status, listed) = board.json("GET", "/api/v1/submissions", None, &Value::Null);
    assert_eq!((status, &listed["submissions"][0]["id"]), (200, &json!(id)));
    let (status, results) = board.json("GET", &format!("/api/v1/submissions/{id}/results"), None, &Value::Null);
    assert_eq!((status, results["episodes"].as_array().unwrap().len()), (200, 2));
    let path = board.runtime.block_on(board.store.bag(id.parse().unwrap(), "S01", 4, 0)).unwrap().unwrap();
    assert_eq!(std::fs::read(path).unwrap(), std::fs::read(&files[1]).unwrap());
    assert_eq!(board.runtime.block_on(board.store.bag(id.parse().unwrap(), "S01", 5, 0)).unwrap(), None);
    // Announcing it again gives the same submission, whatever the order of its files.
    let turned = [files[1].clone(), files[0].clone()];
    let (status, again) = board.json("POST", "/api/v1/submissions", Some(&token), &wish(&manifest(), &turned));
    assert_eq!((status, &again["id"]), (200, &json!(id)));
    // The same files from another account are another submission.
    let other = board.token("other");
    let (status, theirs) = board.json("POST", "/api/v1/submissions", Some(&other), &wish(&manifest(), &files));
    assert!(status == 201 && theirs["id"] != json!(id), "{theirs}");
    // Strangers cannot read the metrics.
    assert_eq!(board.ask("GET", "/metrics", None, b"").0, 404);
    let text = board.metrics();
    assert!(
        text.contains("fiatlux_submissions{state=\"graded\"} 1") && text.contains("fiatlux_graded_total 1"),
        "{text}"
    );
}

/// Guards that an upload resumes where it stopped, and that only the announced content is kept.
#[test]
fn an_upload_goes_on_where_it_broke_off() {
    let board = Board::start("resumed", ServiceOptions::default());
    let token = board.token("lab");
    let file = bag(&board.folder.0, 3);
    let bytes = std::fs::read(&file).unwrap();
    let (_, begun) = board.json("POST", "/api/v1/submissions", Some(&token), &wish(&manifest(), &[file]));
    let id = begun["id"].as_str().unwrap();
    let at = |offset: usize| format!("/api/v1/submissions/{id}/files/0?offset={offset}");
    // The head announces all bytes, but the connection ends after some.
    let head = format!(
        "PUT {} HTTP/1.1\r\nHost: board\r\nAuthorization: Bearer {token}\r\nContent-Length: {}\r\n\r\n",
        at(0),
        bytes.len()
    );
    board.raw(&[head.as_bytes(), &bytes[..1000]].concat());
    let (_, entry) = board.json("GET", &format!("/api/v1/submissions/{id}"), Some(&token), &Value::Null);
    assert_eq!(entry["files"][0]["received"], 1000, "{entry}");
    let finish = format!("/api/v1/submissions/{id}/finish");
    assert_eq!(board.json("POST", &finish, Some(&token), &Value::Null).0, 409);
    // An offset that leaves a gap, and one that repeats bytes.
    for offset in [0, 999, 1001] {
        let (status, text) = board.ask("PUT", &at(offset), Some(&token), &bytes[1000..]);
        assert!(status == 409 && text.contains("\"received\":1000"), "{offset}: {text}");
    }
    let (status, text) = board.ask("PUT", &at(1000), Some(&token), &[&bytes[1000..], b"x"].concat());
    assert_eq!(status, 413, "{text}");
    let (_, entry) = board.json("GET", &format!("/api/v1/submissions/{id}"), Some(&token), &Value::Null);
    let received = entry["files"][0]["received"].as_u64().unwrap() as usize;
    // One byte differs: the file is dropped.
    let mut changed = bytes.clone();
    *changed.last_mut().unwrap() ^= 1;
    if received < bytes.len() {
        let (status, text) = board.ask("PUT", &at(received), Some(&token), &changed[received..]);
        assert!(status == 422 && text.contains("\"received\":0"), "{text}");
    }
    let (status, text) = board.ask("PUT", &at(0), Some(&token), &bytes);
    assert!(status == 200 && text.contains("\"stored\":true"), "{text}");
    // A client that missed the answer may send the file again.
    assert_eq!(board.ask("PUT", &at(0), Some(&token), &bytes).0, 200);
    assert_eq!(board.json("POST", &finish, Some(&token), &Value::Null).0, 202);
    assert_eq!(board.json("POST", &finish, Some(&token), &Value::Null).0, 202);
    assert_eq!(board.decided(id, &token)["state"], "graded");
}

/// Guards that a submitter can read why bags are inconsistent, and that nobody else can.
#[test]
fn a_changed_bag_is_refused_with_its_name() {
    let board = Board::start("refused", ServiceOptions::default());
    let token = board.token("lab");
    let file = bag(&board.folder.0, 3);
    let mut bytes = std::fs::read(&file).unwrap();
    let at = bytes.len() / 2;
    bytes[at] ^= 0x10;
    std::fs::write(&file, &bytes).unwrap();
    let id = board.submit(&token, &manifest(), &[file]);
    let entry = board.decided(&id, &token);
    assert_eq!(entry["state"], "refused");
    assert!(entry["reason"].as_str().unwrap().starts_with("S01-s3-e0.mcap: "), "{entry}");
    let address = format!("/api/v1/submissions/{id}");
    assert_eq!(board.json("GET", &address, None, &Value::Null).0, 401);
    assert_eq!(board.json("GET", &address, Some(&board.token("other")), &Value::Null).0, 404);
    assert_eq!(board.json("GET", &format!("{address}/results"), Some(&token), &Value::Null).0, 404);
    // The manifest has another policy name than the bags.
    let file = bag(&board.folder.0, 9);
    let id = board.submit(&token, &json!({ "policy": "best" }), &[file]);
    let reason = board.decided(&id, &token)["reason"].to_string();
    assert!(reason.contains("'best' in the manifest and 'zero' in the bags"), "{reason}");
}

/// Guards that nobody ranks with the episodes of another account; their owner may submit them again.
#[test]
fn bags_of_another_account_are_refused() {
    let board = Board::start("copied", ServiceOptions::default());
    let [owner, other] = ["owner", "other"].map(|account| board.token(account));
    let files = [bag(&board.folder.0, 3), bag(&board.folder.0, 4)];
    let first = board.submit(&owner, &manifest(), &files);
    assert_eq!(board.decided(&first, &owner)["state"], "graded");
    // One bag under another name, next to a bag of one's own.
    let copy = board.folder.0.join("mine.mcap");
    std::fs::copy(&files[1], &copy).unwrap();
    let copied = board.submit(&other, &manifest(), &[bag(&board.folder.0, 5), copy.clone()]);
    let entry = board.decided(&copied, &other);
    let reason = format!(
        "S01, seed 4: these rows were already submitted as {first} by owner, policy 'zero'; the first submission keeps its \
         place"
    );
    assert_eq!((&entry["state"], &entry["reason"]), (&json!("refused"), &json!(reason)));
    assert_eq!((&entry["claims"]["rows"]["proof"], &entry["division"]), (&json!("refused"), &Value::Null), "{entry}");
    let (status, page) = board.ask("GET", &format!("/runs/{copied}"), None, b"");
    assert!(status == 404 && page.contains("This submission was refused") && !page.contains(&first), "{page}");
    let again = board.submit(&owner, &json!({ "policy": "zero", "note": "again" }), &files);
    assert_eq!(board.decided(&again, &owner)["state"], "graded");
    // One's own later submission of the same episodes takes the place of the earlier one.
    let replaced = board.decided(&first, &owner);
    let reason = format!("replaced by {again}, a later submission of the same episodes");
    assert_eq!((&replaced["state"], &replaced["reason"]), (&json!("refused"), &json!(reason)));
    // A removed submission no longer counts.
    board.runtime.block_on(async {
        for id in [&first, &again] {
            board.store.remove_submission(id.parse().unwrap()).await.unwrap();
        }
    });
    let later = board.submit(&other, &manifest(), &[copy]);
    assert_eq!(board.decided(&later, &other)["state"], "graded");
}

/// Guards that halves of bags that a killed service left are removed, and nothing else.
#[test]
fn halves_of_bags_are_removed() {
    let board = Board::start("halves", ServiceOptions::default());
    let token = board.token("lab");
    let id = board.submit(&token, &manifest(), &[bag(&board.folder.0, 3)]);
    board.decided(&id, &token);
    let store = &board.store;
    let kept = board.runtime.block_on(store.bag(id.parse().unwrap(), "S01", 3, 0)).unwrap().unwrap();
    let [digest, folder] = [kept.file_name().unwrap().to_str().unwrap(), kept.parent().unwrap().to_str().unwrap()];
    let name = |end: &str| format!("{folder}/{digest}{end}");
    // The store writes incomplete content under such a name; other names are not its own.
    let halves = [name("#1"), name("#27")];
    let others = [name(""), name("#"), name("#1a"), name("-1"), format!("{folder}/note#1")];
    halves.iter().chain(&others[1..]).for_each(|path| std::fs::write(path, "half").unwrap());
    assert_eq!(board.runtime.block_on(store.remove_halves()).unwrap(), 2);
    assert!(halves.iter().all(|path| !std::path::Path::new(path).exists()));
    assert!(others.iter().all(|path| std::path::Path::new(path).exists()));
    assert_eq!(board.runtime.block_on(store.remove_halves()).unwrap(), 0);
}

#[test]
fn a_backup_has_the_same_entries_and_bags() {
    let board = Board::start("backup", ServiceOptions::default());
    let token = board.token("lab");
    let id = board.submit(&token, &manifest(), &[bag(&board.folder.0, 3)]);
    board.decided(&id, &token);
    let to = board.folder.0.join("backup");
    board.runtime.block_on(async {
        assert_eq!(board.store.backup(&to).await.unwrap().0, 2, "the bag and the results");
        assert_eq!(board.store.backup(&to).await.unwrap().0, 0, "all of it is there");
        let copy = Store::open(&to).await.unwrap();
        assert_eq!(copy.entries().await.unwrap(), board.store.entries().await.unwrap());
        let id = id.parse().unwrap();
        assert_eq!(copy.results(id).await.unwrap(), board.store.results(id).await.unwrap());
        let [a, b] = [&copy, &board.store].map(|store| store.bag(id, "S01", 3, 0));
        let [a, b] = [a.await.unwrap().unwrap(), b.await.unwrap().unwrap()].map(|path| std::fs::read(path).unwrap());
        assert_eq!(sha256(&a), sha256(&b));
        // A submission removed from the original is still in the copy.
        copy.remove_submission(id).await.unwrap();
        assert!(copy.entries().await.unwrap().is_empty());
        assert_eq!(board.store.entries().await.unwrap().len(), 1);
    });
}

/// Guards a move to another store, of either kind and back: everything is there, the log goes on, and nobody changes the old one meanwhile.
#[test]
fn a_moved_store_has_everything() {
    let board = Board::start("move", ServiceOptions::default());
    let token = board.token("lab");
    let id = board.submit(&token, &manifest(), &[bag(&board.folder.0, 3)]);
    board.decided(&id, &token);
    let at = |name: &str| board.folder.0.join(name);
    let [first, second] = [Place::folder(&at("first")), place(&at("second"))];
    board.runtime.block_on(async {
        let joined = board.store.join().await.unwrap();
        let refused = board.store.move_to(&first).await.unwrap_err();
        assert!(matches!(refused, StoreError::InUse { .. }), "{refused}");
        drop(joined);
        assert_eq!(board.store.move_to(&first).await.unwrap().0, 2, "the bag and the results");
        let refused = board.store.move_to(&first).await.unwrap_err();
        assert!(matches!(refused, StoreError::Taken { .. }), "{refused}");
        let one = Store::open_existing(&first).await.unwrap();
        one.move_to(&second).await.unwrap();
        let two = Store::open_existing(&second).await.unwrap();
        let id = id.parse().unwrap();
        for moved in [&one, &two] {
            assert_eq!(moved.entries().await.unwrap(), board.store.entries().await.unwrap());
            assert_eq!(moved.list_accounts().await.unwrap(), board.store.list_accounts().await.unwrap());
            assert_eq!(moved.list_audit(100).await.unwrap(), board.store.list_audit(100).await.unwrap());
            assert_eq!(moved.results(id).await.unwrap(), board.store.results(id).await.unwrap());
            let [a, b] = [moved, &board.store].map(|store| store.bag(id, "S01", 3, 0));
            let [a, b] =
                [a.await.unwrap().unwrap(), b.await.unwrap().unwrap()].map(|path| std::fs::read(path).unwrap());
            assert_eq!(sha256(&a), sha256(&b));
        }
        let lines = two.list_audit(100).await.unwrap().len() as i64;
        two.make_account("new", Quota::default()).await.unwrap();
        assert_eq!(two.list_audit(1).await.unwrap()[0].seq, lines + 1);
        let nothing = Store::open_existing(&place(&at("third"))).await.unwrap_err();
        assert!(matches!(nothing, StoreError::Nothing { .. }) && !at("third").exists(), "{nothing}");
    });
}

static FULL: OnceLock<PathBuf> = OnceLock::new();
static HAS_ROOM: AtomicBool = AtomicBool::new(false);
static TRIES: AtomicUsize = AtomicUsize::new(0);

/// Guards a submission of thin bags against a disk of the service that is full: it waits, and is graded once there is room.
#[test]
fn a_service_without_room_for_rows_tries_again() {
    simulate_with(|_, into, _| {
        TRIES.fetch_add(1, Ordering::Relaxed);
        let full = FULL.get().filter(|_| HAS_ROOM.load(Ordering::Relaxed));
        let full = full.ok_or_else(|| Unsimulated::NoRoom("No space left on device".into()))?;
        std::fs::copy(full, into).map(drop).map_err(|error| Unsimulated::NoRoom(error.to_string()))
    });
    let board = Board::start("room", ServiceOptions::default());
    let token = board.token("lab");
    let file = bag(&board.folder.0, 3);
    let full = board.folder.0.join("full.mcap");
    std::fs::copy(&file, &full).unwrap();
    FULL.set(full).unwrap();
    assert!(convert(&file, true).unwrap());
    let id = board.submit(&token, &manifest(), std::slice::from_ref(&file));
    let start = Instant::now();
    while TRIES.load(Ordering::Relaxed) < 2 {
        assert!(start.elapsed() < PATIENCE, "it does not try again");
        std::thread::sleep(Duration::from_millis(20));
    }
    let (_, entry) = board.json("GET", &format!("/api/v1/submissions/{id}"), Some(&token), &Value::Null);
    assert_eq!(entry["state"], "received", "{entry}");
    HAS_ROOM.store(true, Ordering::Relaxed);
    assert_eq!(board.decided(&id, &token)["state"], "graded");
}
