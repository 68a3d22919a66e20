//! The episodes as CSV (RFC 4180), for a spreadsheet.

use crate::Results;

const HEAD: &str = "policy,task,seed,episode,success,clean,broken,dropped,gate_progress,peak_hand_force_n,control_effort,\
                    steps,end,steps_in_gate,state_digest,bag,benchmark_version,strict_success,strict_clean,\
                    strict_progress,strict_end,strict_steps,run,run_registered,run_played,run_finished";

/// One line per episode, below a line with the names of the fields in `results.json`. In a run, each line also has the
/// name of the run and its numbers of registered and played episodes: an episode that was not played has no line.
pub fn csv(results: &Results) -> String {
    let mut lines = vec![HEAD.to_owned()];
    let run = results.run.as_ref();
    for e in &results.episodes {
        let fields = [
            quoted(&results.policy),
            e.task.clone(),
            e.seed.to_string(),
            e.episode.to_string(),
            e.success.to_string(),
            e.clean.to_string(),
            e.broken.to_string(),
            e.dropped.to_string(),
            e.gate_progress.to_string(),
            e.peak_hand_force_n.to_string(),
            e.control_effort.to_string(),
            e.steps.to_string(),
            quoted(&e.end),
            e.steps_in_gate.to_string(),
            e.state_digest.clone(),
            quoted(&e.bag),
            results.conditions.benchmark_version.to_string(),
            or_empty(&e.strict_success),
            or_empty(&e.strict_clean),
            or_empty(&e.strict_progress),
            quoted(e.strict_end.as_deref().unwrap_or_default()),
            or_empty(&e.strict_steps),
            quoted(run.map_or("", |run| run.name.as_str())),
            or_empty(&run.map(|run| run.registered)),
            or_empty(&run.map(|run| run.played)),
            or_empty(&run.map(|run| run.finished)),
        ];
        lines.push(fields.join(","));
    }
    lines.join("\n") + "\n"
}

/// The value as text; empty for `None`.
fn or_empty(value: &Option<impl ToString>) -> String {
    value.as_ref().map(ToString::to_string).unwrap_or_default()
}

/// Quotes a cell if necessary. An apostrophe protects a name that a spreadsheet would take for a formula.
fn quoted(text: &str) -> String {
    let text = if text.starts_with(['=', '+', '-', '@', '\t']) { format!("'{text}") } else { text.to_owned() };
    if text.contains(['"', ',', '\n', '\r']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_cannot_break_out() {
        assert_eq!(quoted("zero"), "zero");
        assert_eq!(quoted("a,\"b\""), "\"a,\"\"b\"\"\"");
        assert_eq!(quoted("=1+1"), "'=1+1");
    }
}
