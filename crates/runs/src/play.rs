//! Plays episodes with a server, a recorder and a few clients in this process.

use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc;

use fiatlux_client::{Attempt, Client, RunProgress, WantedEpisode, play_each};
use fiatlux_server::{BagEnd, BagReport, LocalBags, LocalServer, Naming, ServerOptions};

use crate::job::{EvaluateError, EvaluateOptions, Job, SERVER};
use crate::losses::Played;

/// Plays the jobs; returns what became of them.
pub(super) fn play(
    jobs: &[Job],
    bags: &Path,
    server: ServerOptions,
    options: &EvaluateOptions,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&RunProgress),
) -> Result<Played, EvaluateError> {
    let (unwritten, reports) = mpsc::channel();
    // The bags themselves show which of them are whole.
    let on_bag = Box::new(move |report| note_cut(&report, &unwritten));
    let bags = LocalBags { out: bags.into(), naming: Naming::Flat, thin: options.thin, on_bag };
    let server = LocalServer::start(fiatlux_carrier::memory(), server, Some(bags))?;
    let wanted = |job: &Job| WantedEpisode {
        task: job.task.to_string(),
        seed: Some(job.seed),
        horizon_steps: job.task.horizon_steps(),
    };
    let play = |index: usize, attempt: &Attempt| {
        let mut policy = options.policies.make(&options.policy)?;
        let client = Client::open(server.carrier(), Some(SERVER), options.request(jobs[index], policy.as_ref()))?;
        attempt.play(client, policy.as_mut(), stop)
    };
    let ends = play_each(jobs.iter().map(wanted).collect(), options.workers, play, progress, stop);
    server.stop();
    let ended = jobs.iter().zip(ends).filter_map(|(job, end)| Some((*job, end?.err().map(|error| error.to_string()))));
    Ok(Played { ended: ended.collect(), unwritten: reports.try_iter().collect() })
}

fn note_cut(report: &BagReport, unwritten: &mpsc::Sender<(Job, String)>) {
    if let (BagEnd::Cut(reason), Ok(task)) = (&report.end, report.header.task.parse()) {
        // If the evaluation has failed, nobody receives this.
        let _ = unwritten.send((Job { task, seed: report.header.seed }, reason.clone()));
    }
}
