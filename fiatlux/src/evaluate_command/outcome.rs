//! Writes and prints the outcome of an evaluation.

use std::path::Path;
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

use anyhow::Context;
use fiatlux_grading::{Fault, report, tables};
use fiatlux_proto::count;
use fiatlux_runs::Outcome;

/// Writes and prints the outcome of an evaluation, and says how to continue if it was stopped.
pub(super) fn finish(
    as_json: bool,
    out: &Path,
    outcome: &Outcome,
    goes_on: &str,
    stop: &AtomicBool,
) -> anyhow::Result<ExitCode> {
    write_results(out, outcome)?;
    // What a stop interrupted is not lost: it is played again.
    let mut shown = outcome.results.clone();
    if outcome.stopped {
        shown.excluded.retain(|bag| bag.reason != Fault::Aborted);
    }
    if as_json {
        fiatlux_cli::print(outcome.results.to_json()?)?;
    } else if !shown.episodes.is_empty() || !outcome.stopped {
        fiatlux_cli::print_painted(tables::text(&shown), tables::painted)?;
    }
    if super::pictures::draw(out, &outcome.results, stop) {
        write_results(out, outcome)?;
    }
    for lost in &outcome.lost {
        fiatlux_cli::report(format!("lost: {lost}"));
    }
    let folder = out.display();
    if outcome.resumed > 0 {
        fiatlux_cli::report(already_there(outcome.resumed, out));
    }
    fiatlux_cli::report(format!("bags, results.json and report.html are in {folder}"));
    if outcome.stopped {
        let played = outcome.results.episodes.len();
        fiatlux_cli::report(format!("stopped: {played} of {} played, {goes_on}", outcome.asked));
    }
    let whole = outcome.lost.is_empty() && !outcome.stopped;
    Ok(if whole { ExitCode::SUCCESS } else { ExitCode::from(3) })
}

fn already_there(episodes: usize, out: &Path) -> String {
    let (were, episodes) = (if episodes == 1 { "was" } else { "were" }, count(episodes, "episode"));
    format!("{episodes} {were} already in {} and {were} not run again", out.display())
}

fn write_results(out: &Path, outcome: &Outcome) -> anyhow::Result<()> {
    let page = report::html_in(&outcome.results, out);
    for (name, text) in [("results.json", outcome.results.to_json()?), ("report.html", page)] {
        let path = out.join(name);
        fiatlux_cli::write_whole(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}
