//! `fiatlux label`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, bail};
use clap::Args;
use fiatlux_cli::{ProgressLine, in_full, write_whole};
use fiatlux_client::{Client, ClientError};
use fiatlux_policies::{Label, Labeller};
use fiatlux_replay::Bags;
use fiatlux_server::{LocalServer, ServerOptions};
use serde_json::{Value, json};

/// Shown below the options.
pub const EXAMPLES: &str = "Examples:
  fiatlux label takes/S06-s1000-e0.mcap          writes takes/S06-s1000-e0.labels.jsonl
  fiatlux label results/mine --out labels        all bags of a run

A file has a line of JSON for the episode, then one for each action: step, can_label, phase, is_over, part_done, body_command (vx, vy,
wz, height, roll, pitch, yaw; null where the expert commands joints) and joint_target, rad, in the order of `joints` in the first line.
Where the expert cannot go on, can_label is false and reason says why: do not learn from these rows.

Exit codes: 0 ok, 1 failed, 2 usage, 3 stopped, or some bags could not be labelled.";

/// Name of the server in this process.
const SERVER: &str = "label";

/// Options of the command.
#[derive(Debug, Args)]
pub struct LabelArgs {
    /// Bags of episodes, whoever acted in them, or folders with bags.
    #[arg(required = true, value_name = "BAG|DIR")]
    bags: Vec<PathBuf>,
    /// Folder for the labels [default: beside each bag]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Replaces labels that are there; without it their bags are left out.
    #[arg(long)]
    force: bool,
}

/// Runs the command.
pub fn run(args: &LabelArgs) -> anyhow::Result<ExitCode> {
    fiatlux_cli::init_quiet_log();
    let stop = fiatlux_cli::stop_on_signal().context("cannot listen for Ctrl-C")?;
    let jobs = jobs(args)?;
    if let Some(out) = &args.out {
        std::fs::create_dir_all(out).with_context(|| format!("cannot make the folder '{}'", out.display()))?;
    }
    let options = ServerOptions { name: SERVER.into(), workers: 1, ..ServerOptions::default() };
    let server = LocalServer::start(fiatlux_carrier::memory(), options, None)?;
    let (line, mut done, mut failed) = (ProgressLine::default(), 0, 0);
    for (number, (bag, file)) in jobs.iter().enumerate() {
        if file.exists() && !args.force {
            fiatlux_cli::report(format!("{}: is there; replace it with --force", file.display()));
            continue;
        }
        let look = |step: u64, all: u64| {
            line.show(|| format!("{}/{} bags, step {step} of {all}", number + 1, jobs.len()));
        };
        match label(bag, &server, &look, &stop) {
            Ok(text) => {
                write_whole(file, text).with_context(|| format!("cannot write '{}'", file.display()))?;
                line.clear();
                fiatlux_cli::print(format!("{}\n", file.display()))?;
                done += 1;
            }
            Err(_) if stop.load(std::sync::atomic::Ordering::Relaxed) => break,
            Err(error) => {
                line.clear();
                fiatlux_cli::report(format!("{}: {}", bag.display(), in_full(error.as_ref())));
                failed += 1;
            }
        }
    }
    server.stop();
    let stopped = stop.load(std::sync::atomic::Ordering::Relaxed);
    Ok(match (stopped, done, failed) {
        (false, _, 0) => ExitCode::SUCCESS,
        (false, 0, _) => ExitCode::FAILURE,
        _ => ExitCode::from(3),
    })
}

/// Each bag with the file for its labels.
fn jobs(args: &LabelArgs) -> anyhow::Result<Vec<(PathBuf, PathBuf)>> {
    let mut jobs: Vec<(PathBuf, PathBuf)> = Vec::new();
    for path in &args.bags {
        let bags = Bags::find(path)?;
        for bag in (0..bags.count()).filter_map(|index| bags.file(index)) {
            let beside = bag.with_extension("labels.jsonl");
            let file = match (&args.out, beside.file_name()) {
                (Some(out), Some(name)) => out.join(name),
                _ => beside,
            };
            if let Some((other, _)) = jobs.iter().find(|(_, taken)| *taken == file) {
                let (other, bag) = (other.display(), bag.display());
                bail!("labels of '{other}' and '{bag}' have the same name; label them into different folders");
            }
            jobs.push((bag.to_owned(), file));
        }
    }
    Ok(jobs)
}

/// Plays a bag again; the text of its labels.
fn label(bag: &Path, server: &LocalServer, look: &dyn Fn(u64, u64), stop: &AtomicBool) -> anyhow::Result<String> {
    let mut labeller = Labeller::open(bag)?;
    let recorded = labeller.result().and_then(|result| result.end.clone());
    let recorded = recorded.context("the bag was cut before its end; label whole episodes")?;
    let mut client = Client::open(server.carrier(), Some(SERVER), labeller.request())?;
    let steps = recorded.steps;
    let played = client.run_episode(labeller.header().episode, &mut labeller, &mut |step| look(step, steps), stop);
    let digest = match played {
        Ok(end) => end.digest,
        // A take that its operator stopped ends with its last action.
        Err(ClientError::Policy(fiatlux_client::PolicyError::Ended { .. }))
            if recorded.cause == fiatlux_proto::STOPPED =>
        {
            recorded.digest.clone()
        }
        Err(error) => return Err(error.into()),
    };
    // The server ends the session by itself, too.
    drop(client.close());
    if digest != recorded.digest {
        bail!(
            "played again it is another episode; it was recorded in real time, by another version or in another scene"
        );
    }
    let header = labeller.header();
    let first = json!({
        "bag": bag.file_name().map(|name| name.to_string_lossy()),
        "task": header.task, "seed": header.seed, "episode": header.episode, "policy": header.policy,
        "digest": digest, "joints": header.joint_names, "labels": "expert",
    });
    let rows = labeller.labels().iter().enumerate().map(|(step, label)| row(step, label));
    Ok(std::iter::once(first).chain(rows).map(|line| line.to_string() + "\n").collect())
}

/// The line of a step.
fn row(step: usize, label: &Result<Label, fiatlux_client::PolicyError>) -> Value {
    match label {
        Ok(Label { joint_target, body_command, phase, part_done, is_over }) => json!({
            "step": step, "can_label": true, "phase": phase, "is_over": is_over, "part_done": part_done,
            "body_command": body_command.as_ref().map(|command| command.numbers()), "joint_target": joint_target,
        }),
        Err(reason) => json!({ "step": step, "can_label": false, "reason": in_full(reason) }),
    }
}
