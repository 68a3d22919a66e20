//! Finds the episodes of an evaluation that are already in its folder.

use std::path::Path;

use fiatlux_bag::{Bag, BagError, Completeness, part_of};
use fiatlux_client::Policy;
use fiatlux_proto::ABORTED;
use fiatlux_proto::v3::{EpisodeHeader, OpenRequest};
use fiatlux_render::RobotMeshes;
use fiatlux_robot::Robot;

use crate::job::{EvaluateError, EvaluateOptions, Job, folder, grade, job_bags};

/// Jobs without a bag that can be scored. Bags that are cut, damaged, aborted, or of another version or model are
/// removed, so that their episodes are played again. Two builds of one version count as the same.
///
/// # Errors
/// A bag belongs to another policy, session or protocol version, or was made with other meshes, and is not overwritten;
/// or meshes cannot be used.
pub(super) fn not_done(
    jobs: &[Job],
    bags: &Path,
    options: &EvaluateOptions,
    policy: &dyn Policy,
) -> Result<Vec<Job>, EvaluateError> {
    let robots = Robot::NAMES.map(Robot::by_name).into_iter().collect::<Result<Vec<_>, _>>()?;
    let label = |robot: &Robot| {
        let meshes = options.meshes.as_ref().map(|folder| RobotMeshes::open(folder, robot)).transpose()?;
        Ok(meshes.map(|meshes| meshes.label().to_owned()).unwrap_or_default())
    };
    let labels = robots.iter().map(label).collect::<Result<Vec<_>, EvaluateError>>()?;
    let scene = options.scene.digest();
    let remove = |path: &Path| std::fs::remove_file(path).map_err(|error| folder(path, error));
    let mut kept = Vec::new();
    for &job in jobs {
        let path = bags.join(job.bag_name());
        let part = part_of(&path);
        if part.exists() {
            remove(&part)?;
        }
        match Bag::open(&path) {
            Ok(bag) => {
                let wanted = options.request(job, policy);
                let name = Robot::known(&wanted.robot)?;
                let mut known = robots.iter().zip(&labels);
                let (model, meshes) = known
                    .find(|(robot, _)| robot.name() == name)
                    .map_or(("", ""), |(robot, label)| (robot.digest(), label.as_str()));
                check_same(bag.header(), &path, &wanted, meshes)?;
                if is_current(&bag, model, &scene) { kept.push(job) } else { remove(&path)? }
            }
            Err(error @ BagError::Version { .. }) => {
                return Err(folder(&path, format!("{error}; name another folder with --out")));
            }
            Err(_) if path.exists() => remove(&path)?,
            Err(_) => {}
        }
    }
    if !kept.is_empty() {
        // The rows show whether a bag was changed.
        let excluded = grade(&job_bags(&kept, bags), options.workers, &options.out)?.excluded;
        let is_excluded = |job: &Job| excluded.iter().any(|bag| bag.bag.ends_with(&job.bag_name()));
        for job in kept.extract_if(.., |job| is_excluded(job)) {
            remove(&bags.join(job.bag_name()))?;
        }
    }
    Ok(jobs.iter().filter(|job| !kept.contains(job)).copied().collect())
}

/// Refuses a bag whose session is not the requested one.
fn check_same(header: &EpisodeHeader, path: &Path, wanted: &OpenRequest, meshes: &str) -> Result<(), EvaluateError> {
    let Some(found) = &header.request else {
        return Err(folder(path, "its header has no request; name another folder with --out"));
    };
    if found == wanted && header.meshes == meshes {
        return Ok(());
    }
    let what = if found == wanted {
        "an episode with other meshes of the robot".into()
    } else if found.policy == wanted.policy {
        "an episode of another session: other sensors, gains, thresholds or the like".into()
    } else {
        format!("an episode with policy '{}', not '{}'", found.policy, wanted.policy)
    };
    Err(folder(path, format!("it holds {what}; name another folder with --out")))
}

/// True if a bag is whole, was played to its end, and comes from the world that this build simulates.
fn is_current(bag: &Bag, model: &str, scene: &str) -> bool {
    let header = bag.header();
    // A scorer refuses a bag whose result does not name its header.
    let bound = bag.result().filter(|result| !result.header_digest.is_empty());
    let ended = bound.and_then(|result| result.end.as_ref()).is_some_and(|end| end.cause != ABORTED);
    let same_world = header.model_digest == model && header.scene_digest == scene;
    ended && same_world && header.version == env!("CARGO_PKG_VERSION") && *bag.completeness() == Completeness::Whole
}
