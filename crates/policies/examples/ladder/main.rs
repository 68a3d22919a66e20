//! Plays `ladder` in rooms, the last included, and prints how each ended:
//! `cargo run -p fiatlux-policies --example ladder -- 1000..1003 [trace] [climb] [height=0.95] [push=0.3@Carry]`. With `height` the
//! ladder is so many times as high; with `push` the robot gets a speed in m/s 2 s after it came into a phase of the policy. With `climb` it goes on past S01, to where the robot
//! has come out to the ladder's steps, and lets the policy `climb` play S02 from there.
#![allow(missing_docs)]

mod play;

use std::error::Error;

use fiatlux_client::Policy;
use fiatlux_policies::{Climb, Ladder};
use fiatlux_proto::v3::{SessionInfo, TaskInfo};
use fiatlux_rules::{
    CONTROL_DT, Cause, Causes, Judge, JudgeOptions, Protocol, SeedOwner, Task, Thresholds, errand, measure,
};
use fiatlux_skills::phases::Skill;
use fiatlux_world::World;

use play::{Changes, Played, distance, play, start, touched};

/// Time after which S01 has failed, with the way out, s.
const MAX_SECONDS: f64 = 240.0;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [seeds, rest @ ..] = arguments.as_slice() else { return Err("FIRST..LAST [trace]".into()) };
    let rooms = SeedOwner::training_rooms(seeds)?;
    let trace = rest.iter().any(|word| word == "trace");
    let climbs = rest.iter().any(|word| word == "climb");
    let mut changes = Changes::default();
    for word in rest {
        match word.split_once('=') {
            Some(("height", value)) => changes.height = Some(value.parse()?),
            Some(("push", value)) => {
                let (speed, phase) = value.split_once('@').ok_or("push=SPEED@PHASE")?;
                changes.push = Some((speed.parse()?, phase.into()));
            }
            None if word == "trace" || word == "climb" => {}
            _ => {
                return Err(format!("there is no '{word}'; use trace, climb, height=FACTOR or push=SPEED@PHASE").into());
            }
        }
    }
    let (mut won, mut played) = (0, 0);
    if climbs {
        for seed in rooms.clone() {
            let (text, has_won) = climb_after(seed, trace, &changes)?;
            println!("{seed}: {text}");
            won += u64::from(has_won);
            played += 1;
        }
        println!("{won} of {played}");
        return Ok(());
    }
    for seed in rooms {
        let mut before = String::new();
        let Played { cause, seconds, phase, distance, tilt, feet, touched, penetration } =
            play(Ladder::new("")?, seed, &changes, |world, phase| {
                if trace && (phase != before || world.row().step.is_multiple_of(50) || touched(world).0 > 10.0) {
                    print_state(world, phase);
                }
                before = phase.into();
            })?;
        println!(
            "{seed}: {cause:?} after {seconds:.1} s in {phase}, top from {:.2} to {:.2} m of the lamp, tilt {tilt:.3} rad, feet {:.0} mm, {:.1} N on {}, {:.1} mm deep",
            distance[0],
            distance[1],
            1e3 * feet,
            touched.0,
            touched.1,
            1e3 * penetration
        );
        won += u64::from(cause == Cause::Success);
        played += 1;
    }
    println!("{won} of {played}");
    Ok(())
}

/// S01, the way to the steps, and S02 from there; how that ended, and whether S02 did well.
fn climb_after(seed: u64, trace: bool, changes: &Changes) -> Result<(String, bool), Box<dyn Error>> {
    let mut game = start(seed, &Changes { end_on: Some(Causes::of(&[Cause::Fall, Cause::Tip])), ..changes.clone() })?;
    let mut ladder = Ladder::new("")?;
    let mut seen = game.observe()?;
    ladder.reset(&game.info, &seen)?;
    let mut put_down = None;
    while !ladder.is_over() {
        let phase = ladder.phase();
        if trace && game.world().row().step.is_multiple_of(50) {
            print_state(game.world(), &phase);
        }
        if let Some(end) = game.verdict().end {
            return Ok((format!("{:?} after {:.1} s in {phase}", end.cause(), game.seconds()), false));
        }
        if game.seconds() > MAX_SECONDS {
            return Ok((format!("still in {phase} after {MAX_SECONDS} s"), false));
        }
        if phase == "Done" {
            put_down = Some(game.world().row().things[errand::LADDER].pose);
        }
        seen = game.step(&mut ladder, &seen, None)?;
    }
    let (out, ladder) = (game.seconds(), game.world().row().things[errand::LADDER].pose);
    let moved = put_down.map_or(f64::NAN, |pose| (pose.translation.vector - ladder.translation.vector).norm());
    let mut climb = Climb::new()?;
    let task = Some(TaskInfo { task: "S02".into(), ..TaskInfo::default() });
    // As at the start of an episode.
    seen.step = 0;
    climb.reset(&SessionInfo { task, ..game.info.clone() }, &seen)?;
    let mut row = game.world().row().clone();
    row.step = 0;
    let geometry = game.world().scene().geometry();
    let mut judge = Judge::new(Protocol::Strict, Task::S02, Thresholds::default(), geometry, JudgeOptions::default());
    judge.start(&row);
    loop {
        if let Some(end) = judge.verdict().end.or(game.verdict().end) {
            let text = format!(
                "before the steps after {out:.1} s, the ladder {:.1} mm off; then S02 {:?} after {:.1} s",
                1e3 * moved,
                end.cause(),
                game.seconds() - out
            );
            return Ok((text, end.cause() == Cause::Success));
        }
        if trace && row.step.is_multiple_of(50) {
            let part = climb.progress().map_or("to S02".into(), |(time, all)| format!("{time:.1}/{all:.1}"));
            print_state(game.world(), &part);
        }
        seen = game.step(&mut climb, &seen, None)?;
        row.clone_from(game.world().row());
        row.step = ((game.seconds() - out) / CONTROL_DT).round() as u64;
        seen.step = row.step;
        judge.advance(&row);
    }
}

fn print_state(world: &World, phase: &str) {
    let row = world.row();
    let (ladder, pelvis) = (row.things[errand::LADDER].pose, row.robot.pose);
    let here = ladder.inverse() * pelvis;
    let up = ladder.inverse() * nalgebra::Vector3::z();
    println!(
        "{:6.2} {phase:8} pelvis in the ladder's frame {:.3} {:.3} {:.3}, ladder {:.3} up, tilt {:.3} ({:.3} {:.3}), {:.2} m of the lamp{}",
        row.step as f64 * CONTROL_DT,
        here.translation.x,
        here.translation.y,
        pelvis.translation.z,
        ladder.translation.z,
        measure::tilt(&ladder),
        up.x,
        up.y,
        distance(world),
        match touched(world) {
            (force, name) if force > 1.0 => format!(", {force:.1} N on {name}"),
            _ => String::new(),
        }
    );
}
