//! The command `policy-client inspect`.

use clap::Args;
use fiatlux_client::{AccessArgs, Policy, Replay, SessionArgs};
use fiatlux_link::{CarrierArgs, Role};
use fiatlux_proto::v3::{Mode, OpenRequest};

use super::{Failure, policy};
use crate::inspect::{self, Format, Inspection};

/// Options of the command `inspect`.
#[derive(Debug, Args)]
#[command(
    after_help = "Lists every term of the observation with its shape, unit and numbers, and each sensor's rate, size and cost.
To see the robot, show a bag in the browser with `fiatlux view`; `run --record camera,lidar` adds pictures and scans
to a bag, for Foxglove.

Without --sensors the session has the body's sensors, privileged and verdict in every step, lidar and camera at 10 Hz,
and features and flat on request: each large sensor is requested alone three times, once in real time, so that you see
what one costs. The policy of a bag or of a ranked run gets neither privileged nor verdict.

Examples:
  policy-client inspect --task S05
  policy-client inspect --task S02 --policy stand --seconds 60 --real-time --joints
  policy-client inspect --task climb --sensors proprioception,last_action,lidar@25,camera@look --image 512x512
  policy-client inspect --task S11 --json | jq '.sensors[] | {name, rate_hz, bytes}'
  policy-client inspect --task S05 --json --values > observation.json"
)]
pub struct InspectArgs {
    /// Task: S01 to S12, replace, climb
    #[arg(short, long)]
    task: String,
    /// Policy that drives, one of `policy-client list --policies` except vla; replay:BAG takes seed, episode and session
    /// from its bag
    #[arg(short, long, value_name = "NAME", default_value = "stand")]
    policy: String,
    /// Simulated time to play, s
    #[arg(long, value_name = "SECONDS", default_value_t = 10.0, value_parser = seconds)]
    seconds: f64,
    /// List the joints: angles of the standing posture, limits, gains
    #[arg(long, conflicts_with = "json")]
    joints: bool,
    /// Seed of the layout
    #[arg(short, long, default_value_t = 0, value_parser = fiatlux_client::parse_seed, allow_hyphen_values = true)]
    seed: u64,
    /// Index of the episode; with the seed it determines start and noise
    #[arg(long, value_name = "INDEX", default_value_t = 0, value_parser = fiatlux_cli::whole::<u64>(0..))]
    episode: u64,
    /// Name of the server; not needed if there is only one
    #[arg(long, value_name = "NAME")]
    server: Option<String>,
    /// Step at 50 Hz by the wall clock; otherwise the server waits for each action
    #[arg(long)]
    real_time: bool,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
    /// Include all numbers of the last observation
    #[arg(long, requires = "json")]
    values: bool,
    #[command(flatten)]
    session: SessionArgs,
    #[command(flatten)]
    access: AccessArgs,
    #[command(flatten)]
    link: CarrierArgs,
}

/// Shows a session; always returns true on success.
pub fn inspect(args: &InspectArgs) -> Result<bool, Failure> {
    let (policy, base, episode) = driver(args)?;
    let request = request(args, policy.as_ref(), base);
    let link = args.link.open(Role::Client)?.carrier();
    let (server, access) = (args.server.clone(), args.access.read()?);
    let format = if args.json { Format::Json { values: args.values } } else { Format::Text { joints: args.joints } };
    let seconds = args.seconds;
    inspect::inspect(Inspection { policy, request, episode, server, access, seconds, format }, &link)?;
    Ok(true)
}

/// The policy, its session and its episode; for a bag, those that it was recorded with.
fn driver(args: &InspectArgs) -> Result<(Box<dyn Policy>, OpenRequest, u64), Failure> {
    if let Some(path) = fiatlux_policies::replayed_bag(&args.policy) {
        let replay = Replay::open(path)?;
        let base = replay.request();
        if !base.task.eq_ignore_ascii_case(&args.task) {
            return Err(Failure::Usage(format!("the bag was recorded in task {}, not {}", base.task, args.task)));
        }
        let episode = replay.header().episode;
        return Ok((Box::new(replay), base, episode));
    }
    let policy = policy(&args.policy)?;
    let base =
        OpenRequest { policy: policy.name(), task: args.task.clone(), seed: args.seed, ..OpenRequest::default() };
    Ok((policy, base, args.episode))
}

/// The flags override the policy's request, which overrides the defaults.
fn request(args: &InspectArgs, policy: &dyn Policy, base: OpenRequest) -> OpenRequest {
    let mut sensors = policy.sensors();
    for sensor in inspect::default_sensors() {
        if !sensors.iter().any(|asked| asked.name == sensor.name) {
            sensors.push(sensor);
        }
    }
    let mut request = OpenRequest { sensors, weights: String::new(), ..base };
    args.session.apply(&mut request);
    if args.real_time {
        request.set_mode(Mode::RealTime);
    }
    request
}

fn seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse().ok().filter(|seconds: &f64| seconds.is_finite() && *seconds > 0.0);
    seconds.ok_or_else(|| format!("'{text}' is not a time; write seconds, such as 10"))
}
