//! Plays the errand by `expert` in rooms, the last included, and prints how far it came in each and a funnel:
//! `cargo run -p fiatlux-policies --example errand -- replace 64..127`. A subtask in place of `replace` begins at that subtask's start,
//! under the rules of `replace`: `S02 1000..1003`. With
//! `trace` it prints where robot and bulbs are.
#![allow(missing_docs)]

mod play;

use std::error::Error;

use fiatlux_rules::{Bulb, CONTROL_DT, Task, errand};
use nalgebra::Isometry3;
use play::play;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [start, seeds, rest @ ..] = arguments.as_slice() else { return Err("START FIRST..LAST [trace]".into()) };
    let trace = rest.iter().any(|word| word == "trace");
    let start: Task = start.parse()?;
    let (first, last) = seeds.split_once("..").ok_or("FIRST..LAST")?;
    let mut funnel = Vec::new();
    let mut rooms = 0;
    for seed in first.parse::<u64>()?..=last.parse()? {
        let played = play(start, seed, |row, stage| {
            if trace && row.step % 50 == 0 {
                let at = |pose: &Isometry3<f64>| {
                    let at = pose.translation;
                    format!("{:.2} {:.2} {:.2}", at.x, at.y, at.z)
                };
                let crate_ = at(&row.body(errand::CRATE).pose);
                let [old, fresh] = [Bulb::Old, Bulb::Fresh].map(|bulb| at(&row.body(bulb.thing()).pose));
                let robot = at(&row.robot.pose);
                println!(
                    "{:6.1} {stage:24} pelvis {robot}, old {old}, fresh {fresh}, crate {crate_}",
                    row.step as f64 * CONTROL_DT
                );
            }
        })?;
        let stages: Vec<String> = played.stages.iter().map(|(task, at)| format!("{task} {at:.0} s")).collect();
        println!("{seed}: {} after {:.0} s: {}", played.end, played.seconds, stages.join(", "));
        for (task, _) in &played.stages {
            match funnel.iter_mut().find(|(known, _, _)| known == task) {
                Some((_, reached, _)) => *reached += 1,
                None => funnel.push((*task, 1, Vec::new())),
            }
        }
        if let Some((task, _)) = played.stages.last()
            && let Some((_, _, ends)) = funnel.iter_mut().find(|(known, _, _)| known == task)
        {
            ends.push(format!("{seed} {}", played.end));
        }
        rooms += 1;
    }
    funnel.sort_by_key(|(task, _, _)| Task::ALL.iter().position(|known| known == task));
    println!("{rooms} rooms\ntask  reached  ended there");
    for (task, reached, ends) in funnel {
        println!("{task:4}  {reached:7}  {}", ends.join(", "));
    }
    Ok(())
}
