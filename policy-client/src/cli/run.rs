//! `policy-client run`.

use std::time::Instant;

use clap::Args;
use fiatlux_link::{LinkArgs, ProgressLine, Role, stop_on_signal};
use fiatlux_policy::{Client, ClientError, SessionArgs};

use super::report::{Episode, Report};
use super::{Failure, plan};

/// Options of `run`.
#[derive(Debug, Args)]
#[command(after_help = "Policies:
  zero        all actions 0; a robot that leans on nothing falls in about a second
  random      uniform in [-1, 1], drawn from seed and episode
  hold        keeps the posture of the start
  stand       keeps the robot upright on level ground
  replay:BAG  sends a recorded episode's actions once more. Task, seed, episode and everything about the session are
              the bag's unless given. It runs in lockstep unless --real-time is given, also when the bag was
              recorded in real time. At the end the digest is compared with the bag's.

Examples:
  policy-client run --policy zero --task S08 --seed 0
  policy-client run --policy random --task S01 --seed 3 --episodes 10 --json
  policy-client run --policy hold --task S06 --set fragility_n=30 --end-on fall,time-out
  policy-client run --policy stand --task S05 --recorded --record camera,lidar
  policy-client run --policy replay:bags/S08-s0-e0.mcap -e tcp/192.168.1.7:7447")]
pub struct RunArgs {
    /// Name of the policy, see below
    #[arg(short, long, value_name = "NAME")]
    pub policy: String,
    /// Task: S01 to S12, replace, climb
    #[arg(short, long)]
    pub task: Option<String>,
    /// Seed of the layout [default: 0]
    #[arg(short, long)]
    pub seed: Option<u64>,
    /// Index of the first episode; with the seed it draws start and noise [default: 0]
    #[arg(long, value_name = "INDEX")]
    pub episode: Option<u64>,
    /// Number of episodes, one after the other [default: 1]
    #[arg(short = 'n', long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub episodes: Option<u64>,
    /// Name of the server; not needed where there is only one
    #[arg(long, value_name = "NAME")]
    pub server: Option<String>,
    /// Step at 50 Hz by the wall clock, whether an action has come or not; without it the server waits
    #[arg(long)]
    pub real_time: bool,
    /// Wait for a recorder: the episode goes no further than it has recorded
    #[arg(long)]
    pub recorded: bool,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub session: SessionArgs,
    #[command(flatten)]
    pub link: LinkArgs,
}

/// Runs the episodes and prints what came of them; false if a replay's digest differs.
pub fn run(args: &RunArgs) -> Result<bool, Failure> {
    let mut plan = plan::plan(args)?;
    let stop = stop_on_signal()?;
    let link = args.link.open(Role::Client)?;
    let mut client = Client::open(&link, args.server.as_deref(), plan.request)?;
    let horizon = client.info().task.as_ref().map_or(0, |task| task.horizon_steps);
    let mut report = Report::new(&plan.policy.name(), client.info(), plan.digest);
    let mut failure = None;
    for index in plan.first..plan.first.saturating_add(plan.count) {
        let line = ProgressLine::default();
        let start = Instant::now();
        let mut progress = |step| {
            line.show(|| {
                let (rate, left) = (line.rate(step), line.left(step, horizon));
                format!("episode {index}: step {step} of {horizon}, {rate:.0} steps/s, at most {left} left")
            });
        };
        let end = client.run_episode(index, plan.policy.as_mut(), &mut progress, &stop);
        line.clear();
        match end {
            Ok(end) => report.add(Episode { index, end, wall_s: start.elapsed().as_secs_f64() }, args.json),
            Err(error) => {
                failure = Some(error);
                break;
            }
        }
    }
    report.finish(client.round_trips(), args.json);
    // The server misses a client that does not say goodbye, so a failure here costs no more than the grace time.
    if let Err(error) = client.close() {
        tracing::debug!("the session was not closed: {error}");
    }
    match failure {
        None => Ok(report.is_equal()),
        Some(ClientError::Stopped) => Err(anyhow::anyhow!("stopped; the session is closed").into()),
        Some(error) => Err(error.into()),
    }
}
