//! Plays part of an episode and prints what its policy received: every term that the session describes, sizes, times.

mod listing;
mod statistics;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::Instant;

use fiatlux_carrier::Carrier;
use fiatlux_cli::{print, report, stop_on_signal};
use fiatlux_client::{Access, Client, ClientError, Command, Policy, PolicyError};
use fiatlux_proto::v3::{Observation, OpenRequest, Sensor, SessionInfo};
use statistics::SessionStatistics;
use thiserror::Error;

/// Sensors by default, with their rates, Hz: 0 for every step, `None` for on request, since a network computes them.
const SENSORS: [(&str, Option<f64>); 10] = [
    ("proprioception", Some(0.0)),
    ("hand_contact", Some(0.0)),
    ("limb_contact", Some(0.0)),
    ("last_action", Some(0.0)),
    ("lidar", Some(10.0)),
    ("camera", Some(10.0)),
    ("features", None),
    ("flat", None),
    ("privileged", Some(0.0)),
    ("verdict", Some(0.0)),
];

/// A session to inspect, and the form to print.
pub struct Inspection {
    pub policy: Box<dyn Policy>,
    pub request: OpenRequest,
    pub episode: u64,
    pub server: Option<String>,
    pub access: Access,
    /// Longest simulated time to play, s.
    pub seconds: f64,
    pub format: Format,
}

pub enum Format {
    Text {
        /// List the joints.
        joints: bool,
    },
    Json {
        /// Include all numbers of the newest observation.
        values: bool,
    },
}

#[derive(Debug, Error)]
pub enum InspectError {
    #[error(transparent)]
    Client(#[from] ClientError),
    #[error("stopped before the first observation; the session is closed")]
    Stopped,
    #[error("cannot listen for signals")]
    Signals(#[source] std::io::Error),
    #[error(transparent)]
    Print(#[from] std::io::Error),
}

pub fn default_sensors() -> impl Iterator<Item = Sensor> {
    SENSORS.iter().map(|(name, rate)| Sensor {
        rate_hz: rate.unwrap_or_default(),
        on_request: rate.is_none(),
        ..Sensor::from(*name)
    })
}

/// Runs the episode and prints what was seen.
pub fn inspect(inspection: Inspection, link: &Carrier) -> Result<(), InspectError> {
    let Inspection { policy, request, episode, server, access, seconds, format } = inspection;
    let stop = stop_on_signal().map_err(InspectError::Signals)?;
    let mut client = Client::open_with(link, server.as_deref(), request, &access)?;
    let (sender, notices) = mpsc::channel();
    client.send_notices(sender);
    let info = client.info().clone();
    let last = (seconds / info.control_dt.max(1e-6)).round().max(1.0) as u64;
    let mut inspector = Inspector {
        seen: SessionStatistics::new(info, policy.name(), episode),
        inner: policy,
        last,
        looked_last: false,
        looking: None,
        stop: Arc::clone(&stop),
    };
    let run = client.run_episode(episode, &mut inspector, &mut |_| {}, &stop);
    let mut seen = inspector.seen;
    seen.steps = client.round_trips().clone();
    seen.notices.extend(notices.try_iter());
    // The server notices clients that vanish, so a failure here costs no more than the grace time.
    if let Err(error) = client.close() {
        tracing::debug!("the session was not closed: {error}");
    }
    let is_seen = seen.count > 0;
    let failure = match run {
        Ok(end) => {
            seen.end = Some(end);
            None
        }
        Err(ClientError::Stopped) if is_seen => None,
        Err(ClientError::Stopped) => return Err(InspectError::Stopped),
        Err(error) if is_seen => Some(error),
        Err(error) => return Err(error.into()),
    };
    print(match format {
        Format::Text { joints } => listing::text(&seen, joints),
        Format::Json { values } => format!("{:#}\n", listing::document(&seen, values)),
    })?;
    let has_fallen = seen.end.as_ref().is_some_and(|end| end.causes.iter().any(|cause| cause == "fall"));
    if has_fallen && seen.policy != "stand" {
        report("the robot fell; with --policy stand it stays upright, and --end-on time-out continues after a fall");
    }
    failure.map_or(Ok(()), |error| Err(error.into()))
}

/// A policy that wraps another, and sees all that it receives.
struct Inspector {
    inner: Box<dyn Policy>,
    seen: SessionStatistics,
    /// Step at which to stop.
    last: u64,
    looked_last: bool,
    /// The look under way, and when it began.
    looking: Option<(Vec<&'static str>, Instant)>,
    stop: Arc<AtomicBool>,
}

impl Policy for Inspector {
    fn name(&self) -> String {
        self.inner.name()
    }

    fn look(&mut self, observation: &Observation) -> Vec<&'static str> {
        let mut sensors = self.inner.look(observation);
        if observation.step >= self.last && !self.looked_last {
            self.looked_last = true;
            let absent = self.seen.absent(observation);
            sensors.extend(absent.into_iter().filter(|name| !sensors.contains(name)).collect::<Vec<_>>());
        } else if sensors.is_empty() {
            sensors.extend(self.seen.turn(observation));
        }
        self.looking = (!sensors.is_empty()).then(|| (sensors.clone(), Instant::now()));
        sensors
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        self.inner.reset(info, first)
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let look = self.looking.take().map(|(sensors, since)| (sensors, since.elapsed().as_secs_f64()));
        self.seen.observe(observation, look);
        let start = Instant::now();
        let command = self.inner.act(observation)?;
        self.seen.act(&command, start.elapsed().as_secs_f64());
        if observation.step >= self.last {
            self.stop.store(true, Ordering::Relaxed);
        }
        Ok(command)
    }
}
