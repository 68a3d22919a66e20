//! Plays episodes with a server, a recorder and a few clients in this process.

use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc;
use std::time::Duration;

use fiatlux_access::RecorderKey;
use fiatlux_client::{Attempt, Client, RunProgress, WantedEpisode, play_each};
use fiatlux_server::{
    BagEnd, BagReport, Naming, Recorder, RecorderOptions, RecordsFrom, RecordsTo, Server, ServerOptions,
};

use crate::job::{EvaluateError, EvaluateOptions, Job, SERVER};
use crate::losses::Played;

/// Longest time for bags to close after the last episode.
const CLOSING_TIME: Duration = Duration::from_secs(15);

/// Plays the jobs; returns what became of them.
pub(super) fn play(
    jobs: &[Job],
    bags: &Path,
    server: ServerOptions,
    options: &EvaluateOptions,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&RunProgress),
) -> Result<Played, EvaluateError> {
    let link = fiatlux_carrier::memory();
    let key = RecorderKey::generate()?;
    let (unwritten, reports) = mpsc::channel();
    let recorder = Recorder::start(
        link.clone(),
        RecorderOptions {
            out: bags.into(),
            server: Some(SERVER.into()),
            naming: Naming::Flat,
            records: RecordsFrom::ThisProcess(key.clone()),
            // The bags themselves show which of them are whole.
            on_bag: Box::new(move |report| note_cut(&report, &unwritten)),
            // An episode without a bag is reported at the end.
            on_loss: Box::new(|_, _| ()),
            name: SERVER.into(),
        },
    )?;
    let server = ServerOptions { records_to: RecordsTo::ThisProcess(key), ..server };
    let server = Server::start(link.clone(), server)?;
    let wanted = |job: &Job| WantedEpisode {
        task: job.task.to_string(),
        seed: Some(job.seed),
        horizon_steps: job.task.horizon_steps(),
    };
    let play = |index: usize, attempt: &Attempt| {
        let mut policy = options.policies.make(&options.policy)?;
        let client = Client::open(&link, Some(SERVER), options.request(jobs[index], policy.as_ref()))?;
        attempt.play(client, policy.as_mut(), stop)
    };
    let ends = play_each(jobs.iter().map(wanted).collect(), options.workers, play, progress, stop);
    server.shutdown(CLOSING_TIME);
    recorder.stop();
    let ended = jobs.iter().zip(ends).filter_map(|(job, end)| Some((*job, end?.err().map(|error| error.to_string()))));
    Ok(Played { ended: ended.collect(), unwritten: reports.try_iter().collect() })
}

fn note_cut(report: &BagReport, unwritten: &mpsc::Sender<(Job, String)>) {
    if let (BagEnd::Cut(reason), Ok(task)) = (&report.end, report.header.task.parse()) {
        // If the evaluation has failed, nobody receives this.
        let _ = unwritten.send((Job { task, seed: report.header.seed }, reason.clone()));
    }
}
