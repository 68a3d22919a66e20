//! Plays `hands` in rooms, the last included, and prints how each ended:
//! `cargo run -p fiatlux-policies --example hands -- S08 1000..1003 [trace] [FILE.toml] [CHANGE...]`.
//! With `trace` it prints phases, forces and how many criteria hold, and with a file it plays other parameters. Changes are
//! `robot=NAME`, `left` (the bulb begins in the left hand), `scene=FILE` (numbers over those of the scene), `friction=0.7` (of the hands), `size=0.9` (of the fresh bulb),
//! `delay=1` (control steps), `push=0.3@Close` (m/s, half a second into a phase, in another direction in each room) and `lying` (a
//! force lays the fresh bulb down, away from the robot, in another direction in each room).
#![allow(missing_docs)]

mod play;

use std::error::Error;

use fiatlux_policies::Hands;
use fiatlux_rules::{Bulb, CONTROL_DT, Cause, SeedOwner, Task, errand};
use nalgebra::{UnitQuaternion, Vector3};

use play::{Changes, Moment, bulb_of, forces, play};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [task, seeds, rest @ ..] = arguments.as_slice() else { return Err("TASK FIRST..LAST [trace] [FILE]".into()) };
    let task = *Task::ALL.iter().find(|known| format!("{known:?}") == *task).ok_or("no such task")?;
    let rooms = SeedOwner::training_rooms(seeds)?;
    let trace = rest.iter().any(|word| word == "trace");
    let file = rest
        .iter()
        .find(|word| word.ends_with(".toml") && !word.contains('='))
        .map(std::fs::read_to_string)
        .transpose()?;
    let changes = changes(rest)?;
    let (mut peaks, mut times, mut played, mut deepest) = (Vec::new(), Vec::new(), 0, 0.0_f64);
    for seed in rooms {
        let hands = Hands::new()?.with_parameters(file.clone());
        let mut before = String::new();
        let ended = play(task, seed, hands, &changes, |moment| {
            if trace && (moment.phase != before || moment.row.step % 25 == 0) {
                print_state(moment, bulb_of(task));
            }
            before = moment.phase.into();
        })?;
        let clean = if ended.is_spoilt { ", broken or dropped" } else { "" };
        println!(
            "{seed}: {:?} after {:.1} s in {}, peak {:.1} N ({:.1} N after the start), overlap {:.1} mm{clean}",
            ended.cause,
            ended.seconds,
            ended.phase,
            ended.peak,
            ended.later_peak,
            ended.penetration * 1e3
        );
        played += 1;
        if ended.cause == Cause::Success && !ended.is_spoilt {
            peaks.push(ended.peak);
            times.push(ended.seconds);
            deepest = deepest.max(ended.penetration);
        }
    }
    peaks.sort_by(f64::total_cmp);
    times.sort_by(f64::total_cmp);
    let at = |numbers: &[f64], index: usize| numbers.get(index).copied().unwrap_or(f64::NAN);
    let middle = times.len() / 2;
    println!(
        "{} of {played}; of these peak force median {:.1} N, most {:.1} N; time median {:.1} s; overlap most {:.1} mm",
        times.len(),
        at(&peaks, middle),
        at(&peaks, peaks.len().wrapping_sub(1)),
        at(&times, middle),
        deepest * 1e3
    );
    Ok(())
}

/// Changes from words such as `friction=0.7`.
fn changes(words: &[String]) -> Result<Changes, Box<dyn Error>> {
    let has = |change: &str| words.iter().any(|word| word == change);
    let mut changes = Changes { lying: has("lying"), left: has("left"), ..Changes::default() };
    for (name, value) in words.iter().filter_map(|word| word.split_once('=')) {
        match name {
            "robot" => changes.robot = Some(value.into()),
            "scene" => changes.scene = Some(std::fs::read_to_string(value)?),
            "friction" => changes.friction = Some(value.parse()?),
            "size" => changes.fresh_bulb = Some(value.parse()?),
            "delay" => changes.delay = value.parse()?,
            "push" => {
                let (speed, phase) = value.split_once('@').ok_or("push=SPEED@PHASE")?;
                changes.push = Some((speed.parse()?, phase.into()));
            }
            _ => return Err(format!("there is no change '{name}'; use friction, size, delay or push").into()),
        }
    }
    Ok(changes)
}

fn print_state(moment: &Moment<'_>, bulb: Bulb) {
    let row = moment.row;
    let pelvis = row.robot.pose;
    let at = row.body(bulb.thing()).pose.translation.vector;
    let ahead = pelvis.rotation * Vector3::x();
    let level = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -ahead.y.atan2(ahead.x));
    let away = level * (at - pelvis.translation.vector);
    let of_other = row.load(errand::OTHER_FORCE_PEAK[bulb as usize])[0];
    let touching: Vec<usize> =
        forces(row, bulb).enumerate().filter(|(_, force)| *force > 0.3).map(|(body, _)| body).collect();
    println!(
        "{:6.2} {:9} hand off {:3.0} mm, {:4.1} N on {touching:?}, others {of_other:.1} N, bulb {:.3} ahead {:.3} left {:.3} high, \
         pelvis {:.3} high, {} criteria{}",
        row.step as f64 * CONTROL_DT,
        moment.phase,
        moment.off * 1e3,
        forces(row, bulb).fold(0.0, f64::max),
        away.x,
        away.y,
        at.z,
        pelvis.translation.z,
        moment.verdict.count,
        if moment.verdict.dropped { ", dropped" } else { "" },
    );
}
