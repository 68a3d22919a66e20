//! The program `policy-client`, as a function: runs policies on simulation servers.

mod cli;
mod inspect;

use std::process::ExitCode;

use clap::{CommandFactory, Parser};

use cli::plan::RunArgs;
use cli::run::Played;
use cli::{Failure, evaluate, list};

/// Runs policies on a simulation server
#[derive(Debug, Parser)]
#[command(
    name = "policy-client",
    version,
    after_help = "Examples:
  policy-client list
  policy-client inspect --task S05
  policy-client run --policy zero --task S08 --seed 0
  policy-client run --policy stand --task S01 --episodes 3 -e tcp/192.168.1.7:7447
  policy-client run --policy replay:bags/S08-s0-e0.mcap
  policy-client probe --dialect gr00t --model tcp://lab:5555
  policy-client evaluate --policy stand -e tcp/192.168.1.7:7447
  policy-client teleop --task S07 -e tcp/192.168.1.7:7447

Results go to stdout, progress and log to stderr. Exit codes: 0 ok, 1 failed, 2 usage, 3 a run that is not all played,
or a recording that is cut."
)]
struct Cli {
    #[command(subcommand)]
    command: Subcommand,
}

#[derive(Debug, clap::Subcommand)]
enum Subcommand {
    /// Run episodes of a task with a policy
    Run(Box<RunArgs>),
    /// Play a whole run: a policy through all tasks and seeds, on servers elsewhere
    Evaluate(Box<evaluate::EvaluateArgs>),
    /// List what a policy receives in a session, and what each sensor costs
    Inspect(Box<cli::inspect::InspectArgs>),
    /// Drive the robot of a server from a browser, and record takes there
    Teleop(Box<cli::teleop::TeleopArgs>),
    /// Drive a Unitree G1 by a policy, over DDS
    Deploy(cli::deploy::DeployArgs),
    /// Ask a model server for its contract and for one chunk; nothing moves
    Probe(Box<cli::probe::ProbeArgs>),
    /// List the servers that can be reached, or the policies
    List(list::ListArgs),
}

/// Its command line, for completions and pages of `man`.
pub fn command() -> clap::Command {
    <Cli as CommandFactory>::command()
}

/// The program `policy-client`: reads the arguments of this process.
///
/// Exit code 0 ok, 1 failed, 2 usage, 3 a run that is not all played, or a recording that is cut.
pub fn run() -> ExitCode {
    let cli: Cli = fiatlux_cli::parse();
    fiatlux_cli::init_quiet_log();
    let done = match cli.command {
        Subcommand::Run(args) => match cli::run::run(&args) {
            Ok(Played::Cut) => return ExitCode::from(3),
            played => played.map(|played| matches!(played, Played::Whole)),
        },
        Subcommand::Evaluate(args) => return exit(evaluate::evaluate(&args), ExitCode::from(3)),
        Subcommand::Inspect(args) => cli::inspect::inspect(&args),
        Subcommand::Deploy(args) => cli::deploy::run(&args).map(|()| true),
        Subcommand::Probe(args) => cli::probe::probe(&args),
        Subcommand::Teleop(args) => cli::teleop::teleop(&args),
        Subcommand::List(args) => list::list(&args),
    };
    exit(done, ExitCode::FAILURE)
}

/// The exit code; `short` if only part of the work was done.
fn exit(done: Result<bool, Failure>, short: ExitCode) -> ExitCode {
    match done {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => short,
        Err(Failure::Usage(message)) => Cli::command().error(clap::error::ErrorKind::ValueValidation, message).exit(),
        Err(Failure::Failed(error)) => fiatlux_cli::failure(error),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn whole_numbers_name_their_range() {
        fiatlux_cli::check_whole_numbers::<Cli>().unwrap();
    }

    #[test]
    fn every_help_has_an_example() {
        fiatlux_cli::check_examples::<Cli>().unwrap();
    }
}
