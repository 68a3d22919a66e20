//! The subtasks for a paper, with the rules of the `booktabs` package.

use std::fmt::Write;

use super::{conditions_line, count, force, seed_count};
use crate::{Results, TaskResult};

/// A `table` environment that can be pasted as it is.
pub fn latex(results: &Results) -> String {
    let mut out = String::from("% needs \\usepackage{booktabs}\n\\begin{table}[t]\n\\centering\n\\small\n");
    let conditions = conditions_line(&results.conditions);
    let episodes = count(results.episodes.len(), "episode");
    let _ = writeln!(
        out,
        "\\caption{{Fiatlux results of policy \\emph{{{}}}: {episodes}, {}, {}. CSR: clean success rate; SR: success \
         rate; $\\bar\\rho$: mean gate progress; $s$: mean and sample standard deviation over the seeds.}}",
        escape(&results.policy),
        escape(&seed_count(results)),
        escape(&conditions),
    );
    out.push_str("\\begin{tabular}{l r r r r r r r r}\n\\toprule\n");
    out.push_str(
        "\\textbf{Subtask} & $w$ & \\textbf{CSR} & \\textbf{SR} & $\\bar\\rho$ & $s$ & \\textbf{Broken} & \
         \\textbf{Dropped} & \\textbf{Peak (N)} \\\\\n\\midrule\n",
    );
    results.subtasks.iter().for_each(|task| row(&mut out, task, true));
    if !results.extra_tasks.is_empty() {
        out.push_str("\\midrule\n");
        results.extra_tasks.iter().for_each(|task| row(&mut out, task, false));
    }
    if let Some(mean) = results.score.mean {
        let std = results.score.std.map_or(String::new(), |std| format!(" \\pm {std:.3}"));
        let clean = results.overall.clean_success.rate.unwrap_or_default();
        let success = results.overall.success.rate.unwrap_or_default();
        let _ = writeln!(
            out,
            "\\midrule\n\\textbf{{Benchmark}} & & {clean:.2} & {success:.2} & & $\\mathbf{{{mean:.3}}}{std}$ & & & \\\\"
        );
    }
    out.push_str("\\bottomrule\n\\end{tabular}\n");
    if !results.missing.is_empty() {
        let _ =
            writeln!(out, "\\\\[2pt] \\footnotesize Missing under at least one seed: {}.", results.missing.join(", "));
    }
    out.push_str("\\label{tab:fiatlux-results}\n\\end{table}\n");
    out
}

fn row(out: &mut String, task: &TaskResult, scored: bool) {
    let weight = if scored { format!("{:.2}", task.weight) } else { "--".into() };
    let score = match (scored, task.score_std) {
        (true, Some(std)) => format!("${:.3} \\pm {std:.3}$", task.score_mean),
        (true, None) => format!("{:.3}", task.score_mean),
        (false, _) => "--".into(),
    };
    let _ = writeln!(
        out,
        "{} {} & {weight} & {:.2} & {:.2} & {:.2} & {score} & {:.2} & {:.2} & {} \\\\",
        task.id,
        escape(&task.name),
        task.clean_success_rate,
        task.success_rate,
        task.gate_progress,
        task.broken_rate,
        task.dropped_rate,
        force(task.peak_hand_force_n),
    );
}

/// What TeX would read as a command is shown as it is.
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
