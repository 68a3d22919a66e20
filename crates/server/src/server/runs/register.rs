//! Checks what a client registers, field by field.

use std::collections::BTreeSet;

use data_encoding::HEXLOWER;
use fiatlux_bag::run::{MAX_EPISODES, PlannedEpisode};
use fiatlux_proto::PROTOCOL;
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{OpenRequest, Refusal, RunSpec, SeedRange};
use fiatlux_rules::Task;
use sha2::{Digest, Sha256};

use crate::server::plan::{self, MAX_NAME};

/// Longest link of a policy, bytes.
const MAX_LINK: usize = 512;
/// The subtasks of the benchmark.
const SUBTASKS: usize = 12;
/// Seeds of a run that names none.
const PUBLIC_SEEDS: [u64; 4] = [0, 1, 2, 3];
/// Smallest hosted seed: too large to be found by trying, and far from the published ones.
const MIN_HOSTED: u64 = 1 << 32;
/// Number of bits of a hosted seed, which JSON numbers can hold.
const HOSTED_BITS: u32 = 53;

/// SHA-256 of a run's public key, hexadecimal.
pub(super) fn key_digest(key: &str) -> String {
    HEXLOWER.encode(&Sha256::digest(key))
}

/// Compares in a time that does not reveal where the two differ.
pub(super) fn is_same(one: &str, other: &str) -> bool {
    let differing = one.bytes().zip(other.bytes()).fold(0, |bits, (one, other)| bits | (one ^ other));
    one.len() == other.len() && std::hint::black_box(differing) == 0
}

pub(super) fn check_same(run: &str, registered: &RunSpec, asked: &RunSpec) -> Result<(), Refusal> {
    let fields = [
        ("policy", registered.policy == asked.policy),
        ("policy_version", registered.policy_version == asked.policy_version),
        ("policy_link", registered.policy_link == asked.policy_link),
        ("session", registered.session == asked.session),
        ("tasks", registered.tasks == asked.tasks),
        ("seeds", registered.seeds == asked.seeds),
        ("hosted_seeds", registered.hosted_seeds == asked.hosted_seeds),
    ];
    match fields.iter().find(|(_, is_same)| !is_same) {
        None => Ok(()),
        Some((field, _)) => {
            let message = format!(
                "run '{run}' was registered with another {field}; register the same again, or give the new run another name"
            );
            Err(Refusal::new(Code::Value, &format!("register.{field}"), message))
        }
    }
}

/// The request with which an episode's session is opened.
pub(super) fn request(spec: &RunSpec, task: &str, seed: u64) -> OpenRequest {
    OpenRequest {
        protocol: Some(PROTOCOL),
        policy: spec.policy.clone(),
        task: task.into(),
        seed,
        recorded: true,
        ..spec.session.clone().unwrap_or_default()
    }
}

/// Adds the seeds of ranges to the others.
pub(super) fn with_all_seeds(mut spec: RunSpec) -> Result<RunSpec, Refusal> {
    for SeedRange { first, last } in std::mem::take(&mut spec.seed_ranges) {
        let count = last.checked_sub(first).map(|more| more.saturating_add(1));
        let room = MAX_EPISODES.saturating_sub(spec.seeds.len()) as u64;
        if count.is_none_or(|count| count > room) {
            let message = format!(
                "the range {first}..{last} must not end before it begins, and all seeds are at most {MAX_EPISODES}; name \
                 fewer, or make several runs"
            );
            return Err(Refusal::new(Code::Value, "register.seed_ranges", message));
        }
        spec.seeds.extend(first..=last);
    }
    Ok(spec)
}

/// The episodes of a new run; draws hosted seeds from these numbers, or else from the system's random source.
pub(super) fn episodes(spec: &RunSpec, numbers: Option<impl FnMut() -> u64>) -> Result<Vec<PlannedEpisode>, Refusal> {
    let wrong = |field: &str, message: String| Refusal::new(Code::Value, &format!("register.{field}"), message);
    for (field, text, least, most) in [
        ("policy", &spec.policy, 1, MAX_NAME),
        ("policy_version", &spec.policy_version, 0, MAX_NAME),
        ("policy_link", &spec.policy_link, 0, MAX_LINK),
    ] {
        plan::check_text(&format!("register.{field}"), text, least, most)?;
    }
    let session = spec.session.clone().unwrap_or_default();
    for (field, is_set) in [
        ("session.policy", !session.policy.is_empty()),
        ("session.task", !session.task.is_empty()),
        ("session.seed", session.seed != 0),
        ("session.recorded", session.recorded),
        ("session.hello", session.hello.is_some()),
        ("session.replay", session.replay),
        ("session.take", session.take),
    ] {
        if is_set {
            return Err(wrong(field, "the run sets it; leave it out".into()));
        }
    }
    let named = if spec.tasks.is_empty() { None } else { Some(&spec.tasks) };
    let tasks: Vec<Task> = match named {
        None => Task::ALL.into_iter().take(SUBTASKS).collect(),
        Some(names) => names
            .iter()
            .map(|name| name.parse::<Task>())
            .collect::<Result<_, _>>()
            .map_err(|error| Refusal::new(Code::Unknown, "register.tasks", error.to_string()))?,
    };
    if tasks.iter().map(|task| task.short_id()).collect::<BTreeSet<_>>().len() < tasks.len() {
        return Err(wrong("tasks", "a task is listed twice; name each once".into()));
    }
    if spec.hosted_seeds > 0 && session.source != 0 {
        let message = "hosted seeds are for policies, and a person's actions are never ranked; name seeds";
        return Err(wrong("session.source", message.into()));
    }
    if spec.hosted_seeds > 0 && !spec.seeds.is_empty() {
        return Err(wrong("seeds", "seeds are both named and hosted; leave one of the two out".into()));
    }
    let count = match (spec.hosted_seeds, spec.seeds.len()) {
        (0, 0) => PUBLIC_SEEDS.len(),
        (0, named) => named,
        (hosted, _) => hosted as usize,
    };
    if tasks.len().saturating_mul(count) > MAX_EPISODES {
        let field = if spec.hosted_seeds > 0 { "hosted_seeds" } else { "seeds" };
        let message = format!("{} tasks in {count} seeds are more than {MAX_EPISODES} episodes", tasks.len());
        return Err(wrong(field, message + "; ask for fewer"));
    }
    let mut seeds = match (spec.hosted_seeds, spec.seeds.len()) {
        (0, 0) => PUBLIC_SEEDS.to_vec(),
        (0, _) => spec.seeds.clone(),
        (hosted, _) => draw(hosted as usize, numbers)?,
    };
    // In the order in which they were named.
    let mut seen = BTreeSet::new();
    seeds.retain(|seed| seen.insert(*seed));
    if seeds.len() < count {
        return Err(wrong("seeds", "a seed is listed twice; name each once".into()));
    }
    for task in &tasks {
        plan::check(&request(spec, task.short_id(), seeds[0])).map_err(|refusal| {
            // Task and seed are valid, so the error is in the session.
            Refusal { field: format!("register.session.{}", refusal.field), ..refusal }
        })?;
    }
    let of_seed = |seed: u64| tasks.iter().map(move |task| PlannedEpisode { task: task.short_id().into(), seed });
    Ok(seeds.into_iter().flat_map(of_seed).collect())
}

/// Draws distinct seeds from these numbers, or from the system's random source.
fn draw(count: usize, mut numbers: Option<impl FnMut() -> u64>) -> Result<Vec<u64>, Refusal> {
    let mut seeds = BTreeSet::new();
    let mut drawn = Vec::with_capacity(count);
    while drawn.len() < count {
        let number = numbers.as_mut().map_or_else(getrandom::u64, |numbers| Ok(numbers())).map_err(|error| {
            let message =
                format!("the server's system gives no random numbers ({error}); name seeds, or use another server");
            Refusal::new(Code::Busy, "register.hosted_seeds", message)
        })?;
        let seed = number >> (u64::BITS - HOSTED_BITS);
        if seed >= MIN_HOSTED && seeds.insert(seed) {
            drawn.push(seed);
        }
    }
    Ok(drawn)
}
