//! Turns the flags into the specification of a run.

use fiatlux_client::{Policy, Replay, check_tasks, request_of};
use fiatlux_policies::VlaSource;
use fiatlux_proto::v3::{OpenRequest, RunSpec};
use fiatlux_rules::Task;

use super::EvaluateArgs;
use crate::cli::{Failure, usage};

/// Seeds of the published protocol.
const PUBLISHED_SEEDS: [u64; 4] = [0, 1, 2, 3];

/// The specification to register: policy, tasks, seeds and session.
pub fn spec(args: &EvaluateArgs, model: Option<&VlaSource>) -> Result<RunSpec, Failure> {
    let mut spec = match fiatlux_policies::replayed_bag(&args.policy) {
        Some(path) => replay(args, &Replay::open(path)?)?,
        None => {
            let policy = args.make(model).map_err(usage)?;
            let usual: &[Task] = if args.guests.is_empty() { &Task::SUBTASKS } else { &[Task::Replace] };
            let tasks = args.tasks.as_ref().map_or(usual, |tasks| &tasks.0);
            check_tasks(policy.as_ref(), tasks).map_err(usage)?;
            // The run names the policy.
            let session = OpenRequest { policy: String::new(), ..request_of(policy.as_ref()) };
            let seeds = args.seeds.as_ref().map_or(&PUBLISHED_SEEDS[..], |seeds| &seeds.seeds);
            RunSpec {
                policy: policy.name(),
                tasks: tasks.iter().map(ToString::to_string).collect(),
                seeds: if args.hosted.is_some() { Vec::new() } else { seeds.to_vec() },
                hosted_seeds: args.hosted.unwrap_or(0),
                session: Some(session),
                ..RunSpec::default()
            }
        }
    };
    args.session.apply(spec.session.get_or_insert_default());
    spec.policy_version.clone_from(&args.policy_version);
    spec.policy_link.clone_from(&args.policy_link);
    Ok(spec)
}

/// A run of the one episode of a bag.
fn replay(args: &EvaluateArgs, policy: &Replay) -> Result<RunSpec, Failure> {
    let refuse = |message: &str| Err(Failure::Usage(message.into()));
    if args.tasks.is_some() || args.seeds.is_some() || args.hosted.is_some() {
        return refuse("a bag holds one episode: omit --tasks, --seeds and --hosted");
    }
    if policy.header().episode != 0 {
        return refuse(
            "the bag holds a later episode of its session, but a run plays only the first: use policy-client run",
        );
    }
    let request = policy.request();
    Ok(RunSpec {
        policy: policy.name(),
        tasks: vec![request.task.clone()],
        seeds: vec![request.seed],
        // The run sets these itself.
        session: Some(OpenRequest {
            protocol: None,
            policy: String::new(),
            task: String::new(),
            seed: 0,
            recorded: false,
            ..request
        }),
        ..RunSpec::default()
    })
}
