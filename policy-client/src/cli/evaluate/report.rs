//! Prints the outcome of a run, as a table or as JSON.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

use fiatlux_cli::report;
use fiatlux_client::{EpisodeFate, EpisodeOutcome, RunOutcome, Shard};
use fiatlux_proto::plain;
use serde_json::{Value, json};

/// The table's row for one task.
#[derive(Debug, Default)]
struct Row<'a> {
    episodes: usize,
    played: usize,
    success: usize,
    failed: usize,
    lost: usize,
    /// Number of episodes without success by cause.
    causes: BTreeMap<&'a str, usize>,
}

/// Prints a table with a row for each task, or JSON with every episode.
pub fn print(outcome: &RunOutcome, policy: &str, as_json: bool) -> std::io::Result<()> {
    if as_json {
        return fiatlux_cli::print(format!("{:#}\n", as_json_value(outcome, policy)));
    }
    fiatlux_cli::print_headed(table(outcome, policy))
}

/// Reports on stderr what was not played, and how to continue.
pub fn tell(outcome: &RunOutcome, run_file: &Path, shard: Option<Shard>) {
    for episode in outcome.episodes.iter().filter(|episode| episode.fate == EpisodeFate::Failed) {
        report(format!("failed: {}: {}", name(episode), plain(&episode.cause)));
    }
    let lost: Vec<_> = outcome.episodes.iter().filter(|episode| episode.fate == EpisodeFate::Lost).collect();
    let left = lost.len();
    if outcome.stopped && outcome.episodes.is_empty() {
        report("stopped before the run was registered");
    } else if outcome.stopped {
        report(format!("stopped with {left} of {} episodes to play; nothing is lost", outcome.episodes.len()));
    } else {
        lost.iter().for_each(|episode| report(format!("lost: {}: {}", name(episode), plain(&episode.cause))));
    }
    let file = run_file.display();
    if outcome.finished {
        report(format!(
            "run {0} is finished. Grade it on the server's machine: scorer grade DIR/{0}, with the DIR of its --record. For \
             another run, name another --run-file than {file}",
            outcome.run
        ));
    } else if let Some(shard) = shard.filter(|_| outcome.is_whole()) {
        report(format!("shard {shard} of run {} is played; the run is finished with the last shard", outcome.run));
    } else {
        report(format!("run {} is not finished: the same command continues it with the key in {file}", outcome.run));
    }
}

fn name(episode: &EpisodeOutcome) -> String {
    let seed = episode.seed.map_or_else(String::new, |seed| format!(" seed {seed}"));
    format!("{}{seed}", episode.task)
}

fn rows(outcome: &RunOutcome) -> Vec<(&str, Row<'_>)> {
    let mut rows: Vec<(&str, Row<'_>)> = Vec::new();
    for episode in &outcome.episodes {
        let place = rows.iter().position(|(task, _)| *task == episode.task).unwrap_or_else(|| {
            rows.push((&episode.task, Row::default()));
            rows.len() - 1
        });
        let row = &mut rows[place].1;
        row.episodes += 1;
        match episode.fate {
            EpisodeFate::Played => row.played += 1,
            EpisodeFate::Failed => row.failed += 1,
            EpisodeFate::Lost => row.lost += 1,
        }
        if episode.success {
            row.success += 1;
        } else if episode.fate != EpisodeFate::Lost {
            *row.causes.entry(&episode.cause).or_default() += 1;
        }
    }
    rows
}

fn table(outcome: &RunOutcome, policy: &str) -> String {
    let rows = rows(outcome);
    let sum = |of: fn(&Row<'_>) -> usize| rows.iter().map(|(_, row)| of(row)).sum::<usize>();
    let width = rows.iter().map(|(task, _)| task.len()).max().unwrap_or(0).max("task".len());
    let [success, all] = [sum(|row| row.success), sum(|row| row.episodes)];
    let servers = outcome.servers.join(", ");
    let mut text = format!("{policy}: {success}/{all} succeeded\n  run {}, on {servers}\n\n", outcome.run);
    // Writing to a string cannot fail.
    let success = format!("{} success", outcome.protocol);
    let column = success.len();
    let _ = writeln!(text, "{:width$}  {:>9}  {success}  {:>6}  {:>4}  ended by", "task", "played", "failed", "left");
    let mut line = |task: &str, [played, all, success, failed, lost]: [usize; 5], causes: &str| {
        let played = format!("{played}/{all}");
        let line = format!("{task:width$}  {played:>9}  {success:>column$}  {failed:>6}  {lost:>4}  {causes}");
        let _ = writeln!(text, "{}", line.trim_end());
    };
    for (task, row) in &rows {
        let causes: Vec<String> = row.causes.iter().map(|(cause, count)| format!("{} {count}", plain(cause))).collect();
        line(task, [row.played, row.episodes, row.success, row.failed, row.lost], &causes.join(", "));
    }
    let all = [sum(|r| r.played), sum(|r| r.episodes), sum(|r| r.success), sum(|r| r.failed), sum(|r| r.lost)];
    line("all", all, "");
    text
}

fn as_json_value(outcome: &RunOutcome, policy: &str) -> Value {
    let task = |(task, row): &(&str, Row<'_>)| {
        json!({
            "task": task, "episodes": row.episodes, "played": row.played, "success": row.success,
            "failed": row.failed, "lost": row.lost, "causes": row.causes,
        })
    };
    let episode = |episode: &EpisodeOutcome| {
        let fate = match episode.fate {
            EpisodeFate::Played => "played",
            EpisodeFate::Failed => "failed",
            EpisodeFate::Lost => "lost",
        };
        json!({
            "task": episode.task, "seed": episode.seed, "state": fate, "cause": episode.cause,
            "success": episode.success, "digest": episode.digest, "attempts": episode.attempts, "server": episode.server,
        })
    };
    json!({
        "run": outcome.run, "policy": policy, "protocol": outcome.protocol, "servers": outcome.servers, "finished": outcome.finished,
        "stopped": outcome.stopped, "tasks": rows(outcome).iter().map(task).collect::<Vec<_>>(),
        "episodes": outcome.episodes.iter().map(episode).collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn episode(task: &str, fate: EpisodeFate, cause: &str, success: bool) -> EpisodeOutcome {
        EpisodeOutcome {
            task: task.into(),
            seed: Some(0),
            fate,
            cause: cause.into(),
            success,
            digest: String::new(),
            attempts: 1,
            server: None,
        }
    }

    #[test]
    fn a_table_has_a_line_for_each_task() {
        let outcome = RunOutcome {
            run: "r".into(),
            episodes: vec![
                episode("S01", EpisodeFate::Played, "success", true),
                episode("S01", EpisodeFate::Played, "fall", false),
                episode("climb", EpisodeFate::Failed, "other rows", false),
                episode("climb", EpisodeFate::Lost, "silence", false),
            ],
            finished: false,
            stopped: false,
            servers: vec!["lab".into()],
            protocol: "published".into(),
        };
        let text = table(&outcome, "zero");
        assert!(text.starts_with("zero: 1/4 succeeded\n"), "{text}");
        assert!(text.contains("  published success  "), "a success names its judge: {text}");
        let words = |line: &str| line.split_whitespace().map(str::to_owned).collect::<Vec<_>>();
        let lines: Vec<Vec<String>> = text.lines().skip(4).map(words).collect();
        assert_eq!(lines[0], ["S01", "2/2", "1", "0", "0", "fall", "1"], "{text}");
        assert_eq!(lines[1], ["climb", "0/2", "0", "1", "1", "other", "rows", "1"], "{text}");
        assert_eq!(lines[2], ["all", "2/4", "1", "1", "1"], "{text}");
        let json = as_json_value(&outcome, "zero");
        assert_eq!((&json["tasks"][0]["causes"]["fall"], &json["episodes"][3]["state"]), (&json!(1), &json!("lost")));
    }
}
