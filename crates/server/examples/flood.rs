//! Floods a recorder as a stranger would, at full size, and counts the bags of others that are whole.
//!
//! ```sh
//! cargo run --release -p fiatlux-server --example flood -- opens    # 3,000 opens in 10 s; 200 bags of 20 MB in the folder
//! cargo run --release -p fiatlux-server --example flood -- garbage  # garbage on every topic of a session for 60 s
//! cargo run --release -p fiatlux-server --example flood -- quiet    # the same recordings with nobody else
//! ```
//!
//! After the word may stand the number of bags in the folder, that of opens, and the niceness of the process that sends garbage: 19, as from
//! another machine, since what the sender itself takes of the cores says nothing about the service.
#![allow(clippy::unwrap_used, dead_code, missing_docs)]

#[path = "../tests/it/common/mod.rs"]
mod common;

use std::io::Read as _;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use common::flood::{fill, garbage, is_whole, recorded, recorder};
use common::open_session;
use common::victim::{connect, linked, options, request};
use fiatlux_access::RecorderKey;
use fiatlux_proto::keys::SessionKeys;
use fiatlux_proto::v3::OpenRequest;
use fiatlux_server::{RecordsTo, ServerOptions};

const BAGS: usize = 200;
const BAG_BYTES: usize = 20 << 20;
const OPENS: usize = 3000;
const OPENING: Duration = Duration::from_secs(10);
const GARBAGE: Duration = Duration::from_secs(60);
const RECORDINGS: usize = 20;

/// Sends garbage on the topics of the session with these keys until its input ends; prints the number of messages.
fn send(endpoint: &str, root: &str) {
    let link = connect(endpoint);
    let stop = Arc::new(AtomicBool::new(false));
    let (keys, ..) = SessionKeys::of(root).unwrap();
    let flood = garbage(&link, &keys, &stop);
    std::io::stdin().read_to_end(&mut Vec::new()).unwrap();
    stop.store(true, Ordering::Relaxed);
    println!("{}", flood.join().unwrap());
}

fn sender(niceness: usize, endpoint: &str, root: &str) -> Child {
    let mut nice = Command::new("nice");
    nice.args(["-n", &niceness.to_string()]).arg(std::env::current_exe().unwrap()).args(["send", endpoint, root]);
    nice.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap()
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    if let [word, endpoint, root] = &*words
        && word == "send"
    {
        return send(endpoint, root);
    }
    let case = words.first().map_or("quiet", String::as_str);
    let number = |index: usize, usual| words.get(index).and_then(|word| word.parse().ok()).unwrap_or(usual);
    let (full, opens) = (number(1, if case == "garbage" { 0 } else { BAGS }), number(2, OPENS));
    let niceness = number(3, 19);
    let out = std::env::temp_dir().join(format!("fiatlux-flood-{}", std::process::id()));
    if full > 0 {
        fill(&out, full, BAG_BYTES);
    }
    let key = RecorderKey::generate().unwrap();
    let records_to = RecordsTo::Recorders(key.clone());
    let (server, link, stranger, endpoint) = linked(ServerOptions { records_to, ..options() }, Some(options().name));
    let (_recorder, bags, lost) = recorder(&link, &out, &key);
    std::thread::sleep(Duration::from_secs(1));
    let begun = Instant::now();
    if case == "opens" {
        let pace = OPENING / u32::try_from(opens).unwrap_or(u32::MAX).max(1);
        let mut granted = 0;
        for number in 0..opens {
            std::thread::sleep((pace * number as u32).saturating_sub(begun.elapsed()));
            // Each in a room of its own, which the server has to build.
            let request = OpenRequest { seed: number as u64, ..request() };
            granted += usize::from(open_session(&stranger, "test", &request).is_ok());
        }
        println!("{granted} of {opens} opens granted in {:.1} s", begun.elapsed().as_secs_f64());
    }
    let (mut whole, mut times) = (0, Vec::new());
    let begun = Instant::now();
    for _ in 0..RECORDINGS {
        let begun_at = Instant::now();
        let victim = recorded(&link);
        let mut flood = (case == "garbage").then(|| sender(niceness, &endpoint, victim.keys.root()));
        let begin = if flood.is_some() {
            // It connects meanwhile.
            std::thread::sleep(Duration::from_millis(500));
            Instant::now()
        } else {
            begun_at
        };
        let end = victim.play(|_| ());
        whole += usize::from(is_whole(&bags, &end));
        victim.close();
        times.push(begin.elapsed().as_secs_f64());
        if let Some(flood) = flood.take() {
            // Each recording has its part of the time.
            std::thread::sleep((GARBAGE / RECORDINGS as u32).saturating_sub(begun_at.elapsed()));
            let sent = flood.wait_with_output().unwrap().stdout;
            let sent = String::from_utf8_lossy(&sent);
            println!("{} messages of garbage, {whole} bags whole so far, {:.2} s", sent.trim(), times[times.len() - 1]);
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
