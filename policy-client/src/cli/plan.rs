//! What `run` is asked for, with the bag's word where a bag is replayed.

use fiatlux_policy::Policy;
use fiatlux_policy::policies::{self, Replay};
use fiatlux_proto::v3::{Mode, OpenRequest};

use super::run::RunArgs;
use super::{Failure, policy};

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
    match policies::replayed_bag(&args.policy) {
        Some(path) => replay(args, Replay::open(path)?),
        None => {
            let policy = policy(&args.policy)?;
            let task = args.task.clone().ok_or_else(|| Failure::Usage("name a task: --task S01 to S12".into()))?;
            let sensors = policy.sensors();
            let request = request(args, OpenRequest { policy: policy.name(), task, sensors, ..OpenRequest::default() });
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
    let digest = policy.result().and_then(|result| result.end.as_ref()).map(|end| end.digest.clone());
    let digest = digest.filter(|digest| !digest.is_empty());
    if digest.is_none() {
        tracing::warn!("the bag has no digest, for it was cut or aborted; nothing is compared at the end");
    }
    let request = request(args, policy.request());
    let first = args.episode.unwrap_or(policy.header().episode);
    Ok(Plan { policy: Box::new(policy), request, first, count: 1, digest })
}

/// The flags go before what is there.
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
