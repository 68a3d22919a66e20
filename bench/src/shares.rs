//! Times of the parts of a recorded control step.

use std::fmt;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use fiatlux_access::{RecorderKey, RowsKey};
use fiatlux_bag::{Bag, BagWriter, ROWS_PER_CHUNK, topic};
use fiatlux_play::{Command, Play};
use fiatlux_proto::v3::{Action, ActionRecord, EpisodeHeader, Observation, Reward, SessionInfo, State, StepRecord};
use fiatlux_proto::{PROTOCOL, decode, encode, limits};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{Judges, Rewards, RowDigest, Task, Variant};
use fiatlux_sensing::{Sensor, SensorSuite, Sensors, Setup, View};
use fiatlux_wire::{Frames, WireError, joint_messages, read_row, state_message};
use fiatlux_world::{ACTION_SCALE, Episode, EpisodeSpec, Scene, SceneConfig, World};
use serde::Serialize;

use super::BenchError;
use super::machine::machine;
use super::report::write_table;

const POLICY: &str = "stand";
/// Rows from one set of poses in a bag to the next.
const ROWS_PER_FRAMES: u64 = 2;

/// Extent of the measurement.
#[derive(Debug, Clone, Copy)]
pub struct ShareOptions {
    /// The task that is played.
    pub task: Task,
    /// Chunks of a bag that are played.
    pub chunks: u64,
}

/// Result of `bench shares`.
#[derive(Debug, Clone, Serialize)]
pub struct ShareReport {
    /// Processor, cores and platform.
    pub machine: String,
    /// The task that was played.
    pub task: String,
    /// One entry for each part of a step.
    pub parts: Vec<Share>,
}

/// A part of a control step.
#[derive(Debug, Clone, Serialize)]
pub struct Share {
    /// Its name.
    pub name: &'static str,
    /// Median time, us, and the least of what is done once a chunk; of what is done once in several steps, its part of one.
    pub us: f64,
    /// Part of the sum of all.
    pub share: f64,
}

/// Times of the parts, in the order in which they were first taken.
#[derive(Default)]
struct Clock {
    step: u64,
    parts: Vec<Part>,
}

struct Part {
    name: &'static str,
    /// Step of the last time.
    step: u64,
    times: Vec<Duration>,
}

impl Clock {
    /// Times of one part in one step add up.
    fn time<T>(&mut self, name: &'static str, work: impl FnOnce() -> T) -> T {
        let begun = Instant::now();
        let done = black_box(work());
        let (took, step) = (begun.elapsed(), self.step);
        match self.parts.iter_mut().find(|part| part.name == name) {
            Some(part) => {
                if std::mem::replace(&mut part.step, step) != step {
                    part.times.push(Duration::ZERO);
                }
                part.times.iter_mut().next_back().into_iter().for_each(|time| *time += took);
            }
            None => self.parts.push(Part { name, step, times: vec![took] }),
        }
        done
    }

    /// Parts of a step, of which there were so many. Medians, so that other work on the machine does not count.
    fn shares(self, steps: f64) -> Vec<Share> {
        let us = |mut times: Vec<Duration>| {
            times.sort_unstable();
            // A chunk is compressed seldom and long: other work takes turns with most of its times.
            let middle = if times.len() < 100 { 0 } else { times.len() / 2 };
            times[middle].as_secs_f64() * 1e6 * times.len() as f64 / steps
        };
        let share = |Part { name, times, .. }: Part| Share { name, us: us(times), share: 0.0 };
        let mut parts: Vec<_> = self.parts.into_iter().map(share).collect();
        let sum: f64 = parts.iter().map(|part| part.us).sum();
        parts.iter_mut().for_each(|part| part.share = part.us / sum);
        parts
    }
}

/// Plays an episode on this thread as sessions do, each part by itself; a session also hands messages from one peer to another.
///
/// # Errors
/// [`BenchError`]: the scene cannot be built, or the temporary folder not written.
pub fn run(options: &ShareOptions) -> Result<ShareReport, BenchError> {
    let folder = std::env::temp_dir().join(format!("fiatlux-bench-shares-{}", std::process::id()));
    let clock = play(options, &folder);
    drop(std::fs::remove_dir_all(&folder));
    let parts = clock?.shares((options.chunks * ROWS_PER_CHUNK) as f64);
    Ok(ShareReport { machine: machine(), task: options.task.to_string(), parts })
}

fn play(options: &ShareOptions, folder: &Path) -> Result<Clock, BenchError> {
    let &ShareOptions { task, chunks } = options;
    let robot = Arc::new(Robot::benchmark().map_err(scene)?);
    let spec = EpisodeSpec::new(task, 0, 0);
    let built = spec.scene(robot.gains(GainSet::Fiatlux));
    let built = Arc::new(Scene::build(&SceneConfig::default(), robot, built).map_err(scene)?);
    let episode = Episode::start(Arc::clone(&built), &spec).map_err(scene)?;
    let body = Sensors::of_body(task);
    let suite = SensorSuite::new(body.with(Sensor::Lidar), Setup::new(&built, task));
    let mut play = Play::start(episode.clone(), suite, 0).map_err(scene)?;
    let mut world: World = episode.world().clone();
    let mut judges: Judges = episode.judges().clone();
    let mut rewards = Rewards::new(judges.in_force(), Variant::Benchmark, built.joint_groups());
    rewards.start(judges.in_force(), world.row());
    let mut digest: RowDigest = episode.digest().clone();
    let mut policy = fiatlux_policies::Policies::default().make(POLICY).map_err(scene)?;
    let joints = joint_messages(&built.robot, &built.spec.gains);
    let info = SessionInfo { joints, action_scale: ACTION_SCALE, ..SessionInfo::default() };
    let mut observation = play.observe(body).map_err(scene)?;
    let (suite, _) = play.senses();
    policy.reset(&info, &observation).map_err(scene)?;
    let frames = Frames::new(&built.robot);
    let layout = built.robot_layout();
    let key = RecorderKey::generate().map_err(scene)?;
    let proof = RowsKey::of_recorder(&key, "bench", "shares").map_err(scene)?;
    let path: PathBuf = folder.join("shares.mcap");
    let header = EpisodeHeader { protocol: Some(PROTOCOL), ..EpisodeHeader::default() };
    let mut bag = BagWriter::create(&path, &header).map_err(scene)?;
    let first = StepRecord { state: encode(&state_message(world.row())), ..StepRecord::default() };
    bag.push(&first).map_err(scene)?;
    let mut clock = Clock::default();
    for step in 1..chunks * ROWS_PER_CHUNK {
        clock.step = step;
        let command = clock.time("policy", || policy.act(&observation)).map_err(scene)?;
        let target = match command {
            Command::JointTarget(numbers) => numbers,
            _ => return Err(BenchError::Start { case: POLICY, problem: "it gives no joint targets".into() }),
        };
        let action = Action { step: step - 1, joint_target: target.clone(), ..Action::default() };
        let sent = clock.time("messages of action and observation", || encode(&action));
        let received = clock
            .time("messages of action and observation", || decode::<Action>(&sent, limits::MAX_CLIENT_MESSAGE))
            .map_err(scene)?;
        let action = episode.action_for(&target);
        clock.time("physics, four steps", || world.step(&action, &target).map(|_| ())).map_err(scene)?;
        let row = world.row();
        clock.time("both judges", || judges.advance(row));
        clock.time("reward", || rewards.advance(judges.in_force(), row));
        clock.time("digest", || digest.push(row));
        let judge = judges.in_force();
        let view =
            View { scene: &built, episode: 0, row, start: episode.start_pose(), task, judge, reward: rewards.reward() };
        observation = clock.time("observation", || suite.observe(&view, body)).map_err(scene)?;
        let message = clock.time("messages of action and observation", || encode(&observation));
        clock
            .time("messages of action and observation", || decode::<Observation>(&message, limits::MAX_SERVER_MESSAGE))
            .map_err(scene)?;
        clock.time("authentication", || {
            // Both ends of an action and of an observation.
            [&sent, &sent, &message, &message].map(|bytes| proof.prove("bench", bytes))
        });
        let record = clock.time("record", || {
            let action = ActionRecord { action: Some(received), ..ActionRecord::default() };
            let reward = Reward { step, total: rewards.reward(), ..Reward::default() };
            let (state, observation) = (encode(&state_message(row)), encode(&observation));
            StepRecord {
                step,
                state,
                observation,
                action: encode(&action),
                reward: encode(&reward),
                ..StepRecord::default()
            }
        });
        let sent = clock.time("record", || encode(&record));
        let record = clock.time("record", || decode::<StepRecord>(&sent, limits::MAX_SERVER_MESSAGE)).map_err(scene)?;
        if step.is_multiple_of(ROWS_PER_FRAMES) {
            let poses = clock.time("poses for viewers", || {
                let state = decode::<State>(&record.state, limits::MAX_SERVER_MESSAGE).ok();
                state.and_then(|state| read_row(&state, layout).ok()).map(|row| frames.encode(&row))
            });
            bag.message(topic::TF, step, &poses.unwrap_or_default()).map_err(scene)?;
        }
        let part = if (step + 1).is_multiple_of(ROWS_PER_CHUNK) { "compression" } else { "bag" };
        clock.time(part, || bag.push(&record)).map_err(scene)?;
    }
    drop(bag.finish_cut("the benchmark is over").map_err(scene)?);
    grade(&path, layout, episode.judges().clone(), episode.digest().clone(), &mut clock)?;
    Ok(clock)
}

/// The work of a scorer: reads the rows, judges them again and continues their digest.
fn grade(
    path: &Path,
    layout: fiatlux_rules::RobotLayout,
    mut judges: Judges,
    mut digest: RowDigest,
    clock: &mut Clock,
) -> Result<(), BenchError> {
    let bag = Bag::open(path).map_err(scene)?;
    let mut states = bag.states();
    while let Some(state) = clock.time("grading: reading", || states.next()) {
        let state = state.map_err(scene)?;
        clock.step += 1;
        clock
            .time("grading: judges and digest", || {
                let row = read_row(&state, layout)?;
                judges.advance(&row);
                digest.push(&row);
                states.reuse(state);
                Ok::<_, WireError>(())
            })
            .map_err(scene)?;
    }
    Ok(())
}

fn scene(error: impl std::error::Error + Send + Sync + 'static) -> BenchError {
    BenchError::Scene(Box::new(error))
}

impl fmt::Display for ShareReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.machine)?;
        writeln!(f, "A recorded control step of {} by policy {POLICY}, each part by itself:\n", self.task)?;
        let mut rows = vec![["part", "us", "share"].map(str::to_owned).to_vec()];
        let row = |name: &str, us: f64, share: f64| {
            vec![name.to_owned(), format!("{us:.1}"), format!("{:.1} %", 100.0 * share)]
        };
        rows.extend(self.parts.iter().map(|part| row(part.name, part.us, part.share)));
        rows.push(row("all", self.parts.iter().map(|part| part.us).sum(), 1.0));
        write_table(f, &rows)
    }
}
