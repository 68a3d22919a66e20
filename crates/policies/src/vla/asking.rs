//! Asks a model server; retries one that is gone for a while, and uses a thread in real time.

use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::time::{Duration, Instant};

use fiatlux_bridge::{BridgeError, Model, ModelChunk, ModelObservation};
use fiatlux_wbc::CONTROL_DT;

/// Pause between two attempts to reach a server that is gone.
const PAUSE: Duration = Duration::from_millis(250);

/// An answer, and the time since the question, including any new connections.
pub(super) struct Answered {
    pub chunk: ModelChunk,
    pub latency: Duration,
}

/// A message from the thread.
struct Said {
    answered: Result<Answered, BridgeError>,
    problem: Option<String>,
}

/// Asks one server during one episode.
pub(super) struct Asker {
    /// The server; `None` while a thread uses it.
    patient: Option<Patient>,
    thread: Option<(Sender<ModelObservation>, Receiver<Said>)>,
    /// Step and joint angles of the pending question.
    out: Option<(u64, Vec<f64>)>,
    /// Latency of the last answer, zero before the first one.
    usual: Duration,
    problem: Option<String>,
}

/// A model server that is retried after errors.
struct Patient {
    model: Box<dyn Model>,
    patience: Duration,
}

impl Patient {
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
                said => return (said, problem),
            }
        }
    }

    fn infer(&mut self, observation: &ModelObservation) -> Said {
        let start = Instant::now();
        let (said, problem) = self.call(|model| model.infer(observation));
        Said { answered: said.map(|chunk| Answered { chunk, latency: start.elapsed() }), problem }
    }
}

impl Asker {
    pub fn new(model: Box<dyn Model>, patience: Duration) -> Self {
        let patient = Some(Patient { model, patience });
        Self { patient, thread: None, out: None, usual: Duration::ZERO, problem: None }
    }

    /// Tells the server that an episode begins.
    ///
    /// # Errors
    /// [`BridgeError`].
    pub fn reset(&mut self) -> Result<(), BridgeError> {
        let Some(patient) = &mut self.patient else { return Ok(()) };
        patient.call(|model| model.reset()).0
    }

    /// Asks and waits for the answer.
    ///
    /// # Errors
    /// [`BridgeError`].
    pub fn ask(&mut self, observation: &ModelObservation) -> Result<Answered, BridgeError> {
        let Some(patient) = &mut self.patient else { return Err(gone()) };
        let Said { answered, problem } = patient.infer(observation);
        self.problem = problem;
        answered
    }

    /// Asks in a thread; [`Asker::answer`] returns the answer. Only one question is pending at a time.
    pub fn ask_meanwhile(&mut self, observation: ModelObservation, step: u64, q: Vec<f64>) {
        if let Some(mut patient) = self.patient.take() {
            let (questions, asked) = channel::<ModelObservation>();
            let (say, said) = channel();
            // The thread ends when the policy is dropped and its last question is answered or timed out.
            std::thread::spawn(move || {
                while let Ok(observation) = asked.recv() {
                    if say.send(patient.infer(&observation)).is_err() {
                        break;
                    }
                }
            });
            self.thread = Some((questions, said));
        }
        if let Some((questions, _)) = &self.thread
            && questions.send(observation).is_ok()
        {
            self.out = Some((step, q));
        }
    }

    /// Step, joint angles and answer of the pending question, once it has arrived.
    pub fn answer(&mut self) -> Option<(u64, Vec<f64>, Result<Answered, BridgeError>)> {
        let (_, said) = self.thread.as_ref()?;
        let Said { answered, problem } = match said.try_recv() {
            Ok(said) => said,
            Err(TryRecvError::Empty) => return None,
            Err(TryRecvError::Disconnected) => Said { answered: Err(gone()), problem: None },
        };
        self.problem = problem;
        if let Ok(answered) = &answered {
            self.usual = answered.latency;
        }
        let (step, q) = self.out.take()?;
        Some((step, q, answered))
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
