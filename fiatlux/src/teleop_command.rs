//! `fiatlux teleop`.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use fiatlux_rules::Task;
use fiatlux_teleop::{PageArgs, RobotArgs, TakeOptions, takes};

use crate::network::secure;

/// Shown below the options.
pub const EXAMPLES: &str = "Examples:
  fiatlux teleop --task S07                               drive, and record takes into takes/
  fiatlux teleop --task S08 --seed 5 --out takes/grab     the same in another room
  fiatlux teleop --task S08 --lan                         from a headset on the network, over HTTPS
  scorer grade --takes takes                              the table of all takes

Exit codes: 0 ok, 1 failed, 2 usage.";

/// Options of the command.
#[derive(Debug, Args)]
pub struct TeleopArgs {
    /// Task to drive, such as S07.
    #[arg(long)]
    task: Task,
    /// Layout seed of the first room [default: 0; in S07 23, which a straight walk solves]
    #[arg(long, value_parser = fiatlux_client::parse_seed, allow_hyphen_values = true)]
    seed: Option<u64>,
    #[command(flatten)]
    robot: RobotArgs,
    /// Folder of the takes, a bag each.
    #[arg(long, value_name = "DIR", default_value = "takes")]
    out: PathBuf,
    #[command(flatten)]
    page: PageArgs,
}

/// Runs the command: serves the page, and plays takes until Ctrl-C.
pub fn run(args: &TeleopArgs) -> anyhow::Result<ExitCode> {
    fiatlux_cli::init_quiet_log();
    let seed = args.seed.unwrap_or(takes::first_room(args.task));
    let options = TakeOptions { task: args.task, seed, robot: args.robot.robot.into(), out: args.out.clone() };
    args.page.run(secure, |station, stop| takes::play(&options, station, stop))?;
    Ok(ExitCode::SUCCESS)
}
