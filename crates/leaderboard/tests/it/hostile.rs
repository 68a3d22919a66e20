//! Tests requests that the service must refuse, one by one.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use crate::common::{Board, PATIENCE, bag, bags, manifest, read, wish};
use fiatlux_leaderboard::{Limits, Pace, ServiceOptions};
use serde_json::{Value, json};

fn options() -> ServiceOptions {
    ServiceOptions {
        limits: Limits { files: 3, file_bytes: 1 << 20, bytes: 2 << 20 },
        pace: Pace { silence: Duration::from_millis(300), ..Pace::default() },
        token_pause: Duration::ZERO,
        ..ServiceOptions::default()
    }
}

/// Guards that only a token that is neither expired nor revoked, of an open account, gives access.
#[test]
fn tokens_that_are_not_good_open_nothing() {
    let board = Board::start("tokens", options());
    let good = board.token("lab");
    let other = board.token("other");
    let file = bag(&board.folder.0, 3);
    let wished = wish(&manifest(), &[file]);
    let (status, begun) = board.json("POST", "/api/v1/submissions", Some(&good), &wished);
    assert_eq!(status, 201);
    let id = begun["id"].as_str().unwrap().to_owned();
    let (expired, revoked, closed) = board.runtime.block_on(async {
        let expired = board.store.make_token("lab", 0).await.unwrap();
        let revoked = board.store.make_token("lab", 1).await.unwrap();
        board.store.revoke_token(&revoked[8..24]).await.unwrap();
        board.store.make_account("gone", Default::default()).await.unwrap();
        let closed = board.store.make_token("gone", 1).await.unwrap();
        board.store.set_account("gone", None, None, true).await.unwrap();
        (expired, revoked, closed)
    });
    let last = if good.ends_with('0') { "1" } else { "0" };
    let wrong = good[..good.len() - 1].to_owned() + last;
    // The public part of one token with the secret of another.
    let mixed = format!("{}{}", &good[..25], &other[25..]);
    let cases = [
        (None, "has no token"),
        (Some(""), "has no token"),
        (Some("fiatlux"), "did not issue the token"),
        (Some(&*wrong), "did not issue the token"),
        (Some(&*mixed), "did not issue the token"),
        (Some(&good[..good.len() - 1]), "did not issue the token"),
        (Some(&*expired), "has expired"),
        (Some(&*revoked), "was revoked"),
        (Some(&*closed), "is closed"),
    ];
    let requests = [
        ("GET", "/api/v1/account".to_owned()),
        ("POST", "/api/v1/submissions".to_owned()),
        ("GET", format!("/api/v1/submissions/{id}")),
        ("PUT", format!("/api/v1/submissions/{id}/files/0?offset=0")),
        ("POST", format!("/api/v1/submissions/{id}/finish")),
    ];
    for (token, expected) in cases {
        for (method, address) in &requests {
            let (status, answer) = board.json(method, address, token, &wished);
            let message = answer["error"]["message"].as_str().unwrap();
            assert!(status == 401 && message.contains(expected), "{method} {address} {token:?}: {status} {message}");
        }
    }
    // A valid token of another account finds nothing.
    for (method, address) in &requests[2..] {
        let (status, answer) = board.json(method, address, Some(&other), &wished);
        assert_eq!(status, 404, "{method} {address}: {answer}");
    }
    assert_eq!(board.json("GET", "/api/v1/account", Some(&good), &Value::Null).0, 200);
}

/// Guards that no name from a client becomes a path, and that too large submissions are refused before they are sent.
#[test]
fn names_and_sizes_that_do_not_fit_are_refused_early() {
    let board = Board::start("names", options());
    let token = board.token("lab");
    let begin = |manifest: Value, files: Value| {
        let wished = json!({ "manifest": manifest, "files": files });
        let (status, answer) = board.json("POST", "/api/v1/submissions", Some(&token), &wished);
        (status, answer["error"]["message"].as_str().unwrap_or_default().to_owned())
    };
    let sha256 = "0".repeat(64);
    let file = |name: &str, bytes: u64| json!({ "name": name, "bytes": bytes, "sha256": sha256 });
    for name in [
        "../a.mcap",
        "/etc/a.mcap",
        "a/b.mcap",
        "a\\b.mcap",
        "..",
        ".mcap",
        ".a.mcap",
        "-a.mcap",
        "a.mcap\0",
        "a\n.mcap",
        "a.pkl",
        "a.zip",
        "\u{202e}a.mcap",
        "a.mcap/",
        "%2e%2e%2fa.mcap",
        &format!("{}.mcap", "a".repeat(200)),
    ] {
        let (status, message) = begin(manifest(), json!([file(name, 10), file("b.mcap", 10)]));
        assert!(status == 422 && message.contains("files[0].name"), "{name:?}: {status} {message}");
    }
    let ok = || json!([file("a.mcap", 10)]);
    let cases = [
        (manifest(), json!([]), 422, "there is no bag"),
        (manifest(), json!([file("a.run.jsonl", 10)]), 422, "there is no bag"),
        (manifest(), json!([file("a.mcap", 0)]), 413, "files[0].bytes"),
        (manifest(), json!([file("a.mcap", (1 << 20) + 1)]), 413, "files[0].bytes"),
        (manifest(), json!([file("a.mcap", 10), file("a.mcap", 10)]), 422, "is listed twice"),
        (
            manifest(),
            json!([file("a.mcap", 1), file("b.mcap", 1), file("c.mcap", 1), file("d.mcap", 1)]),
            413,
            "4 of them",
        ),
        (
            manifest(),
            json!([file("a.mcap", 1 << 20), file("b.mcap", 1 << 20), file("c.mcap", 1)]),
            413,
            "bytes together",
        ),
        (manifest(), json!([{ "name": "a.mcap", "bytes": 10, "sha256": "xyz" }]), 422, "files[0].sha256"),
        (manifest(), json!([{ "name": "a.mcap", "bytes": 10, "sha256": sha256, "path": "/" }]), 422, "unknown field"),
        (manifest(), json!([{ "name": "a.mcap", "bytes": -1, "sha256": sha256 }]), 422, "cannot be read as JSON"),
        (json!({}), ok(), 422, "policy"),
        (json!({ "policy": " " }), ok(), 422, "policy is empty"),
        (json!({ "policy": "a".repeat(81) }), ok(), 422, "policy is too long"),
        (json!({ "policy": "a\u{1b}[2J" }), ok(), 422, "policy has a control character"),
        (json!({ "policy": "a\u{202e}b" }), ok(), 422, "changes the direction of text"),
        (json!({ "policy": "a", "link": "javascript:alert(1)" }), ok(), 422, "link is not a URL"),
        (json!({ "policy": "a", "link": "https://a\" onclick=x" }), ok(), 422, "link is not a URL"),
        (json!({ "policy": "a", "authors": vec!["b"; 33] }), ok(), 422, "authors has more than 32"),
        (json!({ "policy": "a", "note": "n".repeat(2001) }), ok(), 422, "note is too long"),
        (json!({ "policy": "a", "pickle": "x" }), ok(), 422, "unknown field"),
    ];
    for (manifest, files, expected, part) in cases {
        let (status, message) = begin(manifest, files);
        assert!(status == expected && message.contains(part), "{part}: {status} {message}");
    }
    for address in [
        "/api/v1/submissions/../../board/leaderboard.sqlite",
        "/api/v1/submissions/%2e%2e%2f%2e%2e/results",
        "/api/v1/submissions/0000000000000000",
        "/api/v1/submissions/000000000000000G",
        "/api/v1/submissions/0000000000000000/results",
        "/api/v1/submissions/0000000000000000/files/0",
        "/api/v2/submissions",
        "/api/",
    ] {
        let (status, _) = board.ask("GET", address, Some(&token), b"");
        assert!([404, 405].contains(&status), "{address}: {status}");
    }
    let (status, begun) =
        board.json("POST", "/api/v1/submissions", Some(&token), &json!({ "manifest": manifest(), "files": ok() }));
    assert_eq!(status, 201);
    let id = begun["id"].as_str().unwrap();
    for (place, expected) in
        [("1", 404), ("-1", 404), ("+0", 404), ("0/../0", 404), ("..%2f0", 404), ("4294967296", 404)]
    {
        let address = format!("/api/v1/submissions/{id}/files/{place}?offset=0");
        assert_eq!(board.ask("PUT", &address, Some(&token), b"0123456789").0, expected, "{place}");
    }
    for query in ["", "?offset=", "?offset=-1", "?offset=1e3", "?offset=18446744073709551616", "?from=0"] {
        let address = format!("/api/v1/submissions/{id}/files/0{query}");
        assert_eq!(board.ask("PUT", &address, Some(&token), b"0123456789").0, 400, "{query}");
    }
}

/// Guards that a body larger than any list of files is not read to its end.
#[test]
fn a_body_without_end_is_cut_off() {
    let board = Board::start("endless", options());
    let token = board.token("lab");
    let head = format!(
        "POST /api/v1/submissions HTTP/1.1\r\nHost: board\r\nAuthorization: Bearer {token}\r\nTransfer-Encoding: chunked\r\n\r\n"
    );
    let mut stream = TcpStream::connect(board.address).unwrap();
    stream.write_all(head.as_bytes()).unwrap();
    let chunk = [b"100000\r\n".as_slice(), &vec![b'a'; 1 << 20], b"\r\n"].concat();
    let sent = (0..200).take_while(|_| stream.write_all(&chunk).is_ok()).count();
    assert!(sent < 200, "200 MiB were taken");
    assert_eq!(board.ask("GET", "/health", None, b"").0, 200);
}

/// Guards that a slow upload is ended, keeps the bytes that arrived, and does not hold up others.
#[test]
fn a_silent_upload_is_ended() {
    let board = Board::start("slow", options());
    let token = board.token("lab");
    let file = bag(&board.folder.0, 3);
    let length = file.metadata().unwrap().len();
    let (_, begun) = board.json("POST", "/api/v1/submissions", Some(&token), &wish(&manifest(), &[file]));
    let id = begun["id"].as_str().unwrap();
    let head = format!(
        "PUT /api/v1/submissions/{id}/files/0?offset=0 HTTP/1.1\r\nHost: board\r\nAuthorization: Bearer {token}\r\n\
         Content-Length: {length}\r\n\r\nabc"
    );
    let mut stream = TcpStream::connect(board.address).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream.write_all(head.as_bytes()).unwrap();
    // The client stops sending, but does not hang up.
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    let (status, text) = read(&answer).unwrap();
    assert!(status == 408 && text.contains("\"received\":3"), "{status} {text}");
}

/// Guards against heads that are too long, have too many headers, or never end.
#[test]
fn floods_of_headers_are_refused() {
    let board = Board::start("headers", options());
    let many: String = (0..1000).map(|k| format!("X-{k}: y\r\n")).collect();
    let long = format!("X-Long: {}\r\n", "y".repeat(1 << 20));
    for (what, headers) in [("many", many), ("long", long)] {
        let answer = board.raw(format!("GET /health HTTP/1.1\r\nHost: board\r\n{headers}\r\n").as_bytes());
        let status = read(&answer).map(|(status, _)| status);
        assert!(status.is_none_or(|status| status == 431), "{what}: {status:?}");
    }
    let address = format!("GET /{} HTTP/1.1\r\nHost: board\r\n\r\n", "a".repeat(1 << 20));
    let status = read(&board.raw(address.as_bytes())).map(|(status, _)| status);
    assert!(status.is_none_or(|status| [414, 431].contains(&status)), "{status:?}");
    // If a head never ends, the service hangs up.
    let mut stream = TcpStream::connect(board.address).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream.write_all(b"GET /health HTTP/1.1\r\nHost: bo").unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    assert!(read(&answer).is_none_or(|(status, _)| status == 408), "{}", String::from_utf8_lossy(&answer));
    assert_eq!(board.ask("GET", "/health", None, b"").0, 200);
}

/// Guards an account's limits on bytes, on submissions a day, and on open submissions.
#[test]
fn an_account_has_limits() {
    let board = Board::start("limits", options());
    let token = board.token("lab");
    let begin = |name: &str, bytes: u64| {
        let file = json!({ "name": name, "bytes": bytes, "sha256": "0".repeat(64) });
        let wished = json!({ "manifest": manifest(), "files": [file] });
        let (status, answer) = board.json("POST", "/api/v1/submissions", Some(&token), &wished);
        (status, answer["error"]["message"].as_str().unwrap_or_default().to_owned())
    };
    let set = |a_day, bytes| board.runtime.block_on(board.store.set_account("lab", a_day, bytes, false)).unwrap();
    assert_eq!(begin("a.mcap", 100).0, 201);
    set(None, Some(150));
    let (status, message) = begin("b.mcap", 100);
    assert!(status == 429 && message.contains("150 bytes"), "{status} {message}");
    set(Some(1), Some(1 << 40));
    let (status, message) = begin("b.mcap", 100);
    assert!(status == 429 && message.contains("1 submissions within 24 hours"), "{status} {message}");
    // A submission that was begun may continue.
    assert_eq!(begin("a.mcap", 100).0, 200);
    // What was begun while the clock was ahead by years keeps nobody out until then.
    board.execute("UPDATE submissions SET begun = begun + 100000000000");
    assert_eq!(begin("b.mcap", 100).0, 201);
    set(Some(100), None);
    let statuses: Vec<u16> = (0..10).map(|k| begin(&format!("c{k}.mcap"), 1).0).collect();
    assert_eq!(statuses[..6], [201; 6]);
    assert_eq!(statuses[6..], [429; 4], "eight wait for files");
}

/// Begins to download a bag from an address behind a proxy, and reads nothing of it.
fn reader(board: &Board, bag: &str, address: &str) -> TcpStream {
    let mut stream = TcpStream::connect(board.address).unwrap();
    let head = format!("GET {bag} HTTP/1.1\r\nHost: board\r\nX-Forwarded-For: 192.0.2.9, {address}\r\n\r\n");
    stream.write_all(head.as_bytes()).unwrap();
    stream
}

/// Status of the answer to a [`reader`], who reads nothing after it.
fn status(stream: &mut TcpStream) -> u16 {
    let mut head = [0; 12];
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream.read_exact(&mut head).unwrap();
    std::str::from_utf8(&head[9..]).unwrap().parse().unwrap()
}

/// A service with a public bag that no system buffers whole, and the address of the bag.
fn with_large_bag(name: &str, pace: Pace) -> (Board, String) {
    let board = Board::start(name, ServiceOptions { pace, ..ServiceOptions::default() });
    let token = board.token("lab");
    let path = board.folder.0.join("S01-s3-e0.mcap");
    bags::write(&path, fiatlux_rules::Task::S01, 3, bags::Story::Succeeds(3000));
    assert!(path.metadata().unwrap().len() > 4 << 20);
    let id = board.submit(&token, &manifest(), &[path]);
    assert_eq!(board.decided(&id, &token)["state"], "graded");
    (board, format!("/runs/{id}/episodes/S01-s3-e0/bag"))
}

/// Guards that readers who do not read take the places of nobody else, at one address or at many.
#[test]
fn readers_that_do_not_read_keep_nobody_out() {
    let (board, bag) = with_large_bag("idle-readers", Pace::default());
    let quick = |what: &str| {
        let start = Instant::now();
        for page in ["/health", "/", "/about", "/api/v1/submissions"] {
            assert_eq!(board.ask("GET", page, None, b"").0, 200, "{what}: {page}");
        }
        assert!(start.elapsed() < Duration::from_secs(5), "{what}: {:?}", start.elapsed());
    };
    // The service has 64 places: 8 for an address, 32 for what is large.
    // Some proxies write ports too.
    let mut one: Vec<TcpStream> =
        (0..20).map(|k| reader(&board, &bag, &format!("6.6.6.6, 198.51.100.1:{}", 4000 + k))).collect();
    let statuses: Vec<u16> = one.iter_mut().map(status).collect();
    assert_eq!(statuses.iter().filter(|status| **status == 200).count(), 8, "{statuses:?}");
    assert!(statuses.iter().all(|status| [200, 429].contains(status)), "{statuses:?}");
    quick("one address");
    let mut many: Vec<TcpStream> = (0..100).map(|k| reader(&board, &bag, &format!("203.0.113.{k}"))).collect();
    let statuses: Vec<u16> = many.iter_mut().map(status).collect();
    assert_eq!(statuses.iter().filter(|status| **status == 200).count(), 24, "{statuses:?}");
    assert!(statuses.iter().all(|status| [200, 503].contains(status)), "{statuses:?}");
    quick("many addresses");
    // A disconnected reader frees its place.
    drop(one);
    drop(many);
    let start = Instant::now();
    while status(&mut reader(&board, &bag, "198.51.100.1")) != 200 {
        assert!(start.elapsed() < PATIENCE, "the places are still taken");
    }
}

/// Guards downloads that go on where they were, and readers that ask for the parts that they need: small parts take no place for large
/// answers.
#[test]
fn a_bag_is_sent_in_parts() {
    let (board, bag) = with_large_bag("parts", Pace::default());
    let whole = std::fs::read(board.folder.0.join("S01-s3-e0.mcap")).unwrap();
    let ask = |method: &str, headers: &str| {
        let request = format!("{method} {bag} HTTP/1.1\r\nHost: board\r\nConnection: close\r\n{headers}\r\n");
        let answer = board.raw(request.as_bytes());
        let end = answer.windows(4).position(|window| window == b"\r\n\r\n").unwrap();
        let head = String::from_utf8(answer[..end].to_vec()).unwrap().to_ascii_lowercase();
        (head[9..12].parse::<u16>().unwrap(), head, answer[end + 4..].to_vec())
    };
    let (status, head, body) = ask("GET", "");
    assert!(status == 200 && body == whole, "{head}");
    assert!(
        head.contains("accept-ranges: bytes") && head.contains(&format!("content-length: {}", whole.len())),
        "{head}"
    );
    let tag = head.lines().find_map(|line| line.strip_prefix("etag: ")).unwrap().to_owned();
    assert_eq!(tag.len(), 66, "the digest of the bag: {tag}");
    let (status, _, rest) = ask("GET", &format!("Range: bytes=1000000-\r\nIf-Range: {tag}\r\n"));
    assert!(status == 206 && rest == whole[1_000_000..]);
    let (status, head, tail) = ask("GET", "Range: bytes=-100\r\n");
    assert!(status == 206 && tail == whole[whole.len() - 100..], "{head}");
    let (status, _, all) = ask("GET", "Range: bytes=5-\r\nIf-Range: \"other\"\r\n");
    assert!(status == 200 && all == whole);
    assert_eq!(ask("GET", &format!("Range: bytes={}-\r\n", whole.len())).0, 416);
    assert_eq!(ask("GET", &format!("If-None-Match: {tag}\r\n")).0, 304);
    let (status, head, body) = ask("HEAD", "");
    assert!(status == 200 && body.is_empty() && head.contains(&format!("content-length: {}", whole.len())), "{head}");
    // Answers that have just been read may still have their places, so that a reader of these 32 is refused: another takes its place.
    let mut taken: Vec<TcpStream> = (0..32).map(|k| reader(&board, &bag, &format!("203.0.113.{k}"))).collect();
    while ask("GET", "").0 != 503 {
        assert!(taken.len() < 64, "there is still a place");
        taken.push(reader(&board, &bag, &format!("203.0.113.{}", taken.len())));
    }
    let (status, _, part) = ask("GET", "Range: bytes=4096-8191\r\n");
    assert!(status == 206 && part == whole[4096..8192]);
    drop(taken);
}

#[test]
fn a_reader_that_does_not_read_is_cut() {
    let (board, bag) = with_large_bag("cut-reader", Pace { silence: Duration::from_millis(500), ..Pace::default() });
    let mut stream = reader(&board, &bag, "198.51.100.1");
    assert_eq!(status(&mut stream), 200);
    let start = Instant::now();
    while board.metrics().contains("connections_open 1\n") {
        assert!(start.elapsed() < PATIENCE, "it is still open");
        std::thread::sleep(Duration::from_millis(100));
    }
    let mut rest = Vec::new();
    // The rest is what the system had buffered; then the connection ends, or is reset.
    drop(stream.read_to_end(&mut rest));
    assert!(rest.len() < 4 << 20, "{} bytes", rest.len());
}

/// Guards against guessing: a sender of wrong tokens waits for each answer, and nobody else does.
#[test]
fn wrong_tokens_are_slowed() {
    let pause = Duration::from_millis(250);
    let board = Board::start("guesses", ServiceOptions { token_pause: pause, ..options() });
    let good = board.token("lab");
    let ask = |token: &str, address: &str| {
        let start = Instant::now();
        let head = format!(
            "GET /api/v1/account HTTP/1.1\r\nHost: board\r\nConnection: close\r\nX-Forwarded-For: {address}\r\n\
             Authorization: Bearer {token}\r\n\r\n"
        );
        (read(&board.raw(head.as_bytes())).unwrap().0, start.elapsed())
    };
    let wrong = format!("fiatlux_{}_{}", "0".repeat(16), "0".repeat(64));
    let times: Vec<Duration> = (0..12)
        .map(|_| {
            let (status, time) = ask(&wrong, "198.51.100.1");
            assert_eq!(status, 401);
            time
        })
        .collect();
    assert!(times[4..].iter().all(|time| *time >= pause), "{times:?}");
    // At the same address, and at another one.
    let (status, time) = ask(&good, "198.51.100.1");
    assert!(status == 200 && time < pause, "{status} {time:?}");
    let (status, time) = ask(&wrong, "198.51.100.2");
    assert!(status == 401 && time < pause, "{status} {time:?}");
}
