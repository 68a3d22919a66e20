//! A file of a stranger: read, graded, and shown.
#![no_main]

use std::path::PathBuf;
use std::sync::LazyLock;

use fiatlux_fuzz::{folder, put_together, seeds_wanted, take_apart, write_seeds};
use fiatlux_grading::{GradeOptions, grade};
use fiatlux_replay::Replay;
use libfuzzer_sys::fuzz_target;

const MAGIC: &[u8] = b"\x89MCAP";

static PATH: LazyLock<PathBuf> = LazyLock::new(|| folder("bag").join("a.mcap"));

fuzz_target!(init: if let Some((folder, bag)) = seeds_wanted() {
    let whole = std::fs::read(&bag).expect("a bag");
    write_seeds(&folder, [("whole".to_owned(), whole), ("parts".into(), take_apart(&bag))]);
}, |data: &[u8]| {
    let _ = std::fs::remove_file(&*PATH);
    // As it came, or in parts, whose digests are made anew.
    if data.starts_with(MAGIC) {
        std::fs::write(&*PATH, data).expect("a file");
    } else if put_together(data, &PATH).is_none() {
        return;
    }
    let options = GradeOptions { workers: 1, ..GradeOptions::default() };
    let _ = grade(&[PATH.clone()], &options, &|_| {}).map(|results| results.to_json());
    let _ = Replay::open(&*PATH);
});
