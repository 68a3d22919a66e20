//! The figure of all subtasks: score, success, gate progress and ends, one row each.

use std::collections::BTreeSet;
use std::fmt::Write;

use super::markup::{cause_class, escape, px};
use crate::{Results, TaskResult};

const WIDTH: f64 = 1096.0;
const HEAD: f64 = 46.0;
const ROW: f64 = 30.0;
/// Left edge and width of each panel; the value is written to its right.
const SCORE: (f64, f64) = (274.0, 140.0);
const SUCCESS: (f64, f64) = (526.0, 168.0);
const PROGRESS: (f64, f64) = (762.0, 110.0);
const ENDS: (f64, f64) = (930.0, 166.0);

/// A legend of the causes that occur, sorted by name.
pub(super) fn causes(results: &Results) -> String {
    let causes: BTreeSet<&String> = results.subtasks.iter().flat_map(|task| task.ends.keys()).collect();
    let entry = |cause: &&String| format!("<span><i class=\"b-{}\"></i>{}</span>", cause_class(cause), escape(cause));
    format!("<div class=\"legend\"><span>Ends:</span>{}</div>", causes.iter().map(entry).collect::<String>())
}

pub(super) fn figure(results: &Results) -> String {
    let tasks = &results.subtasks;
    let height = HEAD + ROW * tasks.len() as f64 + 4.0;
    let mut out = format!(
        "<svg viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"Score, success rate, gate progress and ends of each subtask\">",
        px(WIDTH),
        px(height)
    );
    head(&mut out, height);
    for (i, task) in tasks.iter().enumerate() {
        row(&mut out, task, HEAD + ROW * i as f64);
    }
    out.push_str("</svg>");
    out
}

fn head(out: &mut String, height: f64) {
    let title = |out: &mut String, x: f64, text: &str| {
        let _ = write!(out, "<text x=\"{}\" y=\"14\" class=\"t-bold\">{text}</text>", px(x));
    };
    title(out, 0.0, "Subtask");
    title(out, SCORE.0, "Score s, mean \u{b1} std");
    title(out, SUCCESS.0, "Success, 95 %");
    title(out, PROGRESS.0, "Gate progress");
    title(out, ENDS.0, "Ends, published");
    let _ = write!(out, "<text x=\"254\" y=\"14\" text-anchor=\"end\" class=\"t-soft t-small\">weight</text>");
    for (x, width) in [SCORE, SUCCESS, PROGRESS] {
        for (share, label) in [(0.0, "0"), (0.5, "0.5"), (1.0, "1")] {
            let at = px(x + share * width);
            let _ = write!(
                out,
                "<text x=\"{at}\" y=\"34\" text-anchor=\"middle\" class=\"t-soft t-small\">{label}</text>\
                 <path d=\"M{at} 39V{}\" class=\"s-line\"/>",
                px(height - 4.0)
            );
        }
    }
}

fn row(out: &mut String, task: &TaskResult, top: f64) {
    let base = px(top + 19.5);
    let _ = write!(
        out,
        "<text x=\"0\" y=\"{base}\"><tspan class=\"t-bold\">{}</tspan> {}</text>\
         <text x=\"254\" y=\"{base}\" text-anchor=\"end\" class=\"t-soft\">{:.2}</text>",
        escape(&task.id),
        escape(&task.name),
        task.weight
    );
    let shown = TaskRates::of(task);
    bar(out, SCORE, top, shown.score_mean, "f-accent");
    let mut value = format!("{:.3}", shown.score_mean);
    if let Some(std) = shown.score_std {
        let at = |value: f64| px(SCORE.0 + SCORE.1 * value.clamp(0.0, 1.0));
        let middle = px(top + 15.0);
        let (low, high) = (at(shown.score_mean - std), at(shown.score_mean + std));
        if std > 0.0 {
            let _ = write!(out, "<path d=\"M{low} {middle}H{high}\" class=\"s-ink\" stroke-width=\"1.5\"/>");
        }
        let _ = write!(value, " \u{b1} {std:.3}");
    }
    let _ = write!(out, "<text x=\"{}\" y=\"{base}\" class=\"t-small\">{value}</text>", px(SCORE.0 + SCORE.1 + 8.0));
    rate(out, top + 10.0, shown.success_rate, shown.success_interval, true);
    rate(out, top + 20.0, task.success_rate, task.success_interval, false);
    let hits = (shown.success_rate * task.episodes as f64).round();
    let _ = write!(
        out,
        "<text x=\"{}\" y=\"{base}\" class=\"t-small\">{hits}/{}</text>",
        px(SUCCESS.0 + SUCCESS.1 + 10.0),
        task.episodes
    );
    bar(out, PROGRESS, top, shown.progress, "f-held");
    let at = px(PROGRESS.0 + PROGRESS.1 + 8.0);
    let _ = write!(out, "<text x=\"{at}\" y=\"{base}\" class=\"t-small\">{:.2}</text>", shown.progress);
    ends(out, task, top);
}

/// The rates of a task in the figure: the strict verdicts if it has them, else the published ones.
struct TaskRates {
    score_mean: f64,
    score_std: Option<f64>,
    success_rate: f64,
    success_interval: [f64; 2],
    progress: f64,
}

impl TaskRates {
    fn of(task: &TaskResult) -> Self {
        match task.strict_score_mean {
            Some(score_mean) => Self {
                score_mean,
                score_std: task.strict_score_std,
                success_rate: task.strict_success_rate.unwrap_or_default(),
                success_interval: task.strict_success_interval.unwrap_or([0.0, 1.0]),
                progress: task.strict_progress.unwrap_or_default(),
            },
            None => Self {
                score_mean: task.score_mean,
                score_std: task.score_std,
                success_rate: task.clean_success_rate,
                success_interval: task.clean_success_interval,
                progress: task.gate_progress,
            },
        }
    }
}

fn bar(out: &mut String, (x, width): (f64, f64), top: f64, share: f64, class: &str) {
    let mut rect = |length: f64, class: &str| {
        if length > 0.0 {
            let (x, y, length) = (px(x), px(top + 8.0), px(length));
            let _ =
                write!(out, "<rect x=\"{x}\" y=\"{y}\" width=\"{length}\" height=\"14\" rx=\"2\" class=\"{class}\"/>");
        }
    };
    rect(width, "f-track");
    rect(width * share.clamp(0.0, 1.0), class);
}

/// Draws a rate as a point on its interval.
fn rate(out: &mut String, y: f64, rate: f64, [low, high]: [f64; 2], clean: bool) {
    let at = |share: f64| px(SUCCESS.0 + SUCCESS.1 * share);
    let (line, width) = if clean { ("s-accent", 2.0) } else { ("s-soft", 1.5) };
    let point = if clean { "f-accent" } else { "s-ring" };
    let _ = write!(
        out,
        "<path d=\"M{} {y}H{}\" class=\"{line}\" stroke-width=\"{width}\"/>\
         <circle cx=\"{}\" cy=\"{y}\" r=\"3.6\" class=\"{point}\" stroke-width=\"1.5\"/>",
        at(low),
        at(high),
        at(rate),
        y = px(y)
    );
}

/// Draws the shares of the causes as one bar.
fn ends(out: &mut String, task: &TaskResult, top: f64) {
    let total = task.ends.values().sum::<u64>().max(1) as f64;
    let mut x = ENDS.0;
    for (cause, count) in &task.ends {
        let width = ENDS.1 * *count as f64 / total;
        let name = escape(cause);
        let _ = write!(
            out,
            "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"18\" rx=\"2\" class=\"f-{}\"><title>{name}: {count}</title></rect>",
            px(x),
            px(top + 6.0),
            px((width - 1.5).max(1.0)),
            cause_class(cause)
        );
        let label = format!("{cause} {count}");
        // About 6.3 px per letter.
        let room = (width - 8.0) / 6.3;
        let label = if label.chars().count() as f64 <= room { label } else { count.to_string() };
        if label.chars().count() as f64 <= room {
            let _ = write!(
                out,
                "<text x=\"{}\" y=\"{}\" class=\"t-on\">{}</text>",
                px(x + 5.0),
                px(top + 19.0),
                escape(&label)
            );
        }
        x += width;
    }
}
