//! Asks a model server; retries one that is gone for a while, and uses a thread in real time.

use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::time::{Duration, Instant};

use fiatlux_bridge::{BridgeError, Model, ModelChunk, ModelObservation};
use fiatlux_wbc::CONTROL_DT;

/// Pause between two attempts to reach a server that is gone.
const PAUSE: Duration = Duration::from_millis(250);

/// An answer, and the time since the question, including any new connections.
pub(super) struct TimedChunk {
    pub chunk: ModelChunk,
    pub latency: Duration,
}

/// The outcome of a question.
struct Reply {
    answer: Result<TimedChunk, BridgeError>,
    problem: Option<String>,
}

/// Asks one server during one episode.
pub(super) struct ModelClient {
    /// The server; `None` while a thread uses it.
    server: Option<RetryingModel>,
    thread: Option<(Sender<ModelObservation>, Receiver<Reply>)>,
    /// Step and joint angles of the pending question.
    out: Option<(u64, Vec<f64>)>,
    /// Latency of the last answer, zero before the first one.
    usual: Duration,
    problem: Option<String>,
}

/// A model server that is retried after errors.
struct RetryingModel {
    model: Box<dyn Model>,
    patience: Duration,
}

impl RetryingModel {
    /// Repeats a call until it succeeds, the patience is over, or a new connection cannot help. Logs what went wrong.
    fn call<T>(
        &mut self,
        mut call: impl FnMut(&mut dyn Model) -> Result<T, BridgeError>,
    ) -> (Result<T, BridgeError>, Option<String>) {
        let start = Instant::now();
        let mut problem = None;
        loop {
            match call(self.model.as_mut()) {
                Err(error) if error.is_transient() && start.elapsed() < self.patience => {
                    if problem.is_none() {
                        tracing::warn!("{error}; retrying for {:.0} s", self.patience.as_secs_f64());
                    }
                    problem = Some(error.to_string());
                    std::thread::sleep(PAUSE);
                }
                result => return (result, problem),
            }
        }
    }

    fn infer(&mut self, observation: &ModelObservation) -> Reply {
        let start = Instant::now();
        let (result, problem) = self.call(|model| model.infer(observation));
        Reply { answer: result.map(|chunk| TimedChunk { chunk, latency: start.elapsed() }), problem }
    }
}

impl ModelClient {
    pub fn new(model: Box<dyn Model>, patience: Duration) -> Self {
        let server = Some(RetryingModel { model, patience });
        Self { server, thread: None, out: None, usual: Duration::ZERO, problem: None }
    }

    /// Tells the server that an episode begins.
    pub fn reset(&mut self) -> Result<(), BridgeError> {
        let Some(server) = &mut self.server else { return Ok(()) };
        server.call(|model| model.reset()).0
    }

    /// Asks and waits for the answer.
    pub fn ask(&mut self, observation: &ModelObservation) -> Result<TimedChunk, BridgeError> {
        let Some(server) = &mut self.server else { return Err(gone()) };
        let Reply { answer, problem } = server.infer(observation);
        self.problem = problem;
        answer
    }

    /// Asks in a thread; [`ModelClient::answer`] returns the answer. Only one question is pending at a time.
    pub fn ask_meanwhile(&mut self, observation: ModelObservation, step: u64, q: Vec<f64>) {
        if let Some(mut server) = self.server.take() {
            let (questions, asked) = channel::<ModelObservation>();
            let (sender, replies) = channel();
            // The thread ends when the policy is dropped and its last question is answered or timed out.
            std::thread::spawn(move || {
                while let Ok(observation) = asked.recv() {
                    if sender.send(server.infer(&observation)).is_err() {
                        break;
                    }
                }
            });
            self.thread = Some((questions, replies));
        }
        if let Some((questions, _)) = &self.thread
            && questions.send(observation).is_ok()
        {
            self.out = Some((step, q));
        }
    }

    /// Step, joint angles and answer of the pending question, once it has arrived.
    pub fn answer(&mut self) -> Option<(u64, Vec<f64>, Result<TimedChunk, BridgeError>)> {
        let (_, replies) = self.thread.as_ref()?;
        let Reply { answer, problem } = match replies.try_recv() {
            Ok(reply) => reply,
            Err(TryRecvError::Empty) => return None,
            Err(TryRecvError::Disconnected) => Reply { answer: Err(gone()), problem: None },
        };
        self.problem = problem;
        if let Ok(chunk) = &answer {
            self.usual = chunk.latency;
        }
        let (step, q) = self.out.take()?;
        Some((step, q, answer))
    }

    /// True if a question is pending.
    pub fn is_asking(&self) -> bool {
        self.out.is_some()
    }

    /// Latency of the last answer in control steps: the next question must go out that much earlier.
    pub fn usual_steps(&self) -> u64 {
        (self.usual.as_secs_f64() / CONTROL_DT).ceil() as u64
    }

    /// The fault before the last answer; each is returned once.
    pub fn problem(&mut self) -> Option<String> {
        self.problem.take()
    }
}

fn gone() -> BridgeError {
    BridgeError::Lost { question: "infer".into(), problem: "its thread has ended".into() }
}
