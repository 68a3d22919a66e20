//! A service, and the parts of a fleet, that are killed over and over, while clients submit.

use std::path::Path;
use std::process::Command;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use fiatlux_tests::programs::{PATIENCE, Running, Scratch, endpoint, free_port, grade, wait_until};
use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::{Rng as _, SeedableRng as _};

use super::lab::{Board, Elsewhere, Lab, played_run};
use crate::stores::{Postgres, Server, database_of};

const KILLS: usize = 20;
const CLIENTS: usize = 4;

/// Guards that whatever was accepted is there and is verified, whenever the service died; and that clients need do nothing
/// for it but go on.
#[test]
fn what_was_accepted_survives_twenty_kills() {
    let lab = Lab::start("board-kills");
    let run = played_run(&lab, "public", &["--seeds", "0"]);
    let loose = lab.copy(&run, "loose", |name| name.contains("-S01-") || name.contains("-S04-"));
    let server = endpoint(lab.port());
    let mut board = Board::start(&lab, &[]);
    let submitter = board.submitter();
    let (over, accepted) = (AtomicBool::new(false), Mutex::new(Vec::new()));
    let client = |number: usize| {
        for count in 0.. {
            if over.load(Ordering::Relaxed) {
                return;
            }
            let id = submitter.send(&loose, &format!("{number}-{count}"));
            accepted.lock().unwrap().push(id);
        }
    };
    let mut random = Pcg64Mcg::seed_from_u64(20);
    std::thread::scope(|scope| {
        for number in 0..CLIENTS {
            let client = &client;
            scope.spawn(move || client(number));
        }
        for _ in 0..KILLS {
            std::thread::sleep(Duration::from_millis(20 + random.next_u64() % 700));
            board.restart(&[&server]);
        }
        over.store(true, Ordering::Relaxed);
    });
    let accepted = accepted.into_inner().unwrap();
    assert!(accepted.len() >= CLIENTS, "{} were accepted", accepted.len());
    // Each takes the place of the one before, which has the same episodes.
    let is_over = |id: &String| {
        let entry = board.get(&format!("/api/v1/submissions/{id}"));
        entry["state"] == "verified" || entry["reason"].as_str().unwrap().starts_with("replaced by ")
    };
    accepted.iter().for_each(|id| wait_until("a verdict", PATIENCE, || is_over(id)));
    let listed = board.get("/api/v1/submissions");
    let listed = listed["submissions"].as_array().unwrap();
    assert_eq!(listed.len(), 1, "{listed:?}");
    assert!(listed.iter().all(|entry| entry["badge"] == "replayed" && entry["episodes_verified"] == 2), "{listed:?}");
    eprintln!("{} submissions were accepted over {KILLS} kills", accepted.len());
}

/// The port of a bucket's server, in a process that is one.
const CHILD: &str = "FIATLUX_BUCKET_CHILD";
const BUCKET: &str = "fleet";

/// A server of a bucket in a process of its own, whose objects are in the folder.
fn bucket(port: u16, folder: &Scratch) -> Running {
    let mut server = Command::new(std::env::current_exe().unwrap());
    server.args(["--exact", "leaderboard::kills::what_was_accepted_survives_kills_of_all_parts_on_postgres"]);
    server.args(["--include-ignored", "--nocapture"]).env(CHILD, format!("{port} {}", folder.path().display()));
    let mut server = Running::spawn("bucket", server, folder);
    server.wait_for("the bucket is there");
    server
}

/// Guards the same in a fleet, whichever of its parts dies: every accepted submission ends once, with the badge and the results that it
/// would have had.
#[test]
#[ignore = "needs PostgreSQL: tests/run"]
fn what_was_accepted_survives_kills_of_all_parts_on_postgres() {
    if let Ok(place) = std::env::var(CHILD) {
        let (port, folder) = place.split_once(' ').unwrap();
        let _server = Server::start_in(&Path::new(folder).join("objects"), BUCKET, port.parse().unwrap());
        println!("the bucket is there");
        loop {
            std::thread::park();
        }
    }
    let (kills, submissions) = if std::env::var_os("FIATLUX_ALL_ROOMS").is_some() { (20, 200) } else { (2, 16) };
    let lab = Lab::start("board-parts");
    let run = played_run(&lab, "many", &["--seeds", &format!("0..{}", submissions - 1), "--tasks", "S04"]);
    let loose = lab.copy(&run, "loose", |name| name.ends_with(".mcap"));
    let (_, graded) = grade(&loose, lab.folder());
    let bag = |seed: usize| loose.join(format!("test-S04-s{seed}-a1.mcap"));

    let mut postgres = Postgres::start("parts");
    let [bucket_port, server_port] = [free_port(), free_port()];
    let mut objects = bucket(bucket_port, lab.folder());
    let at = endpoint(server_port);
    let serve = || {
        let mut server = Running::start("sim-server", &["--name", "verifies", "-l", &at], lab.folder());
        server.wait_for("listening on");
        server
    };
    let mut server = serve();
    let options = ["--database", &database_of(&postgres), "--files", &format!("s3://{BUCKET}/board")];
    let store =
        Elsewhere { options: options.map(str::to_owned).into(), variables: Server::environment_at(bucket_port).into() };
    let mut board = Board::start_on(&lab, store, &[&at], &[]);
    let submitter = board.submitter();

    let (next, accepted) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let client = || {
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed >= submissions {
                return;
            }
            let id = submitter.send(&bag(seed), "");
            accepted.lock().unwrap().push((seed, id));
        }
    };
    let mut random = Pcg64Mcg::seed_from_u64(59);
    std::thread::scope(|scope| {
        (0..CLIENTS).for_each(|_| drop(scope.spawn(client)));
        for kill in 0..4 * kills {
            std::thread::sleep(Duration::from_millis(20 + random.next_u64() % 700));
            match kill % 4 {
                0 => board.restart(&[&at]),
                1 => postgres.kill(),
                2 => {
                    objects.kill();
                    objects = bucket(bucket_port, lab.folder());
                }
                _ => {
                    server.kill();
                    server = serve();
                }
            }
        }
    });
    let accepted = accepted.into_inner().unwrap();
    assert_eq!(accepted.len(), submissions);
    let log = || board.admin(&["log", "--last", "1000000"]);
    wait_until("all end", 5 * PATIENCE, || {
        std::thread::sleep(Duration::from_millis(500));
        log().matches(": submission verified ").count() + log().matches(": submission refused ").count() >= submissions
    });
    let log = log();
    let numbers = log.lines().map(|line| line.split(' ').next().unwrap().parse::<usize>().unwrap());
    assert!(numbers.eq(1..=log.lines().count()), "{log}");
    for (seed, id) in &accepted {
        let entry = board.get(&format!("/api/v1/submissions/{id}"));
        assert_eq!((&entry["state"], &entry["badge"]), (&"verified".into(), &"replayed".into()), "{entry}");
        for end in ["received", "graded", "verified"] {
            assert_eq!(log.matches(&format!(": submission {end} {id} ")).count(), 1, "{end}: {id}");
        }
        let results = board.get(&format!("/api/v1/submissions/{id}/results"));
        let played = graded["episodes"].as_array().unwrap().iter().find(|row| row["seed"] == *seed).unwrap();
        let without_bag = |row: &serde_json::Value| {
            let mut row = row.clone();
            row["bag"] = serde_json::Value::Null;
            row
        };
        assert_eq!(without_bag(&results["episodes"][0]), without_bag(played), "{id}");
    }
    println!("{submissions} submissions ended once over {kills} kills of each part");
}
