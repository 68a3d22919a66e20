//! The pages: their content, what they let a browser load, and their refusals.

use std::path::PathBuf;

use crate::common::Board;
use crate::common::bags::{Story, write};
use fiatlux_leaderboard::ServiceOptions;
use fiatlux_rules::Task;
use serde_json::{Value, json};

/// Writes bags of all subtasks in one room.
fn all_subtasks(board: &Board, folder: &str, story: impl Fn(Task) -> Story) -> Vec<PathBuf> {
    let folder = board.folder.0.join(folder);
    std::fs::create_dir_all(&folder).unwrap();
    let bag = |task: Task| {
        let path = folder.join(format!("{task}-s3-e0.mcap"));
        write(&path, task, 3, story(task));
        path
    };
    Task::SUBTASKS.into_iter().map(bag).collect()
}

/// Sends two submissions in the same room, the first with a success; returns their ids.
fn with_two(board: &Board, manifest: &Value) -> [String; 2] {
    let carries = |task| if task == Task::S05 { Story::Succeeds(60) } else { Story::Falls(40) };
    let better = all_subtasks(board, "better", carries);
    let worse = all_subtasks(board, "worse", |_| Story::Falls(30));
    ["one", "two"].map(|account| {
        let token = board.token(account);
        let id = board.submit(&token, manifest, if account == "one" { &better } else { &worse });
        let entry = board.decided(&id, &token);
        assert_eq!(entry["state"], "graded", "{entry}");
        id
    })
}

/// Head (in lower case) and body of an answer.
fn answer(board: &Board, address: &str) -> (String, String) {
    let request = format!("GET {address} HTTP/1.1\r\nHost: board\r\nConnection: close\r\n\r\n");
    let answer = board.raw(request.as_bytes());
    let text = String::from_utf8_lossy(&answer);
    let (head, body) = text.split_once("\r\n\r\n").unwrap_or_else(|| panic!("{address}: {text}"));
    (head.to_ascii_lowercase(), body.to_owned())
}

/// Guards that each page exists, has a strict Content-Security-Policy, and shows submitted text as text.
#[test]
fn every_page_is_there_and_lets_nothing_in() {
    let board = Board::start("pages", ServiceOptions::default());
    let manifest = json!({
        "policy": "zero", "authors": ["<b>A</b>", "\"><script>x</script>"], "note": "<img src=x onerror=y>",
        "link": "https://example.org/a?b=c&d=e",
    });
    let [a, b] = with_two(&board, &manifest);
    let episode = format!("/runs/{a}/episodes/S05-s3-e0");
    let pages = [
        "/".to_owned(),
        "/?cells=clean".into(),
        "/about".into(),
        "/tasks/S05".into(),
        format!("/compare?run={a}"),
        format!("/runs/{a}"),
        format!("/runs/{a}/tasks/S05"),
        episode.clone(),
        format!("/compare/{a}/{b}"),
        format!("/compare/{a}/{b}?only=different"),
        format!("/compare/{a}/{b}/episodes/S05-s3-e0"),
    ];
    for page in &pages {
        let (head, body) = answer(&board, page);
        assert!(head.starts_with("http/1.1 200"), "{page}: {head}\n{body}");
        let policy = head.lines().find_map(|line| line.strip_prefix("content-security-policy: ")).unwrap();
        assert!(policy.starts_with("default-src 'none'") && !policy.contains("unsafe"), "{page}: {policy}");
        assert!(
            head.contains("x-content-type-options: nosniff") && head.contains("referrer-policy: no-referrer"),
            "{head}"
        );
        // The policy has no exceptions for styles; the only scripts are those of the replay.
        assert!(!body.contains(" style=") && !body.contains("<style"), "{page}");
        assert!(!body.contains("<script>x") && !body.contains("<img src=x") && !body.contains("<b>A</b>"), "{page}");
    }
    // The run's page says each subtask once, and commands name the site as it was asked for.
    let (_, run) = answer(&board, &format!("/runs/{a}"));
    assert_eq!(run.matches("<li class=\"panel task-card\">").count(), 12, "{run}");
    assert_eq!(run.matches("class=\"sq ").count(), 12);
    assert!(!run.contains("class=\"episode\"") && run.matches("<h2>Subtasks</h2>").count() == 1, "{run}");
    assert!(run.contains(&format!("curl -OJ https://board/runs/{a}/episodes/")), "{run}");
    let (_, about) = answer(&board, "/about");
    assert!(about.contains("--to https://board --token") && !about.contains("THIS-SITE"), "{about}");

    let (_, table) = answer(&board, "/");
    // The unit tests of standings check their order.
    assert!([&a, &b].iter().all(|id| table.contains(&format!("/runs/{id}\""))), "{table}");

    let (head, figure) = answer(&board, &format!("{episode}/figure.svg"));
    assert!(head.contains("image/svg+xml") && head.contains("sandbox") && figure.contains("<svg"), "{head}");
    let bag = board.ask("GET", &format!("{episode}/bag"), None, b"");
    assert_eq!(bag.0, 200);
    let (head, _) = answer(&board, &format!("{episode}/bag"));
    assert!(head.contains("filename=\"s05-s3-e0.mcap\""), "{head}");
    let length = std::fs::metadata(board.folder.0.join("better/S05-s3-e0.mcap")).unwrap().len();
    assert!(head.contains(&format!("content-length: {length}")), "{head}");
    // These bags have no scene to draw; the answer states it without the path of the file.
    let (head, document) = answer(&board, &format!("{episode}/document.json"));
    assert!(head.starts_with("http/1.1 422") && !document.contains("blobs"), "{head}\n{document}");
}

/// Guards that an address reaches only its own page, and that unknown addresses get 404.
#[test]
fn other_addresses_are_refused() {
    let board = Board::start("addresses", ServiceOptions::default());
    let token = board.token("lab");
    let id = board.submit(&token, &crate::common::manifest(), &[crate::common::bag(&board.folder.0, 3)]);
    board.decided(&id, &token);
    let none = [
        "/nothing".to_owned(),
        "/runs/0000000000000000".into(),
        "/runs/..%2f..%2fetc%2fpasswd".into(),
        format!("/runs/{}", id.to_uppercase() + "0"),
        format!("/runs/{id}/tasks/S99"),
        format!("/runs/{id}/tasks/s01"),
        format!("/runs/{id}/tasks/S05"),
        "/tasks/S13".into(),
        "/tasks/s05".into(),
        "/tasks/replace".into(),
        format!("/runs/{id}/tasks/S01/still.png"),
        format!("/runs/{id}/tasks/S01/still.svg"),
        "/runs/0000000000000000/tasks/S01/clip.png".into(),
        format!("/runs/{id}/episodes/S01-s4-e0"),
        format!("/runs/{id}/episodes/S01-s03-e0"),
        format!("/runs/{id}/episodes/..%2fS01-s3-e0/bag"),
        format!("/runs/{id}/episodes/S01-s3-e0%00/bag"),
        format!("/runs/{id}/episodes/S01-s4-e0/bag"),
        "/page/..%2fstyle.css".into(),
        "/page/nothing.js".into(),
        "/style/..%2f..%2fCargo.toml".into(),
        "/?division=9-lockstep-standard-g1_inspire".into(),
    ];
    for address in none {
        let (head, body) = answer(&board, &address);
        assert!(head.starts_with("http/1.1 404") && head.contains("default-src 'none'"), "{address}: {head}\n{body}");
    }
    assert_eq!(board.ask("GET", "/compare?run=x", None, b"").0, 404);
    for address in ["/page/style.css", "/page/main.js", "/page/pair.js", "/style/report.css", "/style/board.css"] {
        let (head, _) = answer(&board, address);
        let tag = head.lines().find_map(|line| line.strip_prefix("etag: ")).unwrap().to_owned();
        let again =
            format!("GET {address} HTTP/1.1\r\nHost: board\r\nConnection: close\r\nIf-None-Match: {tag}\r\n\r\n");
        assert!(String::from_utf8_lossy(&board.raw(again.as_bytes())).starts_with("HTTP/1.1 304"), "{address}");
    }
    // An incomplete submission has no public page.
    let wish = crate::common::wish(&crate::common::manifest(), &[crate::common::bag(&board.folder.0, 5)]);
    let (_, begun) = board.json("POST", "/api/v1/submissions", Some(&token), &wish);
    let begun = begun["id"].as_str().unwrap();
    assert_eq!(board.ask("GET", &format!("/runs/{begun}"), None, b"").0, 404);
}

/// Guards that a comparison is offered only if two runs share an episode.
#[test]
fn a_comparison_is_offered_where_rooms_are_shared() {
    let board = Board::start("partners", ServiceOptions::default());
    let send = |account: &str, seed: u64| {
        let folder = board.folder.0.join(account);
        std::fs::create_dir_all(&folder).unwrap();
        let token = board.token(account);
        let id = board.submit(&token, &crate::common::manifest(), &[crate::common::bag(&folder, seed)]);
        assert_eq!(board.decided(&id, &token)["state"], "graded");
        id
    };
    let [a, _] = [send("three", 7), send("four", 5)];
    let offers = |id: &str| answer(&board, &format!("/compare?run={id}")).1;
    assert!(offers(&a).contains("No other run has played an episode of this one"));
    let (_, run) = answer(&board, &format!("/runs/{a}"));
    assert!(!run.contains("/compare/"), "{run}");
    assert!(answer(&board, "/compare").1.contains("No two runs have played the same episode yet"));
    let [b, c] = with_two(&board, &crate::common::manifest());
    // Without a run, and with one twice, the page leads to a choice.
    let start = std::time::Instant::now();
    let choice = loop {
        let (head, choice) = answer(&board, "/compare");
        assert!(head.starts_with("http/1.1 200"), "{head}");
        // Tables are kept for seconds.
        if choice.contains(&format!("href=\"/compare?run={b}\"")) {
            break choice;
        }
        assert!(start.elapsed() < crate::common::PATIENCE, "{choice}");
        std::thread::sleep(std::time::Duration::from_millis(200));
    };
    assert!(!choice.contains(&format!("/compare?run={a}\"")), "it shares nothing: {choice}");
    assert!(offers(&format!("{b}&run={b}")).contains(&format!("/compare/{b}/{c}")));
    assert!(answer(&board, &format!("/compare?run={b}&run={c}")).0.starts_with("http/1.1 303"));
    // Tables are kept for seconds, but a new run is never missing from its own pages.
    assert!(offers(&c).contains(&format!("/compare/{c}/{b}")) && offers(&b).contains(&format!("/compare/{b}/{c}")));
    assert!(answer(&board, &format!("/runs/{b}/episodes/S05-s3-e0")).1.contains(&format!("/compare/{b}/{c}/episodes")));
    assert!(answer(&board, "/").1.contains("not verified here"), "the paper's rows");
}

/// Guards that a copy of the folder made while the service runs shows the same pages and the same bags.
#[test]
fn a_backup_shows_the_same() {
    let board = Board::start("backup", ServiceOptions::default());
    let [a, b] = with_two(&board, &crate::common::manifest());
    let to = board.folder.0.join("copy");
    board.runtime.block_on(board.store.backup(&to)).unwrap();
    let copy = Board::on("backup-copy", &to);
    let bag = format!("/runs/{b}/episodes/S09-s3-e0/bag");
    for address in ["/".to_owned(), format!("/runs/{a}"), format!("/runs/{b}"), format!("/compare/{a}/{b}"), bag] {
        assert_eq!(answer(&board, &address).1, answer(&copy, &address).1, "{address}");
    }
}
