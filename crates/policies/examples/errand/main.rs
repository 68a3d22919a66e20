//! Plays the errand by `expert` in rooms, the last included, and prints how far it came in each and a funnel:
//! `cargo run -p fiatlux-policies --example errand -- replace 1000..1063`, or `replace fresh:64` for a rate. A subtask in place of `replace`
//! begins at that subtask's start, under the rules of `replace`: `S02 1000..1003`. With `trace` it prints each second where robot and bulbs
//! are and what the robot touches; with `end` five times a second in the last 30 s of rooms without success, and as each subtask begins.
#![allow(missing_docs)]

mod play;

use std::collections::VecDeque;
use std::error::Error;

use fiatlux_client::SeedList;
use fiatlux_rules::{Bulb, CONTROL_DT, SeedOwner, Task, Thresholds, errand};
use fiatlux_world::{ShapeOwner, World};
use nalgebra::Isometry3;
use play::play;

/// Force from which on a contact is printed, N.
const FELT: f64 = 1.0;
/// Share of the force that breaks a bulb from which on it is printed in each step.
const PRESSED: f64 = 0.8;
/// Control steps between the lines of `trace` and of `end`, and how many of the latter are printed.
const EVERY: [u64; 2] = [50, 10];
const LINES: usize = 150;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [start, seeds, rest @ ..] = arguments.as_slice() else { return Err("START FIRST..LAST [trace] [end]".into()) };
    let [traces, shows_end] = ["trace", "end"].map(|word| rest.iter().any(|given| given == word));
    let start: Task = start.parse()?;
    let seeds: Vec<u64> = match seeds.parse::<SeedList>() {
        Ok(drawn) if drawn.fresh => drawn.seeds,
        _ => SeedOwner::training_rooms(seeds)?.collect(),
    };
    let mut funnel = Vec::new();
    let mut rooms = 0;
    for seed in seeds {
        let mut lines = VecDeque::new();
        let mut task = String::new();
        let played = play(start, seed, |world, stage| {
            let is_due = |every: u64| world.row().step.is_multiple_of(every);
            if traces && is_due(EVERY[0]) {
                println!("{}", state(world, stage));
            }
            let now = stage.split(' ').next().unwrap_or_default();
            if shows_end && now != task {
                task = now.to_owned();
                println!("{seed} {} begins", state(world, stage));
            }
            if shows_end && (is_due(EVERY[1]) || presses_a_bulb(world)) {
                lines.push_back(state(world, stage));
                lines.drain(..lines.len().saturating_sub(LINES));
            }
            true
        })?;
        if played.end != "success" {
            lines.iter().for_each(|line| println!("{seed} {line}"));
        }
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

fn is_bulb(owner: &ShapeOwner) -> bool {
    [ShapeOwner::OLD_BULB, ShapeOwner::FRESH_BULB].contains(owner)
}

/// A bulb is soon pressed until it breaks.
fn presses_a_bulb(world: &World) -> bool {
    let pressed = PRESSED * Thresholds::default().fragility_n;
    world.dynamics().contacts().iter().any(|contact| {
        let owners = [contact.shape_a, contact.shape_b].map(|shape| world.scene().owner(shape));
        contact.force.norm() > pressed && owners.iter().any(is_bulb)
    })
}

/// Where robot and bulbs are in the world and the robot in the ladder's frame, how the ladder leans, and what the robot touches
/// besides the floor and with its soles.
fn state(world: &World, stage: &str) -> String {
    let (row, scene) = (world.row(), world.scene());
    let at = |pose: &Isometry3<f64>| {
        let at = pose.translation;
        format!("{:.2} {:.2} {:.2}", at.x, at.y, at.z)
    };
    let ladder = row.things[errand::LADDER].pose;
    let [old, fresh] = [Bulb::Old, Bulb::Fresh].map(|bulb| at(&row.body(bulb.thing()).pose));
    let mut text = format!(
        "{:6.1} {stage:24} pelvis {}, by the ladder {}, old {old}, fresh {fresh}, crate {}",
        row.step as f64 * CONTROL_DT,
        at(&row.robot.pose),
        at(&(ladder.inverse() * row.robot.pose)),
        at(&row.body(errand::CRATE).pose)
    );
    let name = |owner: ShapeOwner| match owner {
        ShapeOwner::Robot(link) => scene.robot.links()[link].name.clone(),
        other => other.name().into(),
    };
    for contact in world.dynamics().contacts().iter().filter(|contact| contact.force.norm() > FELT) {
        let owners = [contact.shape_a, contact.shape_b].map(|shape| scene.owner(shape));
        let is_robots = |owner: &ShapeOwner| matches!(owner, ShapeOwner::Robot(_));
        let names = owners.map(name);
        if owners.iter().any(|owner| is_robots(owner) || is_bulb(owner))
            && names.iter().all(|name| !name.contains("ankle"))
        {
            text += &format!(", {} {} {:.0} N", names[0], names[1], contact.force.norm());
        }
    }
    text
}
