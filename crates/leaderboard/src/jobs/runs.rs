//! Follows the journals of the board's own servers: every hosted run that was registered counts as a try.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use fiatlux_bag::run::{Ledger, journals};
use fiatlux_cli::in_full;

use crate::Service;
use crate::claims::HostedRun;

/// Time between two looks into the folders.
const LOOK: Duration = Duration::from_secs(10);

/// Notes new hosted runs, until it is aborted.
pub(super) async fn follow(service: Arc<Service>) {
    if service.options.runs.is_empty() {
        return;
    }
    let mut seen = BTreeSet::new();
    loop {
        let folders = service.options.runs.clone();
        let look = tokio::task::spawn_blocking(move || {
            let runs = new_runs(&folders, &mut seen);
            (runs, seen)
        });
        let Ok((runs, looked)) = look.await else { return };
        seen = looked;
        if !runs.is_empty()
            && let Err(error) = service.store.know_runs(&runs).await
        {
            tracing::error!(error = in_full(&error), "cannot note the runs of a server; they are read again");
            seen.clear();
        }
        tokio::time::sleep(LOOK).await;
    }
}

/// The hosted runs in these folders whose journals were not seen before. A registration never changes.
fn new_runs(folders: &[PathBuf], seen: &mut BTreeSet<PathBuf>) -> Vec<HostedRun> {
    let mut runs = Vec::new();
    for folder in folders {
        let entries = match std::fs::read_dir(folder) {
            Ok(entries) => entries,
            Err(error) => {
                tracing::warn!(folder = %folder.display(), %error, "cannot look for the runs of a server");
                continue;
            }
        };
        let found = entries.flatten().filter(|entry| entry.path().is_dir());
        for path in found.flat_map(|entry| journals(&entry.path()).unwrap_or_default()) {
            if seen.contains(&path) {
                continue;
            }
            match Ledger::read(&path) {
                Ok(ledger) => {
                    if ledger.is_hosted() {
                        runs.push(hosted_run(&ledger));
                    }
                    seen.insert(path);
                }
                // It may be in the middle of a line; the next look reads it again.
                Err(error) => {
                    tracing::debug!(journal = %path.display(), error = in_full(&error), "cannot read a journal");
                }
            }
        }
    }
    runs
}

fn hosted_run(ledger: &Ledger) -> HostedRun {
    let registration = ledger.registration();
    let mut episodes = BTreeMap::new();
    registration.episodes.iter().for_each(|episode| *episodes.entry(episode.task.clone()).or_default() += 1);
    HostedRun {
        server: registration.server.clone(),
        run: registration.run.clone(),
        holder: registration.holder.clone(),
        policy: registration.spec.policy.clone(),
        version: registration.spec.policy_version.clone(),
        registered_ms: i64::try_from(registration.unix_ms).unwrap_or(i64::MAX),
        episodes,
    }
}
