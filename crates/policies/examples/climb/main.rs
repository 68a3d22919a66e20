//! Plays `climb` in training rooms, the last included, or in rooms drawn afresh (`fresh:64`), on all cores, and prints how each ended:
//! `cargo run -p fiatlux-policies --example climb -- S02 1000..1003 [wall=0.95] [trace] [loads] [FILE.safetensors] [CHANGE...]`, with the
//! network in the file where one is named. With `wall`, only rooms in which a wall or a thing is nearer to the ladder's steps, m. `loads` ends with a table of the joints' efforts and speeds in the successes. Changes are
//! `friction=0.8` (of the ladder), `x=1.05`, `y=` and `z=` (sizes of the ladder), `mass=0.05` (all masses of the robot more by that part),
//! `masses=0.05` (each by another part up to it), `delay=1` (control steps), `push=0.3` (m/s, once during the climb) and
//! `arms=0.12,1.2` (roll of the shoulders and angle of the elbows from which on it goes, rad: as `ladder` leaves them).
#![allow(missing_docs)]

mod play;

use std::error::Error;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use fiatlux_client::SeedList;
use fiatlux_policies::Climb;
use fiatlux_robot::Robot;
use fiatlux_rules::{CONTROL_DT, Cause, Task};

use play::{Changes, Loads, Moment, Played, before_the_steps, ladder_from_pelvis, play};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [task, seeds, rest @ ..] = arguments.as_slice() else {
        return Err("TASK ROOMS [wall=M] [trace] [loads] [FILE.safetensors] [CHANGE...]".into());
    };
    let task = *Task::ALL.iter().find(|known| format!("{known:?}") == *task).ok_or("no such task")?;
    let mut rooms: SeedList = seeds.parse()?;
    rooms.check_training()?;
    if let Some(wall) = rest.iter().find_map(|word| word.strip_prefix("wall=")) {
        let wall: f64 = wall.parse()?;
        let is_near = |seed: u64| before_the_steps(task, seed).map(|room| (room < wall).then_some(seed));
        let near: Result<Vec<_>, _> = rooms.seeds.into_iter().map(is_near).collect();
        rooms.seeds = near?.into_iter().flatten().collect();
    }
    let trace = rest.iter().any(|word| word == "trace");
    let file = rest.iter().find(|word| word.ends_with(".safetensors"));
    let changes = changes(rest)?;
    let climb = || file.map_or_else(Climb::new, |file| Climb::with_network(file));
    let (next, won) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let play_on = || {
        loop {
            let Some(&seed) = rooms.seeds.get(next.fetch_add(1, Ordering::SeqCst)) else { return };
            let watch = |moment: &Moment<'_>| {
                if trace && moment.row.step.is_multiple_of(25) {
                    print_state(moment);
                }
            };
            match climb().map_err(Into::into).and_then(|climb| play(climb, task, seed, &changes, watch)) {
                Ok(played) => {
                    print_end(seed, &played);
                    if played.cause == Cause::Success
                        && let Ok(mut won) = won.lock()
                    {
                        won.push(played);
                    }
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
    let won = won.into_inner()?;
    if rest.iter().any(|word| word == "loads") && !won.is_empty() {
        print_loads(&won)?;
    }
    println!("{} of {}", won.len(), rooms.seeds.len());
    Ok(())
}

/// Changes from words such as `friction=0.8`.
fn changes(words: &[String]) -> Result<Changes, Box<dyn Error>> {
    let mut changes = Changes::default();
    for (name, value) in words.iter().filter_map(|word| word.split_once('=')) {
        match name {
            "friction" => changes.friction = Some(value.parse()?),
            "x" => changes.scale.ladder[0] = value.parse()?,
            "y" => changes.scale.ladder[1] = value.parse()?,
            "z" => changes.scale.ladder[2] = value.parse()?,
            "mass" => changes.mass = value.parse()?,
            "masses" => changes.masses = value.parse()?,
            "delay" => changes.delay = value.parse()?,
            "push" => changes.push = Some(value.parse()?),
            "wall" => {}
            "arms" => {
                let (roll, elbow) = value.split_once(',').ok_or("arms=ROLL,ELBOW")?;
                changes.arms = Some([roll.parse()?, elbow.parse()?]);
            }
            _ => {
                let known = "use friction, x, y, z, mass, masses, delay, push or arms";
                return Err(format!("there is no change '{name}'; {known}").into());
            }
        }
    }
    Ok(changes)
}

fn print_end(seed: u64, played: &Played) {
    let touch = played.loads.first_touch.as_ref();
    let touch =
        touch.map_or(String::new(), |(step, names)| format!(", first {names} at {:.1} s", *step as f64 * CONTROL_DT));
    let Played { cause, seconds, progress, height, ladder, effort, loads } = played;
    println!(
        "{seed}: {cause:?} after {seconds:.1} s, plan {progress:.1?} s, pelvis {height:.2} m, ladder {:.1} mm and {:.4} rad, effort {:.0} %, \
         overlap {:.1} mm, touched with {:.1} N ({}{touch}), grip {:.1} N, loose in {} rows, at most {} in a row",
        1e3 * ladder.0,
        ladder.1,
        100.0 * effort,
        1e3 * loads.penetration,
        loads.touch.0,
        loads.touch.1,
        loads.grip,
        loads.loose.0,
        loads.loose.1
    );
}

fn print_loads(won: &[Played]) -> Result<(), Box<dyn Error>> {
    let robot = Robot::benchmark()?;
    println!("joint: effort 99 % and largest, speed largest, % of the limit and of the rated speed");
    for (index, joint) in robot.joints().iter().enumerate() {
        let bins = won.iter().map(|played| &played.loads.efforts[index]);
        let counts = bins.fold([0_u64; 1001], |mut sum, bins| {
            sum.iter_mut().zip(bins).for_each(|(sum, count)| *sum += u64::from(*count));
            sum
        });
        let (all, mut seen) = (counts.iter().sum::<u64>() as f64, 0.0);
        let high = counts.iter().position(|count| {
            seen += *count as f64;
            seen >= 0.99 * all
        });
        let most = counts.iter().rposition(|count| *count > 0);
        let speed = won.iter().map(|played| played.loads.speeds[index]).fold(0.0, f64::max);
        let percent = |bin: Option<usize>| bin.map_or(f64::NAN, |bin| bin as f64 / 10.0);
        println!("{}: {:.1} {:.1} {:.1}", joint.name, percent(high), percent(most), 100.0 * speed);
    }
    let most = |of: fn(&Loads) -> f64| won.iter().map(|played| of(&played.loads)).fold(0.0, f64::max);
    println!(
        "overlap {:.2} mm, touched with {:.1} N, grip {:.1} N; ladder {:.2} mm and {:.5} rad",
        1e3 * most(|loads| loads.penetration),
        most(|loads| loads.touch.0),
        most(|loads| loads.grip),
        1e3 * won.iter().map(|played| played.ladder.0).fold(0.0, f64::max),
        won.iter().map(|played| played.ladder.1).fold(0.0, f64::max)
    );
    Ok(())
}

fn print_state(moment: &Moment<'_>) {
    let here = ladder_from_pelvis(moment.row);
    println!(
        "{:6.2} plan {:.1?} pelvis {:.3} {:.3} {:.3}, {} criteria",
        moment.row.step as f64 * CONTROL_DT,
        moment.time,
        here.translation.x,
        here.translation.y,
        here.translation.z,
        moment.verdict.count
    );
}
