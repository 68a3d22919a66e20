//! Floods a recorder as a stranger would, at full size, and counts the bags of others that are whole.
//!
//! ```sh
//! cargo run --release -p fiatlux-server --example flood -- opens    # 3,000 opens in 10 s; 200 bags of 20 MB in the folder
//! cargo run --release -p fiatlux-server --example flood -- garbage  # garbage on every topic of a session for 60 s
//! cargo run --release -p fiatlux-server --example flood -- quiet    # the same recordings with nobody else
//! ```
#![allow(clippy::unwrap_used, dead_code, missing_docs)]

#[path = "../tests/it/common/mod.rs"]
mod common;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use common::flood::{fill, garbage, is_whole, play, recorded, recorder};
use common::open_session;
use common::victim::{network, options, request};
use fiatlux_access::RecorderKey;
use fiatlux_server::{RecordsTo, ServerOptions};

const BAGS: usize = 200;
const BAG_BYTES: usize = 20 << 20;
const OPENS: usize = 3000;
const OPENING: Duration = Duration::from_secs(10);
const GARBAGE: Duration = Duration::from_secs(60);
const RECORDINGS: usize = 20;

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let case = words.first().map_or("quiet", String::as_str);
    let number = |index: usize, usual| words.get(index).and_then(|word| word.parse().ok()).unwrap_or(usual);
    let (full, opens) = (number(1, if case == "garbage" { 0 } else { BAGS }), number(2, OPENS));
    let out = std::env::temp_dir().join(format!("fiatlux-flood-{}", std::process::id()));
    if full > 0 {
        fill(&out, full, BAG_BYTES);
    }
    let key = RecorderKey::generate().unwrap();
    let records_to = RecordsTo::Recorders(key.clone());
    let (server, link, stranger) = network(ServerOptions { records_to, ..options() });
    let (_recorder, bags, lost) = recorder(&link, &out, &key);
    std::thread::sleep(Duration::from_secs(1));
    let begun = Instant::now();
    if case == "opens" {
        let pace = OPENING / u32::try_from(opens).unwrap_or(u32::MAX).max(1);
        let mut granted = 0;
        for number in 0..opens {
            std::thread::sleep((pace * number as u32).saturating_sub(begun.elapsed()));
            granted += usize::from(open_session(&stranger, "test", &request()).is_ok());
        }
        println!("{granted} of {opens} opens granted in {:.1} s", begun.elapsed().as_secs_f64());
    }
    let (mut whole, mut times) = (0, Vec::new());
    let begun = Instant::now();
    for _ in 0..RECORDINGS {
        let begin = Instant::now();
        let victim = recorded(&link);
        let stop = Arc::new(AtomicBool::new(false));
        let flood = (case == "garbage").then(|| garbage(&stranger, &victim, &stop));
        let end = play(&victim);
        whole += usize::from(is_whole(&bags, &end));
        victim.close();
        times.push(begin.elapsed().as_secs_f64());
        if let Some(flood) = flood {
            // Each recording has its part of the time.
            std::thread::sleep((GARBAGE / RECORDINGS as u32).saturating_sub(begin.elapsed()));
            stop.store(true, Ordering::Relaxed);
            println!("{} messages of garbage, {whole} bags whole so far", flood.join().unwrap());
        }
    }
    times.sort_by(f64::total_cmp);
    println!(
        "{case}: {whole} of {RECORDINGS} bags whole, {} records lost, {:.2} s in the median, {:.2} s at most, {:.1} s in all",
        lost.load(Ordering::Relaxed),
        times[times.len() / 2],
        times[times.len() - 1],
        begun.elapsed().as_secs_f64()
    );
    drop(server);
    std::fs::remove_dir_all(out).unwrap();
}
