//! The command `policy-client run`.

use std::sync::mpsc;
use std::time::Instant;

use fiatlux_cli::{ProgressLine, stop_on_signal};
use fiatlux_client::{Client, ClientError};
use fiatlux_link::Role;
use fiatlux_proto::plain;
use fiatlux_proto::v3::Notice;
use fiatlux_proto::v3::notice::Code;

use super::Failure;
use super::plan::{RunArgs, plan};
use super::report::{Episode, Report};

/// Outcome of a run, which decides the exit code.
pub enum Played {
    /// Every episode was played as requested.
    Whole,
    /// Every episode was played, but a recorder missed rows.
    Cut,
    /// A replay's digest differs from that of its recording.
    Differs,
}

/// Logs a notice of the server; returns a line for the summary if it says that a recording is cut.
fn pass_on(Notice { code, episode, step, field, message, remedy, .. }: Notice) -> Option<String> {
    tracing::warn!("notice of the server, episode {episode} step {step}: {}; {}", plain(&message), plain(&remedy));
    let is_cut = code == i32::from(Code::Lost) && field == "recorded";
    is_cut.then(|| format!("episode {episode} from step {step} on: {}", plain(&message)))
}

/// Runs the episodes and prints their outcomes.
pub fn run(args: &RunArgs) -> Result<Played, Failure> {
    let mut plan = plan(args)?;
    let stop = stop_on_signal()?;
    let access = args.access.read()?;
    let link = args.link.open(Role::Client)?.carrier();
    let mut client = Client::open_with(&link, args.server.as_deref(), plan.request, &access)?;
    let (sender, notices) = mpsc::channel();
    client.send_notices(sender);
    let mut cut = Vec::new();
    let horizon = client.info().task.as_ref().map_or(0, |task| task.horizon_steps);
    let mut report = Report::new(&plan.policy.name(), client.info(), plan.digest);
    let mut failure = None;
    for index in plan.first..plan.first.saturating_add(plan.count) {
        let line = ProgressLine::default();
        let start = Instant::now();
        let mut progress = |step| {
            line.show(|| {
                let (rate, left) = (line.rate(step), line.left(step, horizon));
                format!("episode {index}: step {step} of {horizon}, {rate:.0} steps/s, about {left} left")
            });
        };
        let end = client.run_episode(index, plan.policy.as_mut(), &mut progress, &stop);
        line.clear();
        cut.extend(notices.try_iter().filter_map(pass_on));
        match end {
            Ok(end) => report.add(Episode { index, end, wall_s: start.elapsed().as_secs_f64() }, args.json)?,
            Err(error) => {
                failure = Some(error);
                break;
            }
        }
    }
    report.finish(client.round_trips(), args.json)?;
    // The server notices clients that vanish, so a failure here costs no more than the grace time.
    if let Err(error) = client.close() {
        tracing::debug!("the session was not closed: {error}");
    }
    cut.extend(notices.try_iter().filter_map(pass_on));
    for recording in &cut {
        fiatlux_cli::report(format!("recording cut: {recording}"));
    }
    match failure {
        None if !cut.is_empty() && report.is_equal() => Ok(Played::Cut),
        None => Ok(if report.is_equal() { Played::Whole } else { Played::Differs }),
        Some(ClientError::Stopped) => Err(anyhow::anyhow!("stopped; the session is closed").into()),
        Some(error) => Err(error.into()),
    }
}
