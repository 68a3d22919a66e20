//! `bench batch`: many worlds in step, compared with a single world and with separate processes, and the cost of
//! sensing.

use std::fmt;
use std::io::{BufRead, BufReader, Write};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use fiatlux_batch::{
    Bank, Batch, BatchConfig, Control, Field, Outcome, Outputs, Spec, Task, TaskError, Walking, WalkingOptions,
};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::Row;
use fiatlux_sensing::{NoiseSeed, Observer, Proprioception};
use fiatlux_world::{ACTION_SCALE, Light, Random, Scene, SceneConfig, SceneSpec, World};
use serde::Serialize;

use super::BenchError;
use super::case::standing_world;
use super::machine::machine;
use super::worlds::heap;

/// Rounds of measurements, which alternate; the best of each counts.
const ROUNDS: usize = 5;
/// Printed by a process of the comparison before it measures.
const READY: &str = "ready";
/// Control steps of each world from the start of its episode.
const STEPS: usize = 50;

/// Cases to measure and to compare with.
#[derive(Debug, Clone)]
pub struct BatchOptions {
    pub worlds: usize,
    /// Number of threads, and of processes to compare them with.
    pub threads: usize,
    pub seconds: f64,
}

/// Result of `bench batch`. Rates are control steps of 20 ms per second, over all worlds.
#[derive(Debug, Clone, Serialize)]
pub struct BatchReport {
    pub machine: String,
    pub worlds: usize,
    /// Threads of the cases with several.
    pub threads: usize,
    /// One world in a loop of `World::step`, whole room, robot standing.
    pub single_steps_per_s: f64,
    /// A batch of such worlds on one thread.
    pub batch_steps_per_s: f64,
    /// Gain or loss of a batch: `batch_steps_per_s / single_steps_per_s`.
    pub batch_ratio: f64,
    /// A batch on `threads` threads.
    pub threads_steps_per_s: f64,
    /// The same number of processes at the same time, each with its share of the worlds on one thread.
    pub processes_steps_per_s: f64,
    /// Threads compared with processes: `threads_steps_per_s / processes_steps_per_s`.
    pub threads_ratio: f64,
    /// Gain from threads: `threads_steps_per_s / batch_steps_per_s`.
    pub speed_up: f64,
    /// A batch on one thread with the proprioception of all joints, noise included.
    pub proprioception_steps_per_s: f64,
    /// Share of a step that proprioception takes, 0 to 1.
    pub proprioception_share: f64,
    /// Walking on a floor, with its observation and rewards, one thread.
    pub walking_steps_per_s: f64,
    /// The same walking task on `threads` threads.
    pub walking_threads_steps_per_s: f64,
    /// Heap bytes of one more world; `None` if the allocator does not count.
    pub bytes_per_world: Option<usize>,
}

pub fn run(options: &BatchOptions) -> Result<BatchReport, BenchError> {
    let BatchOptions { worlds, threads, seconds } = *options;
    let (mut world, targets) = standing_world()?;
    let start = world.row().clone();
    let budget = Duration::from_secs_f64(seconds);
    let mut standing = Running::new(standing_batch(&world, &targets, worlds, 1, false)?);
    let bytes_per_world = bytes(&world, &targets, worlds)?;
    let mut sensing = Running::new(standing_batch(&world, &targets, worlds, 1, true)?);
    let mut threaded = Running::new(standing_batch(&world, &targets, worlds, threads, false)?);
    let mut walking = [Running::new(walking_batch(worlds, 1)?), Running::new(walking_batch(worlds, threads)?)];

    let mut best = [0.0_f64; 7];
    for round in 1..=ROUNDS {
        eprintln!("bench: {worlds} worlds, round {round} of {ROUNDS}");
        let action = vec![0.0; targets.len()];
        let single = rate(
            budget,
            1,
            &mut world,
            |world| world.reset_to(&start).map(|_| ()).map_err(failed),
            |world| world.step(&action, &targets).map(|_| ()).map_err(failed),
        )?;
        let measured = [
            single,
            standing.rate(budget)?,
            sensing.rate(budget)?,
            threaded.rate(budget)?,
            processes(options)?,
            walking[0].rate(budget)?,
            walking[1].rate(budget)?,
        ];
        best.iter_mut().zip(measured).for_each(|(best, rate)| *best = best.max(rate));
    }
    let [single, batch, proprioception, several, processes, walking, walking_threads] = best.map(f64::round);
    Ok(BatchReport {
        machine: machine(),
        worlds,
        threads,
        single_steps_per_s: single,
        batch_steps_per_s: batch,
        batch_ratio: batch / single,
        threads_steps_per_s: several,
        processes_steps_per_s: processes,
        threads_ratio: several / processes,
        speed_up: several / batch,
        proprioception_steps_per_s: proprioception,
        proprioception_share: 1.0 - proprioception / batch,
        walking_steps_per_s: walking,
        walking_threads_steps_per_s: walking_threads,
        bytes_per_world,
    })
}

/// Runs a process of the comparison: its share of the worlds on one thread. Returns control steps per second.
pub fn run_share(options: &BatchOptions) -> Result<f64, BenchError> {
    let (world, targets) = standing_world()?;
    let share = (options.worlds / options.threads).max(1);
    let mut running = Running::new(standing_batch(&world, &targets, share, 1, false)?);
    // All processes measure at the same time: each reports that it is ready, and waits for the others.
    println!("{READY}");
    std::io::stdin().read_line(&mut String::new()).map_err(io("wait for the other processes"))?;
    running.rate(Duration::from_secs_f64(options.seconds))
}

fn io(what: &str) -> impl FnOnce(std::io::Error) -> BenchError {
    let what = what.to_owned();
    move |source| BenchError::Io { what, source }
}

/// Total rate of processes that run at the same time.
fn processes(options: &BatchOptions) -> Result<f64, BenchError> {
    let program = std::env::current_exe().map_err(io("find this program"))?;
    let BatchOptions { worlds, threads, seconds } = options;
    let start = |_| {
        let mut command = Command::new(&program);
        command.args(["batch", "--share", "--worlds", &worlds.to_string()]);
        command.args(["--threads", &threads.to_string(), "--seconds", &seconds.to_string()]);
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().map_err(io("start a process of the comparison"))
    };
    let failed = || BenchError::Start { case: "processes", problem: "a process of the comparison failed".into() };
    let mut children = (0..*threads).map(start).collect::<Result<Vec<_>, _>>()?;
    let mut said = Vec::new();
    for child in &mut children {
        let mut lines = BufReader::new(child.stdout.take().ok_or_else(failed)?).lines();
        if !matches!(lines.next(), Some(Ok(line)) if line == READY) {
            return Err(failed());
        }
        said.push(lines);
    }
    for child in &mut children {
        let mut start = child.stdin.take().ok_or_else(failed)?;
        writeln!(start).map_err(io("tell a process of the comparison to start"))?;
    }
    let mut sum = 0.0;
    for (mut child, mut lines) in children.into_iter().zip(said) {
        let rate = lines.next().and_then(|line| line.ok()?.parse::<f64>().ok());
        let status = child.wait().map_err(io("wait for a process of the comparison"))?;
        sum += rate.filter(|_| status.success()).ok_or_else(failed)?;
    }
    Ok(sum)
}

struct Running {
    batch: Batch,
    outputs: Outputs,
    actions: Vec<f64>,
}

impl Running {
    fn new(batch: Batch) -> Self {
        let actions = vec![0.0; batch.worlds() * batch.spec().actions.len()];
        Self { outputs: Outputs::new(&batch), batch, actions }
    }

    fn rate(&mut self, budget: Duration) -> Result<f64, BenchError> {
        let worlds = self.batch.worlds();
        rate(
            budget,
            worlds,
            self,
            |running| running.batch.reset_with_seed(0, &mut running.outputs.observation).map_err(failed),
            |running| running.batch.step(&running.actions, &mut running.outputs.buffers()).map_err(failed),
        )
    }
}

/// Control steps per second. Every case is stepped repeatedly from the start of an episode: a long episode comes to
/// rest, and its steps become cheaper.
fn rate<T>(
    budget: Duration,
    worlds: usize,
    stepped: &mut T,
    begin: impl Fn(&mut T) -> Result<(), BenchError>,
    step: impl Fn(&mut T) -> Result<(), BenchError>,
) -> Result<f64, BenchError> {
    let (mut spent, mut steps) = (Duration::ZERO, 0);
    while spent < budget {
        begin(stepped)?;
        let begun = Instant::now();
        (0..STEPS).try_for_each(|_| step(stepped))?;
        spent += begun.elapsed();
        steps += STEPS * worlds;
    }
    Ok(steps as f64 / spent.as_secs_f64())
}

/// Heap bytes of one more world.
fn bytes(world: &World, targets: &[f64], worlds: usize) -> Result<Option<usize>, BenchError> {
    let size = |worlds| {
        let before = heap();
        let batch = standing_batch(world, targets, worlds, 1, true)?;
        let size = heap().saturating_sub(before);
        drop(batch);
        Ok::<_, BenchError>(size)
    };
    let each = size(2 * worlds)?.saturating_sub(size(worlds)?) / worlds;
    Ok((each > 0).then_some(each))
}

fn standing_batch(
    world: &World,
    targets: &[f64],
    worlds: usize,
    threads: usize,
    senses: bool,
) -> Result<Batch, BenchError> {
    let mut bank = Bank::standing(Arc::clone(world.scene()));
    bank.starts[0].row = world.row().clone();
    let config = BatchConfig { worlds, threads, ..BatchConfig::new(vec![bank]) };
    Batch::new(config, &Hold::new(world.scene(), targets, senses)).map_err(failed)
}

fn walking_batch(worlds: usize, threads: usize) -> Result<Batch, BenchError> {
    let robot = Arc::new(Robot::by_name("g1_bare").map_err(failed)?);
    let spec = SceneSpec::floor(robot.gains(GainSet::Fiatlux));
    let scene = Arc::new(Scene::build(&SceneConfig::default(), robot, spec).map_err(failed)?);
    let task = Walking::new(&scene, WalkingOptions::default()).map_err(BenchError::Scene)?;
    let config = BatchConfig { worlds, threads, ..BatchConfig::new(vec![Bank::standing(scene)]) };
    Batch::new(config, &task).map_err(failed)
}

fn failed(error: impl std::error::Error + Send + Sync + 'static) -> BenchError {
    BenchError::Scene(Box::new(error))
}

/// Holds joint targets constant.
#[derive(Clone)]
struct Hold {
    spec: Spec,
    targets: Vec<f64>,
    senses: Option<(Observer, Proprioception)>,
}

impl Hold {
    fn new(scene: &Scene, targets: &[f64], senses: bool) -> Self {
        let length = 10 + 2 * targets.len();
        let observation = senses.then(|| Field::new("proprioception", &[length]));
        Self {
            spec: Spec {
                actions: vec![],
                action_range: vec![],
                horizon_steps: u64::MAX,
                action_limit: 0.0,
                observation: observation.into_iter().collect(),
                rewards: vec![],
                reward_weights: vec![],
            },
            targets: targets.into(),
            senses: senses
                .then(|| (Observer::new(scene.robot.q0().to_vec(), None), Proprioception::zeros(targets.len()))),
        }
    }
}

impl Task for Hold {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn begin(&mut self, _: &World, _: &Light, _: &mut Random) -> Result<(), TaskError> {
        if let Some((observer, _)) = &mut self.senses {
            observer.restart(Some(NoiseSeed { seed: 0, episode: 0 }));
        }
        Ok(())
    }

    fn command(&mut self, scene: &Scene, _: &Row, _: &[f64], _: &mut Random, control: &mut Control) {
        control.joint_target.copy_from_slice(&self.targets);
        let places = control.action.iter_mut().zip(&self.targets).zip(scene.robot.q0());
        places.for_each(|((place, target), q0)| *place = (target - q0) / ACTION_SCALE);
    }

    fn judge(&mut self, _: &World, _: &mut Random, _: &mut [f32]) -> Outcome {
        Outcome::Continues
    }

    fn observe(&mut self, world: &World, observation: &mut [f32]) -> Result<(), TaskError> {
        if let Some((observer, sensed)) = &mut self.senses {
            observer.observe(world.row(), sensed);
            let body = sensed.base_angular_velocity.iter().chain(&sensed.projected_gravity);
            let body = body.chain(&sensed.base_linear_velocity).chain([&sensed.base_height]);
            let numbers = body.chain(&sensed.joint_position).chain(&sensed.joint_velocity);
            observation.iter_mut().zip(numbers).for_each(|(place, number)| *place = *number as f32);
        }
        Ok(())
    }

    fn settings(&self) -> Vec<(&'static str, String)> {
        vec![("task", "hold".into())]
    }
}

impl fmt::Display for BatchReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { worlds, threads, .. } = self;
        writeln!(f, "{}", self.machine)?;
        writeln!(f, "Control steps of 20 ms a second, the best of {ROUNDS} rounds taken in turns:\n")?;
        let mut row = |name: &str, rate: f64, note: String| writeln!(f, "  {name:<46} {rate:>8.0}  {note}");
        let (share, each) = (100.0 * self.proprioception_share, worlds / threads);
        row("whole room, standing: one world in a loop", self.single_steps_per_s, String::new())?;
        row(
            &format!("{worlds} worlds on one thread"),
            self.batch_steps_per_s,
            format!("{:.3} of the loop (bar: at least 0.95)", self.batch_ratio),
        )?;
        row(
            "the same with proprioception",
            self.proprioception_steps_per_s,
            format!("which is {share:.1} % of the step (bar: at most 3 %)"),
        )?;
        row(
            &format!("{threads} processes of {each} worlds at the same time"),
            self.processes_steps_per_s,
            String::new(),
        )?;
        row(
            &format!("{worlds} worlds on {threads} threads"),
            self.threads_steps_per_s,
            format!(
                "{:.3} of the processes (bar: at least 0.95), {:.2} times one thread",
                self.threads_ratio, self.speed_up
            ),
        )?;
        row(&format!("walking on a floor: {worlds} on one thread"), self.walking_steps_per_s, String::new())?;
        row(
            &format!("walking on a floor: {worlds} on {threads} threads"),
            self.walking_threads_steps_per_s,
            format!("{:.2} times one thread", self.walking_threads_steps_per_s / self.walking_steps_per_s),
        )?;
        let size = self.bytes_per_world.map_or("not counted".into(), |bytes| format!("{:.1} kB", bytes as f64 / 1e3));
        writeln!(f, "memory of one more world, with proprioception: {size}")
    }
}
