//! Plays `climb` in rooms, the last included, on all cores, and prints how each ended:
//! `cargo run -p fiatlux-policies --example climb -- S02 1000..1003 [trace] [FILE.safetensors]`, with the network in the file where
//! one is named.
#![allow(missing_docs)]

mod play;

use std::error::Error;
use std::sync::atomic::{AtomicU64, Ordering};

use fiatlux_policies::Climb;
use fiatlux_rules::{CONTROL_DT, Cause, Task};
use fiatlux_world::Episode;

use play::{Played, ladder_from_pelvis, play};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [task, seeds, rest @ ..] = arguments.as_slice() else {
        return Err("TASK FIRST..LAST [trace] [FILE.safetensors]".into());
    };
    let task = *Task::ALL.iter().find(|known| format!("{known:?}") == *task).ok_or("no such task")?;
    let (first, last) = seeds.split_once("..").ok_or("FIRST..LAST")?;
    let (first, last) = (first.parse::<u64>()?, last.parse::<u64>()?);
    let trace = rest.iter().any(|word| word == "trace");
    let file = rest.iter().find(|word| word.ends_with(".safetensors"));
    let climb = || file.map_or_else(Climb::new, |file| Climb::with_network(file));
    let (next, won) = (AtomicU64::new(first), AtomicU64::new(0));
    let play_on = || {
        loop {
            let seed = next.fetch_add(1, Ordering::SeqCst);
            if seed > last {
                return;
            }
            let watch = |episode: &Episode, time| {
                if trace && episode.row().step.is_multiple_of(25) {
                    print_state(episode, time);
                }
            };
            match climb().map_err(Into::into).and_then(|climb| play(climb, task, seed, watch)) {
                Ok(Played { cause, seconds, progress, height, ladder, effort }) => {
                    println!(
                        "{seed}: {cause:?} after {seconds:.1} s, plan {progress:.1?} s, pelvis {height:.2} m, ladder {:.1} mm and \
                         {:.4} rad, effort {:.0} %",
                        1e3 * ladder.0,
                        ladder.1,
                        100.0 * effort
                    );
                    won.fetch_add(u64::from(cause == Cause::Success), Ordering::SeqCst);
                }
                Err(error) => println!("{seed}: {error}"),
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(play_on);
        }
    });
    println!("{} of {}", won.load(Ordering::SeqCst), last + 1 - first);
    Ok(())
}

fn print_state(episode: &Episode, time: Option<f64>) {
    let (row, here) = (episode.row(), ladder_from_pelvis(episode.row()));
    println!(
        "{:6.2} plan {time:.1?} pelvis {:.3} {:.3} {:.3}, {} criteria",
        row.step as f64 * CONTROL_DT,
        here.translation.x,
        here.translation.y,
        here.translation.z,
        episode.verdict().count
    );
}
