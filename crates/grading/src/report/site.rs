//! Parts of the report for the pages of a site, where figures and replays have addresses of their own.

use std::path::Path;

use fiatlux_bag::Patience;

use super::episodes::{FigureSource, Site, cards, gate, legend, limit};
use super::figure::figure;
use super::sections;
use super::style::STYLE;
use super::summary::{run_lines, subtasks, summary};
use crate::bag::read;
use crate::{EpisodeRow, GradeOptions, Results};

/// The report in parts, as HTML without scripts or styles. Text from a bag is escaped.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SiteReport {
    /// Warnings for the reader, and cards with the main numbers.
    pub summary: String,
    /// Scores and causes by subtask, as a figure and as a table, without a heading.
    pub subtasks: String,
    /// Tasks that are no subtasks, and the parts of the whole errand.
    pub others: String,
    /// Bags that are not scored, conditions, versions, thresholds.
    pub conditions: String,
}

/// Renders the report in parts, for a page that adds a frame and [`STYLE`](super::STYLE).
pub fn site(results: &Results) -> SiteReport {
    let part = |write: &dyn Fn(&mut String)| {
        let mut out = String::new();
        write(&mut out);
        out
    };
    SiteReport {
        summary: part(&|out| {
            run_lines(out, results);
            summary(out, results);
        }),
        subtasks: part(&|out| {
            if !results.subtasks.is_empty() {
                subtasks(out, results);
            }
        }),
        others: part(&|out| {
            sections::extra_tasks(out, results);
            sections::parts(out, results);
        }),
        conditions: part(&|out| {
            sections::excluded(out, results);
            sections::conditions(out, results);
        }),
    }
}

/// The gate of a task, and cards of some of its episodes.
pub fn task_cards(results: &Results, episodes: &[EpisodeRow], site: &Site<'_>) -> String {
    let mut out = String::new();
    let task = episodes.first().and_then(|episode| episode.task.parse::<fiatlux_rules::Task>().ok());
    gate(&mut out, task.map(fiatlux_rules::Task::spec));
    legend(&mut out);
    cards(&mut out, episodes, limit(results), FigureSource::Site(site));
    out
}

/// The figure of an episode as a self-contained SVG picture, in light and dark: criteria and force on the hands over
/// time. It is drawn from the rows of the bag that can be read before `patience` ends. `None` if there are none.
pub fn episode_figure(bag: &Path, results: &Results, patience: Patience) -> Option<String> {
    let options = GradeOptions {
        set: results
            .conditions
            .thresholds_set
            .iter()
            .filter_map(|key| results.conditions.thresholds.get(key).map(|value| format!("{key}={value}")))
            .collect(),
        published_counting: results.conditions.published_counting,
        ..GradeOptions::default()
    };
    let graded = read(bag, &options, Some(patience)).ok()?.graded;
    let svg = figure(&graded.series, &graded.end, limit(results));
    Some(svg.replacen('>', &format!("><style>{STYLE}svg {{ font-family: system-ui, sans-serif; }}</style>"), 1))
}
