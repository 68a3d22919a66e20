//! Sends randomly changed requests, up to 10,000: none stops the service, and none gets an internal error.

use crate::common::bags::mutations;
use crate::common::{Board, bag, manifest, read, wish};
use fiatlux_leaderboard::{Pace, ServiceOptions};
use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::{Rng as _, SeedableRng as _};

/// Maximum peak memory of the process, bytes.
const MAX_MEMORY: u64 = 1 << 30;

fn mutated(random: &mut Pcg64Mcg, requests: &[Vec<u8>]) -> Vec<u8> {
    let mut pick = |below: usize| (random.next_u64() % below.max(1) as u64) as usize;
    let mut bytes = requests[pick(requests.len())].clone();
    for _ in 0..1 + pick(4) {
        let at = pick(bytes.len());
        match pick(7) {
            0 => bytes[at] ^= 1 << pick(8),
            1 => bytes[at] = pick(256) as u8,
            2 => bytes.truncate(at + 1),
            3 => bytes.insert(at, pick(256) as u8),
            4 => {
                // Inserts a part of another request.
                let other = &requests[pick(requests.len())];
                let from = pick(other.len());
                let part = other[from..(from + 1 + pick(64)).min(other.len())].to_vec();
                bytes.splice(at..at, part);
            }
            5 => {
                let end = (at + 1 + pick(32)).min(bytes.len());
                bytes.drain(at..end);
            }
            _ => {
                let odd: [&[u8]; 8] = [
                    b"\r\n",
                    b"\0",
                    b"99999999999999999999",
                    b"-1",
                    b"../",
                    b"\"",
                    b"{{{{[[[[",
                    b"Transfer-Encoding: chunked\r\n",
                ];
                bytes.splice(at..at, odd[pick(odd.len())].iter().copied());
            }
        }
        if bytes.is_empty() {
            bytes.push(b'G');
        }
    }
    bytes
}

#[test]
fn mutated_requests() {
    let pace = Pace { silence: std::time::Duration::from_millis(200), ..Pace::default() };
    let board = Board::start(
        "mutated",
        ServiceOptions { pace, token_pause: std::time::Duration::ZERO, ..ServiceOptions::default() },
    );
    let token = board.token("lab");
    let file = bag(&board.folder.0, 3);
    let wished = wish(&manifest(), std::slice::from_ref(&file)).to_string();
    let bytes = std::fs::read(&file).unwrap();
    let (_, begun) = board.json("POST", "/api/v1/submissions", Some(&token), &serde_json::from_str(&wished).unwrap());
    let id = begun["id"].as_str().unwrap().to_owned();
    let request = |method: &str, address: &str, body: &[u8]| {
        let head = format!(
            "{method} {address} HTTP/1.1\r\nHost: board\r\nAuthorization: Bearer {token}\r\nContent-Length: {}\r\n\r\n",
            body.len()
        );
        [head.as_bytes(), body].concat()
    };
    let requests = [
        request("POST", "/api/v1/submissions", wished.as_bytes()),
        request("PUT", &format!("/api/v1/submissions/{id}/files/0?offset=0"), &bytes[..bytes.len().min(4000)]),
        request("POST", &format!("/api/v1/submissions/{id}/finish"), b""),
        request("GET", &format!("/api/v1/submissions/{id}"), b""),
        request("GET", &format!("/api/v1/submissions/{id}/results"), b""),
        request("GET", "/api/v1/account", b""),
        request("GET", "/api/v1/submissions", b""),
    ];
    let mut random = Pcg64Mcg::seed_from_u64(17);
    let mut statuses = std::collections::BTreeMap::new();
    for number in 0..mutations(10_000) {
        let sent = mutated(&mut random, &requests);
        let answer = board.raw(&sent);
        let status = if answer.is_empty() { 0 } else { read(&answer).map_or(1, |(status, _)| status) };
        // A request whose head never ends or makes no sense may go without an answer. A handler that panics gives none
        // either, so a request with an unchanged head must get one.
        let is_whole = requests.iter().any(|request| {
            let head = request.windows(4).position(|end| end == b"\r\n\r\n").unwrap() + 4;
            request.len() > head && sent.len() >= request.len() && sent[..head] == request[..head]
        });
        assert!(!is_whole || status >= 200, "{number}: {}", String::from_utf8_lossy(&sent));
        assert!(status < 500, "{number}: {status} to {}", String::from_utf8_lossy(&sent));
        *statuses.entry(status).or_insert(0) += 1;
    }
    assert_eq!(board.ask("GET", "/health", None, b"").0, 200);
    assert_eq!(board.ask("GET", "/ready", None, b"").0, 200);
    assert!([200, 400, 401, 404, 422].iter().all(|status| statuses.contains_key(status)), "{statuses:?}");
    // The changed requests had no effect: at most the original submission is complete.
    let entries = board.runtime.block_on(board.store.entries()).unwrap();
    assert!(entries.iter().all(|entry| entry.badge == fiatlux_leaderboard::Badge::SelfReported));
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak =
        status.lines().find_map(|line| line.strip_prefix("VmHWM:")).and_then(|line| line.trim().strip_suffix(" kB"));
    if let Some(peak) = peak {
        assert!(peak.trim().parse::<u64>().unwrap() * 1024 < MAX_MEMORY, "{peak} kB");
    }
}
