//! The programs `sim-server` and `recorder`, as functions.

mod daemon;
mod metrics;
pub mod recorder;
mod robot;

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{ExitCode, Stdio};

use anyhow::Context;
use clap::{Parser, Subcommand};
use fiatlux_mjcf::{ExportScene, MjcfOptions, OptionSet, to_mjcf};
use fiatlux_robot::Robot;
use fiatlux_rules::Task;

/// Simulates the errand's scenes for policies.
///
/// Without a subcommand it serves sessions over Zenoh until it is interrupted, on the loopback interface unless -l or
/// -e say otherwise. When it is ready it prints one line on stdout; its log goes to stderr. On an interrupt (SIGINT,
/// SIGTERM) it ends all sessions, lets recorders finish, and exits with 0, or with 3 if a recorder missed records.
#[derive(Debug, Parser)]
#[command(name = "sim-server", version, args_conflicts_with_subcommands = true, after_help = EXAMPLES)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    daemon: daemon::DaemonArgs,
}

const EXAMPLES: &str = "\
Examples:
  sim-server                                  for policies on this machine
  sim-server -l tcp/0.0.0.0:7447 --name lab   for policies on the network
  sim-server --name lab --record bags         and keep runs: every episode once, recorded here and not by the client
  sim-server --settings lab.toml              with the flags that a file has; deploy/settings/sim-server.toml shows all
  sim-server --unitree --task S07             be a G1 for Unitree's own programs, in domain 1
  sim-server export --task S01 -o scene.xml   the same scene for MuJoCo
  sim-server export --format usd --task S01 -o scene   and as USD";

#[derive(Debug, Subcommand)]
enum Command {
    /// Writes a scene for another simulator.
    Export(Export),
}

#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  sim-server export --task S01 -o scene.xml")]
struct Export {
    /// Format of the file.
    #[arg(long, value_enum, default_value_t = Format::Mjcf)]
    format: Format,
    /// Task whose scene to write: S01 to S12, replace or climb.
    #[arg(long, required_unless_present = "robot_only")]
    task: Option<Task>,
    /// Layout seed of the room.
    #[arg(long, default_value_t = 0, value_parser = fiatlux_cli::whole::<u64>(0..))]
    seed: u64,
    /// Instead of a task: the robot in its standing posture, without room and props.
    #[arg(long, conflicts_with_all = ["task", "seed"])]
    robot_only: bool,
    /// With --robot-only: add a floor under its feet.
    #[arg(long, requires = "robot_only")]
    floor: bool,
    /// Robot, by its name or that of its hands.
    #[arg(long, default_value = Robot::NAMES[0], value_parser = Robot::known, visible_alias = "hands")]
    robot: &'static str,
    /// Length of a physics step, s.
    #[arg(long, default_value_t = 0.005, value_parser = timestep)]
    timestep: f64,
    /// Keep MuJoCo's default integrator, friction pyramids and `impratio`, with the drives' damping as passive joint damping. Effort
    /// limits then clamp the stiffness only.
    #[arg(long)]
    mujoco_defaults: bool,
    /// Output file, with usd a folder; - for stdout.
    #[arg(short, long)]
    output: PathBuf,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Format {
    /// MJCF, as MuJoCo 4 loads it.
    Mjcf,
    /// USD: a folder with scene.usda, written by `python3 -m fiatlux.assets`, the wheel's extra assets.
    Usd,
}

fn timestep(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(value) if value > 0.0 && value <= 0.1 => Ok(value),
        _ => Err("use a number of seconds above 0 and at most 0.1".into()),
    }
}

/// Exit code for data loss.
const LOSS: u8 = 3;

/// Its command line, for completions and pages of `man`.
pub fn command() -> clap::Command {
    fiatlux_cli::command_with_settings::<Cli>()
}

/// The program `sim-server`: reads the arguments of this process.
///
/// Exit code 0 ok, 1 failed, 2 usage, 3 a recorder missed records.
pub fn run() -> ExitCode {
    let cli: Cli = fiatlux_cli::parse_with_settings();
    let done = match &cli.command {
        Some(Command::Export(export)) => run_export(export).map(|()| true),
        None => daemon::run(cli.daemon),
    };
    match done {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(LOSS),
        Err(error) => fiatlux_cli::failure(error),
    }
}

fn run_export(export: &Export) -> anyhow::Result<()> {
    let scene = match export.task {
        Some(task) => ExportScene::task(task, export.seed, export.robot)?,
        None => ExportScene::robot_only(export.robot, export.floor)?,
    };
    let options = MjcfOptions {
        name: scene.name,
        timestep: export.timestep,
        option_set: if export.mujoco_defaults { OptionSet::Defaults } else { OptionSet::Nearest },
        names: scene.names,
    };
    let text = to_mjcf(&scene.model, &scene.state, &scene.targets, &options);
    if let Format::Usd = export.format {
        return write_usd(&text, &export.output);
    }
    if export.output.as_os_str() == "-" {
        return Ok(fiatlux_cli::print(text)?);
    }
    fiatlux_cli::write_whole(&export.output, text).with_context(|| format!("cannot write {}", export.output.display()))
}

/// Lets the Python package write a scene as USD: the libraries of USD are there.
fn write_usd(mjcf: &str, folder: &Path) -> anyhow::Result<()> {
    let remedy = "install the wheel with its extra assets into the environment of python3 (docs/assets.md)";
    let mut python = std::process::Command::new("python3");
    let command = python.args(["-m", "fiatlux.assets", "scene", "--mjcf", "-", "--out"]).arg(folder);
    let mut running =
        command.stdin(Stdio::piped()).spawn().with_context(|| format!("cannot start python3; {remedy}"))?;
    // A package that is missing closes its end.
    let written = running.stdin.take().map_or(Ok(()), |mut stdin| stdin.write_all(mjcf.as_bytes()));
    let status = running.wait()?;
    anyhow::ensure!(status.success(), "python3 -m fiatlux.assets failed; {remedy}");
    Ok(written?)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_example_settings_show_every_flag() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/settings/sim-server.toml");
        fiatlux_cli::check_example::<Cli>(path.as_ref()).unwrap();
        Cli::command().debug_assert();
    }

    #[test]
    fn flags_of_a_robot_ask_for_one() {
        let checked = |flags: &[&str]| {
            let cli = Cli::try_parse_from([&["sim-server"], flags].concat()).unwrap();
            cli.daemon.robot.check().map_err(|error| error.to_string())
        };
        for flags in
            [&["--domain", "0"][..], &["--task", "S01"], &["--seed", "3"], &["--lockstep"], &["--dds-address", "::1"]]
        {
            let refused = checked(flags).unwrap_err();
            assert!(refused.starts_with(flags[0]) && refused.contains("--unitree"), "{refused}");
            assert_eq!(checked(&[&["--unitree"], flags].concat()), Ok(()));
        }
        assert_eq!(checked(&[]), Ok(()));
    }

    #[test]
    fn whole_numbers_name_their_range() {
        fiatlux_cli::check_whole_numbers::<Cli>().unwrap();
    }

    #[test]
    fn every_help_has_an_example() {
        fiatlux_cli::check_examples::<Cli>().unwrap();
    }
}
