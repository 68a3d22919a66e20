//! The program `fiatlux`: the whole service on one machine.
//!
//! - [`render`]: recorded episodes as a video, a still or a folder of pictures.
//! - [`keys`]: keys, certificates and configs of an installation on several machines.

mod demonstrate_command;
mod evaluate_command;
#[allow(missing_docs)] // Used by this program and its tests.
pub mod keys;
mod keys_command;
mod label_command;
mod lists_command;
#[cfg(feature = "manual")]
mod manual;
mod network;
mod part;
#[cfg(feature = "programs")]
mod programs;
#[allow(missing_docs)] // Used by this program and its tests.
pub mod render;
mod render_command;
mod teleop_command;
mod view_command;

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use fiatlux_policies::Policies;

pub use part::part_of;
#[cfg(feature = "programs")]
pub use programs::program_named;

/// Fiatlux on one machine.
#[derive(Debug, Parser)]
#[command(
    name = "fiatlux",
    version,
    after_help = "Examples:
  fiatlux evaluate --policy expert          play, record and grade the twelve subtasks
  fiatlux view results/expert               look at the episodes in 3D
  fiatlux policies                          what can be played; also tasks, sensors, robots"
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Plays a policy through tasks and seeds, records every episode and grades it.
    ///
    /// Server, recorder, policy and scorer run in this process. Bags,
    /// results.json and report.html go to the output folder; the table goes to stdout. Ctrl-C stops cleanly and grades
    /// what is finished; the same command then continues.
    #[command(after_help = evaluate_command::after_help())]
    Evaluate(Box<evaluate_command::EvaluateArgs>),
    /// Records clean demonstrations of one task in training rooms, and makes a LeRobot data set of them.
    ///
    /// Plays rooms from seed 1000 on, several at once, until N episodes passed the strict gate with nothing dropped or broken.
    /// Their bags are in OUT/bags, with the camera's images, proprioception, actions, commands to the whole-body controller and
    /// the instruction; everything that was played is in OUT/played. Ctrl-C stops cleanly; the same command then
    /// continues, and one with more episodes adds to what is there.
    #[command(after_help = demonstrate_command::EXAMPLES)]
    Demonstrate(Box<demonstrate_command::DemonstrateArgs>),
    /// Says for each action of recorded episodes what the expert would have done in its place, for learning.
    ///
    /// Plays the episodes again on a server in this process, takes of teleoperation and other policies' bags too. Ctrl-C stops cleanly;
    /// the same command then continues.
    #[command(after_help = label_command::EXAMPLES)]
    Label(label_command::LabelArgs),
    /// Makes a video, a folder of pictures or a still of recorded episodes.
    ///
    /// Needs no graphics driver. A video needs ffmpeg in PATH; without it the frames are written as PNG files. Ctrl-C
    /// ends the clip early and keeps the frames drawn so far.
    #[command(after_help = render_command::EXAMPLES)]
    Render(render_command::RenderArgs),
    /// Shows recorded episodes in the browser: in 3D, with a time bar, conditions that light up as they hold, and contact forces.
    ///
    /// Serves only this machine, on 127.0.0.1, until Ctrl-C; needs no account and no network.
    #[command(after_help = view_command::EXAMPLES)]
    View(view_command::ViewArgs),
    /// Lets a person drive the robot from a browser, by keys, gamepad or headset, and records takes.
    ///
    /// Prints the page's address, with a token without which nobody can see or drive. A take goes on past mistakes and time-out until
    /// its gate holds or its operator stops it. Ctrl-C keeps the take that is being recorded.
    #[command(after_help = teleop_command::EXAMPLES)]
    Teleop(teleop_command::TeleopArgs),
    /// Makes keys, certificates and Zenoh configs, so that each program can do its part on a network and nothing else.
    #[command(after_help = keys_command::EXAMPLES)]
    Keys(keys_command::KeysArgs),
    /// Lists the policies, each with a line.
    #[command(after_help = "Example:\n  fiatlux policies")]
    Policies(lists_command::ListArgs),
    /// Lists the tasks, each with what the robot is told to do.
    #[command(after_help = "Example:\n  fiatlux tasks --json")]
    Tasks(lists_command::ListArgs),
    /// Lists the sensors, each with what it senses.
    #[command(after_help = "Example:\n  fiatlux sensors")]
    Sensors(lists_command::ListArgs),
    /// Lists the robots, by name and hands.
    #[command(after_help = "Example:\n  fiatlux robots")]
    Robots(lists_command::ListArgs),
    /// Passes messages on between programs, and enforces the access control in its config.
    ///
    /// When it is ready it prints one line on stdout; on an interrupt (SIGINT, SIGTERM) it exits with 0.
    #[command(after_help = "Example:\n  fiatlux router --config router.json5")]
    Router(network::RouterArgs),
    /// Writes completions for shells and pages for `man`, of every program.
    #[cfg(feature = "manual")]
    #[command(hide = true, after_help = "Example:\n  fiatlux manual share")]
    Manual(manual::ManualArgs),
}

/// The program `fiatlux`, which plays these policies. Results on stdout, progress and errors on stderr; exit code 0 ok, 1 failed,
/// 2 usage, 3 finished with data loss.
///
/// A program of your own that knows one more policy:
///
/// ```no_run
/// use fiatlux_policies::{Entry, Policies, Zero};
///
/// fn main() -> std::process::ExitCode {
///     let mine = Entry { name: "mine", does: "all actions 0", make: |_| Ok(Box::new(Zero::default())) };
///     fiatlux::run(Policies::default().with(mine))
/// }
/// ```
pub fn run(policies: Policies) -> ExitCode {
    fiatlux_server::simulate_thin_bags();
    let done = match fiatlux_cli::parse::<Cli>().command {
        Command::Evaluate(args) => evaluate_command::run(&args, policies),
        Command::Demonstrate(args) => demonstrate_command::run(&args, policies),
        Command::Label(args) => label_command::run(&args),
        Command::Render(args) => render_command::run(&args),
        Command::View(args) => view_command::run(&args),
        Command::Teleop(args) => teleop_command::run(&args),
        Command::Keys(args) => keys_command::keys(args).map(|()| ExitCode::SUCCESS),
        Command::Policies(args) => args.print(lists_command::policies(&policies)),
        Command::Tasks(args) => args.print(lists_command::tasks()),
        Command::Sensors(args) => args.print(lists_command::sensors()),
        Command::Robots(args) => args.print(lists_command::robots()),
        Command::Router(args) => network::router(args).map(|()| ExitCode::SUCCESS),
        #[cfg(feature = "manual")]
        Command::Manual(args) => manual::run(&args).map(|()| ExitCode::SUCCESS),
    };
    match done {
        Ok(code) => code,
        Err(error) => fiatlux_cli::failure(error),
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
