//! Our world as a G1 in a domain of DDS, for a session.

use std::net::IpAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use fiatlux_client::{Command, Policy, PolicyError};
use fiatlux_proto::v3::{Observation, SessionInfo};

use crate::dds::{Bus, DdsError, LOW_CMD, LOW_STATE, Reader, SWITCHER_REQUEST, SWITCHER_RESPONSE, Writer};
use crate::messages::{HandCmds, LowCmd, LowState, Request, Response, ResponseHeader};
use crate::motors::Hands;
use crate::stand_in::{Body, is_sound};
use crate::ticks::{PERIOD, Ticks};

/// With the clock, a step is answered so many periods after its state, which leaves two for the answer's way.
const ANSWER_AFTER: u32 = 8;
/// Commands of a control step of 20 ms, as programs of 500 Hz send them.
const COMMANDS_A_STEP: usize = 10;
/// The last state is sent again until the next one is measured; its time does not go beyond that.
const MAX_LATER_MS: u32 = 19;

const API_CHECK_MODE: i64 = 1001;
const API_RELEASE_MODE: i64 = 1003;
/// The maker's number for a call that a service does not have.
const NOT_IMPLEMENTED: i32 = 3203;

/// When the world goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pace {
    /// With the clock; the newest command holds.
    Clock,
    /// After ten commands a control step, so that a program of 500 Hz meets every state, however slow the machine.
    Commands,
}

/// Shared by the threads.
struct Shared {
    /// The robot, and when it was measured; `None` before the first episode.
    body: Mutex<Option<(Body, Instant)>>,
    commands: Mutex<Commands>,
    stop: AtomicBool,
}

/// All that came in.
#[derive(Default)]
struct Commands {
    body: Option<(LowCmd, Instant)>,
    hands: Option<HandCmds>,
    /// Sound commands of the body so far, and others.
    sound: usize,
    unsound: usize,
}

/// A policy that is whatever drives a G1 in a domain of DDS: it publishes what the robot measures on `rt/lowstate`, takes
/// `rt/lowcmd` and commands of hands, and answers the motion switcher's calls. An episode begins with the first command.
pub struct StandIn {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    pace: Pace,
    /// Commands that the last step had seen.
    seen: usize,
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl StandIn {
    /// Joins a domain; with an address, on that network of this machine alone.
    ///
    /// # Errors
    /// [`DdsError`].
    pub fn join(domain: u16, address: Option<IpAddr>, pace: Pace) -> Result<Self, DdsError> {
        let bus = Bus::open(domain, address)?;
        let ends = Ends {
            states: bus.writer(LOW_STATE)?,
            commands: bus.reader(LOW_CMD)?,
            hands: bus.reader(&Hands::known().topic)?,
            requests: bus.reader(SWITCHER_REQUEST)?,
            responses: bus.writer(SWITCHER_RESPONSE)?,
            _bus: bus,
        };
        let shared = Arc::new(Shared {
            body: Mutex::new(None),
            commands: Mutex::new(Commands::default()),
            stop: AtomicBool::new(false),
        });
        let ours = Arc::clone(&shared);
        let thread = std::thread::spawn(move || ends.serve(&ours));
        Ok(Self { shared, thread: Some(thread), pace, seen: 0 })
    }
}

impl Drop for StandIn {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // It has no panic of its own, and nothing waits for what it would return.
            let _ = thread.join();
        }
    }
}

impl Policy for StandIn {
    fn name(&self) -> String {
        "unitree".into()
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        let mut body = Body::new(info).map_err(PolicyError::of("unitree"))?;
        if !body.sense(first) {
            return Err(lacks());
        }
        *lock(&self.shared.body) = Some((body, Instant::now()));
        *lock(&self.shared.commands) = Commands::default();
        self.seen = 0;
        Ok(())
    }

    fn waits(&mut self, _first: &Observation) -> bool {
        lock(&self.shared.commands).body.is_none()
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        match &mut *lock(&self.shared.body) {
            None => return Err(PolicyError::not_reset("unitree")),
            Some((body, at)) => {
                if !body.sense(observation) {
                    return Err(lacks());
                }
                *at = Instant::now();
            }
        }
        if self.pace == Pace::Clock {
            // The next step begins with what is commanded then, not with the answer to the state before.
            std::thread::sleep(PERIOD * ANSWER_AFTER);
        } else {
            let until = self.seen + COMMANDS_A_STEP;
            // A program that is gone is one whose commands do not come: the session waits no longer than a robot would.
            while {
                let commands = lock(&self.shared.commands);
                let silent = commands.body.as_ref().is_none_or(|(_, at)| at.elapsed() > Duration::from_secs(1));
                commands.sound < until && !silent
            } {
                std::thread::sleep(PERIOD / 4);
            }
        }
        let commands = lock(&self.shared.commands);
        self.seen = commands.sound;
        let silence = commands.body.as_ref().map_or(f64::INFINITY, |(_, at)| at.elapsed().as_secs_f64());
        let mut body = lock(&self.shared.body);
        let Some((body, _)) = &mut *body else { return Err(PolicyError::not_reset("unitree")) };
        let command = commands.body.as_ref().map(|(command, _)| command);
        Ok(Command::JointTarget(body.follow(command, commands.hands.as_ref(), silence).to_vec()))
    }
}

fn lacks() -> PolicyError {
    PolicyError::Sensor { policy: "unitree", sensor: "proprioception" }
}

/// Our ends of the topics.
struct Ends {
    states: Writer<LowState>,
    commands: Reader<LowCmd>,
    hands: Reader<HandCmds>,
    requests: Reader<Request>,
    responses: Writer<Response>,
    // Lives as long as its ends.
    _bus: Bus,
}

impl Ends {
    /// Publishes states and takes commands until it is told to stop.
    fn serve(mut self, shared: &Shared) {
        let mut ticks = Ticks::begin();
        while !shared.stop.load(Ordering::Relaxed) {
            let state = lock(&shared.body).as_ref().map(|(body, at)| {
                let later = u32::try_from(at.elapsed().as_millis()).unwrap_or(u32::MAX);
                body.state(later.min(MAX_LATER_MS))
            });
            if let Some(state) = state {
                self.states.write(&state);
            }
            while let Some(command) = self.commands.take() {
                let mut commands = lock(&shared.commands);
                if is_sound(&command) {
                    commands.sound += 1;
                    commands.body = Some((command, Instant::now()));
                } else {
                    commands.unsound += 1;
                    if commands.unsound.is_power_of_two() {
                        tracing::warn!(
                            "{} commands on rt/lowcmd were left out: a wrong checksum, or a number that is not finite",
                            commands.unsound
                        );
                    }
                }
            }
            while let Some(hands) = self.hands.take() {
                if hands.cmds.iter().all(|cmd| cmd.q.is_finite()) {
                    lock(&shared.commands).hands = Some(hands);
                }
            }
            while let Some(request) = self.requests.take() {
                if !request.header.noreply {
                    self.responses.write(&answer(&request));
                }
            }
            ticks.wait();
        }
    }
}

/// The motion switcher of a robot whose own walking is released already.
fn answer(request: &Request) -> Response {
    let (status, data) = match request.header.identity.api_id {
        API_CHECK_MODE => (0, r#"{"form":"0","name":""}"#.into()),
        API_RELEASE_MODE => (0, String::new()),
        _ => (NOT_IMPLEMENTED, String::new()),
    };
    let header = ResponseHeader { identity: request.header.identity, status };
    Response { header, data, binary: Vec::new() }
}
