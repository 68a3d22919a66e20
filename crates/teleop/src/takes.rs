//! Takes, one after the other: a session for each, recorded into a bag.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use fiatlux_cli::in_full;
use fiatlux_client::{ClientError, Policy as _};
use fiatlux_proto::v3::notice::Code;
use fiatlux_proto::v3::{Mode, Notice, OpenRequest};
use fiatlux_proto::{PROTOCOL, STOPPED, plain};
use fiatlux_robot::Robot;
use fiatlux_rules::{Cause, Task};
use fiatlux_world::{EpisodeSpec, Scene, SceneConfig};

use crate::NAME;
use crate::frame::Order;
use crate::operator::Operator;
use crate::station::{Phase, Room, Station};
use crate::studio::{Bag, OwnServer, ServerElsewhere, Studio, TakeError};
use crate::view::Document;

/// Time between two looks for an order.
const LOOK: Duration = Duration::from_millis(20);
/// Time between two tries to reach a server that is lost.
const RETRY: Duration = Duration::from_secs(1);
/// End of a take whose server was lost.
const LOST: &str = "lost";
/// Shown when a page is opened again.
const ABANDONED: &str = "the take was stopped because no page was open for 10 s: save it or discard it";

/// Seed of the room that is shown first where none is asked for: in S07 one that a straight walk solves, as `first_room.rs` of the
/// tests walks it.
pub const fn first_room(task: Task) -> u64 {
    match task {
        Task::S07 => 23,
        _ => 0,
    }
}

/// The robot to drive, and the folder of takes.
#[derive(Debug, Clone)]
pub struct TakeOptions {
    pub task: Task,
    pub seed: u64,
    /// Name of the robot.
    pub robot: String,
    /// Folder of the bags.
    pub out: PathBuf,
}

/// The outcome of all takes.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Kept {
    /// Bags of the takes that were kept, in order.
    pub bags: Vec<PathBuf>,
    /// Number of takes that were discarded.
    pub discarded: usize,
    /// Bags of those that only the owner of their server can put aside.
    pub left: Vec<PathBuf>,
}

/// The request for the session of a take.
fn request(task: Task, robot: &str, seed: u64, operator: &Operator, mode: Mode) -> OpenRequest {
    OpenRequest {
        protocol: Some(PROTOCOL),
        policy: NAME.into(),
        task: task.to_string(),
        robot: robot.into(),
        seed,
        mode: mode.into(),
        sensors: operator.sensors(),
        end_on: vec![Cause::Success.name().into()],
        recorded: true,
        take: true,
        ..OpenRequest::default()
    }
}

/// The room of a request, for the page.
fn room(task: Task, request: &OpenRequest) -> Result<Room, TakeError> {
    let robot = Arc::new(Robot::by_name(Robot::known(&request.robot)?)?);
    let gains = robot.gains(request.gains.parse().unwrap_or_default());
    let spec = EpisodeSpec::new(task, request.seed, 0);
    let scene = Scene::build(&SceneConfig::default(), robot, spec.scene(gains))?;
    Ok(Room::new(&Document::new(&scene, &spec)))
}

/// Plays takes on a server of this process until `quit` is set. What is being recorded then is kept.
///
/// # Errors
/// [`TakeError`]; the bags of earlier takes stay in the folder.
pub fn play(options: &TakeOptions, station: &Arc<Station>, quit: &Arc<AtomicBool>) -> Result<Kept, TakeError> {
    let mut studio = OwnServer::start(&options.out)?;
    let played = play_in(&mut studio, options.task, &options.robot, options.seed, station, quit);
    studio.close();
    played
}

/// As [`play`], on a server elsewhere, whose recorder keeps the bags. If it is lost, the page says so until it is back.
///
/// # Errors
/// [`TakeError`]: the first session cannot be opened.
pub fn play_elsewhere(
    mut server: ServerElsewhere,
    task: Task,
    robot: &str,
    seed: u64,
    station: &Arc<Station>,
    quit: &Arc<AtomicBool>,
) -> Result<Kept, TakeError> {
    play_in(&mut server, task, robot, seed, station, quit)
}

fn play_in(
    studio: &mut dyn Studio,
    task: Task,
    robot: &str,
    seed: u64,
    station: &Arc<Station>,
    quit: &Arc<AtomicBool>,
) -> Result<Kept, TakeError> {
    let (shown, was_open, is_lost, kept) = (None, false, false, Kept::default());
    let mut takes = Takes { studio, task, robot, seed, station, quit, shown, was_open, is_lost, kept };
    while !quit.load(Ordering::Relaxed) {
        match takes.open()? {
            Some(take) if take.operator.has_started() => takes.answer(take)?,
            Some(take) => takes.leave_room(take)?,
            None => {}
        }
    }
    Ok(takes.kept)
}

/// Takes in one room after the other.
struct Takes<'a> {
    studio: &'a mut dyn Studio,
    task: Task,
    robot: &'a str,
    /// Of the room that is played now.
    seed: u64,
    station: &'a Arc<Station>,
    quit: &'a Arc<AtomicBool>,
    /// Seed of the room that the page shows.
    shown: Option<u64>,
    /// A session was open once.
    was_open: bool,
    /// The page says that the server is lost.
    is_lost: bool,
    kept: Kept,
}

/// A session that is over.
struct Take {
    ended: Result<String, ClientError>,
    /// Its session was closed in order.
    is_closed: bool,
    /// The problem to show; empty where there is none.
    problem: String,
    bag: Option<Bag>,
    operator: Operator,
}

impl Takes<'_> {
    /// Plays a session, the room shown first; `None` where the server is lost.
    fn open(&mut self) -> Result<Option<Take>, TakeError> {
        let stop = Arc::new(AtomicBool::new(false));
        // A server in this process waits for each action, so that a take can pause.
        let comes_back = self.studio.comes_back();
        let mode = if comes_back { Mode::RealTime } else { Mode::Lockstep };
        let mut operator =
            Operator::new(Arc::clone(self.station), Arc::clone(self.quit), Arc::clone(&stop), comes_back);
        let episode = self.studio.next_episode(self.task, self.seed);
        let request = request(self.task, self.robot, self.seed, &operator, mode);
        self.station.status.send_modify(|status| {
            (status.phase, status.episode) = (Phase::Opening, episode.to_string());
        });
        if self.shown != Some(self.seed) {
            self.station.show_room(room(self.task, &request)?);
            self.shown = Some(self.seed);
        }
        let mut client = match self.studio.client(request) {
            Err(error) if self.was_open && comes_back => {
                self.lose(&error);
                return Ok(None);
            }
            Err(error) => return Err(TakeError::Session(Box::new(error))),
            Ok(client) => client,
        };
        self.was_open = true;
        if std::mem::take(&mut self.is_lost) {
            self.station.status.send_modify(|status| status.problem.clear());
        }
        // That a step came late is in the bag, and nothing that an operator can act on.
        let (sender, notices) = mpsc::channel();
        client.send_notices(sender);
        let info = client.info().clone();
        let ended = client.run_episode(episode, &mut operator, &mut |_| (), &stop);
        let closed = client.close();
        let cut = notices.try_iter().filter_map(recording_cut).last();
        let problem = match (&ended, &closed) {
            (Err(error), _) if !matches!(error, ClientError::Stopped) => in_full(error),
            (Err(_), Err(error)) => in_full(error),
            _ if operator.is_abandoned() => ABANDONED.into(),
            _ => cut.unwrap_or_default(),
        };
        let bag = self.studio.bag(&info, episode);
        let (ended, is_closed) = (ended.map(|end| end.cause), closed.is_ok());
        Ok(Some(Take { ended, is_closed, problem, bag, operator }))
    }

    /// Nothing but the room was shown.
    fn leave_room(&mut self, take: Take) -> Result<(), TakeError> {
        if let Some(bag) = &take.bag {
            self.studio.forget(bag);
        }
        match take.ended {
            Err(error) if !matches!(error, ClientError::Stopped) && !self.quit.load(Ordering::Relaxed) => {
                if !self.studio.comes_back() {
                    return Err(TakeError::Session(Box::new(error)));
                }
                self.lose(&error);
            }
            _ => self.seed += u64::from(take.operator.order() == Some(Order::Next)),
        }
        Ok(())
    }

    /// Keeps or discards a take as its operator says.
    fn answer(&mut self, take: Take) -> Result<(), TakeError> {
        let Take { ended, is_closed, problem, bag, operator } = take;
        let cause = match (ended, &bag) {
            (Ok(cause), _) => cause,
            (_, Some(Bag { end: Some(end), .. })) => end.clone(),
            (_, Some(_)) => if is_closed { STOPPED } else { LOST }.into(),
            (_, None) => "not recorded".into(),
        };
        let name = bag.as_ref().and_then(|bag| bag.path.file_name());
        let name = name.map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        // Before the page knows: what its operator orders then is an answer.
        self.station.forget_orders();
        self.station.status.send_modify(|status| {
            (status.phase, status.end, status.bag, status.problem) = (Phase::Ended, cause, name, problem);
        });
        let order = match operator.order() {
            None | Some(Order::Stop | Order::Start) => decision(self.station, self.quit),
            Some(order) => order,
        };
        match (order, bag) {
            (Order::Discard, Some(bag)) => {
                self.kept.discarded += 1;
                if !self.studio.discard(&bag)? {
                    let said = format!("{} stays with its server, whose owner can put it aside", bag.path.display());
                    self.station.status.send_modify(|status| status.problem = said);
                    self.kept.left.push(bag.path);
                }
            }
            (_, Some(bag)) => {
                self.kept.bags.push(bag.path);
                self.station.status.send_modify(|status| {
                    status.kept += 1;
                    status.problem.clear();
                });
            }
            (_, None) => {}
        }
        self.seed += u64::from(order == Order::Next);
        Ok(())
    }

    /// Says on the page that the server is lost, and waits a little.
    fn lose(&mut self, error: &ClientError) {
        self.is_lost = true;
        self.station.status.send_modify(|status| status.problem = in_full(error));
        let start = Instant::now();
        while start.elapsed() < RETRY && !self.quit.load(Ordering::Relaxed) {
            std::thread::sleep(LOOK);
        }
    }
}

/// The text of a notice that a recording lacks rows.
fn recording_cut(notice: Notice) -> Option<String> {
    let is_cut = notice.code() == Code::Lost && notice.field == "recorded";
    is_cut.then(|| format!("the recording is cut: {}", plain(&notice.message)))
}

/// Decides on a take that has ended. It is kept if the program ends first.
fn decision(station: &Station, quit: &AtomicBool) -> Order {
    while !quit.load(Ordering::Relaxed) {
        match station.order() {
            Some(Order::Stop) => {}
            Some(order) => return order,
            None => std::thread::sleep(LOOK),
        }
    }
    Order::Save
}
