//! Bags with random changes, up to 10,000: none crashes the grader, and only unchanged ones are scored.

use std::collections::BTreeMap;

use crate::common::{Folder, Story, mutations, write};
use fiatlux_grading::{GradeOptions, ScoreError, grade};
use fiatlux_rules::Task;
use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::{Rng as _, SeedableRng as _};

/// Maximum peak memory of the process, bytes.
const MAX_MEMORY: u64 = 1 << 30;

fn mutated(random: &mut Pcg64Mcg, sources: &[Vec<u8>]) -> Vec<u8> {
    let mut pick = |below: usize| (random.next_u64() % below.max(1) as u64) as usize;
    let mut bytes = sources[pick(sources.len())].clone();
    for _ in 0..1 + pick(3) {
        let at = pick(bytes.len());
        match pick(7) {
            0 => bytes[at] ^= 1 << pick(8),
            1 => bytes[at] = pick(256) as u8,
            // Makes a length, an offset or a count zero or far too large.
            2 => {
                let odd = [0, 1, u64::MAX, u64::MAX / 2, 1 << 32, 1 << 40][pick(6)].to_le_bytes();
                let end = (at + 8).min(bytes.len());
                bytes[at..end].copy_from_slice(&odd[..end - at]);
            }
            3 => bytes.truncate(at),
            4 => {
                let other = &sources[pick(sources.len())];
                let from = pick(other.len());
                let end = (from + 1 + pick(4096)).min(other.len());
                bytes.splice(at..at, other[from..end].iter().copied());
            }
            5 => {
                let end = (at + 1 + pick(4096)).min(bytes.len());
                bytes.drain(at..end);
            }
            _ => bytes.insert(at, pick(256) as u8),
        }
        if bytes.is_empty() {
            return bytes;
        }
    }
    bytes
}

#[test]
fn mutated_bags() {
    let folder = Folder::new("mutated");
    let stories =
        [(Task::S01, 3, Story::Succeeds(20)), (Task::S05, 4, Story::Falls(30)), (Task::S08, 5, Story::Crushes(20))];
    let sources: Vec<Vec<u8>> = stories
        .into_iter()
        .map(|(task, seed, story)| {
            let path = folder.0.join("source.mcap");
            write(&path, task, seed, story);
            let bytes = std::fs::read(&path).expect("written");
            std::fs::remove_file(path).expect("removed");
            bytes
        })
        .collect();
    let path = folder.0.join("a.mcap");
    let options = GradeOptions { workers: 1, relative_to: folder.0.clone(), ..GradeOptions::default() };
    let (mut random, mut reasons) = (Pcg64Mcg::seed_from_u64(17), BTreeMap::new());
    let count = mutations(10_000);
    for number in 0..count {
        let bytes = mutated(&mut random, &sources);
        std::fs::write(&path, &bytes).expect("written");
        let graded = grade(std::slice::from_ref(&path), &options, &|_| {});
        assert!(!matches!(graded, Err(ScoreError::Worker)), "{number}: the grader panicked");
        let graded = graded.unwrap_or_else(|error| panic!("{number}: {error}"));
        let is_same = sources.contains(&bytes);
        assert_eq!(graded.episodes.len(), usize::from(is_same), "{number}: {:?}", graded.excluded);
        for bag in graded.excluded {
            *reasons.entry(bag.reason).or_insert(0) += 1;
        }
    }
    assert!(reasons.len() >= 3, "{reasons:?}");
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:")?.trim().strip_suffix(" kB")?.trim().parse::<u64>().ok());
    let peak: u64 = peak.unwrap_or(0) * 1024;
    assert!(peak < MAX_MEMORY, "{peak} bytes");
    eprintln!("{count} bags: {reasons:?}, at most {} MiB", peak >> 20);
}
