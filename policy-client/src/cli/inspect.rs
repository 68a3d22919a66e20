//! `policy-client inspect`.

mod canvas;
mod document;
mod files;
mod inspector;
mod pictures;
mod scan;
mod screen;
mod state;
mod table;
mod terms;
#[cfg(test)]
mod tests;
mod text;
mod view;

use std::io::IsTerminal;
use std::path::PathBuf;
use std::sync::mpsc;
use std::time::Instant;

use clap::Args;
use fiatlux_link::{LinkArgs, Role, print, stop_on_signal};
use fiatlux_policy::policies::{self, Replay};
use fiatlux_policy::{Client, ClientError, Policy, SessionArgs};
use fiatlux_proto::v3::{Mode, OpenRequest, Sensor};

use super::{Failure, policy};
use inspector::Inspector;
use screen::Screen;
use state::State;
use view::{Part, Style};

/// What a session has unless --sensors says otherwise. Features and flat take a network's time: they are looked at.
const SENSORS: [(&str, f64); 8] = [
    ("proprioception", 0.0),
    ("hand_contact", 0.0),
    ("limb_contact", 0.0),
    ("last_action", 0.0),
    ("lidar", 10.0),
    ("camera", 10.0),
    ("privileged", 0.0),
    ("verdict", 0.0),
];
const LOOKED_AT: [&str; 2] = ["features", "flat"];

/// Width of a text that goes to no terminal.
const WIDTH: usize = 100;

/// Options of `inspect`.
#[derive(Debug, Args)]
#[command(
    after_help = "A policy drives the robot while you watch. On a terminal the view is drawn live; at the end, which is
--seconds, the episode's end or Ctrl-C, it is printed once more in full, and DIR has
  camera.png        the last image, twice its size
  lidar.png         the last scan: ranges around the robot, near ones bright, and their hits from above
  observation.json  the last observation, all numbers

Without --sensors the session has the body's sensors, privileged and verdict in every step, lidar and camera at 10 Hz,
and features and flat on request: lidar, camera, features and flat are each looked at alone three times, once in real
time, so that you see what one costs. A bag's or a ranked run's policy has no privileged and no verdict.

Examples:
  policy-client inspect --task S05
  policy-client inspect --task S02 --policy stand --seconds 60 --real-time
  policy-client inspect --task climb --sensors proprioception,last_action,lidar@25,camera@look --image 512x512
  policy-client inspect --task S11 --json --out s11 --force | jq '.sensors[] | {name, rate_hz, bytes}'"
)]
pub struct InspectArgs {
    /// Task: S01 to S12, replace, climb
    #[arg(short, long)]
    task: String,
    /// Policy that drives: zero, random, hold, stand, or replay:BAG, whose seed, episode and session are those of its bag
    #[arg(short, long, value_name = "NAME", default_value = "stand")]
    policy: String,
    /// Simulated time, s
    #[arg(long, value_name = "SECONDS", default_value_t = 10.0, value_parser = seconds)]
    seconds: f64,
    /// Folder for the pictures and the observation [default: inspect-TASK]
    #[arg(short, long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Write into a folder that has something in it; files of the same names are replaced
    #[arg(long)]
    force: bool,
    /// List the joints: angles of the standing posture, limits, gains
    #[arg(long)]
    joints: bool,
    /// Seed of the layout
    #[arg(short, long, default_value_t = 0)]
    seed: u64,
    /// Index of the episode; with the seed it draws start and noise
    #[arg(long, value_name = "INDEX", default_value_t = 0)]
    episode: u64,
    /// Name of the server; not needed where there is only one
    #[arg(long, value_name = "NAME")]
    server: Option<String>,
    /// Step at 50 Hz by the wall clock; without it the server waits for each action
    #[arg(long)]
    real_time: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    session: SessionArgs,
    #[command(flatten)]
    link: LinkArgs,
}

/// Shows a session; false is never the answer.
pub fn inspect(args: &InspectArgs) -> Result<bool, Failure> {
    let (policy, base, episode) = driver(args)?;
    let folder = args.out.clone().unwrap_or_else(|| format!("inspect-{}", args.task).into());
    files::check(&folder, args.force)?;
    let request = request(args, policy.as_ref(), base);
    let stop = stop_on_signal()?;
    let link = args.link.open(Role::Client)?;
    let mut client = Client::open(&link, args.server.as_deref(), request)?;
    let (sender, notices) = mpsc::channel();
    client.send_notices(sender);
    let mut state = State::new(client.info().clone(), policy.name(), episode);
    let color = std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
    let last = (args.seconds / state.info.control_dt.max(1e-6)).round() as u64;
    let mut inspector = Inspector {
        inner: policy,
        state: &mut state,
        screen: (!args.json).then(|| terminal(color)).flatten(),
        notices,
        last: last.max(1),
        stop: stop.clone(),
        origin: Instant::now(),
        looking: None,
    };
    let run = client.run_episode(episode, &mut inspector, &mut |_| {}, &stop);
    inspector.read_notices();
    if let Some(screen) = &mut inspector.screen {
        screen.clear();
    }
    // The server misses a client that does not say goodbye, so a failure here costs no more than the grace time.
    if let Err(error) = client.close() {
        tracing::debug!("the session was not closed: {error}");
    }
    let failure = match run {
        Ok(end) => {
            state.end = Some(end);
            None
        }
        Err(ClientError::Stopped) if state.observations > 0 => None,
        Err(ClientError::Stopped) => {
            return Err(anyhow::anyhow!("stopped before the first observation; the session is closed").into());
        }
        Err(error) if state.observations == 0 => return Err(error.into()),
        Err(error) => Some(error),
    };
    let files = files::write(&folder, &state);
    if args.json {
        print(format!("{:#}\n", document::report(&state, &files?)));
    } else {
        let style = Style { width: width(), color: color && std::io::stdout().is_terminal() };
        print(view::draw(&state, Part::Summary { joints: args.joints }, style));
        hint(&state);
        print(files?.values().fold("\n".to_owned(), |text, path| text + path + "\n"));
    }
    failure.map_or(Ok(true), |error| Err(error.into()))
}

/// A robot that lies on the floor shows little.
fn hint(state: &State) {
    let fell = state.end.as_ref().is_some_and(|end| end.causes.iter().any(|cause| cause == "fall"));
    if fell && state.policy != "stand" {
        eprintln!("the robot fell; with --policy stand it stays upright, and --end-on time-out goes on after a fall");
    }
}

/// The policy, the session that it asks for, and the episode: for a bag those that it was recorded with.
fn driver(args: &InspectArgs) -> Result<(Box<dyn Policy>, OpenRequest, u64), Failure> {
    if let Some(path) = policies::replayed_bag(&args.policy) {
        let replay = Replay::open(path)?;
        let base = replay.request();
        if !base.task.eq_ignore_ascii_case(&args.task) {
            return Err(Failure::Usage(format!("the bag is of task {}, not {}", base.task, args.task)));
        }
        let episode = replay.header().episode;
        return Ok((Box::new(replay), base, episode));
    }
    let policy = policy(&args.policy)?;
    let base =
        OpenRequest { policy: policy.name(), task: args.task.clone(), seed: args.seed, ..OpenRequest::default() };
    Ok((policy, base, args.episode))
}

/// The flags go before what the policy asks for, and that before what is shown by default.
fn request(args: &InspectArgs, policy: &dyn Policy, base: OpenRequest) -> OpenRequest {
    let timed = SENSORS.map(|(name, rate_hz)| Sensor { rate_hz, ..Sensor::from(name) });
    let looked_at = LOOKED_AT.map(|name| Sensor { on_request: true, ..Sensor::from(name) });
    let mut sensors = policy.sensors();
    for sensor in timed.into_iter().chain(looked_at) {
        if !sensors.iter().any(|asked| asked.name == sensor.name) {
            sensors.push(sensor);
        }
    }
    let mut request = OpenRequest { sensors, weights: String::new(), ..base };
    args.session.apply(&mut request);
    if args.real_time {
        request.set_mode(Mode::RealTime);
    }
    request
}

/// Where the view can be drawn, if anywhere.
fn terminal(color: bool) -> Option<Screen<Box<dyn std::io::Write + Send>>> {
    if std::io::stdout().is_terminal() {
        Some(Screen::new(Box::new(std::io::stdout()), color))
    } else if std::io::stderr().is_terminal() {
        Some(Screen::new(Box::new(std::io::stderr()), color))
    } else {
        None
    }
}

/// Width of the text at the end.
fn width() -> usize {
    if std::io::stdout().is_terminal() {
        return screen::size()[0];
    }
    std::env::var("COLUMNS").ok().and_then(|columns| columns.parse().ok()).unwrap_or(WIDTH)
}

fn seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse().ok().filter(|seconds: &f64| seconds.is_finite() && *seconds > 0.0);
    seconds.ok_or_else(|| format!("'{text}' is no time; write seconds, such as 10"))
}
