//! The cost of sensors: control steps per second on one thread for sets of sensors, and the time of each sensor.

use std::fmt;
use std::path::{Path, PathBuf};
use std::process::{self, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use fiatlux_features::{Arithmetic, ResNet18, Weights};
use fiatlux_play::{Command, Play};
use fiatlux_proto::encode;
use fiatlux_proto::v3::SessionInfo;
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::Task;
use fiatlux_sensing::{Sensor, SensorSuite, Sensors, Setup};
use fiatlux_wire::joint_messages;
use fiatlux_world::{ACTION_SCALE, Episode, EpisodeSpec, Scene, SceneConfig};
use serde::{Deserialize, Serialize};

use super::machine::machine;
use super::report::write_table;
use super::{BenchError, Times};

/// A robot that stands from start to time-out with a bulb in the hand: every step costs the same.
const TASK: Task = Task::S05;
const POLICY: &str = "stand";
/// Tasks whose start states each sensor is timed in: on the floor, on the ladder, at the bench.
const PLACES: [Task; 3] = [Task::S05, Task::S11, Task::S08];
/// Rows in which each sensor is timed at each place.
const ROWS: u64 = 60;

/// Extent of the measurement.
#[derive(Debug, Clone)]
pub struct SensorOptions {
    pub seconds: f64,
    /// Script that times PyTorch; `None` to leave PyTorch out.
    pub oracle: Option<PathBuf>,
}

/// Result of `bench sensors`.
#[derive(Debug, Clone, Serialize)]
pub struct SensorReport {
    pub machine: String,
    pub cases: Vec<StepCase>,
    /// The time of each sensor alone.
    pub sensors: Vec<SensorCase>,
}

/// Control steps with some sensors in every observation.
#[derive(Debug, Clone, Serialize)]
pub struct StepCase {
    pub name: String,
    pub steps_per_s: f64,
    pub real_time_factor: f64,
    pub mean_us: f64,
    pub p50_us: f64,
    pub p99_us: f64,
    /// Size of an observation's message, bytes.
    pub message_bytes: usize,
}

/// Time of one sensor in a row.
#[derive(Debug, Clone, Serialize)]
pub struct SensorCase {
    pub name: String,
    pub mean_us: f64,
    pub p50_us: f64,
    pub p99_us: f64,
    /// For features: PyTorch's median on one thread in its fastest form, us.
    pub pytorch_us: Option<f64>,
    /// `pytorch_us / p50_us`, above 1 if ours is faster.
    pub ratio: Option<f64>,
}

/// Measures all cases on this thread.
pub fn run(options: &SensorOptions) -> Result<SensorReport, BenchError> {
    let network = ResNet18::new(&Weights::seeded(0));
    let body = Sensors::of_body(TASK);
    let lidar = body.with(Sensor::Lidar);
    let all = lidar.with(Sensor::Camera).with(Sensor::Features).with(Sensor::Privileged);
    let cases = [("body", body), ("body and LiDAR", lidar), ("all: LiDAR, camera, features, privileged", all)];
    let budget = Duration::from_secs_f64(options.seconds);
    let cases = cases.into_iter().map(|(name, sensors)| steps(name, sensors, &network, budget));
    let cases = cases.collect::<Result<Vec<_>, _>>()?;
    let mut sensors = costs(&Sensor::ALL, &network)?;
    let whole = ResNet18::with(&Weights::seeded(0), Arithmetic::Int8);
    let int8 = costs(&[Sensor::Camera, Sensor::Features], &whole)?.pop();
    sensors.extend(int8.map(|case| SensorCase { name: "features, int8".into(), ..case }));
    if let Some(oracle) = &options.oracle {
        let pytorch_us = pytorch(oracle)?;
        for case in sensors.iter_mut().filter(|case| case.name == Sensor::Features.name()) {
            case.pytorch_us = Some(pytorch_us);
            case.ratio = Some(pytorch_us / case.p50_us);
        }
    }
    Ok(SensorReport { machine: machine(), cases, sensors })
}

/// An episode and its sensors, as a session has them.
fn start(task: Task, sensors: Sensors, network: &ResNet18) -> Result<Play, BenchError> {
    let robot = Arc::new(Robot::benchmark().map_err(scene)?);
    let gains = robot.gains(GainSet::Fiatlux);
    let spec = EpisodeSpec::new(task, 0, 0);
    let built = Arc::new(Scene::build(&SceneConfig::default(), robot, spec.scene(gains)).map_err(scene)?);
    let suite = SensorSuite::new(sensors, Setup::new(&built, task)).with_network(Some(network.twin()));
    Play::start(Episode::start(built, &spec).map_err(scene)?, suite, 0).map_err(scene)
}

/// Takes control steps as a session does, except for sending messages: policy, physics, rules, sensors, encoding.
fn steps(name: &str, sensors: Sensors, network: &ResNet18, budget: Duration) -> Result<StepCase, BenchError> {
    let mut play = start(TASK, sensors, network)?;
    let mut policy = fiatlux_policies::Policies::default().make(POLICY).map_err(scene)?;
    let mut observation = play.observe(sensors).map_err(scene)?;
    let room = play.episode().scene();
    let joints = joint_messages(&room.robot, &room.spec.gains);
    let info = SessionInfo { joints, action_scale: ACTION_SCALE, ..SessionInfo::default() };
    policy.reset(&info, &observation).map_err(scene)?;
    let mut times = Vec::new();
    let (mut message, start) = (Vec::new(), Instant::now());
    while play.episode().end().is_none() && start.elapsed() < budget {
        let begun = Instant::now();
        play.step(&policy.act(&observation).map_err(scene)?).map_err(scene)?;
        observation = play.observe(sensors).map_err(scene)?;
        message = encode(&observation);
        times.push(begun.elapsed());
    }
    let steps_per_s = times.len() as f64 / times.iter().sum::<Duration>().as_secs_f64();
    let Times { mean_us, p50_us, p99_us } = Times::of(&mut times);
    Ok(StepCase {
        name: name.into(),
        steps_per_s,
        real_time_factor: steps_per_s * fiatlux_rules::CONTROL_DT,
        mean_us,
        p50_us,
        p99_us,
        message_bytes: message.len(),
    })
}

/// Times each sensor in fresh rows, after computing what it depends on: the camera before its features, everything
/// before the flat vector.
fn costs(sensors: &[Sensor], network: &ResNet18) -> Result<Vec<SensorCase>, BenchError> {
    let all = Sensors::of(sensors);
    let mut samples: Vec<Vec<Duration>> = vec![Vec::new(); sensors.len()];
    for place in PLACES {
        let mut play = start(place, all, network)?;
        let hold = Command::Action(play.episode().row().action.clone());
        for _ in 0..ROWS {
            for (&sensor, samples) in sensors.iter().zip(&mut samples) {
                let begun = Instant::now();
                play.observe(Sensors::of(&[sensor])).map_err(scene)?;
                samples.push(begun.elapsed());
            }
            if play.episode().end().is_some() {
                break;
            }
            play.step(&hold).map_err(scene)?;
        }
    }
    let case = |(sensor, samples): (&Sensor, &mut Vec<Duration>)| {
        let Times { mean_us, p50_us, p99_us } = Times::of(samples);
        SensorCase { name: sensor.name().into(), mean_us, p50_us, p99_us, pytorch_us: None, ratio: None }
    };
    Ok(sensors.iter().zip(&mut samples).map(case).collect())
}

/// Median time of PyTorch's fastest form, us.
fn pytorch(script: &Path) -> Result<f64, BenchError> {
    #[derive(Deserialize)]
    struct Output {
        fastest_median_ms: f64,
    }
    const CASE: &str = "features";
    if !script.is_file() {
        return Err(BenchError::NoOracle(script.to_owned()));
    }
    let weights = std::env::temp_dir().join(format!("fiatlux-bench-{}.safetensors", process::id()));
    let io = |what: &str, source| BenchError::Io { what: what.into(), source };
    std::fs::write(&weights, Weights::seeded(0).to_safetensors()).map_err(|source| io("write the weights", source))?;
    let mut command = process::Command::new("python3");
    command.arg(script).arg(&weights).args(["--time-only", "--json"]).stderr(Stdio::inherit());
    let output = command.output();
    drop(std::fs::remove_file(&weights));
    let output = output.map_err(|source| io("start python3", source))?;
    if !output.status.success() {
        return Err(BenchError::OracleFailed { case: CASE, status: output.status });
    }
    let output: Output =
        serde_json::from_slice(&output.stdout).map_err(|source| BenchError::OracleOutput { case: CASE, source })?;
    Ok(output.fastest_median_ms * 1e3)
}

fn scene(error: impl std::error::Error + Send + Sync + 'static) -> BenchError {
    BenchError::Scene(Box::new(error))
}

impl fmt::Display for SensorReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.machine)?;
        writeln!(
            f,
            "Control steps of 20 ms on one thread, task {TASK}, policy {POLICY}, every sensor in each step:\n"
        )?;
        let header = ["sensors", "steps/s", "x real time", "mean, us", "p50, us", "p99, us", "message, bytes"];
        let mut rows = vec![header.map(str::to_owned).to_vec()];
        for case in &self.cases {
            let mut row = vec![case.name.clone()];
            row.extend([case.steps_per_s, case.real_time_factor].map(|number| format!("{number:.1}")));
            row.extend([case.mean_us, case.p50_us, case.p99_us].map(|number| format!("{number:.0}")));
            row.push(case.message_bytes.to_string());
            rows.push(row);
        }
        write_table(f, &rows)?;
        writeln!(f, "\nEach sensor in one row, what it stands on not counted (features: the camera):\n")?;
        let header = ["sensor", "mean, us", "p50, us", "p99, us", "PyTorch, us", "PyTorch / ours"];
        let mut rows = vec![header.map(str::to_owned).to_vec()];
        for case in &self.sensors {
            let mut row = vec![case.name.clone()];
            row.extend([case.mean_us, case.p50_us, case.p99_us].map(|number| format!("{number:.1}")));
            row.push(case.pytorch_us.map_or("-".into(), |number| format!("{number:.0}")));
            row.push(case.ratio.map_or("-".into(), |ratio| format!("{ratio:.2}")));
            rows.push(row);
        }
        write_table(f, &rows)
    }
}
