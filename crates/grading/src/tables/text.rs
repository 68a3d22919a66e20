//! The table for a terminal, at most 80 columns wide.

use std::fmt::Write;

use fiatlux_proto::{count, plain};

use super::{conditions_line, coverage, missing, run_line, seed_count};
use crate::{Fault, Overall, RateRow, Results, Score, SeedRow, TaskResult};

const WIDTH: usize = 80;
/// More seeds than this are not listed one by one.
const MANY_SEEDS: usize = 8;

/// Heading of the causes, by which [`painted`] knows them.
const ENDS: &str = "How they ended, by the published judge";

/// The result in one line, then subtasks and ends, conditions, rates, missing subtasks and bags that were left out.
pub fn text(results: &Results) -> String {
    let mut out = String::new();
    if results.episodes.is_empty() {
        out.push_str("No episode could be scored.\n");
    } else {
        let _ = writeln!(out, "{}", wrapped(&result_line(results), "  "));
    }
    if !results.subtasks.is_empty() {
        out.push('\n');
        table(&mut out, &results.subtasks, true);
    }
    if !results.extra_tasks.is_empty() {
        out.push_str("\nNot part of the score\n");
        table(&mut out, &results.extra_tasks, false);
    }
    if !results.parts.is_empty() {
        parts(&mut out, results);
    }
    if !results.episodes.is_empty() {
        out.push('\n');
        rates(&mut out, results);
    }
    let lines = missing(results);
    if !lines.is_empty() {
        out.push('\n');
    }
    for line in lines {
        let _ = writeln!(out, "{}", wrapped(&line, "  "));
    }
    excluded(&mut out, results);
    out
}

/// The text with colours of a terminal: the first line bold, successes green, other ends red, what is 0 or missing grey.
pub fn painted(text: &str) -> String {
    const GREEN: Option<&str> = Some("32");
    const RED: Option<&str> = Some("31");
    const GREY: Option<&str> = Some("90");
    let in_table = |word: &str| match word {
        "1.00" | "1.000" => GREEN,
        "0.00" | "0.000" | "-" => GREY,
        _ => None,
    };
    let in_ends = |word: &str| match word {
        "success" => GREEN,
        word if word.starts_with(|first: char| first.is_ascii_lowercase()) => RED,
        _ => None,
    };
    let plain = |_: &str| None;
    let mut out = String::new();
    let mut of: &dyn Fn(&str) -> Option<&'static str> = &plain;
    for (index, line) in text.lines().enumerate() {
        if index == 0 {
            out += &format!("\x1b[1m{line}\x1b[0m\n");
            continue;
        }
        // The name of a task, in front, has no colour.
        let rest = line.char_indices().nth(10).map_or(line.len(), |(at, _)| at);
        out += &line[..rest];
        for part in line[rest..].split_inclusive(' ') {
            let word = part.trim_end_matches([' ', ',']);
            match of(word) {
                Some(code) => out += &format!("\x1b[{code}m{word}\x1b[0m{}", &part[word.len()..]),
                None => out += part,
            }
        }
        out.push('\n');
        if line.starts_with("task ") {
            of = &in_table;
        } else if line == ENDS {
            of = &in_ends;
        } else if line.is_empty() {
            of = &plain;
        }
    }
    out
}

/// Episodes, conditions, scores and rates with their intervals.
fn rates(out: &mut String, results: &Results) {
    let episodes = count(results.episodes.len(), "episode");
    let _ = writeln!(out, "  {}", wrapped(&format!("{episodes}, {}", seed_count(results)), "  "));
    let _ = writeln!(out, "  {}", wrapped(&conditions_line(&results.conditions), "  "));
    if let Some(run) = &results.run {
        for line in std::iter::once(run_line(run)).chain(run.notes.iter().map(|note| format!("Note: {note}"))) {
            let _ = writeln!(out, "  {}", wrapped(&line, "  "));
        }
    }
    out.push('\n');
    let overall = &results.overall;
    let rate = |name: &str, rate: &RateRow| match (rate.rate, rate.interval) {
        (Some(value), Some([low, high])) => format!(
            "{name:<22}{:>6.1} %   {}/{}, 95 % interval {:.1} to {:.1} %\n",
            100.0 * value,
            rate.hits,
            overall.episodes,
            100.0 * low,
            100.0 * high
        ),
        _ => String::new(),
    };
    let score = |out: &mut String, name: &str, score: &Score| {
        let Some(mean) = score.mean else { return };
        let spread = match score.std {
            Some(std) => format!("+- {std:.4} over the seeds"),
            None => "a single seed".into(),
        };
        let line = format!("{name:<22}{mean:>8.4}   {spread} ({})", by_seed(score));
        let _ = writeln!(out, "{}", wrapped(&line, "                                 "));
    };
    if let (Some(strict), Some(success)) = (&results.score_strict, &overall.strict_success) {
        score(out, "Score S, strict", strict);
        out.push_str(&rate("Success, strict", success));
    }
    score(out, "Score S, published", &results.score);
    out.push_str(&rate("Success, published", &overall.success));
    out.push_str(&rate("Clean, published", &overall.clean_success));
    out.push_str(&rate("Bulb broken", &overall.broken));
    out.push_str(&rate("Bulb dropped", &overall.dropped));
}

/// Successes and S of the judge that ranks, such as `walk: 12/12 strict, S 1.000 over 3 of 12 subtasks`. Bags that were
/// judged only by the published rules have no strict verdict.
fn result_line(results: &Results) -> String {
    let Overall { episodes, strict_success, success, .. } = &results.overall;
    let (hits, judge, score) = match (strict_success, &results.score_strict) {
        (Some(strict), score) => (strict.hits, "strict", score.as_ref()),
        (None, _) => (success.hits, "published", Some(&results.score)),
    };
    let mean = score.and_then(|score| score.mean).map_or_else(String::new, |mean| format!(", S {mean:.3}"));
    let covers = if mean.is_empty() { String::new() } else { format!(" {}", coverage(results)) };
    format!("{}: {hits}/{episodes} {judge}{mean}{covers}", plain(&results.policy))
}

/// The scores under each seed, or of many only the least and the greatest.
fn by_seed(score: &Score) -> String {
    let one = |row: &SeedRow| format!("{}: {:.4}", row.seed, row.score);
    let span = |row: &SeedRow| format!("{:.4} (seed {})", row.score, row.seed);
    let order = |a: &&SeedRow, b: &&SeedRow| a.score.total_cmp(&b.score);
    let rows = &score.per_seed;
    match (rows.iter().min_by(order), rows.iter().max_by(order)) {
        (Some(least), Some(most)) if rows.len() > MANY_SEEDS => format!("from {} to {}", span(least), span(most)),
        _ => rows.iter().map(one).collect::<Vec<_>>().join(", "),
    }
}

fn table(out: &mut String, tasks: &[TaskResult], scored: bool) {
    let score_head = if scored { "     s   std" } else { "" };
    let half = |name: &str| format!("  {name:-^width$}", width = if scored { 22 } else { 10 });
    let _ = writeln!(out, "{:<30}{}{}", "", half(" strict "), half(" published "));
    let _ = writeln!(
        out,
        "{:<26} {:>3}  {:>5}{:>5}{score_head}  {:>5}{:>5}{score_head}",
        "task", "n", "succ", "gate", "clean", "gate"
    );
    for task in tasks {
        let name = format!("{} {}", task.id, task.name);
        let score = |mean: Option<f64>, std: Option<f64>| {
            if scored { format!(" {} {}", share(mean, 3), share(std, 3)) } else { String::new() }
        };
        let _ = writeln!(
            out,
            "{name:<26.26} {:>3}  {}{}{}  {}{}{}",
            task.episodes,
            share(task.strict_success_rate, 2),
            share(task.strict_progress, 2),
            score(task.strict_score_mean, task.strict_score_std),
            share(Some(task.clean_success_rate), 2),
            share(Some(task.gate_progress), 2),
            score(Some(task.score_mean), task.score_std),
        );
    }
    let _ = writeln!(out, "\n{ENDS}");
    for task in tasks {
        let mut ends: Vec<_> = task.ends.iter().collect();
        ends.sort_by_key(|(cause, count)| (std::cmp::Reverse(**count), (*cause).clone()));
        let ends: Vec<_> = ends.into_iter().map(|(cause, count)| format!("{cause} {count}")).collect();
        let line = format!("  {:<8}{}", task.id, ends.join(", "));
        let _ = writeln!(out, "{}", wrapped(&line, "          "));
    }
}

/// The subtasks within the errands of a relay.
fn parts(out: &mut String, results: &Results) {
    let protocol = &results.conditions.protocol;
    let _ = writeln!(out, "\nSubtasks within the errand, from the states they were handed over in, {protocol}");
    let _ = writeln!(out, "{:<26} {:>7} {:>5} {:>5}  95 %          played by", "subtask", "reached", "succ", "rate");
    for part in &results.parts {
        let name = format!("{} {}", part.id, part.name);
        let [low, high] = part.success_interval;
        let rate = match part.reached {
            0 => format!("{:>5}  {:<12}", "-", "-"),
            _ => format!("{:>5.2}  {low:.2} to {high:.2}", part.success_rate),
        };
        let policy = plain(&part.policy);
        let _ = writeln!(out, "{name:<26.26} {:>7} {:>5} {rate}  {policy}", part.reached, part.successes);
    }
}

fn excluded(out: &mut String, results: &Results) {
    if results.excluded.is_empty() {
        return;
    }
    let failed = if results.run.is_some() { ", each a failure" } else { "" };
    let _ = writeln!(out, "\nNot scored ({}{failed})", count(results.excluded.len(), "bag"));
    for bag in &results.excluded {
        let what = match (&bag.task, bag.seed, bag.reason) {
            (_, _, Fault::Unreadable | Fault::Unfinished | Fault::Lost) | (None, ..) | (_, None, _) => String::new(),
            (Some(task), Some(seed), _) => {
                format!(" ({task}, seed {seed}: {} steps, progress {:.2})", bag.steps, bag.gate_progress)
            }
        };
        let line = format!("  {}: {}: {}{what}", bag.bag, bag.reason.name(), bag.detail);
        let _ = writeln!(out, "{}", wrapped(&line, "      "));
    }
}

/// A share in five columns; a dash for `None`.
fn share(value: Option<f64>, digits: usize) -> String {
    value.map_or("    -".into(), |value| format!("{value:>5.digits$}"))
}

/// A text on one or several lines: breaks it at spaces and indents all but the first. Long words stay whole.
fn wrapped(text: &str, indent: &str) -> String {
    let text = plain(text);
    let mut lines = vec![String::new()];
    let mut used = 0;
    for (i, word) in text.split(' ').enumerate() {
        let length = word.chars().count();
        if i > 0 && used + 1 + length > WIDTH - 2 {
            lines.push(format!("{indent}{word}"));
            used = indent.len() + length;
            continue;
        }
        if let Some(line) = lines.last_mut() {
            if i > 0 {
                line.push(' ');
            }
            line.push_str(word);
            used += length + usize::from(i > 0);
        }
    }
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Codes are put around words; nothing else changes.
    #[test]
    fn colours_are_of_results_alone() {
        let text = format!(
            "walk: 1/2 strict\n\n{:30}-- strict --\ntask                         n   succ\nS05 carry to 1.00 and 0.00 3    1.00 0.00 -\n\n{ENDS}\n  \
             S05     success 1, fall 1\n\n  Success, strict 0.00 success\n",
            ""
        );
        let painted = painted(&text);
        let codes = ["1", "0", "31", "32", "90"].map(|code| format!("\x1b[{code}m"));
        assert_eq!(codes.iter().fold(painted.clone(), |text, code| text.replace(code, "")), text);
        let lines: Vec<&str> = painted.lines().collect();
        assert_eq!(lines[0], "\x1b[1mwalk: 1/2 strict\x1b[0m");
        assert!(lines[4].ends_with("\x1b[32m1.00\x1b[0m \x1b[90m0.00\x1b[0m \x1b[90m-\x1b[0m"), "{:?}", lines[4]);
        assert_eq!(lines[7], "  S05     \x1b[32msuccess\x1b[0m 1, \x1b[31mfall\x1b[0m 1");
        assert!(!lines[9].contains('\x1b'), "{:?}", lines[9]);
    }
}
