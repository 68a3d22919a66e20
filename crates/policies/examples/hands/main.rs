//! Plays `hands` in rooms, the last included, and prints how each ended. With `trace` it prints phases, forces and how many
//! criteria hold, and with a file it plays other parameters:
//! `cargo run -p fiatlux-policies --example hands -- S08 1000..1003 [trace] [FILE.toml]`.
#![allow(missing_docs)]

mod play;

use std::error::Error;

use fiatlux_policies::Hands;
use fiatlux_rules::{Bulb, CONTROL_DT, Cause, Task};
use fiatlux_world::Episode;

use play::{forces, play};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [task, seeds, rest @ ..] = arguments.as_slice() else { return Err("TASK FIRST..LAST [trace] [FILE]".into()) };
    let task = *Task::ALL.iter().find(|known| format!("{known:?}") == *task).ok_or("no such task")?;
    let (first, last) = seeds.split_once("..").ok_or("FIRST..LAST")?;
    let trace = rest.iter().any(|word| word == "trace");
    let file = rest.iter().find(|word| word.ends_with(".toml")).map(std::fs::read_to_string).transpose()?;
    let (mut peaks, mut times, mut played) = (Vec::new(), Vec::new(), 0);
    for seed in first.parse::<u64>()?..=last.parse()? {
        let mut hands = Hands::new()?;
        if let Some(file) = &file {
            hands = hands.with_parameters(file.clone());
        }
        let mut before = String::new();
        let ended = play(task, seed, hands, |episode, phase, off| {
            if trace && (phase != before || episode.row().step % 25 == 0) {
                print_state(episode, phase, off);
            }
            before = phase.into();
        })?;
        println!("{seed}: {:?} after {:.1} s in {}, peak {:.1} N", ended.cause, ended.seconds, ended.phase, ended.peak);
        played += 1;
        if ended.cause == Cause::Success {
            peaks.push(ended.peak);
            times.push(ended.seconds);
        }
    }
    peaks.sort_by(f64::total_cmp);
    times.sort_by(f64::total_cmp);
    let at = |numbers: &[f64], index: usize| numbers.get(index).copied().unwrap_or(f64::NAN);
    let middle = times.len() / 2;
    println!(
        "{} of {played}; of these peak force median {:.1} N, most {:.1} N; time median {:.1} s",
        times.len(),
        at(&peaks, middle),
        at(&peaks, peaks.len().wrapping_sub(1)),
        at(&times, middle)
    );
    Ok(())
}

fn print_state(episode: &Episode, phase: &str, off: f64) {
    let row = episode.row();
    let bulb = row.body(Bulb::Fresh.thing()).pose.translation.vector - row.robot.pose.translation.vector;
    let touching: Vec<usize> =
        forces(row).enumerate().filter(|(_, force)| *force > 0.3).map(|(body, _)| body).collect();
    println!(
        "{:6.2} {phase:9} hand off {:3.0} mm, {:4.1} N on {touching:?}, bulb {:.3} {:.3} {:.3} from the pelvis, {} criteria",
        row.step as f64 * CONTROL_DT,
        off * 1e3,
        forces(row).fold(0.0, f64::max),
        bulb.x,
        bulb.y,
        bulb.z,
        episode.verdict().count
    );
}
