//! The policy that a person is: it answers with what the operator asks for at that moment.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use fiatlux_client::{Policy, PolicyError};
use fiatlux_proto::v3::{Observation, Sensor, SessionInfo};
use fiatlux_robot::Robot;
use fiatlux_session::Command;
use fiatlux_wbc::CONTROL_DT;

use crate::NAME;
use crate::frame::Order;
use crate::pilot::Pilot;
use crate::station::{Phase, Station};
use crate::view::{Timing, View};

/// A take that no page has been open for this long pauses; on a server elsewhere, whose clock goes on, it is stopped, and kept.
const MAX_EMPTY: Duration = Duration::from_secs(10);
/// Time between two looks for a page while it pauses.
const LOOK: Duration = Duration::from_millis(20);

/// Plays an episode as its operator asks.
pub(crate) struct Operator {
    station: Arc<Station>,
    pilot: Option<(Pilot, View)>,
    /// The program is to end.
    quit: Arc<AtomicBool>,
    /// Ends the episode.
    stop: Arc<AtomicBool>,
    /// The room is shown, and the clock can be started.
    is_ready: bool,
    has_started: bool,
    order: Option<Order>,
    is_abandoned: bool,
    /// The operator's own clock, where the server waits for each action; `None` where the server has one.
    pace: Option<Pace>,
}

/// Answers in real time.
#[derive(Debug, Default)]
struct Pace {
    /// When the last answer was due.
    due: Option<Instant>,
}

impl Pace {
    /// Waits until the next answer is due. Whoever is a whole step late goes on from there.
    fn keep(&mut self) {
        let (period, now) = (Duration::from_secs_f64(CONTROL_DT), Instant::now());
        let due = self.due.map_or(now, |due| due + period);
        std::thread::sleep(due.saturating_duration_since(now));
        self.due = Some(if now.saturating_duration_since(due) > period { now } else { due });
    }
}

impl Operator {
    /// `has_clock` says that the server steps in real time by itself; otherwise the operator does.
    pub fn new(station: Arc<Station>, quit: Arc<AtomicBool>, stop: Arc<AtomicBool>, has_clock: bool) -> Self {
        let pace = (!has_clock).then(Pace::default);
        Self {
            station,
            pilot: None,
            quit,
            stop,
            is_ready: false,
            has_started: false,
            order: None,
            is_abandoned: false,
            pace,
        }
    }

    /// True if the clock was started.
    pub fn has_started(&self) -> bool {
        self.has_started
    }

    /// True if the take was stopped because no page was open.
    pub fn is_abandoned(&self) -> bool {
        self.is_abandoned
    }

    /// The order that ended the episode.
    pub fn order(&self) -> Option<Order> {
        self.order
    }
}

impl Policy for Operator {
    fn name(&self) -> String {
        NAME.into()
    }

    fn sensors(&self) -> Vec<Sensor> {
        ["proprioception", "hand_contact", "last_action", "privileged", "verdict"].map(Sensor::from).into()
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        let names = info.joints.iter().map(|joint| joint.name.as_str());
        let robot = Robot::of_session(&info.robot, names).map_err(PolicyError::of(NAME))?;
        self.pilot = Some((Pilot::new(info, first)?, View::new(robot, info)));
        Ok(())
    }

    /// The clock starts by an order; until then the room is shown.
    fn waits(&mut self, first: &Observation) -> bool {
        if self.has_started {
            return false;
        }
        if !std::mem::replace(&mut self.is_ready, true) {
            if let Some((pilot, view)) = &mut self.pilot
                && let Some(state) = view.state(first, pilot.driven(), Timing { echo_ms: -1.0, ..Timing::default() })
            {
                self.station.live.send_replace(Arc::new(state));
            }
            self.station.forget_orders();
            self.station.status.send_modify(|status| status.phase = Phase::Ready);
        }
        match self.station.order() {
            Some(Order::Start) => {
                self.has_started = true;
                self.station.status.send_modify(|status| {
                    (status.phase, status.end, status.problem) = (Phase::Running, String::new(), String::new());
                });
            }
            Some(Order::Next) => {
                self.order = Some(Order::Next);
                self.stop.store(true, Ordering::Relaxed);
            }
            _ if self.quit.load(Ordering::Relaxed) => self.stop.store(true, Ordering::Relaxed),
            _ => {}
        }
        !self.has_started
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let began = Instant::now();
        let Some((pilot, view)) = &mut self.pilot else { return Err(PolicyError::not_reset(NAME)) };
        while let Some(order) = self.station.order() {
            if order != Order::Start {
                self.order = self.order.or(Some(order));
                self.stop.store(true, Ordering::Relaxed);
            }
        }
        match &mut self.pace {
            None => self.is_abandoned |= self.station.empty_for() > MAX_EMPTY,
            Some(pace) => {
                while self.station.empty_for() > MAX_EMPTY && !self.quit.load(Ordering::Relaxed) {
                    pace.due = None;
                    std::thread::sleep(LOOK);
                }
            }
        }
        if self.is_abandoned || self.quit.load(Ordering::Relaxed) {
            self.stop.store(true, Ordering::Relaxed);
        }
        let fresh = self.station.fresh();
        let command = pilot.step(fresh.as_ref().map(|fresh| &fresh.frame), observation)?;
        let timing = Timing {
            echo_ms: fresh.as_ref().map_or(-1.0, |fresh| fresh.echo_ms),
            age_ms: fresh.as_ref().map_or(0.0, |fresh| fresh.age.as_secs_f32() * 1e3),
            answer_ms: began.elapsed().as_secs_f32() * 1e3,
        };
        if let Some(state) = view.state(observation, pilot.driven(), timing) {
            self.station.live.send_replace(Arc::new(state));
        }
        if let Some(pace) = &mut self.pace {
            pace.keep();
        }
        Ok(command)
    }
}
