//! A journal that takes no more lines.

use fiatlux_tests::programs::PATIENCE;
use serde_json::Value;

use super::lab::{Lab, RunArgs};

/// The registration alone takes 252,131 bytes, more than the bag of a fall.
const LARGE: RunArgs = RunArgs { tasks: "all", seeds: "0..799", episodes: 9600, parallel: "4" };

/// Room for that and for the events of some fifty episodes: the client hears of the first ones before it is full.
const FILE_BLOCKS: u32 = 560;

/// Guards that the run stops and says why, that it lists what is not played, and that it claims nothing that is not on disk.
#[test]
fn a_journal_runs_full() {
    let lab = Lab::start_with("full", 1, LARGE, true, Some(FILE_BLOCKS));
    let mut client = lab.client();
    let (status, text) = client.finish(PATIENCE);
    let (outcome, log): (Value, String) = (serde_json::from_str(&text).unwrap(), client.log());
    assert_eq!((status.code(), &outcome["finished"]), (Some(3), &false.into()), "{log:.2000}");
    assert!(
        log.contains("WARN server lab-1 refuses 'journal': the server cannot write the run's journal"),
        "{log:.2000}"
    );

    let on_disk = lab.on_disk();
    let mut claimed = 0;
    for (index, episode) in outcome["episodes"].as_array().unwrap().iter().enumerate() {
        if episode["state"] == "played" {
            let digest = episode["digest"].as_str().unwrap().to_owned();
            assert!(on_disk.contains(&(index, digest)), "{episode}");
            claimed += 1;
        }
    }
    assert!((1..=on_disk.len()).contains(&claimed), "{claimed} of {}", on_disk.len());
    assert_eq!(log.matches("\nlost: ").count(), LARGE.episodes - claimed, "each is named");
}
