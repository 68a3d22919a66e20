//! The report: one self-contained page, in light and dark, without scripts.
//!
//! Text from a bag is escaped. The same results give the same bytes.

mod episodes;
mod figure;
mod markup;
mod overview;
mod sections;
mod site;
mod style;
mod summary;

use std::fmt::Write;
use std::path::Path;

use episodes::FigureSource;
use fiatlux_proto::count;
use markup::escape;
use summary::{run_lines, subtasks, summary};

use crate::Results;
use crate::tables::{conditions_line, seed_count};

pub use episodes::{REPLAYS, Site};
pub use markup::cause_class;
pub use site::{SiteReport, episode_figure, site, task_cards};
pub use style::STYLE;

/// The report as one HTML page without links to replays.
pub fn html(results: &Results) -> String {
    page(results, None)
}

/// The report as one HTML page for a folder. An episode links to its replay, a file with the bag's name and `.html`, and shows its still,
/// one with `.png`, where these are next to the bag or in the folder's [`REPLAYS`]. Stills are part of the page.
pub fn html_in(results: &Results, folder: &Path) -> String {
    page(results, Some(folder))
}

fn page(results: &Results, folder: Option<&Path>) -> String {
    let mut out = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<meta name=\"color-scheme\" \
         content=\"light dark\">\n<title>Fiatlux: {}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<main>\n",
        escape(&results.policy)
    );
    headline(&mut out, results);
    if !results.subtasks.is_empty() {
        out.push_str("<h2>Subtasks</h2>\n");
        subtasks(&mut out, results);
    }
    sections::extra_tasks(&mut out, results);
    sections::parts(&mut out, results);
    if !results.episodes.is_empty() {
        episodes::section(&mut out, results, FigureSource::File(folder));
    }
    sections::excluded(&mut out, results);
    sections::conditions(&mut out, results);
    sections::reproduce(&mut out, results);
    out.push_str("</main>\n</body>\n</html>\n");
    out
}

fn headline(out: &mut String, results: &Results) {
    let _ = writeln!(out, "<div class=\"kicker\">Fiatlux evaluation</div>");
    if results.episodes.is_empty() {
        let _ = writeln!(out, "<h1>No episode could be scored</h1>\n<p>The bags and the reasons are listed below.</p>");
        return;
    }
    let _ = writeln!(
        out,
        "<h1>Policy {}</h1>\n<p class=\"soft\">{}, {}. {}.</p>",
        escape(&results.policy),
        count(results.episodes.len(), "episode"),
        escape(&seed_count(results)),
        escape(&conditions_line(&results.conditions).replacen('b', "B", 1)),
    );
    run_lines(out, results);
    summary(out, results);
}
