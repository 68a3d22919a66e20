//! Half of what plays a run is lost on the way, and the run is not.

use fiatlux_tests::programs::{PATIENCE, wait_until};

use super::lab::{BENCHMARK, Lab, RunArgs};

/// Two servers of a group; one of them is killed with what it plays, and later the client.
fn a_server_and_the_client_are_lost(name: &str, asked: RunArgs) {
    let mut lab = Lab::start(name, 2, asked);
    let mut client = lab.client();
    wait_until("a third is played", PATIENCE, || lab.played() >= asked.episodes / 3);
    lab.kill(1);
    wait_until("the other server plays on", PATIENCE, || lab.played() >= asked.episodes / 2);
    client.kill();
    assert!(lab.played() < asked.episodes, "there is something left to play");
    lab.assert_whole(&mut lab.client());
    lab.assert_verified(0);
}

#[test]
fn the_benchmark_loses_a_server_and_its_client() {
    a_server_and_the_client_are_lost("loss", BENCHMARK);
}
