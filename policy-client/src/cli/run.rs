//! `policy-client run`.

use std::time::Instant;

use fiatlux_link::{ProgressLine, Role, stop_on_signal};
use fiatlux_policy::{Client, ClientError};

use super::Failure;
use super::plan::{RunArgs, plan};
use super::report::{Episode, Report};

/// Runs the episodes and prints what came of them; false if a replay's digest differs.
pub fn run(args: &RunArgs) -> Result<bool, Failure> {
    let mut plan = plan(args)?;
    let stop = stop_on_signal()?;
    let link = args.link.open(Role::Client)?;
    let mut client = Client::open(&link, args.server.as_deref(), plan.request)?;
    let horizon = client.info().task.as_ref().map_or(0, |task| task.horizon_steps);
    let mut report = Report::new(&plan.policy.name(), client.info(), plan.digest);
    let mut failure = None;
    for index in plan.first..plan.first.saturating_add(plan.count) {
        let line = ProgressLine::default();
        let start = Instant::now();
        let mut progress = |step| {
            line.show(|| {
                let (rate, left) = (line.rate(step), line.left(step, horizon));
                format!("episode {index}: step {step} of {horizon}, {rate:.0} steps/s, at most {left} left")
            });
        };
        let end = client.run_episode(index, plan.policy.as_mut(), &mut progress, &stop);
        line.clear();
        match end {
            Ok(end) => report.add(Episode { index, end, wall_s: start.elapsed().as_secs_f64() }, args.json),
            Err(error) => {
                failure = Some(error);
                break;
            }
        }
    }
    report.finish(client.round_trips(), args.json);
    // The server misses a client that does not say goodbye, so a failure here costs no more than the grace time.
    if let Err(error) = client.close() {
        tracing::debug!("the session was not closed: {error}");
    }
    match failure {
        None => Ok(report.is_equal()),
        Some(ClientError::Stopped) => Err(anyhow::anyhow!("stopped; the session is closed").into()),
        Some(error) => Err(error.into()),
    }
}
