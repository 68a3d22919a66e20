//! A server of the group that does not play.

use fiatlux_tests::programs::{Running, endpoint, free_port};

use super::lab::{Lab, RunArgs};

const ASKED: RunArgs = RunArgs { tasks: "S05,S07", seeds: "0..3", episodes: 8, parallel: "2" };

/// Guards that a server which plays nothing is named with the remedy, however well the others do.
#[test]
fn who_does_not_take_part_is_named() {
    let lab = Lab::start("refuses", 1, ASKED);
    let second = endpoint(free_port());
    let mut server = Running::start("sim-server", &["--name", "lab-2", "-l", &second, "--workers", "1"], &lab.folder);
    server.wait_for("listening on ");
    let mut client = lab.client_with(&["-e", &second]);
    lab.assert_whole(&mut client);
    let named = "server lab-2 refuses 'run': this server keeps no runs; start it with --record DIR, or use another one; server lab-2 \
                 does not take part";
    let log = client.log();
    assert_eq!(log.matches(named).count(), 1, "{log}");
}
