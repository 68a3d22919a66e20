//! Turns the flags of `run` into a request; for a replay, the bag fills in the rest.

use clap::Args;
use fiatlux_client::{AccessArgs, Policy, Replay, SessionArgs, parse_seed, request_of};
use fiatlux_link::CarrierArgs;
use fiatlux_policies::VlaArgs;
use fiatlux_proto::v3::{Mode, OpenRequest};

use super::{Failure, model_server, policy};

/// Options of the command `run`.
#[derive(Debug, Args)]
#[command(after_help = "Policies:
  zero        all actions 0; a robot that leans on nothing falls in about a second
  random      uniform in [-1, 1], drawn from seed and episode
  hold        keeps the posture of the start
  stand       keeps the robot upright on level ground
  wbc         walks, turns and bends on --command
  walk        walks to where S05, S07 or S09 ends, by the privileged observation
  vla         plays the chunks of a model server: --dialect, --model, --map; docs/bridges.md
  replay:BAG  sends a recorded episode's actions once more. Task, seed, episode and everything about the session are
              the bag's unless given. It runs in lockstep unless --real-time is given, also when the bag was
              recorded in real time. At the end the digest is compared with the bag's.

Examples:
  policy-client run --policy zero --task S08 --seed 0
  policy-client run --policy random --task S01 --seed 3 --episodes 10 --json
  policy-client run --policy hold --task S06 --set fragility_n=30 --end-on fall,time-out
  policy-client run --policy stand --task S05 --recorded --record camera,lidar
  policy-client run --policy wbc --command vx=0.4,wz=0.2 --task S07
  policy-client run --policy vla --dialect gr00t --model tcp://lab:5555 --task S05
  policy-client run --policy replay:bags/S08-s0-e0.mcap -e tcp/192.168.1.7:7447")]
pub struct RunArgs {
    /// Name of the policy, see below
    #[arg(short, long, value_name = "NAME")]
    pub policy: String,
    /// Command for the policy wbc: vx, vy (m/s), wz (rad/s), height (m), roll, pitch, yaw of the torso (rad), such as
    /// vx=0.4,wz=0.2 [default: stand]
    #[arg(long, value_name = "LIST")]
    pub command: Option<String>,
    /// Task: S01 to S12, replace, climb
    #[arg(short, long)]
    pub task: Option<String>,
    /// Seed of the layout [default: 0]
    #[arg(short, long, value_parser = parse_seed, allow_hyphen_values = true)]
    pub seed: Option<u64>,
    /// Index of the first episode; with the seed it determines start and noise [default: 0]
    #[arg(long, value_name = "INDEX", value_parser = fiatlux_cli::whole::<u64>(0..))]
    pub episode: Option<u64>,
    /// Number of episodes to play, one after another [default: 1]
    #[arg(short = 'n', long, value_name = "N", value_parser = fiatlux_cli::whole::<u64>(1..))]
    pub episodes: Option<u64>,
    /// Name of the server; not needed if there is only one
    #[arg(long, value_name = "NAME")]
    pub server: Option<String>,
    /// Step at 50 Hz by the wall clock, whether or not an action has arrived; otherwise the server waits
    #[arg(long)]
    pub real_time: bool,
    /// Guarantee a whole recording: the episode waits for the recorder. Without it a running recorder also writes the
    /// episode, but may miss rows
    #[arg(long)]
    pub recorded: bool,
    /// Print results as JSON
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub vla: VlaArgs,
    #[command(flatten)]
    pub session: SessionArgs,
    #[command(flatten)]
    pub access: AccessArgs,
    #[command(flatten)]
    pub link: CarrierArgs,
}

/// A run, from flags and bag.
pub struct Plan {
    pub policy: Box<dyn Policy>,
    pub request: OpenRequest,
    /// Index of the first episode.
    pub first: u64,
    pub count: u64,
    /// Digest of the recorded episode; `None` unless a whole bag is replayed.
    pub digest: Option<String>,
}

/// Turns the flags into a plan.
pub fn plan(args: &RunArgs) -> Result<Plan, Failure> {
    match fiatlux_policies::replayed_bag(&args.policy) {
        Some(path) => replay(args, Replay::open(path)?),
        None => {
            let name = args.command.as_ref().map(|command| format!("{}:{command}", args.policy));
            let task = args.task.clone().ok_or_else(|| Failure::Usage("name a task: --task S01 to S12".into()))?;
            let policy = match model_server(&args.policy, &args.vla, args.session.robot(), args.real_time)? {
                Some(source) => Box::new(source.policy()),
                None => policy(name.as_deref().unwrap_or(&args.policy))?,
            };
            let request = request(args, OpenRequest { task, ..request_of(policy.as_ref()) });
            Ok(Plan {
                policy,
                request,
                first: args.episode.unwrap_or(0),
                count: args.episodes.unwrap_or(1),
                digest: None,
            })
        }
    }
}

fn replay(args: &RunArgs, policy: Replay) -> Result<Plan, Failure> {
    if args.episodes.is_some_and(|count| count != 1) {
        return Err(Failure::Usage("a bag holds one episode: omit --episodes".into()));
    }
    let digest = policy.result().and_then(|result| result.end.as_ref()).map(|end| end.digest.clone());
    let digest = digest.filter(|digest| !digest.is_empty());
    if digest.is_none() {
        tracing::warn!("the bag has no digest, because it was cut or aborted; there is nothing to compare at the end");
    }
    let request = request(args, policy.request());
    let first = args.episode.unwrap_or(policy.header().episode);
    Ok(Plan { policy: Box::new(policy), request, first, count: 1, digest })
}

/// The request, with the values of the flags in place of its own.
fn request(args: &RunArgs, mut request: OpenRequest) -> OpenRequest {
    request.task = args.task.clone().unwrap_or(request.task);
    request.seed = args.seed.unwrap_or(request.seed);
    request.recorded = args.recorded;
    args.session.apply(&mut request);
    if args.real_time {
        request.set_mode(Mode::RealTime);
    }
    request
}
