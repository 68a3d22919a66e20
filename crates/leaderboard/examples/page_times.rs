//! Measures pages while files are uploaded: asks a running `scorer serve` for its pages, alone and during 50 uploads of
//! 10 MB at once, and prints p50, p99 and the longest of each.
//!
//!     page_times ADDRESS TOKEN_FILE [ROUNDS]
//!
//! ADDRESS is HOST:PORT. The account should have `--submissions-a-day 100000`. Each round is a submission of 50 files that are
//! no bags, so it is refused in the end. Pages are asked for every 5 ms on one connection each, as browsers that come anew do; the
//! runs that are listed are asked for too.
#![allow(clippy::unwrap_used)] // A failure is shown, and ends the example.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use data_encoding::HEXLOWER;
use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

const UPLOADS: usize = 50;
const BYTES: usize = 10_000_000;
const EVERY: Duration = Duration::from_millis(5);
/// Requests that are measured without uploads.
const ALONE: usize = 2000;

struct Target {
    host: String,
    token: String,
}

impl Target {
    /// Status and body of an answer.
    async fn ask(&self, method: &str, address: &str, body: &[u8]) -> (u16, Vec<u8>) {
        let Self { host, token } = self;
        let mut stream = TcpStream::connect(host).await.unwrap();
        stream.set_nodelay(true).unwrap();
        let head = format!(
            "{method} {address} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\nAuthorization: Bearer {token}\r\n\
             Content-Length: {}\r\n\r\n",
            body.len()
        );
        stream.write_all(head.as_bytes()).await.unwrap();
        stream.write_all(body).await.unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).await.unwrap();
        let end = answer.windows(4).position(|end| end == b"\r\n\r\n").unwrap() + 4;
        let status = std::str::from_utf8(&answer[9..12]).unwrap().parse().unwrap();
        (status, answer.split_off(end))
    }

    async fn json(&self, method: &str, address: &str, body: &Value) -> Value {
        let body = if body.is_null() { String::new() } else { body.to_string() };
        let (status, answer) = self.ask(method, address, body.as_bytes()).await;
        let answer = serde_json::from_slice(&answer).unwrap();
        assert!((200..300).contains(&status), "{method} {address}: {status} {answer}");
        answer
    }

    /// Requests one page after the other until it is stopped, or has sent `most` requests; returns the time of each.
    async fn pages(&self, pages: &[String], most: usize, stop: &AtomicBool) -> Vec<Duration> {
        let mut times = Vec::new();
        for page in pages.iter().cycle().take(most) {
            if stop.load(Ordering::Relaxed) {
                break;
            }
            let start = Instant::now();
            let (status, _) = self.ask("GET", page, b"").await;
            times.push(start.elapsed());
            assert_eq!(status, 200, "{page}");
            tokio::time::sleep(EVERY).await;
        }
        times
    }
}

fn content(round: usize, place: usize) -> Vec<u8> {
    let mut bytes = vec![b'x'; BYTES];
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_nanos();
    let name = format!("{now:>32}{round:>16}{place:>16}");
    bytes[..name.len()].copy_from_slice(name.as_bytes());
    bytes
}

fn print(what: &str, times: &mut [Duration]) {
    times.sort_unstable();
    let at = |share: f64| times[((times.len() - 1) as f64 * share) as usize].as_secs_f64() * 1e3;
    println!(
        "{what:<28} {:>6} pages: p50 {:>6.1} ms, p99 {:>6.1} ms, longest {:>6.1} ms",
        times.len(),
        at(0.5),
        at(0.99),
        at(1.0)
    );
}

fn main() {
    // Uploads have a thread of their own, so that the measured requests do not wait for them here.
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [host, token, rest @ ..] = &args[..] else { panic!("page_times HOST:PORT TOKEN_FILE [ROUNDS]") };
    let rounds: usize = rest.first().map_or(5, |rounds| rounds.parse().unwrap());
    let token = std::fs::read_to_string(token).unwrap().trim().to_owned();
    let target = Arc::new(Target { host: host.clone(), token });
    let runtime = || tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let asking = runtime();
    let listed = asking.block_on(target.json("GET", "/api/v1/submissions", &Value::Null));
    let runs = listed["submissions"].as_array().unwrap().iter().take(3);
    let runs = runs.map(|run| format!("/runs/{}", run["id"].as_str().unwrap()));
    let pages: Vec<String> = ["/", "/about"].map(str::to_owned).into_iter().chain(runs).collect();
    println!("{}", pages.join(" "));
    let never = AtomicBool::new(false);
    print("alone", &mut asking.block_on(target.pages(&pages, ALONE, &never)));

    let (mut all, mut taken) = (Vec::new(), Duration::ZERO);
    for round in 0..rounds {
        let contents: Vec<Arc<Vec<u8>>> = (0..UPLOADS).map(|place| Arc::new(content(round, place))).collect();
        let hex = |bytes: &[u8]| HEXLOWER.encode(&Sha256::digest(bytes));
        let files: Vec<Value> = (0..).zip(&contents)
            .map(|(place, bytes): (usize, _)| json!({ "name": format!("{place:02}.mcap"), "bytes": BYTES, "sha256": hex(bytes) }))
            .collect();
        let wish = json!({ "manifest": { "policy": "page-times" }, "files": files });
        let begun = asking.block_on(target.json("POST", "/api/v1/submissions", &wish));
        let address = format!("/api/v1/submissions/{}", begun["id"].as_str().unwrap());
        let over = Arc::new(AtomicBool::new(false));
        let uploading = {
            let (target, address, over) = (Arc::clone(&target), address.clone(), Arc::clone(&over));
            std::thread::spawn(move || {
                let start = Instant::now();
                runtime().block_on(async {
                    let uploads: Vec<_> = contents
                        .into_iter()
                        .enumerate()
                        .map(|(place, bytes)| {
                            let (target, address) = (Arc::clone(&target), format!("{address}/files/{place}?offset=0"));
                            tokio::spawn(async move { target.ask("PUT", &address, &bytes).await.0 })
                        })
                        .collect();
                    for upload in uploads {
                        assert_eq!(upload.await.unwrap(), 200);
                    }
                });
                over.store(true, Ordering::Relaxed);
                start.elapsed()
            })
        };
        all.extend(asking.block_on(target.pages(&pages, usize::MAX, &over)));
        taken += uploading.join().unwrap();
        asking.block_on(target.json("POST", &format!("{address}/finish"), &Value::Null));
        while asking.block_on(target.json("GET", &address, &Value::Null))["state"] == "received" {
            std::thread::sleep(Duration::from_millis(100));
        }
    }
    print("during 50 uploads of 10 MB", &mut all);
    let megabytes = (rounds * UPLOADS * BYTES) as f64 / 1e6;
    println!("uploads: {:.0} MB/s", megabytes / taken.as_secs_f64());
}
