//! Two runs, episode by episode, and two replays side by side.

use std::sync::Arc;

use askama::Template;
use axum::extract::{Path, RawQuery, State};
use axum::response::{IntoResponse, Redirect, Response};
use fiatlux_grading::{CompareError, Comparison, EpisodeRow, Pairs, Results, compare_results};
use fiatlux_replay::site::{SitePage, pair};

use super::answer::{Problem, page, replay_page};
use super::episode::find;
use super::key::Key;
use super::show;
use super::state::Pages;
use crate::{Entry, SubmissionId};

const PAIRS: usize = 100;
/// Runs to choose from on a page.
const CHOICES: usize = 50;

#[derive(Template)]
#[template(path = "choose.html")]
struct ChoosePage<'a> {
    /// The run that was chosen; then `others` share episodes with it, and else with any run.
    entry: Option<&'a Entry>,
    /// Runs, and the number of episodes that they share with the one that was chosen.
    others: &'a [(&'a Entry, usize)],
    page: usize,
    pages: usize,
}

/// The runs that one run can be compared with, `?run=`: those that share episodes with it. Without it, the runs to begin with. Two
/// runs, `?run=&run=`, lead to their comparison.
pub(super) async fn choose(State(pages): State<Arc<Pages>>, RawQuery(query): RawQuery) -> Result<Response, Problem> {
    let query = query.as_deref();
    let first = show::asked(query, "run").next();
    let second = show::asked(query, "run").find(|id| Some(*id) != first);
    let is_id = |id: &str| id.parse::<SubmissionId>().is_ok();
    if let (Some(a), Some(b)) = (first, second)
        && is_id(a)
        && is_id(b)
    {
        return Ok(Redirect::to(&format!("/compare/{a}/{b}")).into_response());
    }
    let entry = match first {
        Some(id) => Some(pages.open(id).await?),
        None => None,
    };
    let board = match &entry {
        Some(entry) => pages.board_with(entry.id).await?,
        None => pages.board().await?,
    };
    let others = match &entry {
        Some(entry) => board.partners(entry.id),
        None => board.comparable(),
    };
    let part = show::part(&others, CHOICES, query);
    let shown = ChoosePage { entry: entry.as_ref(), others: part.shown, page: part.page, pages: part.pages };
    Ok(page(&shown))
}

struct EpisodePair<'a> {
    key: Key,
    a: &'a EpisodeRow,
    b: &'a EpisodeRow,
}

impl EpisodePair<'_> {
    /// True if both have a bag, so that they can be shown.
    fn can_be_seen(&self) -> bool {
        self.a.failure.is_none() && self.b.failure.is_none()
    }
}

#[derive(Template)]
#[template(path = "compare.html")]
struct ComparePage<'a> {
    a: &'a Entry,
    b: &'a Entry,
    comparison: &'a Comparison,
    /// Each subtask, then all of them together.
    lines: Vec<SubtaskLine<'a>>,
    shown: &'a [EpisodePair<'a>],
    only_different: bool,
    /// `only_different` as part of the query of other pages of the list.
    only: &'static str,
    different: usize,
    all: usize,
    page: usize,
    pages: usize,
}

/// The results of both runs in the pairs of one subtask, or of all.
struct SubtaskLine<'a> {
    pairs: &'a Pairs,
    a: RunMeans,
    b: RunMeans,
}

/// Heads of the columns of the subtasks; groups stand above them.
const HEADS: [&str; 14] =
    ["Pairs", "A", "B", "only A", "only B", "p", "A", "B", "p", "A \u{2212} B", "A", "B", "A", "B"];

impl SubtaskLine<'_> {
    /// The cells of the line, each with a label that is complete without a head.
    fn cells(&self) -> Vec<(&'static str, String)> {
        let (pairs, a, b) = (self.pairs, &self.a, &self.b);
        let score = |value: f64| format!("{value:.3}");
        vec![
            ("Pairs", pairs.pairs.to_string()),
            ("Successes, A", pairs.successes_a.to_string()),
            ("Successes, B", pairs.successes_b.to_string()),
            ("Only A", pairs.only_a.to_string()),
            ("Only B", pairs.only_b.to_string()),
            ("p of successes", show::p_value(&pairs.success_p)),
            ("Progress, A", score(pairs.progress_a)),
            ("Progress, B", score(pairs.progress_b)),
            ("p of progress", show::p_value(&pairs.progress_p)),
            ("Score, A \u{2212} B", format!("{:+.3}", pairs.score_difference)),
            ("Published score, A", score(a.published)),
            ("Published score, B", score(b.published)),
            ("Mean length, A, s", format!("{:.1}", a.seconds)),
            ("Mean length, B, s", format!("{:.1}", b.seconds)),
        ]
    }
}

#[derive(Default)]
struct RunMeans {
    /// Score of an episode by the published judge: half success, half gate progress.
    published: f64,
    /// Length by the judge that ended the episode, s.
    seconds: f64,
    /// Number of episodes by the cause of their end, the most frequent first.
    ends: Vec<(String, usize)>,
}

impl RunMeans {
    fn of<'a>(rows: impl Iterator<Item = &'a EpisodeRow>) -> Self {
        let (mut count, mut sums) = (0_usize, Self::default());
        for row in rows {
            count += 1;
            sums.published += 0.5 * f64::from(u8::from(row.success)) + 0.5 * row.gate_progress;
            sums.seconds += seconds_of(row);
            let end = show::end_of(row);
            match sums.ends.iter_mut().find(|(found, _)| found == end) {
                Some((_, count)) => *count += 1,
                None => sums.ends.push((end.to_owned(), 1)),
            }
        }
        sums.ends.sort_by(|(name_a, a), (name_b, b)| b.cmp(a).then(name_a.cmp(name_b)));
        let count = count.max(1) as f64;
        Self { published: sums.published / count, seconds: sums.seconds / count, ends: sums.ends }
    }

    /// The causes in a line of text, such as `fall 3, time-out 1`.
    fn ends_text(&self) -> String {
        let texts: Vec<_> = self.ends.iter().map(|(cause, count)| format!("{cause} {count}")).collect();
        texts.join(", ")
    }
}

/// Length of an episode, s, by the strict judge if the results have one.
fn seconds_of(row: &EpisodeRow) -> f64 {
    row.strict_steps.unwrap_or(row.steps) as f64 * fiatlux_rules::CONTROL_DT
}

/// True for a success, by the strict judge if the results have one.
fn passed(row: &EpisodeRow) -> bool {
    row.strict_success.unwrap_or(row.success)
}

impl ComparePage<'_> {
    /// Gate progress, by the strict judge if the results have one.
    fn progress(&self, row: &EpisodeRow) -> f64 {
        row.strict_progress.unwrap_or(row.gate_progress)
    }

    fn seconds(&self, row: &EpisodeRow) -> String {
        format!("{:.1}\u{202f}s", seconds_of(row))
    }
}

/// The comparison of two runs; `?only=different` lists only the pairs in which exactly one run succeeded.
pub(super) async fn runs(
    State(pages): State<Arc<Pages>>,
    Path((a, b)): Path<(String, String)>,
    RawQuery(query): RawQuery,
) -> Result<Response, Problem> {
    let (entry_a, of_a) = pages.run(&a).await?;
    let (entry_b, of_b) = pages.run(&b).await?;
    let (left, right) = (Arc::clone(&of_a), Arc::clone(&of_b));
    let compared = pages.heavy.run(move || compare_results((&a, &left), (&b, &right), true)).await?;
    let comparison = compared.map_err(|error| match error {
        CompareError::NoPairs => Problem::Asked(
            "These two runs share no episode: no task was played by both in the same room. Choose two with common seeds.".into(),
        ),
        error => Problem::Asked(format!("These two runs cannot be compared: {error}.")),
    })?;
    let query = query.as_deref();
    let mut both = pairs(&of_a, &of_b);
    let all = both.len();
    let lines = comparison.tasks.iter().chain(comparison.overall.as_ref()).map(|pairs| {
        let of = || both.iter().filter(|both| pairs.task == "all" || both.key.task.short_id() == pairs.task);
        SubtaskLine { pairs, a: RunMeans::of(of().map(|both| both.a)), b: RunMeans::of(of().map(|both| both.b)) }
    });
    let lines = lines.collect();
    let differs = |both: &EpisodePair<'_>| passed(both.a) != passed(both.b);
    let different = both.iter().filter(|both| differs(both)).count();
    let only_different = show::asked(query, "only").next() == Some("different");
    if only_different {
        both.retain(differs);
    }
    let part = show::part(&both, PAIRS, query);
    Ok(page(&ComparePage {
        a: &entry_a,
        b: &entry_b,
        comparison: &comparison,
        lines,
        shown: part.shown,
        only_different,
        only: if only_different { "only=different&" } else { "" },
        different,
        all,
        page: part.page,
        pages: part.pages,
    }))
}

/// The episodes that both runs have, in order of task, seed and index.
fn pairs<'a>(a: &'a Results, b: &'a Results) -> Vec<EpisodePair<'a>> {
    let key = |row: &EpisodeRow| (row.task.clone(), row.seed, row.episode);
    let others: std::collections::BTreeMap<_, &EpisodeRow> = b.episodes.iter().map(|row| (key(row), row)).collect();
    let both =
        a.episodes.iter().filter_map(|row| Some(EpisodePair { key: Key::of(row)?, a: row, b: others.get(&key(row))? }));
    both.collect()
}

#[derive(Template)]
#[template(path = "pair.html")]
struct PairPage<'a> {
    a: &'a Entry,
    b: &'a Entry,
    key: Key,
    replay: &'a SitePage,
}

/// Two replays of the same room, side by side with one time bar.
pub(super) async fn episodes(
    State(pages): State<Arc<Pages>>,
    Path((a, b, key)): Path<(String, String, String)>,
) -> Result<Response, Problem> {
    let (a, b) = (find(&pages, &a, &key).await?, find(&pages, &b, &key).await?);
    for found in [&a, &b] {
        if found.row().failure.is_some() {
            let policy = &found.entry.manifest.policy;
            return Err(Problem::Asked(format!(
                "{policy} has no recording of this episode, so there is nothing to show."
            )));
        }
    }
    let replay = pair();
    let shown = PairPage { a: &a.entry, b: &b.entry, key: a.key, replay: &replay };
    Ok(replay_page(&shown, &replay.script))
}
