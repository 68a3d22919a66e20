//! The balance controller on the simulated robot, with reset noise and observation noise: it stands and keeps its bulb.
#![allow(clippy::unwrap_used, missing_docs)]

#[path = "balance/bare_hands.rs"]
mod bare_hands;

use std::fmt;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use fiatlux_robot::{GainSet, JointGains, Robot};
use fiatlux_rules::{Bulb, Cause, Judge, JudgeOptions, Protocol, Row, Task, Thresholds, errand};
use fiatlux_sensing::{NoiseSeed, Observer, Proprioception};
use fiatlux_wbc::{Balance, BalanceError, Sensed};
use fiatlux_world::{ACTION_SCALE, Scene, SceneConfig, SceneKind, SceneSpec, StartOptions, World, start};
use nalgebra::Vector3;

const INSPIRE: &str = "g1_inspire";
/// Joints of the G1 with Inspire hands.
const JOINTS: usize = 53;

/// Control steps in a second.
const SECOND: usize = 50;
/// The tasks' time-out, control steps.
const FULL: usize = 120 * SECOND;

fn carried(task: Task) -> Option<Bulb> {
    match task {
        Task::S04 | Task::S05 | Task::S06 => Some(Bulb::Old),
        Task::S09 | Task::S10 | Task::S11 => Some(Bulb::Fresh),
        _ => None,
    }
}

/// Measurements of one episode.
struct Stood {
    /// Control steps until the end.
    steps: usize,
    end: Option<Cause>,
    held: Option<Held>,
    /// Farthest from where the pelvis was after 2 s, over the floor, and root mean square speed of the centre of mass
    /// from then on.
    sway: f64,
    speed: f64,
    per_step: Duration,
}

/// Measurements of a hand that held its bulb.
struct Held {
    at_10_s: bool,
    at_end: bool,
    /// Rows in which it did not.
    rows_without: usize,
    /// Largest and smallest of each row's largest force on a hand body, N.
    most: f64,
    least: f64,
    /// Way of the bulb in the palm since 2 s, at the end, m.
    drift: f64,
}

impl fmt::Display for Stood {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let end = self.end.map_or("none".into(), |end| format!("{end:?}"));
        let (sway, speed, us) = (self.sway * 1e3, self.speed * 1e3, self.per_step.as_secs_f64() * 1e6);
        write!(f, "{:>6}  {end:<8} {sway:>8.1} {speed:>10.1} {us:>8.1}", self.steps)?;
        match &self.held {
            None => write!(f, "  -"),
            Some(held) => {
                let answer = |yes| if yes { "held" } else { "LOST" };
                let (early, late) = (answer(held.at_10_s), answer(held.at_end));
                write!(f, "  {early} / {late}, {:.1}..{:.1} N, {} rows", held.least, held.most, held.rows_without)?;
                write!(f, " without, drift {:.1} mm", 1e3 * held.drift)
            }
        }
    }
}

/// One episode of a robot that stands.
struct Episode {
    world: World,
    observer: Observer,
    balance: Balance,
    staged: Vec<f64>,
    q0: Vec<f64>,
    thinking: Duration,
}

impl Episode {
    fn new(robot: &str, task: Task, seed: u64, episode: u64, gains: GainSet) -> Self {
        let robot = Arc::new(Robot::by_name(robot).unwrap());
        let gains = robot.gains(gains);
        let spec = SceneSpec::new(SceneKind::of(task), seed, gains.clone());
        let scene = Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec).unwrap();
        let world = start(Arc::new(scene), task, episode, &StartOptions::default()).unwrap();
        let q0 = robot.q0().to_vec();
        // The staged posture as a policy knows it: the first action.
        let staged: Vec<f64> = q0.iter().zip(&world.row().action).map(|(q0, a)| q0 + ACTION_SCALE * a).collect();
        Self {
            observer: Observer::new(q0.clone(), Some(NoiseSeed { seed, episode })),
            balance: Balance::new(robot, gains, &q0).unwrap(),
            staged,
            q0,
            world,
            thinking: Duration::ZERO,
        }
    }

    fn step(&mut self) -> &Row {
        let mut sensed = Proprioception::zeros(self.q0.len());
        self.observer.observe(self.world.row(), &mut sensed);
        let clock = Instant::now();
        let targets = self.balance.step(&sensed.view(), &self.staged);
        let targets = targets.unwrap();
        self.thinking += clock.elapsed();
        let action: Vec<f64> = targets.iter().zip(&self.q0).map(|(target, q0)| (target - q0) / ACTION_SCALE).collect();
        self.world.step(&action, targets).unwrap()
    }

    /// Adds a velocity to the whole robot, pelvis axes, m/s.
    fn push(&mut self, velocity: Vector3<f64>) {
        let mut row = self.world.row().clone();
        row.robot.linear_velocity += row.robot.pose.rotation * velocity;
        self.world.reset_to(&row).unwrap();
    }
}

fn play(robot: &str, task: Task, seed: u64, episode: u64, gains: GainSet, steps: usize) -> Stood {
    let mut run = Episode::new(robot, task, seed, episode, gains);
    let geometry = run.world.scene().geometry();
    let mut judge = Judge::new(Protocol::Published, task, Thresholds::default(), geometry, JudgeOptions::default());
    judge.start(run.world.row());
    let touch = Thresholds::default().touch_n;
    let mut held = carried(task).map(|_| Held {
        at_10_s: false,
        at_end: false,
        rows_without: 0,
        most: 0.0,
        least: f64::INFINITY,
        drift: 0.0,
    });
    let (mut settled, mut sway, mut squares) = (Vector3::zeros(), 0.0_f64, 0.0);
    let mut stood = 0;
    let mut settled_bulb = Vector3::zeros();
    for step in 1..=steps {
        run.step();
        stood = step;
        let row = run.world.row();
        let pelvis = row.robot.pose.translation.vector;
        if step <= 2 * SECOND {
            settled = pelvis;
        } else {
            sway = sway.max((pelvis - settled).xy().norm());
            squares += row.com_velocity.norm_squared();
        }
        if let (Some(held), Some(bulb)) = (&mut held, carried(task)) {
            let forces = row.force(errand::HAND_FORCE[bulb as usize]).iter().map(Vector3::norm);
            let force = forces.fold(0.0, f64::max);
            held.at_end = force > touch;
            held.at_10_s |= step == 10 * SECOND && held.at_end;
            held.rows_without += usize::from(!held.at_end);
            (held.most, held.least) = (held.most.max(force), held.least.min(force));
            if [2 * SECOND, steps].contains(&step) {
                let palm_from_bulb = row.world_from_palm[1].inverse() * row.body(bulb.thing()).pose;
                let place = palm_from_bulb.translation.vector;
                held.drift = (place - settled_bulb).norm();
                settled_bulb = place;
            }
        }
        if judge.advance(row).end.is_some() {
            break;
        }
    }
    let moving = stood.saturating_sub(2 * SECOND).max(1);
    Stood {
        steps: stood,
        end: judge.verdict().end.map(|end| end.cause()),
        held,
        sway,
        speed: (squares / moving as f64).sqrt(),
        per_step: run.thinking / stood as u32,
    }
}

#[test]
fn it_stands_for_20_seconds_and_keeps_its_bulb() {
    for (task, seed) in [(Task::S01, 0), (Task::S06, 3), (Task::S09, 1)] {
        let stood = play(INSPIRE, task, seed, 0, GainSet::Fiatlux, 20 * SECOND);
        println!("{task} seed {seed}: {stood}");
        assert_eq!((stood.steps, stood.end), (20 * SECOND, None), "{task} seed {seed}");
        assert!(stood.sway < 0.05, "{task} seed {seed}: {} m", stood.sway);
        assert!(stood.held.is_none_or(|held| held.at_10_s && held.at_end), "{task} seed {seed}");
    }
}

/// Dex3 hands keep the bulb in all tasks that begin with one, on the floor and on the platform.
#[test]
fn dex3_hands_keep_their_bulb() {
    for task in Task::SUBTASKS.into_iter().filter(|task| carried(*task).is_some()) {
        let stood = play("g1_dex3", task, 1000, 0, GainSet::Fiatlux, 10 * SECOND);
        println!("{task}: {stood}");
        assert_eq!((stood.steps, stood.end), (10 * SECOND, None), "{task}");
        let held = stood.held.unwrap();
        assert!(
            held.rows_without == 0 && held.drift < 2e-3 && held.most < 10.0,
            "{task}: {} N {} m",
            held.most,
            held.drift
        );
    }
}

/// Nothing is written to the arms and hands but what was staged.
#[test]
fn it_leaves_arms_and_hands_as_staged() {
    let mut run = Episode::new(INSPIRE, Task::S05, 0, 0, GainSet::Fiatlux);
    let staged = run.world.row().joint_target.clone();
    for _ in 0..10 {
        assert_eq!(run.step().joint_target[12..], staged[12..]);
    }
}

/// A push of 0.2 m/s puts the capture point 5 cm off: half the length of the sole before its centre, and less than the
/// width of the stance.
#[test]
fn it_stands_when_pushed() {
    let pushes = [[0.2, 0.0], [-0.2, 0.0], [0.0, 0.2], [0.0, -0.2]];
    for [x, y] in pushes {
        let mut run = Episode::new(INSPIRE, Task::S02, 1, 0, GainSet::Fiatlux);
        for _ in 0..3 * SECOND {
            run.step();
        }
        run.push(Vector3::new(x, y, 0.0));
        for _ in 0..5 * SECOND {
            run.step();
        }
        let height = run.step().robot.pose.translation.z;
        assert!(height > 0.75, "pushed by ({x}, {y}) m/s: {height} m");
    }
}

#[test]
fn what_it_cannot_use_is_refused() {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let gains = robot.gains(GainSet::default());
    let q0 = robot.q0().to_vec();
    let error = Balance::new(Arc::clone(&robot), gains.clone(), &q0[1..]).unwrap_err();
    assert_eq!(error.to_string(), "q0 has 52 numbers where the robot has 53 joints");
    for (stiffness, effort_limit) in [(0.0, 50.0), (40.0, f64::NAN)] {
        let mut gains = gains.clone();
        gains.0[4] = JointGains { stiffness, effort_limit, ..gains.0[4] };
        let error = Balance::new(Arc::clone(&robot), gains, &q0).unwrap_err();
        assert!(matches!(&error, BalanceError::Drive { joint, .. } if joint == "left_ankle_pitch_joint"), "{error}");
    }

    let mut balance = Balance::new(robot, gains, &q0).unwrap();
    let zeros = [0.0; JOINTS];
    let good = Sensed::upright(&zeros, &[]);
    let targets = balance.clone().step(&good, &q0).unwrap().to_vec();
    let bad = Sensed { projected_gravity: [0.0, f64::NAN, -1.0], ..good };
    assert_eq!(balance.step(&bad, &q0), Err(BalanceError::NotFinite { field: "the observed projected gravity" }));
    let bad = Sensed { joint_position: &[f64::NAN; JOINTS], ..good };
    assert!(matches!(balance.step(&bad, &q0), Err(BalanceError::Kinematics(_))));
    let bad = Sensed { joint_position: &[0.0; 7], ..good };
    assert!(matches!(balance.step(&bad, &q0), Err(BalanceError::Length { found: 7, expected: JOINTS, .. })));
    let posture = balance.step(&good, &q0[1..]).unwrap_err().to_string();
    assert_eq!(posture, "the posture has 52 numbers where the robot has 53 joints");
    // Nothing of them is remembered.
    assert_eq!(balance.step(&good, &q0).unwrap(), targets);
}

/// A range from the environment, such as `4..20`.
fn range(name: &str, default: Range<u64>) -> Range<u64> {
    let Ok(text) = std::env::var(name) else { return default };
    let (first, end) = text.split_once("..").unwrap();
    first.parse().unwrap()..end.parse().unwrap()
}

/// The README's column `stand`: every task of the table to its time-out in four rooms with `FIATLUX_ALL_ROOMS` set, in one room with
/// `FIATLUX_SLOW_TESTS`, 20 s in one room without. `FIATLUX_STAND_SEEDS` and `FIATLUX_STAND_EPISODES`, such as `0..20`, choose other
/// seeds and episodes, `FIATLUX_STAND_GAINS` another set of gains, `FIATLUX_STAND_ROBOT` another robot.
#[test]
fn it_stands_in_every_task_of_the_table() {
    let is_set = |name: &str| std::env::var_os(name).is_some();
    let steps = if is_set("FIATLUX_SLOW_TESTS") { FULL } else { 20 * SECOND };
    let rooms = if is_set("FIATLUX_ALL_ROOMS") { 4 } else { 1 };
    let (seeds, episodes) = (range("FIATLUX_STAND_SEEDS", 0..rooms), range("FIATLUX_STAND_EPISODES", 0..1));
    let gains = std::env::var("FIATLUX_STAND_GAINS").map_or(GainSet::Fiatlux, |name| name.parse().unwrap());
    let robot = std::env::var("FIATLUX_STAND_ROBOT").unwrap_or(INSPIRE.into());
    let robot = robot.as_str();
    let mut jobs = Vec::new();
    for task in Task::SUBTASKS {
        for seed in seeds.clone() {
            jobs.extend(episodes.clone().map(|episode| (task, seed, episode)));
        }
    }
    let (next, results) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                while let Some(&(task, seed, episode)) = jobs.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let stood = play(robot, task, seed, episode, gains, steps);
                    results.lock().unwrap().push(((task, seed, episode), stood));
                }
            });
        }
    });
    let mut results = results.into_inner().unwrap();
    results.sort_by_key(|(job, _)| jobs.iter().position(|other| other == job));
    println!("task seed episode   steps  end       sway, mm  speed, mm/s  us/step  bulb at 10 s / at the end");
    for ((task, seed, episode), stood) in &results {
        println!("{:<4} {seed:>4} {episode:>7}  {stood}", task.short_id());
    }
    let expected = (steps == FULL).then_some(Cause::TimeOut);
    let whole = results.iter().filter(|(_, stood)| (stood.steps, stood.end) == (steps, expected)).count();
    let lost =
        results.iter().filter(|(_, stood)| stood.held.as_ref().is_some_and(|held| held.rows_without > 0)).count();
    println!("{whole} of {} stood for {steps} steps; a bulb was not held at some row in {lost}", results.len());
    assert_eq!((whole, lost), (results.len(), 0));
}
