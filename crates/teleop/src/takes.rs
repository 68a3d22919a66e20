//! Takes, one after the other: a session for each, recorded into a folder of bags.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver};
use std::time::Duration;

use fiatlux_access::RecorderKey;
use fiatlux_carrier::Carrier;
use fiatlux_cli::in_full;
use fiatlux_client::{Client, ClientError, Policy as _};
use fiatlux_proto::PROTOCOL;
use fiatlux_proto::v3::{Mode, OpenRequest};
use fiatlux_robot::Robot;
use fiatlux_rules::{Cause, Task};
use fiatlux_server::{
    BagEnd, BagReport, Naming, Recorder, RecorderOptions, RecordsFrom, RecordsTo, Server, ServerOptions,
};
use fiatlux_world::{EpisodeSpec, Scene, SceneConfig};
use thiserror::Error;

use crate::NAME;
use crate::frame::Order;
use crate::operator::Operator;
use crate::station::{Phase, Room, Station};
use crate::view::Document;

/// Name of the server in this process.
const SERVER: &str = "teleop";
/// Longest time for a bag to close.
const CLOSING_TIME: Duration = Duration::from_secs(15);
/// Operators take their time before they start.
const PATIENCE: Duration = Duration::from_secs(24 * 3600);
/// Time between two looks for an order.
const LOOK: Duration = Duration::from_millis(20);
/// Suffix of the name of a bag that was put aside, so that nobody grades it.
const ASIDE: &str = "discarded";

/// The robot to drive, and the folder of takes.
#[derive(Debug, Clone)]
pub struct TakeOptions {
    pub task: Task,
    pub seed: u64,
    /// Folder of the bags.
    pub out: PathBuf,
}

/// Why no takes can be made.
#[derive(Debug, Error)]
pub enum TakeError {
    #[error("cannot use the folder {}: {source}; name another one with --out", path.display())]
    Folder { path: PathBuf, source: std::io::Error },
    #[error("cannot draw a key for the recorder")]
    Key(#[from] fiatlux_access::AccessError),
    #[error("cannot start the server")]
    Server(#[from] fiatlux_server::ServerError),
    #[error("cannot start the recorder")]
    Recorder(#[from] fiatlux_server::RecorderError),
    #[error("cannot load the robot")]
    Robot(#[from] fiatlux_robot::RobotError),
    #[error("cannot show the room")]
    Scene(#[from] fiatlux_world::SceneError),
    #[error("cannot open a session")]
    Session(#[source] Box<ClientError>),
}

/// The outcome of all takes.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Kept {
    /// Bags of the takes that were kept, in order.
    pub bags: Vec<PathBuf>,
    /// Bags that were put aside.
    pub discarded: usize,
}

/// Server and recorder of takes, and the folder.
struct Studio {
    link: Carrier,
    server: Server,
    recorder: Recorder,
    reports: Receiver<BagReport>,
}

impl Studio {
    fn open(out: &Path) -> Result<Self, TakeError> {
        std::fs::create_dir_all(out).map_err(|source| TakeError::Folder { path: out.into(), source })?;
        let link = fiatlux_carrier::memory();
        let key = RecorderKey::generate()?;
        let (sender, reports) = mpsc::channel();
        let sender = std::sync::Mutex::new(sender);
        let recorder = Recorder::start(
            link.clone(),
            RecorderOptions {
                out: out.into(),
                server: Some(SERVER.into()),
                naming: Naming::Flat,
                records: RecordsFrom::ThisProcess(key.clone()),
                on_bag: Box::new(move |report| {
                    if let Ok(sender) = sender.lock() {
                        // Nobody waits for it if the program ends.
                        drop(sender.send(report));
                    }
                }),
                on_loss: Box::new(|_, _| ()),
                name: SERVER.into(),
            },
        )?;
        let options = ServerOptions {
            name: SERVER.into(),
            workers: 1,
            action_timeout: PATIENCE,
            records_to: RecordsTo::ThisProcess(key),
            ..ServerOptions::default()
        };
        let server = Server::start(link.clone(), options)?;
        Ok(Self { link, server, recorder, reports })
    }

    fn close(self) {
        self.server.shutdown(CLOSING_TIME);
        self.recorder.stop();
    }
}

/// Index of the next episode of a task in a room: a take is an episode of its own.
fn next_episode(out: &Path, task: Task, seed: u64) -> u64 {
    let start = format!("{task}-s{seed}-e");
    let index = |name: &str| name.strip_prefix(&start)?.split('.').next()?.parse::<u64>().ok();
    let files = std::fs::read_dir(out).into_iter().flatten().flatten();
    let taken = files.filter_map(|file| index(&file.file_name().to_string_lossy()));
    taken.max().map_or(0, |last| last.saturating_add(1))
}

/// The request for the session of a take.
fn request(options: &TakeOptions, seed: u64, operator: &Operator) -> OpenRequest {
    OpenRequest {
        protocol: Some(PROTOCOL),
        policy: NAME.into(),
        task: options.task.to_string(),
        seed,
        mode: Mode::RealTime.into(),
        sensors: operator.sensors(),
        end_on: vec![Cause::Success.name().into()],
        recorded: true,
        take: true,
        ..OpenRequest::default()
    }
}

/// The room of a request, for the page.
fn room(options: &TakeOptions, request: &OpenRequest) -> Result<Room, TakeError> {
    let robot = Arc::new(Robot::by_name(Robot::known(&request.robot)?)?);
    let gains = robot.gains(request.gains.parse().unwrap_or_default());
    let spec = EpisodeSpec::new(options.task, request.seed, 0);
    let scene = Scene::build(&SceneConfig::default(), robot, spec.scene(gains))?;
    Ok(Room::new(&Document::new(&scene, &spec)))
}

/// Plays takes until `quit` is set. What is being recorded then is kept.
///
/// # Errors
/// [`TakeError`]; the bags of earlier takes stay in the folder.
pub fn play(options: &TakeOptions, station: &Arc<Station>, quit: &Arc<AtomicBool>) -> Result<Kept, TakeError> {
    let studio = Studio::open(&options.out)?;
    let played = play_in(&studio, options, station, quit);
    studio.close();
    played
}

fn play_in(
    studio: &Studio,
    options: &TakeOptions,
    station: &Arc<Station>,
    quit: &Arc<AtomicBool>,
) -> Result<Kept, TakeError> {
    let mut kept = Kept::default();
    let (mut seed, mut shown) = (options.seed, None);
    while !quit.load(Ordering::Relaxed) {
        let stop = Arc::new(AtomicBool::new(false));
        let mut operator = Operator::new(Arc::clone(station), Arc::clone(quit), Arc::clone(&stop));
        let episode = next_episode(&options.out, options.task, seed);
        let request = request(options, seed, &operator);
        station.status.send_modify(|status| {
            (status.phase, status.episode) = (Phase::Opening, episode.to_string());
        });
        if shown != Some(seed) {
            station.show_room(room(options, &request)?);
            shown = Some(seed);
        }
        let failed = |error| TakeError::Session(Box::new(error));
        let mut client = Client::open(&studio.link, Some(SERVER), request).map_err(failed)?;
        // That a step came late is in the bag, and nothing that an operator can act on.
        let (notices, _unread) = mpsc::channel();
        client.send_notices(notices);
        let ended = client.run_episode(episode, &mut operator, &mut |_| (), &stop);
        let closed = client.close();
        let problem = match (&ended, &closed) {
            (Err(ClientError::Stopped), Ok(())) | (Ok(_), _) => String::new(),
            (Err(error), _) if !matches!(error, ClientError::Stopped) => in_full(error),
            (_, Err(error)) => in_full(error),
            _ => String::new(),
        };
        let report = await_bag(&studio.reports);
        if !operator.has_started() {
            // Nothing but the room was shown. What cannot be removed is a take of no steps.
            if let Some(report) = &report {
                let _ = std::fs::remove_file(&report.path);
            }
            if !problem.is_empty() && !quit.load(Ordering::Relaxed) {
                return Err(failed(ended.err().unwrap_or(ClientError::Stopped)));
            }
            seed += u64::from(operator.order() == Some(Order::Next));
            continue;
        }
        let cause = match (&report, &ended) {
            (_, Ok(end)) => end.cause.clone(),
            (Some(BagReport { end: BagEnd::Whole(result), .. }), _) => {
                result.end.as_ref().map_or_else(String::new, |end| end.cause.clone())
            }
            (Some(BagReport { end: BagEnd::Cut(reason), .. }), _) => reason.clone(),
            (None, _) => "not recorded".into(),
        };
        let name = report.as_ref().and_then(|report| report.path.file_name());
        let bag = name.map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        station.status.send_modify(|status| {
            (status.phase, status.end, status.bag, status.problem) = (Phase::Ended, cause, bag, problem);
        });
        let order = match operator.order() {
            None | Some(Order::Stop | Order::Start) => decision(station, quit),
            Some(order) => order,
        };
        match (order, report) {
            (Order::Discard, Some(report)) => {
                kept.discarded += 1;
                let aside = report.path.with_extension(format!("mcap.{ASIDE}"));
                std::fs::rename(&report.path, &aside).map_err(|source| TakeError::Folder { path: aside, source })?;
            }
            (_, Some(report)) => {
                kept.bags.push(report.path);
                station.status.send_modify(|status| status.kept += 1);
            }
            (_, None) => {}
        }
        seed += u64::from(order == Order::Next);
    }
    Ok(kept)
}

/// Decides on a take that has ended. It is kept if the program ends first.
fn decision(station: &Station, quit: &AtomicBool) -> Order {
    station.forget_orders();
    while !quit.load(Ordering::Relaxed) {
        match station.order() {
            Some(Order::Stop) => {}
            Some(order) => return order,
            None => std::thread::sleep(LOOK),
        }
    }
    Order::Save
}

/// The report on the last bag.
fn await_bag(reports: &Receiver<BagReport>) -> Option<BagReport> {
    reports.recv_timeout(CLOSING_TIME).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn takes_of_a_room_are_numbered_those_put_aside_too() {
        let out = std::env::temp_dir().join(format!("fiatlux-teleop-names-{}", std::process::id()));
        std::fs::create_dir_all(&out).expect("a folder");
        assert_eq!(next_episode(&out, Task::S07, 1), 0);
        for name in ["S07-s1-e0.mcap", "S07-s1-e4.mcap.discarded", "S07-s10-e7.mcap", "S08-s1-e9.mcap", "notes.txt"] {
            std::fs::write(out.join(name), "").expect("a file");
        }
        assert_eq!(next_episode(&out, Task::S07, 1), 5);
        std::fs::remove_dir_all(out).expect("removed");
    }
}
