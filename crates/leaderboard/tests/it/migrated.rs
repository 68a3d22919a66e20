//! A board of an older version: its entries keep their bags, and are judged by the present rules.

use std::path::Path;

use serde_json::{Value, json};
use sqlx::sqlite::{SqliteConnectOptions, SqlitePool};
use sqlx::{AssertSqlSafe, Row as _};

use crate::common::{Board, bag, manifest};
use fiatlux_leaderboard::ServiceOptions;

/// Turns the database of a folder into one of schema version 2, in which a badge and a division were stored.
async fn make_old(folder: &Path, statements: &[String]) {
    let options = SqliteConnectOptions::new().filename(folder.join("leaderboard.sqlite"));
    let pool = SqlitePool::connect_with(options).await.unwrap();
    let back = [
        "DROP TABLE known_rows",
        "DROP TABLE hosted_runs",
        "ALTER TABLE submissions DROP COLUMN facts",
        "ALTER TABLE submissions DROP COLUMN indexed",
        "ALTER TABLE submissions DROP COLUMN replaces",
        "DROP INDEX episodes_by_queue",
        "ALTER TABLE episodes DROP COLUMN queue",
        "ALTER TABLE episodes DROP COLUMN attempt",
        "ALTER TABLE episodes DROP COLUMN leased_until",
        "ALTER TABLE episodes DROP COLUMN refusals",
        "ALTER TABLE episodes DROP COLUMN version",
        "DROP TABLE duties",
        "DROP TABLE summaries",
        "DROP TABLE counters",
        "DELETE FROM schema_version WHERE version > 2",
    ];
    for statement in back.into_iter().map(str::to_owned).chain(statements.iter().cloned()) {
        sqlx::query(AssertSqlSafe(statement.clone()))
            .execute(&pool)
            .await
            .unwrap_or_else(|error| panic!("{statement}: {error}"));
    }
    let columns =
        sqlx::query("SELECT name FROM pragma_table_info('submissions') ORDER BY cid").fetch_all(&pool).await.unwrap();
    let columns: Vec<String> = columns.iter().map(|row| row.get(0)).collect();
    let old = [
        "id", "account", "manifest", "state", "reason", "badge", "division", "begun", "received", "bytes", "results",
        "drawn",
    ];
    assert_eq!(columns, old);
    pool.close().await;
}

/// Guards the one migration: every bag stays, and what was ranked by the old rules is judged by the new ones.
#[test]
fn old_entries_are_judged_by_the_present_rules() {
    let board = Board::start("old", ServiceOptions::default());
    let token = board.token("one");
    board.token("two");
    let send = |seed: u64| {
        let id = board.submit(&token, &manifest(), &[bag(&board.folder.0, seed)]);
        assert_eq!(board.decided(&id, &token)["state"], "graded");
        id
    };
    let [replayed, hosted, unplayable, real_time] = [3, 4, 5, 6].map(send);
    let copy = "00000000000000aa";
    let to = board.folder.0.join("old");
    let statements = [
        // As the old version left them: all verified, three of them ranked.
        "UPDATE submissions SET state = 'verified', division = '{\"time\":\"lockstep\"}'".to_owned(),
        format!("UPDATE submissions SET badge = 'replayed' WHERE id = '{replayed}'"),
        format!("UPDATE submissions SET badge = 'hosted' WHERE id = '{hosted}'"),
        format!("UPDATE episodes SET verdict = 'equal' WHERE submission IN ('{replayed}', '{hosted}')"),
        format!("UPDATE episodes SET verdict = 'refused' WHERE submission = '{unplayable}'"),
        format!("UPDATE episodes SET verdict = 'none' WHERE submission = '{real_time}'"),
        // Another account had sent the rows of the first entry.
        format!(
            "INSERT INTO submissions SELECT '{copy}', 'two', manifest, state, reason, badge, division, begun, received + 1, \
             bytes, results, drawn FROM submissions WHERE id = '{replayed}'"
        ),
        format!(
            "INSERT INTO files SELECT '{copy}', place, name, bytes, sha256, stored FROM files WHERE submission = '{replayed}'"
        ),
        format!(
            "INSERT INTO episodes SELECT '{copy}', task, seed, episode, place, verdict, server, detail FROM episodes \
             WHERE submission = '{replayed}'"
        ),
    ];
    board.runtime.block_on(async {
        board.store.backup(&to).await.unwrap();
        make_old(&to, &statements).await;
    });
    let migrated = Board::on("migrated", &to);
    let entry = |id: &str| {
        let entries = migrated.runtime.block_on(migrated.store.list_submissions()).unwrap();
        entries.into_iter().find(|entry| entry.id.to_string() == id).unwrap()
    };
    let badge_of = |id: &str| serde_json::to_value(entry(id).badge).unwrap();
    assert_eq!((badge_of(&replayed), badge_of(&hosted)), (json!("replayed"), json!("hosted")));
    // These bags are of the published protocol, in one room: no table of today ranks them.
    assert!(
        [&replayed, &hosted].iter().all(|id| entry(id).division.is_none() && entry(id).obstacle.contains("strict"))
    );
    let refused = entry(&unplayable);
    assert!(refused.reason.contains("could not be simulated again"), "{}", refused.reason);
    let waits = entry(&real_time);
    assert_eq!((serde_json::to_value(waits.state).unwrap(), waits.progress), (json!("graded"), (0, 1)));
    // The rows of old entries are known as soon as the service has read them.
    let start = std::time::Instant::now();
    while entry(copy).reason.is_empty() {
        assert!(start.elapsed() < crate::common::PATIENCE, "the copy is still there");
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    assert!(entry(copy).reason.contains(&format!("already submitted as {replayed} by one")), "{}", entry(copy).reason);
    for (id, seed) in [(&*replayed, 3), (&*hosted, 4), (&*unplayable, 5), (&*real_time, 6), (copy, 3)] {
        let path = migrated.runtime.block_on(migrated.store.bag(id.parse().unwrap(), "S01", seed, 0)).unwrap().unwrap();
        assert_eq!(
            std::fs::read(path).unwrap(),
            std::fs::read(board.folder.0.join(format!("S01-s{seed}-e0.mcap"))).unwrap(),
            "{id}"
        );
    }
    // And a new submission is compared with them.
    let third = migrated.token("three");
    let id = migrated.submit(&third, &manifest(), &[board.folder.0.join("S01-s3-e0.mcap")]);
    assert!(migrated.decided(&id, &third)["reason"].as_str().unwrap().contains("by one"));
    let (status, listed) = migrated.json("GET", "/api/v1/submissions", None, &Value::Null);
    assert_eq!((status, listed["submissions"].as_array().unwrap().len()), (200, 3), "{listed}");
}
