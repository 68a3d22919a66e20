//! Verifies episodes by simulating them again on a sim-server.

use std::io::Read as _;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use fiatlux_bag::Bag;
use fiatlux_cli::in_full;
use fiatlux_client::{Access, ClientError, describe_servers, live_servers};
use fiatlux_grading::Difference;
use fiatlux_link::{CarrierArgs, Link, Role};
use fiatlux_rules::{BENCHMARK_VERSION, pins};
use fiatlux_verify::{Verification, VerifyError, verify};
use sha2::{Digest as _, Sha256};

use super::{Verifier, VerifierGroup, VerifyOutcome};
use crate::store::{Digest, Verdict};

/// A sim-server that simulates episodes again to verify them.
#[derive(Debug)]
pub struct ServerVerifier {
    name: String,
    /// Endpoints and settings of its Zenoh link.
    link: CarrierArgs,
    /// `None` if it is the only one on that link.
    server: Option<String>,
    access: Arc<Access>,
}

impl ServerVerifier {
    /// On the server of this name; `None` if it is the only one on the link.
    pub fn new(link: CarrierArgs, server: Option<String>, access: &Arc<Access>) -> Self {
        let place = link.connect.join(", ");
        let name = server.as_ref().map_or(place.clone(), |server| format!("{server} at {place}"));
        Self { name, link, server, access: Arc::clone(access) }
    }

    /// The version of the server that this link reaches.
    fn version_on(&self, link: &Link) -> Option<String> {
        let servers = describe_servers(&link.carrier()).unwrap_or_default();
        let wanted = self.server.as_deref();
        let info = servers.into_iter().find(|info| wanted.is_none_or(|wanted| info.server == wanted));
        info.map(|info| info.version)
    }
}

/// The sim-servers on a link whose names begin alike.
#[derive(Debug)]
pub struct ServerGroup {
    link: CarrierArgs,
    start: String,
    access: Arc<Access>,
}

impl ServerGroup {
    /// Of names that begin so.
    pub fn new(link: CarrierArgs, start: String, access: &Arc<Access>) -> Self {
        Self { link, start, access: Arc::clone(access) }
    }
}

impl VerifierGroup for ServerGroup {
    fn present(&self) -> Option<Vec<Arc<dyn Verifier>>> {
        let found = live_servers(&self.link.open(Role::Client).ok()?.carrier()).ok()?;
        let members = found.into_iter().filter(|name| name.starts_with(&self.start));
        let verifier =
            |name| -> Arc<dyn Verifier> { Arc::new(ServerVerifier::new(self.link.clone(), Some(name), &self.access)) };
        Some(members.map(verifier).collect())
    }
}

impl Verifier for ServerVerifier {
    fn name(&self) -> &str {
        &self.name
    }

    fn version(&self) -> Option<String> {
        self.version_on(&self.link.open(Role::Client).ok()?)
    }

    fn verify(&self, path: &Path, sha256: &str, steps: &mut u64, stop: &AtomicBool) -> VerifyOutcome {
        let mut progress = |step, _| *steps = step;
        // Opened anew for each episode: the server may have been away.
        let link = match self.link.open(Role::Client) {
            Ok(link) => link,
            Err(error) => return VerifyOutcome::Again(in_full(&error)),
        };
        let done = verify(path, &link.carrier(), self.server.as_deref(), &self.access, &mut progress, stop);
        // Servers of another version may play otherwise, or refuse what was played.
        let is_equal = done.as_ref().is_ok_and(Verification::is_equal);
        let is_of_server = |error: &VerifyError| error.is_of_server() || matches!(error, VerifyError::Lost { .. });
        if !is_equal
            && !done.as_ref().is_err_and(is_of_server)
            && let Ok(bag) = Bag::open(path)
            && let Some(outcome) = unfit(&bag.header().version, self.version_on(&link).as_deref())
        {
            return outcome;
        }
        match done {
            Ok(verification) if !verification.is_equal() && has_objects(path) => {
                // Only a server with the same files can tell.
                match &verification.header {
                    Some(Difference { field, .. }) if field.contains("assets") || field == "scene_digest" => {
                        VerifyOutcome::NotTaken(
                            "the server does not have the bag's objects; start one with --asset for each of them"
                                .into(),
                        )
                    }
                    _ => of_verification(&verification),
                }
            }
            Ok(verification) => of_verification(&verification),
            Err(VerifyError::Client(ClientError::Stopped)) => VerifyOutcome::Stopped,
            // The bag could be read when it was graded: check that it is still the same file.
            Err(error @ (VerifyError::Bag { .. } | VerifyError::Reread(_) | VerifyError::Actions(_)))
            | Err(error @ VerifyError::Client(ClientError::Policy(_))) => match digest_of(path) {
                Some(digest) if digest.as_str() == sha256 => {
                    let folder = path.parent().map(|folder| folder.join("").display().to_string()).unwrap_or_default();
                    let reason = in_full(&error).replace(&folder, "").replace(sha256, "the bag");
                    VerifyOutcome::Decided(Verdict::Differs, reason)
                }
                _ => VerifyOutcome::Again(
                    "the bag on disk is not the one that was uploaded; restore it from a backup".into(),
                ),
            },
            Err(error) if is_of_server(&error) => VerifyOutcome::Again(in_full(&error)),
            Err(VerifyError::Client(ClientError::Refused { field, message, .. })) => {
                VerifyOutcome::NotTaken(format!("{field}: {message}"))
            }
            Err(error) => VerifyOutcome::NotTaken(in_full(&error)),
        }
    }
}

/// Without a version that is equal to the bag's, the server's word means nothing.
fn unfit(recorded: &str, server: Option<&str>) -> Option<VerifyOutcome> {
    match server {
        Some(version) if version == recorded => None,
        Some(version) => Some(VerifyOutcome::OtherVersion {
            // No server has the version "none".
            bag: if recorded.is_empty() { "none" } else { recorded }.into(),
            reason: format!(
                "the bag was recorded by version {recorded}, the server is version {version}; start one of the bag's version"
            ),
        }),
        None => Some(VerifyOutcome::Again("the server does not say which version it is".into())),
    }
}

fn of_verification(verification: &Verification) -> VerifyOutcome {
    if verification.is_equal() {
        return VerifyOutcome::Decided(Verdict::Equal, String::new());
    }
    if let Some(Difference { field, recorded, .. }) = &verification.header
        && is_pinned(field, recorded)
    {
        return VerifyOutcome::Again(format!(
            "the server's {field} is not that of the benchmark; start the server without --scene"
        ));
    }
    let said = |place: String, difference: &Difference| {
        let Difference { field, found, recorded } = difference;
        format!("{place}: {field} is {recorded} in the bag, {found} in the second run")
    };
    let header = verification.header.as_ref().map(|difference| said("header".into(), difference));
    let row = verification.row.as_ref().map(|(step, difference)| said(format!("step {step}"), difference));
    let result = verification.result.as_ref().map(|difference| said("result".into(), difference));
    let ended = || match &verification.simulated {
        None => "the second run did not end at the bag's last step".to_owned(),
        Some(end) => format!("the second run ended by {} at step {}", end.cause, end.steps),
    };
    VerifyOutcome::Decided(Verdict::Differs, row.or(header).or(result).unwrap_or_else(ended))
}

fn has_objects(path: &Path) -> bool {
    Bag::open(path).is_ok_and(|bag| !bag.header().assets.is_empty())
}

/// True if a bag's header has the benchmark's own value of a field. If the second run has another one, the server is
/// not set up for the benchmark, and the bag is not at fault.
fn is_pinned(field: &str, recorded: &str) -> bool {
    match field {
        "model_digest" => pins::RANKED_ROBOTS.into_iter().any(|robot| pins::model(robot) == Some(recorded)),
        "scene_digest" => recorded == pins::SCENE,
        "benchmark_version" => recorded == BENCHMARK_VERSION.to_string(),
        _ => false,
    }
}

fn digest_of(path: &Path) -> Option<Digest> {
    let mut file = std::fs::File::open(path).ok()?;
    let (mut sum, mut block) = (Sha256::new(), vec![0; 1 << 20]);
    loop {
        match file.read(&mut block).ok()? {
            0 => return Some(Digest::from(sum)),
            read => sum.update(&block[..read]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Guards that refusals and differences of servers of another set-up cost a good run nothing during an upgrade.
    #[test]
    fn only_servers_of_the_bags_version_decide() {
        assert_eq!(unfit("0.7.0", Some("0.7.0")), None);
        let Some(VerifyOutcome::OtherVersion { bag, reason }) = unfit("0.7.0", Some("0.8.0")) else {
            panic!("it decides")
        };
        assert!(bag == "0.7.0" && reason.contains("start one of the bag's version"), "{reason}");
        assert!(
            matches!(unfit("0.7.0", None), Some(VerifyOutcome::Again(_))),
            "a busy server may answer the next time"
        );
    }
}
