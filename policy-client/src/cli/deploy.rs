//! The command `policy-client deploy`.

use std::net::IpAddr;
use std::path::PathBuf;

use clap::Args;
use fiatlux_cli::whole;
use fiatlux_robot::Robot;
use fiatlux_rules::Task;

use super::Failure;

/// Options of the command `deploy`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  policy-client deploy --policy stand --dry-run
  policy-client deploy --policy wbc --command vx=0.3 --address 192.168.123.222 --record drive.mcap
  policy-client deploy --policy wbc --domain 1 --address 127.0.0.1 --ramp 0     beside sim-server --unitree --dds-address 127.0.0.1

It was tried on our own simulator alone, never on a robot. Hang the robot up first, keep the remote in your hand (B and select stop), and
release the robot's own walking (L2+R2). A lean of 1 rad, 20 rad/s of a
joint, 6 rad/s of the pelvis, 85 degrees Celsius of a motor's casing or 120 of its winding, or 0.1 s without a state or without targets
lets it down: all motors damp until it is started again. So do the end and Ctrl-C.")]
pub struct DeployArgs {
    /// Name of the policy, one that reads proprioception alone and sends joint targets: hold, stand, wbc
    #[arg(short, long, value_name = "NAME")]
    policy: String,
    /// Command for the policy wbc, as for run
    #[arg(long, value_name = "LIST")]
    command: Option<String>,
    /// Domain of DDS: a robot is in 0, a simulator in 1
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = whole::<u16>(0..=232))]
    domain: u16,
    /// Address of this machine on the robot's network, such as 192.168.123.222 [default: all networks]
    #[arg(long, value_name = "ADDRESS")]
    address: Option<IpAddr>,
    /// Time in which the robot is brought from its posture to the policy's, s. 0 where it stands already and must be kept from falling at
    /// once, as in a simulator
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0, value_parser = ramp)]
    ramp: f64,
    /// Time for which the policy drives, s
    #[arg(long, value_name = "SECONDS", default_value_t = 60.0, value_parser = seconds)]
    seconds: f64,
    /// Compute all commands and send none
    #[arg(long)]
    dry_run: bool,
    /// Record all states and commands as an MCAP file
    #[arg(long, value_name = "FILE.mcap")]
    record: Option<PathBuf>,
    /// The robot, by its name or that of its hands
    #[arg(long, value_name = "NAME", default_value = Robot::NAMES[0], value_parser = Robot::known)]
    robot: &'static str,
    /// Task that the policy is told
    #[arg(short, long, default_value = "S07")]
    task: Task,
}

fn seconds(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|seconds| (0.1..=86_400.0).contains(seconds));
    number.ok_or_else(|| "use a number of seconds from 0.1 to 86400".into())
}

fn ramp(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|seconds| (0.0..=60.0).contains(seconds));
    number.ok_or_else(|| "use a number of seconds from 0 to 60".into())
}

/// Drives the robot.
#[cfg(not(feature = "unitree"))]
pub fn run(_: &DeployArgs) -> Result<(), Failure> {
    let built = "this build has no DDS; build policy-client with `--features unitree`";
    Err(anyhow::anyhow!(built).into())
}

/// Drives the robot.
#[cfg(feature = "unitree")]
pub fn run(args: &DeployArgs) -> Result<(), Failure> {
    use std::sync::Arc;

    use fiatlux_robot::GainSet;
    use fiatlux_unitree::{Deployment, Limits, Reason, deploy};
    use fiatlux_world::{EpisodeSpec, Scene, SceneConfig};

    let name = args.command.as_ref().map(|command| format!("{}:{command}", args.policy));
    let mut policy = super::policy(name.as_deref().unwrap_or(&args.policy))?;
    let senses = ["proprioception", "last_action"];
    let wanted = policy.sensors();
    if let Some(sensor) = wanted.iter().find(|sensor| !senses.contains(&sensor.name.as_str())) {
        let problem = format!("{} reads {}, which the robot does not send", args.policy, sensor.name);
        return Err(Failure::Usage(problem));
    }
    let robot = Arc::new(Robot::by_name(args.robot)?);
    let spec = EpisodeSpec::new(args.task, 0, 0).scene(robot.gains(GainSet::default()));
    let mut info =
        fiatlux_wire::session_terms(args.task, &Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec)?);
    // Things of a room that is not the robot's.
    info.footprints.clear();

    let stop = fiatlux_cli::stop_on_signal()?;
    let deployment = Deployment {
        domain: args.domain,
        address: args.address,
        limits: Limits { ramp: args.ramp, ..Limits::default() },
        dry: args.dry_run,
        record: args.record.as_deref(),
        seconds: args.seconds,
    };
    let done = deploy(&deployment, &robot, &info, policy.as_mut(), &stop)?;
    let what = if args.dry_run { "would have been sent" } else { "sent" };
    fiatlux_cli::print(format!(
        "let down: {}\n{} states heard ({} with a wrong checksum), {} targets of {}, {} commands {what}\n",
        done.reason, done.states, done.unsound, done.steps, args.policy, done.commands
    ))?;
    match done.reason {
        Reason::TimeOver | Reason::Stopped => Ok(()),
        reason => Err(anyhow::anyhow!("the robot was let down: {reason}").into()),
    }
}
