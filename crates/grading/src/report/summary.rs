//! The main numbers, and the warnings that precede them.

use std::fmt::Write;

use fiatlux_proto::count;

use super::markup::{escape, share};
use super::{overview, sections};
use crate::tables::{coverage, missing, run_line};
use crate::{Fault, RateRow, Results, Score, TaskResult};

/// Writes the progress of a run, and the remarks from its journals.
pub(super) fn run_lines(out: &mut String, results: &Results) {
    if let Some(run) = &results.run {
        for line in std::iter::once(&run_line(run)).chain(&run.notes) {
            let _ = writeln!(out, "<p class=\"soft\">{}.</p>", escape(line));
        }
    }
}

/// Writes the warnings and the main numbers.
pub(super) fn summary(out: &mut String, results: &Results) {
    warnings(out, results);
    out.push_str("<div class=\"cards\">\n");
    let overall = &results.overall;
    let only = only_task(results);
    if overall.episodes > 0 {
        if let (Some(score), Some(success)) = (&results.score_strict, &overall.strict_success) {
            match only {
                Some(task) => {
                    task_card(out, "strict", task, task.strict_score_mean.zip(Some(task.strict_score_std)), "big");
                }
                None => score_card(out, "Score S, strict", score, "big"),
            }
            rate_card(out, "Success, strict", success, overall.episodes, "big");
        }
        match only {
            Some(task) => task_card(out, "published", task, Some((task.score_mean, task.score_std)), "mid"),
            None => score_card(out, "Score S, published", &results.score, "mid"),
        }
        rate_card(out, "Clean, published", &overall.clean_success, overall.episodes, "mid");
        violations_card(out, results);
    }
    out.push_str("</div>\n");
    if overall.episodes > 0 {
        let score = match only {
            Some(_) => "<b>s</b> is half the success rate and half the mean gate progress.",
            None => {
                "<b>S</b> is the mean of the subtasks' scores s, weighted by difficulty; s is half the success rate and half \
                 the mean gate progress."
            }
        };
        let _ = writeln!(
            out,
            "<p class=\"soft small\"><b>Published</b> is the paper's rulebook; <b>strict</b> also asks that a gate holds for \
             a second, that the robot stands upright on what carries it, and that a bulb is in the grip of one hand: \
             stunts pass the first and not the second. Rankings go by strict. <b>Clean</b> is a success with no bulb broken \
             (a hand body above {} N at any step) and none dropped; a strict success always is. {score} At 0 \
             nothing was reached that the start did not give; an episode whose gate never fires adds at most half of its \
             weight; at 1 every gate fired. The spread is the sample standard deviation over layout seeds: scores under \
             different seeds do not compare, for the layout sets the difficulty.</p>",
            results.conditions.thresholds.get("fragility_n").copied().unwrap_or_default()
        );
    }
}

/// Writes the warnings that a reader needs before the first number.
fn warnings(out: &mut String, results: &Results) {
    let mut warn = |title: &str, text: &str| {
        let _ = writeln!(out, "<div class=\"panel warn\"><b>{title}</b> {}</div>", escape(text));
    };
    if !results.conditions.ranked {
        let text = format!("{}.", results.conditions.deviations.join("; "));
        warn("Not ranked: this run was played under other conditions than the benchmark's.", &text);
    }
    let lacking = missing(results);
    // One task has no S, so nothing is missing in it.
    if !lacking.is_empty() && only_task(results).is_none() {
        let covers = results.run.is_none().then(|| format!("S is {}", coverage(results)));
        let lines: Vec<String> = covers.into_iter().chain(lacking).collect();
        warn("Missing subtasks.", &format!("{}.", lines.join(". ")));
    }
    if let Some(lost) = results.lost_journal() {
        warn("Journal missing.", &format!("{lost}."));
    }
    if results.excluded.iter().any(|bag| bag.reason != Fault::Duplicate) {
        let text = format!("{} could not be scored; the list is below.", count(results.excluded.len(), "bag"));
        warn("Data loss.", &text);
    }
}

fn rate_card(out: &mut String, name: &str, rate: &RateRow, episodes: u64, size: &str) {
    let (value, [low, high]) = (rate.rate.unwrap_or_default(), rate.interval.unwrap_or([0.0, 1.0]));
    let _ = writeln!(
        out,
        "<div class=\"panel\"><div class=\"card-name\">{name}</div><div class=\"{size}\">{}</div>\
         <div class=\"card-note\">{} of {episodes} episodes<br>95\u{202f}% interval {} to {}</div></div>",
        share(value),
        rate.hits,
        share(low),
        share(high)
    );
}

/// The subtask of results that have no other: their cards show its score, and not what is left of it in S.
fn only_task(results: &Results) -> Option<&TaskResult> {
    match results.subtasks.as_slice() {
        [only] => Some(only),
        _ => None,
    }
}

fn task_card(out: &mut String, judge: &str, task: &TaskResult, score: Option<(f64, Option<f64>)>, size: &str) {
    let Some((mean, std)) = score else { return };
    let _ = writeln!(
        out,
        "<div class=\"panel\"><div class=\"card-name\">Score s, {judge}</div><div class=\"{size}\">{mean:.3}{}</div>\
         <div class=\"card-note\">{} {}<br>of 1, mean \u{b1} std over seeds</div></div>",
        spread(std),
        escape(&task.id),
        escape(&task.name)
    );
}

fn spread(std: Option<f64>) -> String {
    std.map_or(String::new(), |std| format!(" <span class=\"mid soft\">\u{b1}\u{202f}{std:.3}</span>"))
}

fn score_card(out: &mut String, name: &str, score: &Score, size: &str) {
    let Some(mean) = score.mean else { return };
    let seeds: Vec<_> = score.per_seed.iter().map(|seed| format!("{}:\u{a0}{:.3}", seed.seed, seed.score)).collect();
    // A server's random numbers mean nothing to a reader.
    let is_drawn = score.per_seed.iter().any(|seed| seed.seed > 99_999);
    let shown = match seeds.len() {
        count if is_drawn || count > 12 => format!("over {count} seeds"),
        _ => format!("by seed {}", seeds.join(", ")),
    };
    let _ = writeln!(
        out,
        "<div class=\"panel\"><div class=\"card-name\">{name}</div><div class=\"{size}\">{mean:.3}{}</div>\
         <div class=\"card-note\">over {} of 12 subtasks<br>of 1, mean \u{b1} std<br>{shown}</div></div>",
        spread(score.std),
        score.subtasks
    );
}

fn violations_card(out: &mut String, results: &Results) {
    let rate = |rate: &RateRow| share(rate.rate.unwrap_or_default());
    let overall = &results.overall;
    let _ = writeln!(
        out,
        "<div class=\"panel\"><div class=\"card-name\">Broken / dropped</div><div class=\"mid\">{} / {}</div>\
         <div class=\"card-note\">{} with a broken bulb<br>{} with a dropped one</div></div>",
        rate(&overall.broken),
        rate(&overall.dropped),
        count(overall.broken.hits, "episode"),
        overall.dropped.hits
    );
}

pub(super) fn subtasks(out: &mut String, results: &Results) {
    out.push_str(
        "<div class=\"panel wide scroll\" tabindex=\"0\" role=\"region\" aria-label=\"Subtasks as a figure\">",
    );
    out.push_str(&overview::figure(results));
    let (protocol, success) = match results.score_strict {
        Some(_) => ("strict", "strict success"),
        None => ("published", "published clean success"),
    };
    let _ = write!(
        out,
        "<div class=\"legend\"><span><i class=\"k-accent\"></i>{protocol} score s, with its standard deviation over the \
         seeds</span><span><i class=\"k-dot\"></i>{success} with Wilson interval</span><span><i class=\"k-ring\"></i>published \
         success</span><span><i class=\"k-held\"></i>mean {protocol} gate progress</span></div>"
    );
    out.push_str(&overview::causes(results));
    out.push_str("</div>\n");
    out.push_str("<div class=\"panel scroll\" tabindex=\"0\" role=\"region\" aria-label=\"Subtasks as a table\">");
    sections::task_table(out, &results.subtasks, true);
    out.push_str("</div>\n");
}
