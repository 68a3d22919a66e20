//! Shows a session as its policy sees it: live on a terminal, then as text or JSON, pictures and numbers.
//!
//! Only `terms` lists what an observation can contain; everything else here follows that list.

mod document;
mod files;
mod inspector;
mod picture;
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

use fiatlux_carrier::Carrier;
use fiatlux_cli::{print, print_styled, stop_on_signal};
use fiatlux_client::{Access, Client, ClientError, Policy};
use fiatlux_proto::v3::{OpenRequest, Sensor};
use thiserror::Error;

pub use files::{FilesError, check};
use inspector::Inspector;
use screen::Screen;
use state::State;
use view::{Part, Style};

/// What to inspect, and how to show it.
pub struct Inspection {
    pub policy: Box<dyn Policy>,
    pub request: OpenRequest,
    pub episode: u64,
    pub server: Option<String>,
    pub access: Access,
    /// Longest simulated time to play, s.
    pub seconds: f64,
    /// Folder for the pictures and the observation.
    pub folder: PathBuf,
    pub joints: bool,
    pub json: bool,
}

/// Why an inspection failed or is incomplete.
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
    #[error(transparent)]
    Files(#[from] FilesError),
}

/// The sensors that are shown by default. Features and flat take the time of a network, so they are on request.
pub fn default_sensors() -> impl Iterator<Item = Sensor> {
    terms::SENSORS.iter().map(|sensor| Sensor {
        rate_hz: sensor.rate_hz.unwrap_or(0.0),
        on_request: sensor.rate_hz.is_none(),
        ..Sensor::from(sensor.name)
    })
}

/// Runs the episode, prints what was seen, and writes the files.
pub fn inspect(inspection: Inspection, link: &Carrier) -> Result<(), InspectError> {
    let Inspection { policy, request, episode, server, access, seconds, folder, joints, json } = inspection;
    let stop = stop_on_signal().map_err(InspectError::Signals)?;
    let mut client = Client::open_with(link, server.as_deref(), request, &access)?;
    let (sender, notices) = mpsc::channel();
    client.send_notices(sender);
    let mut state = State::new(client.info().clone(), policy.name(), episode);
    let color = std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
    let screen = if json { None } else { Screen::on_terminal(color) };
    let last = (seconds / state.info.control_dt.max(1e-6)).round().max(1.0) as u64;
    let mut inspector = Inspector::new(policy, &mut state, screen, notices, last, stop.clone());
    let run = client.run_episode(episode, &mut inspector, &mut |_| {}, &stop);
    inspector.finish();
    // The server notices clients that vanish, so a failure here costs no more than the grace time.
    if let Err(error) = client.close() {
        tracing::debug!("the session was not closed: {error}");
    }
    let mut failure = None;
    match run {
        Ok(end) => state.end = Some(end),
        Err(ClientError::Stopped) if state.observations > 0 => {}
        Err(ClientError::Stopped) => return Err(InspectError::Stopped),
        Err(error) if state.observations == 0 => return Err(error.into()),
        Err(error) => failure = Some(error),
    }
    let files = files::write(&folder, &state);
    if json {
        print(format!("{:#}\n", document::report(&state, &files?)))?;
    } else {
        let style = Style { width: screen::width(), color: color && std::io::stdout().is_terminal() };
        print_styled(view::draw(&state, Part::Summary { joints }, style))?;
        // A robot on the floor shows little.
        if state.end.as_ref().is_some_and(|end| end.causes.iter().any(|cause| cause == "fall"))
            && state.policy != "stand"
        {
            eprintln!(
                "the robot fell; with --policy stand it stays upright, and --end-on time-out continues after a fall"
            );
        }
        print(files?.values().fold("\n".to_owned(), |text, path| text + path + "\n"))?;
    }
    failure.map_or(Ok(()), |error| Err(error.into()))
}
