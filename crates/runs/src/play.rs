//! Plays episodes with a server, a recorder and a few clients in this process.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc};
use std::time::{Duration, Instant};

use fiatlux_access::RecorderKey;
use fiatlux_carrier::Carrier;
use fiatlux_client::{Client, ClientError};
use fiatlux_server::{
    BagEnd, BagReport, Naming, Recorder, RecorderOptions, RecordsFrom, RecordsTo, Server, ServerOptions,
};

use crate::job::{EvaluateError, EvaluateOptions, Job, SERVER};
use crate::losses::Played;
use crate::progress::Progress;

/// How often progress is reported.
const REPORT_PERIOD: Duration = Duration::from_millis(250);
/// Longest time for bags to close after the last episode.
const CLOSING_TIME: Duration = Duration::from_secs(15);

/// Plays the jobs; returns what became of them.
pub(super) fn play(
    jobs: &[Job],
    bags: &Path,
    server: ServerOptions,
    options: &EvaluateOptions,
    stop: &Arc<AtomicBool>,
    progress: &mut dyn FnMut(&Progress),
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
    let board = Board::new(jobs, options.workers);
    std::thread::scope(|scope| {
        let client = |seat| {
            let (board, link) = (&board, &link);
            scope.spawn(move || {
                while let Some(job) = board.next(seat).filter(|_| !stop.load(Ordering::Relaxed)) {
                    let played = play_one(link, job, options, &mut |step| board.note_step(seat, step), stop);
                    board.finish(seat, played.err());
                }
            })
        };
        let clients: Vec<_> = (0..options.workers).map(client).collect();
        let mut last_report = Instant::now();
        while clients.iter().any(|client| !client.is_finished()) {
            std::thread::sleep(Duration::from_millis(10));
            if last_report.elapsed() >= REPORT_PERIOD {
                last_report = Instant::now();
                progress(&board.look());
            }
        }
    });
    server.shutdown(CLOSING_TIME);
    recorder.stop();
    progress(&board.look());
    let (over, failed) = board.over();
    Ok(Played { over, failed, unwritten: reports.try_iter().collect() })
}

/// Notes why a bag is not whole.
fn note_cut(report: &BagReport, unwritten: &mpsc::Sender<(Job, String)>) {
    if let (BagEnd::Cut(reason), Ok(task)) = (&report.end, report.header.task.parse()) {
        // If the evaluation has failed, nobody receives this.
        let _ = unwritten.send((Job { task, seed: report.header.seed }, reason.clone()));
    }
}

/// Plays one episode in a session of its own.
fn play_one(
    link: &Carrier,
    job: Job,
    options: &EvaluateOptions,
    on_step: &mut dyn FnMut(u64),
    stop: &AtomicBool,
) -> Result<(), ClientError> {
    let mut policy = options.policies.make(&options.policy)?;
    let mut client = Client::open(link, Some(SERVER), options.request(job, policy.as_ref()))?;
    client.run_episode(0, policy.as_mut(), on_step, stop)?;
    // The episode is over, and a session that is not closed ends by itself.
    if let Err(error) = client.close() {
        tracing::debug!("{} seed {}: the session was not closed: {error}", job.task, job.seed);
    }
    Ok(())
}

/// Assigns jobs to clients, each of which has a seat.
struct Board<'a> {
    jobs: &'a [Job],
    state: Mutex<BoardState>,
}

#[derive(Default)]
struct BoardState {
    next: usize,
    finished: usize,
    /// Steps of finished episodes.
    steps: u64,
    /// Job and step of the client in each seat.
    seats: Vec<Option<(Job, u64)>>,
    failed: Vec<(Job, String)>,
    over: Vec<Job>,
}

impl<'a> Board<'a> {
    fn new(jobs: &'a [Job], seats: usize) -> Self {
        let state = BoardState { seats: vec![None; seats], ..BoardState::default() };
        Self { jobs, state: Mutex::new(state) }
    }

    fn state(&self) -> MutexGuard<'_, BoardState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn next(&self, seat: usize) -> Option<Job> {
        let mut state = self.state();
        let job = self.jobs.get(state.next).copied()?;
        state.next += 1;
        state.seats[seat] = Some((job, 0));
        Some(job)
    }

    fn note_step(&self, seat: usize, step: u64) {
        if let Some((_, at)) = &mut self.state().seats[seat] {
            *at = step;
        }
    }

    fn finish(&self, seat: usize, error: Option<ClientError>) {
        let mut state = self.state();
        let Some((job, step)) = state.seats[seat].take() else { return };
        state.finished += 1;
        state.steps += step;
        if !matches!(error, Some(ClientError::Stopped)) {
            state.over.push(job);
        }
        if let Some(error) = error.filter(|error| !matches!(error, ClientError::Stopped)) {
            state.failed.push((job, error.to_string()));
        }
    }

    fn look(&self) -> Progress {
        let state = self.state();
        let playing: Vec<_> = state.seats.iter().flatten().map(|&(job, step)| (job.task, job.seed, step)).collect();
        let under_way = playing.iter().map(|(task, _, step)| task.horizon_steps().saturating_sub(*step));
        let waiting = self.jobs[state.next..].iter().map(|job| job.task.horizon_steps());
        Progress {
            episodes: self.jobs.len(),
            finished: state.finished,
            steps: state.steps + playing.iter().map(|(_, _, step)| step).sum::<u64>(),
            steps_left: under_way.chain(waiting).sum(),
            playing,
        }
    }

    /// Episodes that have ended, and the reasons of clients that failed.
    fn over(&self) -> (Vec<Job>, Vec<(Job, String)>) {
        let state = self.state();
        (state.over.clone(), state.failed.clone())
    }
}
