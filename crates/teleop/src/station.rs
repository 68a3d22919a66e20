//! Shared by pages and the robot's side: the newest input, orders, and what pages are shown.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use serde_json::Value;
use tokio::sync::watch;

use crate::frame::{Frame, Order};
use crate::inputs::Inputs;
use crate::view::Document;

/// Oldest input that still moves the robot.
pub const MAX_AGE: Duration = Duration::from_millis(200);
/// Most orders that wait.
const MAX_ORDERS: usize = 8;

/// State of a take, as pages get it.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Status {
    /// Counts the rooms that were shown: a page loads the document again when it changes.
    pub room: u64,
    pub phase: Phase,
    /// Index of the episode in its room.
    pub episode: String,
    /// End of the last take, such as `success` or `stopped`; empty while one runs.
    pub end: String,
    /// File of the last take.
    pub bag: String,
    /// Takes that were kept since the start.
    pub kept: u32,
    /// Problem; empty where there is none.
    pub problem: String,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// The room is being built.
    #[default]
    Opening,
    /// The robot is staged; the clock starts with the take.
    Ready,
    Running,
    /// The take has ended, and is kept unless it is discarded.
    Ended,
}

/// A room as pages load it.
#[derive(Debug, Clone, Default)]
pub(crate) struct Room {
    pub document: Vec<u8>,
    pub meshes: Vec<u8>,
}

impl Room {
    pub fn new(document: &Document) -> Self {
        Self { document: serde_json::to_vec(document).unwrap_or_default(), meshes: document.stage.bytes.clone() }
    }
}

/// The input in force.
#[derive(Debug, Clone)]
pub(crate) struct Fresh {
    pub frame: Frame,
    /// The page's own time of it, ms.
    pub echo_ms: f64,
    pub age: Duration,
}

#[derive(Default)]
struct Inner {
    /// The connection that drives; 0 for none.
    driver: u64,
    connections: u64,
    /// Pages that are open, and since when there is none.
    pages: usize,
    empty_since: Option<Instant>,
    inputs: Inputs,
    newest: Option<(Frame, f64, Instant)>,
    orders: VecDeque<Order>,
    room: Arc<Room>,
}

/// Shared by the server of the page and the robot's side.
#[derive(Default)]
pub struct Station {
    inner: Mutex<Inner>,
    pub(crate) live: watch::Sender<Arc<Vec<u8>>>,
    pub(crate) status: watch::Sender<Status>,
    pub(crate) driver: watch::Sender<u64>,
}

/// A message of a page.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Message {
    /// Name of the input of `data`.
    #[serde(default)]
    input: Option<String>,
    #[serde(default)]
    data: Value,
    /// The page's own time of the input, ms.
    #[serde(default)]
    at: f64,
    #[serde(default)]
    order: Option<Order>,
    /// The page wants to drive.
    #[serde(default)]
    drive: bool,
}

impl Station {
    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes in a page, which drives from now on.
    pub fn enter(&self) -> u64 {
        let mut inner = self.lock();
        inner.connections += 1;
        inner.pages += 1;
        inner.empty_since = None;
        let id = inner.connections;
        self.hand_over(&mut inner, id);
        id
    }

    /// A page is gone: if it drove, the robot stands.
    pub(crate) fn leave(&self, id: u64) {
        let mut inner = self.lock();
        inner.pages = inner.pages.saturating_sub(1);
        if inner.pages == 0 {
            inner.empty_since = Some(Instant::now());
        }
        if inner.driver == id {
            self.hand_over(&mut inner, 0);
        }
    }

    /// Time since the last page was closed; zero while one is open, or none was yet.
    pub(crate) fn empty_for(&self) -> Duration {
        self.lock().empty_since.map_or(Duration::ZERO, |since| since.elapsed())
    }

    fn hand_over(&self, inner: &mut Inner, id: u64) {
        inner.driver = id;
        inner.newest = None;
        // Keys held and sticks pulled before are those of another page.
        inner.inputs = Inputs::default();
        self.driver.send_replace(id);
    }

    /// Takes a message of a page.
    ///
    /// # Errors
    /// Its fault, in words for its user.
    pub fn take(&self, id: u64, text: &str) -> Result<(), String> {
        let message: Message = serde_json::from_str(text)
            .map_err(|error| format!("a message of the page cannot be read: {error}; reload the page"))?;
        let mut inner = self.lock();
        if message.drive {
            self.hand_over(&mut inner, id);
        }
        if inner.driver != id {
            return Ok(());
        }
        let mut orders: Vec<Order> = message.order.into_iter().collect();
        if let Some(name) = &message.input {
            if !message.at.is_finite() {
                return Err("the time of an input is not finite; reload the page".into());
            }
            let reading = inner.inputs.read(name, &message.data).map_err(|error| {
                inner.newest = None;
                fiatlux_cli::in_full(&error)
            })?;
            inner.newest = reading.frame.map(|frame| (frame, message.at, Instant::now()));
            orders.extend(reading.orders);
        }
        for order in orders {
            if inner.orders.len() < MAX_ORDERS {
                inner.orders.push_back(order);
            }
        }
        Ok(())
    }

    /// The input in force; `None` where it is missing or too old.
    pub(crate) fn fresh(&self) -> Option<Fresh> {
        let inner = self.lock();
        let (frame, echo_ms, at) = inner.newest.as_ref()?;
        let age = at.elapsed();
        (age <= MAX_AGE).then(|| Fresh { frame: frame.clone(), echo_ms: *echo_ms, age })
    }

    /// The next order of the operator.
    pub(crate) fn order(&self) -> Option<Order> {
        self.lock().orders.pop_front()
    }

    /// Forgets orders that were given before.
    pub(crate) fn forget_orders(&self) {
        self.lock().orders.clear();
    }

    pub(crate) fn room(&self) -> Arc<Room> {
        Arc::clone(&self.lock().room)
    }

    /// Shows another room.
    pub(crate) fn show_room(&self, room: Room) {
        self.lock().room = Arc::new(room);
        self.status.send_modify(|status| status.room += 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn walk(station: &Station, id: u64) {
        let text = r#"{"input":"keyboard","at":5.0,"data":{"keys":["KeyW"],"focused":true,"running":true}}"#;
        station.take(id, text).expect("a message");
    }

    #[test]
    fn the_newest_page_drives_and_a_robot_without_one_stands() {
        let station = Station::default();
        let first = station.enter();
        walk(&station, first);
        assert_eq!(station.fresh().map(|fresh| fresh.frame.walk), Some([1.0, 0.0, 0.0]));
        let second = station.enter();
        assert!(station.fresh().is_none(), "the second page has sent nothing");
        walk(&station, first);
        assert!(station.fresh().is_none(), "the first page does not drive");
        walk(&station, second);
        assert!(station.fresh().is_some());
        station.leave(first);
        assert!(station.fresh().is_some());
        station.leave(second);
        assert!(station.fresh().is_none());
    }

    #[test]
    fn it_is_empty_once_the_last_page_is_closed() {
        let station = Station::default();
        assert_eq!(station.empty_for(), Duration::ZERO, "nobody came yet");
        let [first, second] = [station.enter(), station.enter()];
        station.leave(first);
        assert_eq!(station.empty_for(), Duration::ZERO);
        station.leave(second);
        std::thread::sleep(Duration::from_millis(2));
        assert!(station.empty_for() > Duration::ZERO);
        station.enter();
        assert_eq!(station.empty_for(), Duration::ZERO);
    }

    #[test]
    fn an_input_that_gets_old_is_gone() {
        let station = Station::default();
        let id = station.enter();
        walk(&station, id);
        std::thread::sleep(MAX_AGE + Duration::from_millis(20));
        assert!(station.fresh().is_none());
    }

    #[test]
    fn a_message_that_cannot_be_read_stops_the_robot_and_is_told() {
        let station = Station::default();
        let id = station.enter();
        walk(&station, id);
        let nan = r#"{"input":"gamepad","at":1,"data":{"axes":[NaN],"buttons":[],"connected":true,"running":true}}"#;
        assert!(station.take(id, nan).is_err_and(|problem| problem.contains("reload the page")));
        assert!(station.take(id, r#"{"input":"mouse","data":{}}"#).is_err_and(|problem| problem.contains("keyboard")));
        assert!(station.fresh().is_none());
    }
}
