//! The command `policy-client teleop`.

use clap::Args;
use fiatlux_client::{AccessArgs, parse_seed};
use fiatlux_link::{CarrierArgs, Role};
use fiatlux_rules::Task;
use fiatlux_teleop::{PageArgs, RobotArgs, Secured, ServerElsewhere, takes};

use super::Failure;

/// Options of the command `teleop`.
#[derive(Debug, Args)]
#[command(
    after_help = "The page is served by this machine, and the takes are recorded where the server's are: it needs --record, or a
recorder. Ctrl-C ends it, and prints the bags of the takes that are kept, below the recorder's folder.

Examples:
  policy-client teleop --task S07 -e tcp/192.168.1.7:7447
  policy-client teleop --task S08 --seed 5 --lan -e tcp/192.168.1.7:7447 --token operator.token"
)]
pub struct TeleopArgs {
    /// Task to drive, such as S07
    #[arg(short, long)]
    task: Task,
    /// Layout seed of the first room [default: 0; in S07 23, which a straight walk solves]
    #[arg(short, long, value_parser = parse_seed, allow_hyphen_values = true)]
    seed: Option<u64>,
    #[command(flatten)]
    robot: RobotArgs,
    /// Index of the first take's episode in each room; with the seed it determines start and noise
    #[arg(long, value_name = "INDEX", default_value_t = 0, value_parser = fiatlux_cli::whole::<u64>(0..))]
    episode: u64,
    /// Name of the server; not needed if there is only one
    #[arg(long, value_name = "NAME")]
    server: Option<String>,
    #[command(flatten, next_help_heading = "Page")]
    page: PageArgs,
    #[command(flatten)]
    access: AccessArgs,
    #[command(flatten)]
    link: CarrierArgs,
}

/// Serves the page, and plays takes until Ctrl-C; always returns true on success.
pub fn teleop(args: &TeleopArgs) -> Result<bool, Failure> {
    let access = args.access.read()?;
    let link = args.link.open(Role::Client)?;
    let server = ServerElsewhere::find(link.carrier(), args.server.as_deref(), access, args.episode)?;
    let secure = |folder: &_, hosts: &_| {
        let (names, secure, said) = fiatlux_tls::secure(folder, hosts)?;
        Ok::<_, fiatlux_tls::CertificateError>(Secured { names, secure, said })
    };
    let (robot, seed) = (args.robot.robot, args.seed.unwrap_or(takes::first_room(args.task)));
    args.page.run(secure, |station, stop| takes::play_elsewhere(server, args.task, robot, seed, station, stop))?;
    Ok(true)
}
