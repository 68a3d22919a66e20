//! A service that is killed over and over, while clients submit.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use fiatlux_leaderboard::{Submit, SubmitProgress, Upload};
use fiatlux_tests::programs::{PATIENCE, endpoint, wait_until};
use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::{Rng as _, SeedableRng as _};

use super::lab::{Board, Lab, played_run};

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
    let (url, token) = (board.url(), std::fs::read_to_string(board.token()).unwrap());
    let (over, accepted) = (AtomicBool::new(false), Mutex::new(Vec::new()));
    let client = |number: usize| {
        for count in 0.. {
            if over.load(Ordering::Relaxed) {
                return;
            }
            let mut upload = Upload::find(&loose).unwrap();
            upload.manifest.note = format!("{number}-{count}");
            let never = AtomicBool::new(false);
            let mut quiet = |_: SubmitProgress| {};
            let sent = Submit::to(&url, &token, &mut quiet, &never).unwrap().send(&upload).unwrap();
            accepted.lock().unwrap().push(sent.id);
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
