//! The command `fiatlux`. Results on stdout, progress and errors on stderr; exit code 0 ok, 1 failed, 2 usage.

use std::alloc::System;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand};
use fiatlux::bench::world::{self, Options};
use stats_alloc::{INSTRUMENTED_SYSTEM, StatsAlloc};

/// Counts what is allocated, for the memory that a world takes. A physics step allocates nothing.
#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Fiatlux on one machine.
#[derive(Debug, Parser)]
#[command(version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Measures speeds.
    #[command(subcommand)]
    Bench(Bench),
}

#[derive(Debug, Subcommand)]
enum Bench {
    /// Microseconds per physics step of 5 ms on one core, and many worlds on two.
    World(WorldArgs),
}

#[derive(Debug, Args)]
struct WorldArgs {
    /// Also times MuJoCo on the exported scene, case by case. Needs Python 3.11 or newer; makes its own environment.
    #[arg(long)]
    mujoco: bool,
    /// Prints JSON in place of the table.
    #[arg(long)]
    json: bool,
    /// Simulated seconds that each case is measured over; a twentieth of it for Rapier's multibody.
    #[arg(long, default_value_t = 60.0, value_parser = positive)]
    seconds: f64,
    /// Script that times MuJoCo.
    #[arg(long, default_value = "tests/oracle/oracle.py")]
    oracle: PathBuf,
}

fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err("give a positive number of seconds".into()),
    }
}

fn main() -> ExitCode {
    let Command::Bench(Bench::World(args)) = Cli::parse().command;
    match bench_world(args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn bench_world(args: WorldArgs) -> anyhow::Result<()> {
    let options = Options { seconds: args.seconds, oracle: args.mujoco.then_some(args.oracle) };
    let report = world::run(&options)?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        print!("{report}");
    }
    Ok(())
}
