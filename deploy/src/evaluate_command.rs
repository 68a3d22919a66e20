//! `fiatlux evaluate`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use clap::Args;
use fiatlux::evaluate::{EvaluateOptions, Outcome, Progress, evaluate};
use fiatlux_link::ProgressLine;
use fiatlux_policy::{SessionArgs, policies};
use fiatlux_rules::{CONTROL_DT, Task};
use fiatlux_scorer::{report, tables};

/// Shown below the options.
pub const EXAMPLES: &str = "Examples:
  fiatlux evaluate --policy zero                          the twelve subtasks in rooms 0 to 3
  fiatlux evaluate --policy stand --tasks S05,S06 --seeds 0..9
  fiatlux evaluate --policy hold --tasks climb --seeds 0 --json

Exit codes: 0 ok, 1 failed, 2 usage, 3 finished with episodes that are missing.";

/// Options of the command.
#[derive(Debug, Args)]
pub struct EvaluateArgs {
    /// Policy: zero, random, hold or stand.
    #[arg(long, value_parser = policy)]
    policy: String,
    /// Tasks: all (the twelve subtasks), or a list such as S01,S05,replace,climb.
    #[arg(long, default_value = "all", value_parser = tasks)]
    tasks: TaskList,
    /// Layout seeds: a range such as 0..3, which includes both ends, or a list such as 0,7.
    #[arg(long, default_value = "0..3", value_parser = seeds)]
    seeds: SeedList,
    /// Output folder [default: results/POLICY].
    #[arg(long)]
    out: Option<PathBuf>,
    /// Episodes at once [default: one a core].
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256))]
    workers: Option<u16>,
    /// Prints results.json in place of the table.
    #[arg(long)]
    json: bool,
    /// Folder of meshes of the robot's links in metres, LINK.stl or LINK.obj such as those of Unitree's description: pictures
    /// show them in place of our own shapes. Runs whose policies see such pictures are not ranked.
    #[arg(long, value_name = "DIR")]
    meshes: Option<PathBuf>,
    #[command(flatten)]
    session: SessionArgs,
}

#[derive(Debug, Clone)]
struct TaskList(Vec<Task>);

#[derive(Debug, Clone)]
struct SeedList(Vec<u64>);

fn policy(name: &str) -> Result<String, String> {
    if name.starts_with("replay:") {
        return Err("a bag is one episode; replay it with policy-client run, or compare it with scorer verify".into());
    }
    policies::by_name(name).map(|_| name.into()).map_err(|error| error.to_string())
}

fn tasks(text: &str) -> Result<TaskList, String> {
    let mut tasks = Vec::new();
    for name in text.split(',') {
        let named = match name.trim() {
            "all" => Task::SUBTASKS.to_vec(),
            name => vec![name.parse().map_err(|error| format!("{error}, or all for the twelve subtasks"))?],
        };
        tasks.extend(named);
    }
    tasks.sort();
    tasks.dedup();
    Ok(TaskList(tasks))
}

fn seeds(text: &str) -> Result<SeedList, String> {
    /// More rooms than anyone has time for.
    const MOST: u64 = 10_000;
    let number = |text: &str| {
        let refused = |_| format!("'{text}' is no seed; give a range such as 0..3 or a list such as 0,7");
        text.trim().parse::<u64>().map_err(refused)
    };
    let mut seeds = Vec::new();
    for part in text.split(',') {
        match part.split_once("..") {
            None => seeds.push(number(part)?),
            Some((first, last)) => {
                let (first, last) = (number(first)?, number(last.trim_start_matches('='))?);
                if last < first || last - first >= MOST {
                    return Err(format!("'{part}' is no range of 1 to {MOST} seeds, from the first to the last"));
                }
                seeds.extend(first..=last);
            }
        }
    }
    seeds.sort_unstable();
    seeds.dedup();
    Ok(SeedList(seeds))
}

/// Runs the command.
pub fn run(args: &EvaluateArgs) -> anyhow::Result<ExitCode> {
    fiatlux_link::init_quiet_log();
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    // A policy may be named by a path.
    let folder = args.policy.replace(|c: char| !c.is_ascii_alphanumeric() && c != '-', "_");
    let mut session = args.session.clone();
    let options = EvaluateOptions {
        policy: args.policy.clone(),
        tasks: args.tasks.0.clone(),
        seeds: args.seeds.0.clone(),
        out: args.out.clone().unwrap_or_else(|| PathBuf::from("results").join(folder)),
        workers: args.workers.map_or(cores, usize::from),
        weights: session.split_weights(),
        meshes: args.meshes.clone(),
        session,
    };
    let stop = fiatlux_link::stop_on_signal().context("cannot listen for Ctrl-C")?;
    let line = ProgressLine::default();
    let outcome = evaluate(&options, &stop, &mut |progress| line.show(|| look(&line, progress)));
    line.clear();
    let outcome = outcome?;
    write_results(&options, &outcome)?;
    if args.json {
        fiatlux_link::print(outcome.results.to_json()?);
    } else {
        fiatlux_link::print(tables::text(&outcome.results));
    }
    for lost in &outcome.lost {
        eprintln!("lost: {lost}");
    }
    let out = options.out.display();
    if outcome.resumed > 0 {
        eprintln!("{} episodes were in {out} already and were not run again", outcome.resumed);
    }
    eprintln!("bags, results.json and report.html are in {out}");
    if outcome.stopped {
        eprintln!("stopped before the end; the same command goes on from here");
    }
    let whole = outcome.lost.is_empty() && !outcome.stopped;
    Ok(if whole { ExitCode::SUCCESS } else { ExitCode::from(3) })
}

fn look(line: &ProgressLine, progress: &Progress) -> String {
    let Progress { episodes, finished, steps, steps_left, playing } = progress;
    let (rate, left) = (line.rate(*steps), line.left(*steps, steps + steps_left));
    let mut text = format!("{finished}/{episodes} episodes, {rate:.0} steps/s, at most {left} left");
    for (task, seed, step) in playing {
        text += &format!("  {task}/{seed} at {:.0} s", *step as f64 * CONTROL_DT);
    }
    text
}

fn write_results(options: &EvaluateOptions, outcome: &Outcome) -> anyhow::Result<()> {
    for (name, text) in [("results.json", outcome.results.to_json()?), ("report.html", report::html(&outcome.results))]
    {
        let path = options.out.join(name);
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn lists_of_tasks() {
        assert_eq!(tasks("all").unwrap().0, Task::SUBTASKS);
        assert_eq!(tasks("climb, s5,S05").unwrap().0, [Task::S05, Task::Climb]);
        assert!(tasks("S05,S13").unwrap_err().starts_with("there is no task 'S13'"));
    }

    #[test]
    fn lists_of_seeds() {
        assert_eq!(seeds("0..3").unwrap().0, [0, 1, 2, 3]);
        assert_eq!(seeds("7,0..=1,7").unwrap().0, [0, 1, 7]);
        for bad in ["", "x", "3..1", "0..99999999", "-1"] {
            assert!(seeds(bad).is_err(), "{bad}");
        }
    }
}
