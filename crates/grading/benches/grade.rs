//! The time of grading: 48 bags of 6,000 rows, and each part of the work. `cargo bench -p fiatlux-grading [-- BAGS
//! ROWS]`

#[path = "../tests/common/mod.rs"]
mod common;

use std::hint::black_box;
use std::time::Instant;

use common::room::LAYOUT;
use common::{Folder, Story, header, result, rows, write};
use fiatlux_bag::Bag;
use fiatlux_grading::{GradeOptions, Grader, grade, report};
use fiatlux_proto::{Message, v3};
use fiatlux_rules::{RowDigest, Task};
use fiatlux_wire::{read_row, state_message};

fn main() {
    let numbers: Vec<u64> = std::env::args().skip(1).filter_map(|arg| arg.parse().ok()).collect();
    let [bags, steps] = [numbers.first().copied().unwrap_or(48), numbers.get(1).copied().unwrap_or(6_000)];
    let folder = Folder::new("bench");
    for k in 0..bags {
        let task = Task::SUBTASKS[k as usize % 12];
        write(&folder.0.join(format!("{task}-{k}.mcap")), task, k / 12, Story::Waits(steps));
    }
    let bytes: u64 =
        std::fs::read_dir(&folder.0).expect("listed").flatten().map(|e| e.metadata().map_or(0, |m| m.len())).sum();
    println!("{bags} bags, {:.0} MB", bytes as f64 / 1e6);
    for workers in [1, 2] {
        let options = GradeOptions { workers, ..GradeOptions::default() };
        let start = Instant::now();
        let results = grade(std::slice::from_ref(&folder.0), &options, &|_| {}).expect("graded");
        let seconds = start.elapsed().as_secs_f64();
        let count: u64 = results.episodes.iter().map(|episode| episode.steps + 1).sum();
        println!(
            "{workers} workers: {seconds:.2} s, {:.1} us a row on each",
            1e6 * seconds * workers as f64 / count as f64
        );
        let start = Instant::now();
        let page = report::html(&results);
        println!("  page: {:.0} ms, {:.2} MB", 1e3 * start.elapsed().as_secs_f64(), page.len() as f64 / 1e6);
    }
    parts(&folder);
}

/// Times each part of the work alone, on the rows of one bag.
fn parts(folder: &Folder) {
    let (header, rows) = (header(Task::S03, 0), rows(Task::S03, 0, Story::Waits(2000)));
    let states: Vec<v3::State> = rows.iter().map(state_message).collect();
    let bytes: Vec<Vec<u8>> = states.iter().map(Message::encode_to_vec).collect();
    let path = folder.0.join("parts.mcap");
    common::begin(&path, &header, &rows).finish(&result(&header, &rows)).expect("finished");
    let bag = Bag::open(&path).expect("a bag");
    let time = |name: &str, work: &mut dyn FnMut()| {
        work();
        let start = Instant::now();
        (0..5).for_each(|_| work());
        println!("{name:<28}{:>7.2} us a row", 1e6 * start.elapsed().as_secs_f64() / 5.0 / rows.len() as f64);
    };
    println!("{} bytes a row", bytes[0].len());
    time("file to State", &mut || bag.states().for_each(|state| drop(black_box(state))));
    time("bytes to State", &mut || bytes.iter().for_each(|bytes| drop(black_box(v3::State::decode(&bytes[..])))));
    time("State to Row", &mut || {
        states.iter().for_each(|state| {
            let _ = black_box(read_row(state, LAYOUT));
        });
    });
    time("digest", &mut || {
        let mut digest = RowDigest::new(&[]);
        rows.iter().for_each(|row| digest.push(row));
        black_box(digest.bytes());
    });
    time("judge, digest and series", &mut || {
        let mut grader = Grader::new(&header, &[], false).expect("a header");
        rows.iter().for_each(|row| grader.push(row));
        black_box(grader.finish(None));
    });
}
