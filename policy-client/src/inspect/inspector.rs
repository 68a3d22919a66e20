//! A policy that wraps another and sees all that it receives.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::time::Instant;

use fiatlux_client::{Command, Policy, PolicyError};
use fiatlux_proto::v3::{Notice, Observation, SessionInfo};

use super::screen::{Screen, Terminal};
use super::state::State;
use super::view::{self, Part};

/// Wraps a policy and shows what it receives.
pub struct Inspector<'a> {
    inner: Box<dyn Policy>,
    state: &'a mut State,
    screen: Option<Screen<Terminal>>,
    notices: Receiver<Notice>,
    /// Step at which to stop.
    last: u64,
    stop: Arc<AtomicBool>,
    origin: Instant,
    /// Sensors of the look under way, and the time when it began, s.
    looking: Option<(Vec<&'static str>, f64)>,
}

impl<'a> Inspector<'a> {
    pub fn new(
        inner: Box<dyn Policy>,
        state: &'a mut State,
        screen: Option<Screen<Terminal>>,
        notices: Receiver<Notice>,
        last: u64,
        stop: Arc<AtomicBool>,
    ) -> Self {
        Self { inner, state, screen, notices, last, stop, origin: Instant::now(), looking: None }
    }

    /// Takes in the server's last messages, and clears the view.
    pub fn finish(&mut self) {
        self.read_notices();
        if let Some(screen) = &mut self.screen {
            screen.clear();
        }
    }

    fn now_s(&self) -> f64 {
        self.origin.elapsed().as_secs_f64()
    }

    fn read_notices(&mut self) {
        self.notices.try_iter().for_each(|notice| self.state.noticed(notice));
    }
}

impl Policy for Inspector<'_> {
    fn name(&self) -> String {
        self.inner.name()
    }

    fn look(&mut self, observation: &Observation) -> Vec<&'static str> {
        let now_s = self.now_s();
        self.read_notices();
        let is_new = self.state.observed(observation, now_s);
        let mut sensors = self.inner.look(observation);
        if is_new && observation.step >= self.last {
            let wanted = self.state.wanted(observation, true);
            sensors.extend(wanted.into_iter().filter(|name| !sensors.contains(name)).collect::<Vec<_>>());
        } else if is_new && sensors.is_empty() {
            sensors = self.state.wanted(observation, false);
        }
        let state = &*self.state;
        if let Some(screen) = &mut self.screen {
            screen.show(now_s, |style| view::draw(state, Part::Live, style));
        }
        self.looking = (!sensors.is_empty()).then(|| (sensors.clone(), self.now_s()));
        sensors
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        self.inner.reset(info, first)
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let start_s = self.now_s();
        if let Some((sensors, since_s)) = self.looking.take() {
            self.state.looked(&sensors, observation, start_s - since_s);
        }
        let command = self.inner.act(observation)?;
        let now_s = self.now_s();
        self.state.acted(&command, now_s - start_s, now_s);
        if observation.step >= self.last {
            self.stop.store(true, Ordering::Relaxed);
        }
        Ok(command)
    }
}
