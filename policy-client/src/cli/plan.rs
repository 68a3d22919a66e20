//! What `run` is asked for, with the bag's word where a bag is replayed.

use std::path::Path;

use fiatlux_policy::policies::{self, Replay};
use fiatlux_policy::{Policy, PolicyError};
use fiatlux_proto::v1::{EpisodeHeader, Mode, OpenRequest};

use super::Failure;
use super::run::RunArgs;

/// What is to be run.
pub struct Plan {
    pub policy: Box<dyn Policy>,
    pub request: OpenRequest,
    /// Index of the first episode.
    pub first: u64,
    pub count: u64,
    /// Digest of the recorded episode, where one is replayed and its bag is whole.
    pub digest: Option<String>,
}

/// Reads the options.
pub fn plan(args: &RunArgs) -> Result<Plan, Failure> {
    match args.policy.strip_prefix("replay:").filter(|path| !path.is_empty()) {
        Some(path) => replay(args, Replay::open(Path::new(path))?),
        None => {
            let policy = policies::by_name(&args.policy).map_err(|error| match error {
                PolicyError::Unknown { .. } => Failure::Usage(error.to_string()),
                other => other.into(),
            })?;
            let task = args.task.clone().ok_or_else(|| Failure::Usage("name a task: --task S01 to S12".into()))?;
            let request = request(args, policy.as_ref(), &EpisodeHeader { task, ..EpisodeHeader::default() });
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
        return Err(Failure::Usage("a bag holds one episode: leave --episodes out".into()));
    }
    let mut header = policy.header().clone();
    if !header.end_on_overridden {
        header.end_on.clear();
    }
    let digest = policy.result().and_then(|result| result.end.as_ref()).map(|end| end.digest.clone());
    let digest = digest.filter(|digest| !digest.is_empty());
    if digest.is_none() {
        tracing::warn!("the bag has no digest, for it was cut or aborted; nothing is compared at the end");
    }
    let request = request(args, &policy, &header);
    let first = args.episode.unwrap_or(header.episode);
    Ok(Plan { policy: Box::new(policy), request, first, count: 1, digest })
}

/// The flags go before the header.
fn request(args: &RunArgs, policy: &dyn Policy, header: &EpisodeHeader) -> OpenRequest {
    let mut thresholds = header.thresholds.clone();
    thresholds.extend(args.set.iter().cloned());
    // An action that held in real time is recorded like any other: in lockstep the same rows come of it.
    let mode = if args.real_time { Mode::RealTime } else { Mode::Lockstep };
    OpenRequest {
        protocol: None,
        policy: policy.name(),
        task: args.task.clone().unwrap_or_else(|| header.task.clone()),
        seed: args.seed.unwrap_or(header.seed),
        mode: mode.into(),
        sensors: header.sensors.clone(),
        gains: args.gains.clone().unwrap_or_else(|| header.gains.clone()),
        hands: header.hands.clone(),
        no_noise: args.no_noise || header.no_noise,
        recorded: args.recorded,
        end_on: if args.end_on.is_empty() { header.end_on.clone() } else { args.end_on.clone() },
        thresholds,
    }
}
