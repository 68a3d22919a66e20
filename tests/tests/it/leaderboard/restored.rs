//! A service whose folder is lost, and brought back from a backup.

use std::path::Path;
use std::process::Command;

use fiatlux_tests::programs::{endpoint, program};

use super::lab::{Board, Lab, played_run, wait_for_state};

/// Guards that a backup put in the place of a lost folder is the service as it was: the same list, pages and bags, byte by byte,
/// and what waited for a second run gets it.
#[test]
fn a_restored_folder_goes_on() {
    let lab = Lab::start("board-restored");
    let run = played_run(&lab, "public", &["--seeds", "0"]);
    let loose = lab.copy(&run, "loose", |name| name.contains("-S01-"));
    // Without a server that verifies, jobs wait.
    let mut board = Board::start_with(&lab, &[], &[]);
    let (code, waiting) = board.submit_without_waiting(&run);
    assert_eq!(code, 0, "{waiting}");
    let id = waiting["id"].as_str().unwrap();
    wait_for_state(&board, id, "graded");
    let folder = board.folder();
    let backup = lab.folder().path().join("backup");
    let admin = |folder: &Path| {
        Command::new(program("scorer")).args(["admin", "--folder"]).arg(folder).args(["backup"]).arg(&backup).output()
    };
    let done = admin(&folder).unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let list = board.fetch("/api/v1/submissions");
    let addresses =
        ["".to_owned(), "/tasks/S05".into(), "/episodes/S01-s0-e0".into(), "/episodes/S12-s0-e0/bag".into()];
    let addresses = addresses.map(|rest| format!("/runs/{id}{rest}"));
    let before = addresses.each_ref().map(|address| board.fetch(address));
    // Later entries are not in the backup.
    board.submit_without_waiting(&loose);
    board.stop();
    std::fs::remove_dir_all(&folder).unwrap();
    std::fs::rename(&backup, &folder).unwrap();

    board.restart(&[]);
    assert!(board.fetch("/api/v1/submissions") == list, "the list");
    for (address, before) in addresses.iter().zip(&before) {
        assert!(board.fetch(address) == *before, "{address}");
    }
    board.restart(&[&endpoint(lab.port())]);
    wait_for_state(&board, id, "verified");
    let entry = board.get(&format!("/api/v1/submissions/{id}"));
    assert_eq!((&entry["badge"], &entry["episodes_verified"]), (&"replayed".into(), &12.into()), "{entry}");
    // It takes submissions again.
    let (code, again) = board.submit(&run, &["--note", "again"]);
    assert_eq!((code, again["badge"].as_str()), (0, Some("replayed")), "{again}");
}
