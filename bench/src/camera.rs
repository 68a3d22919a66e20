//! The cost of a picture: ours beside MuJoCo's of the same scene on a software renderer, in turns.

use std::fmt;
use std::hint::black_box;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use fiatlux_mjcf::{MjcfOptions, Names, OptionSet, to_mjcf};
use fiatlux_render::{Camera, Lighting, Renderer, Visuals};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::Task;
use fiatlux_world::{PHYSICS_DT, Scene, SceneConfig, SceneKind, SceneSpec, StartOptions, World, start};
use serde::{Deserialize, Serialize};

use super::machine::machine;
use super::report::write_table;
use super::stats::median;
use super::{BenchError, Folder};

const CASE: &str = "camera";
/// Width and height of the pictures.
const SIZES: [[usize; 2]; 4] = [[64, 64], [128, 128], [256, 256], [640, 480]];
/// Starts that are drawn: standing, on the ladder with a bulb, at the bench.
const STARTS: [(Task, u64); 3] = [(Task::S01, 0), (Task::S11, 4), (Task::S08, 0)];

/// Extent of the measurement.
#[derive(Debug, Clone)]
pub struct CameraOptions {
    /// Turns of each side for each size and start.
    pub rounds: usize,
    /// Least processor time of a turn, s.
    pub seconds: f64,
    /// Script that times MuJoCo; `None` to leave MuJoCo out.
    pub oracle: Option<PathBuf>,
}

/// Result of `bench camera`.
#[derive(Debug, Clone, Serialize)]
pub struct CameraReport {
    pub machine: String,
    pub cases: Vec<CameraCase>,
}

/// Pictures of one size: processor time of the mean of the starts, medians over rounds.
#[derive(Debug, Clone, Serialize)]
pub struct CameraCase {
    pub size: [usize; 2],
    pub milliseconds: f64,
    /// By the fastest round.
    pub pictures_per_s: f64,
    pub mujoco_milliseconds: Option<f64>,
    /// MuJoCo's time by ours in the same round, above 1 if ours is faster; and its interval of 95 %.
    pub ratio: Option<f64>,
    pub ratio_interval: Option<[f64; 2]>,
}

/// A start state and what draws it.
struct Place {
    world: World,
    visuals: Visuals,
}

/// Measures all sizes on this thread.
///
/// # Errors
/// [`BenchError`]: no scene, or no MuJoCo.
pub fn run(options: &CameraOptions) -> Result<CameraReport, BenchError> {
    let places = STARTS.map(|(task, seed)| Place::new(task, seed)).into_iter().collect::<Result<Vec<_>, _>>()?;
    let mut rival = options.oracle.as_deref().map(|script| Rival::start(script, &places)).transpose()?;
    let mut cases = Vec::new();
    for size in SIZES {
        let mut renderer = Renderer::new(size[0], size[1]);
        let (mut ours, mut theirs, mut ratios) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..options.rounds {
            let (mut own, mut other) = (0.0, 0.0);
            for (index, place) in places.iter().enumerate() {
                own += place.time(&mut renderer, size, options.seconds)? / places.len() as f64;
                if let Some(rival) = &mut rival {
                    other += rival.time(index, size, options.seconds)? / places.len() as f64;
                }
            }
            ours.push(own);
            theirs.push(other);
            ratios.push(other / own);
        }
        let (milliseconds, _) = median(&mut ours);
        let (ratio, interval) = median(&mut ratios);
        let has_rival = rival.is_some();
        cases.push(CameraCase {
            size,
            milliseconds,
            pictures_per_s: 1e3 / ours[0],
            mujoco_milliseconds: has_rival.then(|| median(&mut theirs).0),
            ratio: has_rival.then_some(ratio),
            ratio_interval: has_rival.then_some(interval),
        });
    }
    Ok(CameraReport { machine: machine(), cases })
}

impl Place {
    fn new(task: Task, seed: u64) -> Result<Self, BenchError> {
        let robot = Arc::new(Robot::benchmark().map_err(scene)?);
        let spec = SceneSpec::new(SceneKind::of(task), seed, robot.gains(GainSet::Fiatlux));
        let built = Arc::new(Scene::build(&SceneConfig::default(), robot, spec).map_err(scene)?);
        let world = start(Arc::clone(&built), task, 0, &StartOptions::default()).map_err(scene)?;
        Ok(Self { world, visuals: Visuals::new(&built) })
    }

    /// Processor time of a picture of the head camera, ms.
    fn time(&self, renderer: &mut Renderer, [width, height]: [usize; 2], seconds: f64) -> Result<f64, BenchError> {
        let row = self.world.row();
        let (light, least) = (Lighting::default(), Duration::from_secs_f64(seconds));
        let mut draw = || {
            // As each step does: the camera moves with the robot.
            let camera = Camera::head(&self.world.scene().robot, row).map_err(scene)?.fitted(width, height);
            black_box(renderer.render(&self.visuals, row, &camera, &light));
            Ok::<_, BenchError>(())
        };
        draw()?;
        let (clock, mut count) = (Clock::start(), 0_u32);
        while count == 0 || clock.elapsed() < least {
            // The clock costs more than a small picture.
            for _ in 0..16 {
                draw()?;
            }
            count += 16;
        }
        Ok(clock.elapsed().as_secs_f64() * 1e3 / f64::from(count))
    }

    fn mjcf(&self) -> String {
        let (built, row) = (self.world.scene(), self.world.row());
        let mut targets = vec![0.0; built.model.drives().len()];
        for (ids, target) in built.robot_ids.joints.iter().zip(&row.joint_target) {
            targets[ids.drive] = *target;
        }
        let options = MjcfOptions {
            name: CASE.into(),
            timestep: PHYSICS_DT,
            option_set: OptionSet::Nearest,
            names: Names::of_scene(built),
        };
        to_mjcf(&built.model, self.world.state(), &targets, &options)
    }
}

/// Processor time of this thread; time by the clock where the system does not say it.
struct Clock {
    begun: Instant,
    used: Option<Duration>,
}

impl Clock {
    fn start() -> Self {
        Self { begun: Instant::now(), used: Self::used() }
    }

    fn elapsed(&self) -> Duration {
        let used = self.used.zip(Self::used()).map(|(before, now)| now.saturating_sub(before));
        used.unwrap_or_else(|| self.begun.elapsed())
    }

    /// Time on a processor so far, as Linux counts it.
    fn used() -> Option<Duration> {
        let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
        text.split_whitespace().next()?.parse().ok().map(Duration::from_nanos)
    }
}

/// The script, which draws when it is asked.
struct Rival {
    child: Child,
    /// `None` when it has to end.
    requests: Option<ChildStdin>,
    answers: BufReader<ChildStdout>,
    /// The scenes; removed at the end.
    _folder: Folder,
}

#[derive(Deserialize)]
struct Answer {
    milliseconds: f64,
}

impl Rival {
    fn start(script: &Path, places: &[Place]) -> Result<Self, BenchError> {
        if !script.is_file() {
            return Err(BenchError::NoOracle(script.to_owned()));
        }
        let folder = Folder::new()?;
        let mut command = Command::new("python3");
        command.arg(script);
        for (index, place) in places.iter().enumerate() {
            let path = folder.path().join(format!("{index}.xml"));
            std::fs::write(&path, place.mjcf()).map_err(|source| io("write a scene", source))?;
            command.arg(path);
        }
        command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().map_err(|source| io("start python3", source))?;
        let none = || io("talk to python3", std::io::ErrorKind::BrokenPipe.into());
        let requests = child.stdin.take().ok_or_else(none)?;
        let answers = BufReader::new(child.stdout.take().ok_or_else(none)?);
        Ok(Self { child, requests: Some(requests), answers, _folder: folder })
    }

    /// Processor time of a picture, ms.
    fn time(&mut self, place: usize, [width, height]: [usize; 2], seconds: f64) -> Result<f64, BenchError> {
        let mut answer = String::new();
        let asked = match &mut self.requests {
            Some(requests) => writeln!(requests, "{place} {width} {height} {seconds}"),
            None => Ok(()),
        };
        if asked.and_then(|()| self.answers.read_line(&mut answer)).is_err() || answer.is_empty() {
            let status = self.child.wait().map_err(|source| io("wait for python3", source))?;
            return Err(BenchError::OracleFailed { case: CASE, status });
        }
        let answer: Answer =
            serde_json::from_str(&answer).map_err(|source| BenchError::OracleOutput { case: CASE, source })?;
        Ok(answer.milliseconds)
    }
}

impl Drop for Rival {
    fn drop(&mut self) {
        // It ends when its input does.
        self.requests = None;
        self.child.wait().ok();
    }
}

fn io(what: &str, source: std::io::Error) -> BenchError {
    BenchError::Io { what: what.into(), source }
}

fn scene(error: impl std::error::Error + Send + Sync + 'static) -> BenchError {
    BenchError::Scene(Box::new(error))
}

impl fmt::Display for CameraReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.machine)?;
        writeln!(f, "Pictures of the head camera on one thread, processor time, mean of {} starts:\n", STARTS.len())?;
        let header = ["size", "ours, ms", "pictures/s, best round", "MuJoCo, ms", "MuJoCo / ours", "95 %"];
        let mut rows = vec![header.map(str::to_owned).to_vec()];
        for case in &self.cases {
            let or_none = |text: Option<String>| text.unwrap_or_else(|| "-".into());
            rows.push(vec![
                format!("{}x{}", case.size[0], case.size[1]),
                format!("{:.2}", case.milliseconds),
                format!("{:.0}", case.pictures_per_s),
                or_none(case.mujoco_milliseconds.map(|number| format!("{number:.1}"))),
                or_none(case.ratio.map(|ratio| format!("{ratio:.1}"))),
                or_none(case.ratio_interval.map(|[low, high]| format!("{low:.1} to {high:.1}"))),
            ]);
        }
        write_table(f, &rows)
    }
}
