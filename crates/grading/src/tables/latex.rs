//! The subtasks for a paper, with the rules of the `booktabs` package.

use std::fmt::Write;

use fiatlux_proto::count;

use super::{conditions_line, coverage, run_line, seed_count};
use crate::{RateRow, Results, TaskResult};

/// A `table` environment that can be pasted into a paper.
pub fn latex(results: &Results) -> String {
    let mut out = String::from("% needs \\usepackage{booktabs}\n\\begin{table}[t]\n\\centering\n\\small\n");
    let conditions = conditions_line(&results.conditions);
    let episodes = count(results.episodes.len(), "episode");
    let run = results.run.as_ref().map(|run| format!(" {}.", escape(&run_line(run)))).unwrap_or_default();
    let _ = writeln!(
        out,
        "\\caption{{Fiatlux results of policy \\emph{{{}}}: {episodes}, {}, {}. CSR: clean success rate; SR: success \
         rate; $\\bar\\rho$: mean gate progress; $s$: mean and sample standard deviation over the seeds; each by the \
         strict and by the published gates.{run}}}",
        escape(&results.policy),
        escape(&seed_count(results)),
        escape(&conditions),
    );
    out.push_str("\\begin{tabular}{l r r r r r r r r}\n\\toprule\n");
    out.push_str(
        " & & \\multicolumn{3}{c}{strict} & \\multicolumn{4}{c}{published} \\\\\n\
         \\textbf{Subtask} & $w$ & \\textbf{SR} & $\\bar\\rho$ & $s$ & \\textbf{CSR} & \\textbf{SR} & $\\bar\\rho$ & \
         $s$ \\\\\n\\midrule\n",
    );
    results.subtasks.iter().for_each(|task| row(&mut out, task, true));
    if !results.extra_tasks.is_empty() {
        out.push_str("\\midrule\n");
        results.extra_tasks.iter().for_each(|task| row(&mut out, task, false));
    }
    if results.score.mean.is_some() {
        let (strict, overall) = (results.score_strict.as_ref(), &results.overall);
        let rate = |row: Option<&RateRow>| share(row.and_then(|row| row.rate));
        let _ = writeln!(
            out,
            "\\midrule\n\\textbf{{Benchmark}} $S$ {} & & {} & & {} & {} & {} & & {} \\\\",
            coverage(results),
            rate(overall.strict_success.as_ref()),
            spread(strict.and_then(|score| score.mean), strict.and_then(|score| score.std)),
            rate(Some(&overall.clean_success)),
            rate(Some(&overall.success)),
            spread(results.score.mean, results.score.std),
        );
    }
    out.push_str("\\bottomrule\n\\end{tabular}\n");
    if !results.missing.is_empty() {
        let _ = writeln!(
            out,
            "\\\\[2pt] \\footnotesize Without a scored episode under at least one seed: {}.",
            results.missing.join(", ")
        );
    }
    out.push_str("\\label{tab:fiatlux-results}\n\\end{table}\n");
    out
}

fn row(out: &mut String, task: &TaskResult, scored: bool) {
    let weight = if scored { format!("{:.2}", task.weight) } else { "--".into() };
    let score = |mean: Option<f64>, std: Option<f64>| spread(mean.filter(|_| scored), std);
    let _ = writeln!(
        out,
        "{} {} & {weight} & {} & {} & {} & {:.2} & {:.2} & {:.2} & {} \\\\",
        task.id,
        escape(&task.name),
        share(task.strict_success_rate),
        share(task.strict_progress),
        score(task.strict_score_mean, task.strict_score_std),
        task.clean_success_rate,
        task.success_rate,
        task.gate_progress,
        score(Some(task.score_mean), task.score_std),
    );
}

fn share(value: Option<f64>) -> String {
    value.map_or("--".into(), |value| format!("{value:.2}"))
}

fn spread(mean: Option<f64>, std: Option<f64>) -> String {
    match (mean, std) {
        (Some(mean), Some(std)) => format!("${mean:.3} \\pm {std:.3}$"),
        (Some(mean), None) => format!("{mean:.3}"),
        (None, _) => "--".into(),
    }
}

fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => out.extend(['\\', c]),
            '\\' => out.push_str("\\textbackslash{}"),
            '~' => out.push_str("\\textasciitilde{}"),
            '^' => out.push_str("\\textasciicircum{}"),
            c if c.is_control() => out.push(' '),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_cannot_break_out() {
        assert_eq!(escape("a_b \\input{x} 5%"), "a\\_b \\textbackslash{}input\\{x\\} 5\\%");
    }
}
