//! A server that is there and does not answer.

use fiatlux_tests::programs::{PATIENCE, wait_until};
use serde_json::Value;

use super::lab::{Lab, RunArgs, digests, undisturbed};

const ASKED: RunArgs = RunArgs { tasks: "all", seeds: "0..1", episodes: 24, parallel: "4" };

fn hang_half_way(name: &str, shares: bool) -> (Lab, Value, Option<i32>, String) {
    let mut lab = Lab::start_with(name, 2, ASKED, shares, None);
    let mut client = lab.client_with(&["--patience", "8"]);
    wait_until("some are played", PATIENCE, || lab.played() >= ASKED.episodes / 4);
    lab.server(1).signal("STOP");
    let (status, text) = client.finish(PATIENCE);
    lab.server(1).signal("CONT");
    let outcome = serde_json::from_str(&text).unwrap();
    (lab, outcome, status.code(), client.log())
}

/// Guards that the other servers play what a server hangs over.
#[test]
fn the_run_goes_on_over_the_others() {
    let (_lab, outcome, code, log) = hang_half_way("hang", false);
    assert_eq!(code, Some(0), "{log}");
    assert_eq!(digests(&outcome, "digest"), undisturbed(ASKED));
}

/// Guards that a run ends with a named cause where the others may not play what is open there: it may go on at any time.
#[test]
fn or_ends_with_a_named_cause() {
    let (_lab, outcome, code, log) = hang_half_way("hang-shared", true);
    let lost = outcome["episodes"].as_array().unwrap().iter().filter(|episode| episode["state"] == "lost");
    let causes: Vec<&str> = lost.map(|episode| episode["cause"].as_str().unwrap()).collect();
    match code {
        // Nothing was open there at that moment.
        Some(0) => assert_eq!(digests(&outcome, "digest"), undisturbed(ASKED)),
        code => {
            assert_eq!(code, Some(3), "{log}");
            let of_others =
                "nothing could be played for 8 s: server lab-1 refuses 'open': the episode is open on server 'lab-2'";
            let is_named = |cause: &&str| {
                cause.starts_with(of_others) || cause.starts_with("fiatlux/v3/lab-2/run was not answered")
            };
            assert!(!causes.is_empty() && causes.iter().all(is_named), "{causes:?}\n{log}");
        }
    }
}
