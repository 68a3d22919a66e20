//! Each program is killed at random moments of a run and started again. Whatever is graded in the end has the rows of an
//! undisturbed run, and nothing is missing.

use std::thread::sleep;
use std::time::Duration;

use fiatlux_tests::programs::{PATIENCE, Service, alone, grade, wait_until};
use fiatlux_tests::{at_full_length, repeats};

use super::lab::{BENCHMARK, Lab, RunArgs};

fn kills_of_each() -> u64 {
    repeats(20, 6, 4)
}

/// The everyday form has half of the benchmark.
fn asked() -> RunArgs {
    let half = RunArgs { tasks: "all", seeds: "0..1", episodes: 24, parallel: "4" };
    if at_full_length() { BENCHMARK } else { half }
}

/// SplitMix64: the same moments in every run of the test, as far as a machine keeps time.
struct Dice(u64);

impl Dice {
    fn below(&mut self, end: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (mixed ^ (mixed >> 31)) % end
    }

    fn wait_ms(&mut self, first: u64, last: u64) {
        sleep(Duration::from_millis(first + self.below(last - first)));
    }
}

/// One run after the other, until all kills are done: each run is whole in the end.
fn kill_in_runs(
    name: &str,
    seed: u64,
    mut kill: impl FnMut(&mut Lab, &mut fiatlux_tests::programs::Running, &mut Dice),
) {
    let (mut dice, asked) = (Dice(seed), asked());
    let (mut kills, all) = (0, kills_of_each());
    while kills < all {
        let mut lab = Lab::start(name, 2, asked);
        let mut client = lab.client();
        dice.wait_ms(200, 1500);
        while kills < all && client.is_running() {
            kill(&mut lab, &mut client, &mut dice);
            kills += 1;
            println!("{name}: kill {kills} with {} of {} played", lab.played(), asked.episodes);
            dice.wait_ms(50, 1500);
        }
        lab.assert_whole(&mut client);
    }
}

#[test]
fn servers_die() {
    kill_in_runs("server-kills", 1, |lab, _, dice| {
        let server = dice.below(2) as usize;
        lab.kill(server);
        // Sometimes it is back before anybody has missed it.
        dice.wait_ms(0, 3000);
        lab.revive(server);
    });
}

#[test]
fn clients_die() {
    kill_in_runs("client-kills", 2, |lab, client, _| {
        client.kill();
        *client = lab.client();
    });
}

/// Outside runs a recorder of its own writes the bags: it loses no row, for the session waits for the next recorder.
#[test]
fn recorders_die() {
    let asked = ["--policy", "random", "--task", "S01", "--seed", "5", "--episodes", "30"];
    let expected = alone(&asked);
    let (mut dice, mut kills, all) = (Dice(3), 0, kills_of_each());
    while kills < all {
        let service = Service::start("recorder-kills", &[]);
        let mut recorder = service.record();
        let mut client = service.client(&[&asked[..], &["--recorded"]].concat());
        dice.wait_ms(200, 1000);
        while kills < all && client.is_running() {
            recorder.kill();
            recorder = service.record();
            kills += 1;
            dice.wait_ms(50, 1000);
        }
        let episodes = fiatlux_tests::programs::played(&mut client);
        assert_eq!(episodes, expected);
        // Rows of the last episodes may still be with the server.
        wait_until("all bags are whole", PATIENCE, || service.folder.files(".mcap").len() == episodes.len());
        // One that was started just now has to listen for the signal first.
        wait_until("it records", PATIENCE, || recorder.log().contains("bags go to "));
        recorder.signal("TERM");
        let (status, bags) = recorder.finish(PATIENCE);
        assert!(status.success(), "no bag is cut: {status}\n{bags}\n{}", recorder.log());
        let (code, results) = grade(&service.bags(), &service.folder);
        let graded = results["episodes"].as_array().unwrap();
        assert_eq!((code, graded.len()), (0, episodes.len()), "{:#}", results["excluded"]);
        assert!(graded.iter().zip(&episodes).all(|(graded, episode)| graded["state_digest"] == episode.digest));
    }
}
