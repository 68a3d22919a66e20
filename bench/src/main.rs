//! The program `fiatlux-bench`: speeds of physics, sensors, batches and sessions, as tables or JSON.

use std::alloc::System;
use std::fmt::Display;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand};
use fiatlux_bench::batch::{self, BatchOptions};
use fiatlux_bench::camera::{self, CameraOptions};
use fiatlux_bench::sensors::{self, SensorOptions};
use fiatlux_bench::service::{self, ServiceOptions};
use fiatlux_bench::shares::{self, ShareOptions};
use fiatlux_bench::violence::{self, ViolenceOptions};
use fiatlux_bench::world::{self, Options};
use fiatlux_rules::Task;
use serde::Serialize;
use stats_alloc::{INSTRUMENTED_SYSTEM, StatsAlloc};

/// Counts allocations, to measure the memory of a world. A physics step allocates nothing.
#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Measures the speed of physics, sensors, batches and sessions
#[derive(Debug, Parser)]
#[command(name = env!("CARGO_BIN_NAME"), version)]
struct Cli {
    #[command(subcommand)]
    bench: Bench,
}

#[derive(Debug, Subcommand)]
enum Bench {
    /// Microseconds per physics step of 5 ms on one core, and many worlds on two cores.
    World(WorldArgs),
    /// Control steps per second on one core for sets of sensors, and microseconds for each sensor.
    Sensors(SensorArgs),
    /// Milliseconds of a picture at four sizes, and MuJoCo's of the same scene on a software renderer.
    Camera(CameraArgs),
    /// Behaviour under violent targets: energy in free flight, speeds, penetration, solves that do not converge, and
    /// the error relative to a step of 0.25 ms.
    Violence(ViolenceArgs),
    /// Control steps per second of sessions: in one process, over TCP, and with many client processes.
    Service(ServiceArgs),
    /// Microseconds of each part of a recorded control step: physics, judges, digest, observation, record and the rest.
    Shares(ShareArgs),
    /// Control steps per second of many worlds in step: compared with a single world and with separate processes, with
    /// proprioception, and for walking.
    Batch(BatchArgs),
}

#[derive(Debug, Args)]
struct WorldArgs {
    /// Also time MuJoCo on the exported scene, case by case. Needs Python 3.11 or newer; makes its own environment.
    #[arg(long)]
    mujoco: bool,
    /// Print JSON instead of the table.
    #[arg(long)]
    json: bool,
    /// Simulated seconds for each case; a twentieth of that for Rapier's multibody.
    #[arg(long, default_value_t = 60.0, value_parser = positive)]
    seconds: f64,
    /// Script that times MuJoCo.
    #[arg(long, default_value = "tests/oracle/oracle.py")]
    oracle: PathBuf,
}

#[derive(Debug, Args)]
struct ViolenceArgs {
    /// Runs of 10 s under violent targets, spread over all tasks and patterns.
    #[arg(long, default_value_t = 1000, value_parser = fiatlux_cli::whole::<u64>(0..))]
    runs: u64,
    /// Random starts of 1 s each in the room.
    #[arg(long, default_value_t = 20_000, value_parser = fiatlux_cli::whole::<u64>(0..))]
    starts: u64,
    /// Threads; results do not depend on it [default: all cores]
    #[arg(long, value_parser = fiatlux_cli::whole::<usize>(1..=1024))]
    threads: Option<usize>,
    /// Measure nothing; write starts, targets and scenes to this folder, for `tests/oracle/violence.py`.
    #[arg(long, value_name = "FOLDER")]
    export: Option<PathBuf>,
    /// Print JSON instead of the tables.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
struct SensorArgs {
    /// Also time PyTorch on the features. Needs Python 3.11 or newer; makes its own environment of several GB.
    #[arg(long)]
    pytorch: bool,
    /// Print JSON instead of the table.
    #[arg(long)]
    json: bool,
    /// Longest time for each case, s.
    #[arg(long, default_value_t = 5.0, value_parser = positive)]
    seconds: f64,
    /// Script that times PyTorch.
    #[arg(long, default_value = "tests/oracle/features.py")]
    oracle: PathBuf,
}

#[derive(Debug, Args)]
struct CameraArgs {
    /// Leave MuJoCo out. With it, needs Python 3.11 or newer, libEGL and Mesa; makes its own environment.
    #[arg(long)]
    alone: bool,
    /// Turns of each side for each size and start.
    #[arg(long, default_value_t = 10, value_parser = fiatlux_cli::whole::<u16>(1..=1000))]
    rounds: u16,
    /// Least processor time of a turn, s.
    #[arg(long, default_value_t = 0.2, value_parser = positive)]
    seconds: f64,
    /// Print JSON instead of the table.
    #[arg(long)]
    json: bool,
    /// Script that times MuJoCo.
    #[arg(long, default_value = "tests/oracle/camera.py")]
    oracle: PathBuf,
}

#[derive(Debug, Args)]
struct ServiceArgs {
    /// Number of sessions in the case with many of them.
    #[arg(long, default_value_t = 32, value_parser = fiatlux_cli::whole::<u16>(2..=1024))]
    sessions: u16,
    /// Duration of the cases with client processes, s.
    #[arg(long, default_value_t = 15.0, value_parser = positive)]
    seconds: f64,
    /// Program of the client processes [default: policy-client next to this program]
    #[arg(long)]
    policy_client: Option<PathBuf>,
    /// Print JSON instead of the table.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
struct ShareArgs {
    /// Task that is played.
    #[arg(long, default_value = "S05")]
    task: Task,
    /// Chunks of 128 rows to play; an episode has 46 at most.
    #[arg(long, default_value_t = 20, value_parser = fiatlux_cli::whole::<u8>(1..=46))]
    chunks: u8,
    /// Print JSON instead of the table.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
struct BatchArgs {
    /// Worlds of each batch.
    #[arg(long, default_value_t = 256, value_parser = fiatlux_cli::whole::<u16>(1..=65_535))]
    worlds: u16,
    /// Number of threads, and of processes to compare them with [default: all cores]
    #[arg(long, value_parser = fiatlux_cli::whole::<u16>(1..=1024))]
    threads: Option<u16>,
    /// Rounds of threads against processes.
    #[arg(long, default_value_t = 40, value_parser = fiatlux_cli::whole::<u16>(1..=1000))]
    rounds: u16,
    /// Duration of each measurement in a round, s.
    #[arg(long, default_value_t = 0.5, value_parser = positive)]
    seconds: f64,
    /// Print JSON instead of the table.
    #[arg(long)]
    json: bool,
    /// Run as a process of the comparison: step a share of the worlds as it is told.
    #[arg(long, hide = true)]
    share: bool,
}

fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err("give a positive number of seconds".into()),
    }
}

fn main() -> ExitCode {
    let done = match fiatlux_cli::parse::<Cli>().bench {
        Bench::World(args) => bench_world(args),
        Bench::Sensors(args) => bench_sensors(args),
        Bench::Camera(args) => bench_camera(args),
        Bench::Violence(args) => bench_violence(&args),
        Bench::Batch(args) => bench_batch(&args),
        Bench::Service(args) => bench_service(args),
        Bench::Shares(args) => bench_shares(&args),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => fiatlux_cli::failure(error),
    }
}

fn bench_service(args: ServiceArgs) -> anyhow::Result<()> {
    fiatlux_cli::init_quiet_log();
    let sibling = || Ok::<_, std::io::Error>(std::env::current_exe()?.with_file_name("policy-client"));
    let policy_client = args.policy_client.map_or_else(sibling, Ok)?;
    let report =
        service::run(&ServiceOptions { sessions: args.sessions.into(), seconds: args.seconds, policy_client })?;
    show(&report, args.json)
}

fn bench_batch(args: &BatchArgs) -> anyhow::Result<()> {
    let cores = || std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let threads = args.threads.map_or_else(cores, usize::from).min(args.worlds.into());
    let options =
        BatchOptions { worlds: args.worlds.into(), threads, rounds: args.rounds.into(), seconds: args.seconds };
    if args.share {
        return Ok(batch::serve_share(&options)?);
    }
    show(&batch::run(&options)?, args.json)
}

fn bench_shares(args: &ShareArgs) -> anyhow::Result<()> {
    show(&shares::run(&ShareOptions { task: args.task, chunks: args.chunks.into() })?, args.json)
}

fn bench_sensors(args: SensorArgs) -> anyhow::Result<()> {
    let options = SensorOptions { seconds: args.seconds, oracle: args.pytorch.then_some(args.oracle) };
    let report = sensors::run(&options)?;
    show(&report, args.json)
}

fn bench_camera(args: CameraArgs) -> anyhow::Result<()> {
    let oracle = (!args.alone).then_some(args.oracle);
    let options = CameraOptions { rounds: args.rounds.into(), seconds: args.seconds, oracle };
    show(&camera::run(&options)?, args.json)
}

fn bench_violence(args: &ViolenceArgs) -> anyhow::Result<()> {
    let cores = || std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let threads = args.threads.unwrap_or_else(cores).max(1);
    let options = ViolenceOptions { runs: args.runs, starts: args.starts, threads };
    match &args.export {
        Some(folder) => Ok(violence::export(folder, &options)?),
        None => show(&violence::run(&options)?, args.json),
    }
}

fn bench_world(args: WorldArgs) -> anyhow::Result<()> {
    let options = Options { seconds: args.seconds, oracle: args.mujoco.then_some(args.oracle) };
    let report = world::run(&options)?;
    show(&report, args.json)
}

fn show(report: &(impl Serialize + Display), as_json: bool) -> anyhow::Result<()> {
    let text = if as_json { serde_json::to_string_pretty(report)? + "\n" } else { report.to_string() };
    Ok(fiatlux_cli::print(text)?)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn whole_numbers_name_their_range() {
        fiatlux_cli::check_whole_numbers::<Cli>().unwrap();
    }
}
