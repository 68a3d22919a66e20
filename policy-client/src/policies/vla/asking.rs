//! Questions to a model server: patient with one that is gone for a while, and in a thread of their own in real time.

use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::time::{Duration, Instant};

use fiatlux_bridge::{BridgeError, Model, ModelChunk, ModelObservation};
use fiatlux_wbc::CONTROL_DT;

/// Between two tries to reach a server that is gone.
const PAUSE: Duration = Duration::from_millis(250);

/// An answer, and how long it took from the question on, new connections included.
pub(super) struct Answered {
    pub chunk: ModelChunk,
    pub latency: Duration,
}

/// What a thread says.
struct Said {
    answered: Result<Answered, BridgeError>,
    problem: Option<String>,
}

/// Asks one server, for one episode.
pub(super) struct Asker {
    /// Where no thread has it.
    patient: Option<Patient>,
    thread: Option<(Sender<ModelObservation>, Receiver<Said>)>,
    /// Step and angles of the question that is out.
    out: Option<(u64, Vec<f64>)>,
    /// The last latency.
    usual: Duration,
    problem: Option<String>,
}

/// A model server, tried again.
struct Patient {
    model: Box<dyn Model>,
    patience: Duration,
}

impl Patient {
    /// Calls until it goes well, the patience is over, or the error is one that no new connection mends. Says what went wrong.
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
                        tracing::warn!("{error}; it is tried again for {:.0} s", self.patience.as_secs_f64());
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

    /// An episode begins.
    ///
    /// # Errors
    /// [`BridgeError`].
    pub fn reset(&mut self) -> Result<(), BridgeError> {
        let Some(patient) = &mut self.patient else { return Ok(()) };
        patient.call(|model| model.reset()).0
    }

    /// Asks and waits.
    ///
    /// # Errors
    /// [`BridgeError`].
    pub fn ask(&mut self, observation: &ModelObservation) -> Result<Answered, BridgeError> {
        let Some(patient) = &mut self.patient else { return Err(gone()) };
        let Said { answered, problem } = patient.infer(observation);
        self.problem = problem;
        answered
    }

    /// Asks in a thread; [`Asker::answer`] has what came of it. One question is out at a time.
    pub fn ask_meanwhile(&mut self, observation: ModelObservation, step: u64, q: Vec<f64>) {
        if let Some(mut patient) = self.patient.take() {
            let (questions, asked) = channel::<ModelObservation>();
            let (say, said) = channel();
            // It ends when the policy is dropped and its last question is answered or timed out.
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

    /// Step and angles of the question, and its answer, once it is there.
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

    /// Whether a question is out.
    pub fn is_asking(&self) -> bool {
        self.out.is_some()
    }

    /// Control steps that the last answer took: a question has to go out so much earlier.
    pub fn usual_steps(&self) -> u64 {
        (self.usual.as_secs_f64() / CONTROL_DT).ceil() as u64
    }

    /// What went wrong on the way to the last answer, once.
    pub fn problem(&mut self) -> Option<String> {
        self.problem.take()
    }
}

fn gone() -> BridgeError {
    BridgeError::Lost { question: "infer".into(), problem: "its thread has ended".into() }
}
