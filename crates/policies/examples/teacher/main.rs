//! Measures `expert` as a teacher of learners, in rooms that may be drawn afresh:
//! `cargo run --release -p fiatlux-policies --example teacher -- S06,S08 fresh:32 [spoilt] [each] [threads=2] [parameters=FILE]`.
//! In each room it plays an episode undisturbed; then an expert that has seen nothing takes over at 0.3, 0.6 and 0.9 of that episode's
//! own time; then one rides along from the start with slow noise of 0.014 rad on the targets of arms and fingers. With `spoilt`, a learner
//! spoils the state halfway first: it holds still for 1.5 s, or adds noise of 0.1 rad for 1.5 s, or of 0.25 rad to all joints for 0.3 s.
//! With `each`, every attempt is printed. An expert that says that it cannot go on is asked on: it was right if no success comes.
//! A file has parameters of `hands`.
#![allow(missing_docs)]

use std::error::Error;
use std::fmt;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use fiatlux_client::{Command, Policy, SeedList, TaskList};
use fiatlux_policies::Expert;
use fiatlux_proto::v3::Observation;
use fiatlux_rules::{CONTROL_DT, Cause, Task};
use fiatlux_wbc::MOVED;
use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::Rng as _;

#[path = "../game/mod.rs"]
mod game;

use game::{Game, Start};

/// Parts of an episode after which another expert takes over.
const PARTS: [f64; 3] = [0.3, 0.6, 0.9];
/// Control steps from one kept state to the next.
const KEPT_EVERY: u64 = 25;
/// Noise of targets that an expert rides along with, rad, and the time in which it changes, s.
const NOISE_RAD: f64 = 0.014;
const NOISE_TIME_S: f64 = 1.0;
/// Control steps within which an expert counts as saying at once that it cannot go on.
const AT_ONCE: u64 = 5;

/// The end of an attempt.
#[derive(Debug, Clone, PartialEq)]
enum Ended {
    Succeeds,
    /// Without having said so: why, and what it did last.
    Fails(Cause, String),
    /// It said that it could not go on: after how many control steps, why, and whether a success came nevertheless.
    Says {
        after: u64,
        why: String,
        succeeds: bool,
    },
}

impl fmt::Display for Ended {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Succeeds => write!(f, "success"),
            Self::Fails(cause, phase) => write!(f, "{cause:?} in {phase}"),
            Self::Says { after, why, succeeds } => {
                let wrongly = if *succeeds { ", wrongly" } else { "" };
                write!(f, "says after {:.1} s{wrongly}: {why}", *after as f64 * CONTROL_DT)
            }
        }
    }
}

/// Adds to targets; the step counts from where it begins.
type Student = Box<dyn FnMut(u64, &mut [f64])>;

/// The attempts of a room, by name.
type Attempts = Vec<(String, Ended)>;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [tasks, rooms, rest @ ..] = arguments.as_slice() else { return Err("TASK,TASK ROOMS [spoilt] [each]".into()) };
    let rooms: SeedList = rooms.parse()?;
    rooms.check_training()?;
    let says = |word: &str| rest.iter().any(|other| other == word);
    let threads = rest.iter().find_map(|word| word.strip_prefix("threads=")).map_or(Ok(2), str::parse)?;
    for task in tasks.parse::<TaskList>()?.0 {
        let (next, done) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
        let work = || -> Result<(), String> {
            while let Some(seed) = rooms.seeds.get(next.fetch_add(1, Ordering::Relaxed)) {
                let attempts = room(task, *seed, says("spoilt")).map_err(|error| error.to_string())?;
                for (name, ended) in attempts.iter().filter(|_| says("each")) {
                    println!("{task:?} {seed} {name}: {ended}");
                }
                done.lock().map_err(|error| error.to_string())?.push(attempts);
            }
            Ok(())
        };
        std::thread::scope(|scope| {
            let running: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
            running.into_iter().try_for_each(|thread| thread.join().map_err(|_| "a thread panicked".to_string())?)
        })?;
        print(task, &done.into_inner()?);
    }
    Ok(())
}

/// A table of a task: for each kind of attempt how many rooms succeeded, failed without a word, and were given up rightly or wrongly.
fn print(task: Task, rooms: &[Attempts]) {
    let names = rooms.iter().max_by_key(|attempts| attempts.len()).into_iter().flatten().map(|(name, _)| name);
    println!("{task:?}           of  succeeds  fails  says at once  later  wrongly");
    for name in names {
        let ends: Vec<_> = rooms.iter().flatten().filter(|(other, _)| other == name).map(|(_, ended)| ended).collect();
        let count = |is: &dyn Fn(&Ended) -> bool| ends.iter().filter(|ended| is(ended)).count();
        println!(
            "{name:12} {:4}  {:8}  {:5}  {:12}  {:5}  {:7}",
            ends.len(),
            count(&|ended| *ended == Ended::Succeeds),
            count(&|ended| matches!(ended, Ended::Fails(..))),
            count(&|ended| matches!(ended, Ended::Says { after, .. } if *after <= AT_ONCE)),
            count(&|ended| matches!(ended, Ended::Says { after, .. } if *after > AT_ONCE)),
            count(&|ended| matches!(ended, Ended::Says { succeeds: true, .. })),
        );
    }
}

/// All attempts in a room; those that begin in the midst only where the undisturbed one succeeds.
fn room(task: Task, seed: u64, spoilt: bool) -> Result<Attempts, Box<dyn Error>> {
    let mut kept = Vec::new();
    let start = Game::start(Start::of(task, seed)?)?;
    let mut attempts = vec![("undisturbed".into(), teach(start.clone(), |_, _| (), Some(&mut kept))?)];
    attempts.push(("noise".into(), teach(start, noise(seed, NOISE_RAD, MOVED), None)?));
    if !matches!(attempts.first(), Some((_, Ended::Succeeds))) {
        return Ok(attempts);
    }
    let at = |part: f64| kept.get((kept.len() as f64 * part) as usize).cloned().ok_or("an episode without steps");
    for part in PARTS {
        attempts.push((format!("from {part}"), teach(at(part)?, |_, _| (), None)?));
    }
    let learners: [(&str, u64, Student); 3] = [
        ("held 1.5 s", 75, Box::new(|_, _| ())),
        ("0.1 rad", 75, Box::new(noise(seed, 0.1, MOVED))),
        ("0.25 rad", 15, Box::new(noise(seed, 0.25, 0))),
    ];
    for (name, steps, mut student) in learners.into_iter().filter(|_| spoilt) {
        let mut game = at(0.5)?;
        let targets = game.world().row().joint_target.clone();
        for step in 0..steps {
            let mut targets = targets.clone();
            student(step, &mut targets);
            if game.verdict().end.is_none() {
                game.go_on(&Command::JointTarget(targets), None)?;
            }
        }
        if game.verdict().end.is_none() {
            attempts.push((name.into(), teach(game, |_, _| (), None)?));
        }
    }
    Ok(attempts)
}

/// Plays on to the end as a fresh expert says, with what a learner makes of its answers. Keeps states in `kept`.
fn teach(
    mut game: Game,
    mut student: impl FnMut(u64, &mut [f64]),
    mut kept: Option<&mut Vec<Game>>,
) -> Result<Ended, Box<dyn Error>> {
    let file = std::env::args().find_map(|word| word.strip_prefix("parameters=").map(str::to_string));
    let mut expert = Expert::with_parameters(file.map(std::fs::read_to_string).transpose()?)?;
    let mut seen: Observation = game.observe()?;
    let first = game.world().row().step;
    let mut said: Option<(u64, String)> = None;
    if let Err(refused) = expert.reset(&game.info, &seen) {
        return Ok(Ended::Says { after: 0, why: refused.to_string(), succeeds: false });
    }
    while game.verdict().end.is_none() {
        let step = game.world().row().step - first;
        if let Some(kept) = kept.as_mut().filter(|_| step.is_multiple_of(KEPT_EVERY)) {
            kept.push(game.clone());
        }
        let answer = match &said {
            Some(_) => expert.act(&seen),
            None => expert.label(&seen).map(|label| Command::JointTarget(label.joint_target)),
        };
        let mut command = match (answer, &said) {
            (Ok(command), _) => command,
            (Err(refused), None) => {
                said = Some((step, refused.to_string()));
                continue;
            }
            (Err(_), Some(_)) => break,
        };
        if let Command::JointTarget(targets) = &mut command {
            student(step, targets);
        }
        seen = game.go_on(&command, None)?;
    }
    let cause = game.verdict().end.map(|end| end.cause());
    let succeeds = cause == Some(Cause::Success);
    Ok(match (said, cause) {
        (Some((after, why)), _) => Ended::Says { after, why, succeeds },
        (None, Some(cause)) if !succeeds => Ended::Fails(cause, expert.phase().unwrap_or_default()),
        _ => Ended::Succeeds,
    })
}

/// Slow noise of targets from a joint on, of a standard deviation in rad.
fn noise(seed: u64, deviation: f64, from: usize) -> impl FnMut(u64, &mut [f64]) {
    let mut random = Pcg64Mcg::new(u128::from(seed) | 1);
    let mut offsets: Vec<f64> = Vec::new();
    let stays = (-CONTROL_DT / NOISE_TIME_S).exp();
    move |_, targets| {
        let begins = offsets.is_empty();
        offsets.resize(targets.len(), 0.0);
        for (offset, target) in offsets.iter_mut().zip(targets).skip(from) {
            // Nearly normal, of deviation 1.
            let drawn = (0..12).map(|_| f64::from(random.next_u32()) / f64::from(u32::MAX)).sum::<f64>() - 6.0;
            let kept = if begins { 0.0 } else { stays };
            *offset = kept * *offset + deviation * (1.0 - kept * kept).sqrt() * drawn;
            *target += *offset;
        }
    }
}
