//! The command `fiatlux evaluate --external`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use fiatlux_cli::ProgressLine;
use fiatlux_client::RunProgress;
use fiatlux_proto::keys::is_name;
use fiatlux_proto::v3::OpenRequest;
use fiatlux_runs::{EvaluateError, ExternalOptions, ExternalProgress, evaluate_external};
use fiatlux_world::SceneConfig;

use super::EvaluateArgs;
use super::outcome::finish;

/// Parses the name of a server.
pub(super) fn name(text: &str) -> Result<String, String> {
    if is_name(text) { Ok(text.into()) } else { Err("use 1 to 64 letters, digits, - or _".into()) }
}

/// Serves one run, and writes and prints its outcome.
pub(super) fn run(args: &EvaluateArgs) -> anyhow::Result<ExitCode> {
    if args.tasks.is_some() || args.seeds.is_some() {
        return Ok(refuse("the client names tasks and seeds: give --tasks and --seeds to policy-client evaluate"));
    }
    let mut session = args.session.clone();
    let weights = session.split_weights();
    let mut asked = OpenRequest::default();
    session.apply(&mut asked);
    asked.weights.clear();
    if asked != OpenRequest::default() {
        return Ok(refuse(
            "the client chooses the options of its sessions: give these flags to policy-client evaluate",
        ));
    }
    let scene = match SceneConfig::default().with_assets(&args.assets) {
        Ok(scene) => scene,
        Err(error) => return Ok(refuse(&format!("{:#}", anyhow::Error::new(error)))),
    };
    let options = ExternalOptions {
        name: args.name.clone(),
        out: args.out.clone().unwrap_or_else(|| PathBuf::from("results").join(&args.name)),
        thin: args.bags.is_thin(),
        workers: args.workers(),
        weights,
        meshes: args.meshes.clone(),
        scene,
        shard: None,
    };
    let stop = fiatlux_cli::stop_on_signal().context("cannot listen for Ctrl-C")?;
    let (carrier, endpoint) = crate::network::listen(&args.listen, &args.name)?;
    // The rate counts from the registration of the run.
    let mut line = None;
    let mut is_greeted = false;
    let outcome = evaluate_external(carrier, &options, &stop, &mut |progress| match progress {
        ExternalProgress::Waiting => {
            if !std::mem::replace(&mut is_greeted, true)
                && let Err(error) = greet(args, &endpoint)
            {
                tracing::warn!("{error}");
            }
        }
        playing => {
            let line = line.get_or_insert_with(ProgressLine::default);
            line.show(|| look(line, playing));
        }
    });
    if let Some(line) = line {
        line.clear();
    }
    let again = format!(
        "continue it with `fiatlux evaluate --external --name {} --listen {endpoint} --out {}`, and run the client's command \
         again",
        options.name,
        options.out.display()
    );
    if let Err(EvaluateError::Nothing { .. }) = &outcome
        && stop.load(std::sync::atomic::Ordering::Relaxed)
    {
        fiatlux_cli::report(format!("stopped before the end; {again}"));
    }
    finish(args.json, &options.out, &outcome?, &again, &stop)
}

/// Prints what is wrong with the flags, as clap does.
fn refuse(why: &str) -> ExitCode {
    fiatlux_cli::usage(why)
}

/// Prints the command for the client.
fn greet(args: &EvaluateArgs, endpoint: &str) -> std::io::Result<()> {
    let reachable = endpoint.replace("0.0.0.0", "ADDRESS-OF-THIS-MACHINE").replace("[::]", "ADDRESS-OF-THIS-MACHINE");
    let line = format!("policy-client evaluate --policy NAME -e {reachable} --server {}\n", args.name);
    let call = format!("fiatlux.Client(\"{reachable}\").evaluate(YourPolicy, server=\"{}\")", args.name);
    if args.json {
        fiatlux_cli::report(line);
    } else {
        fiatlux_cli::print(line)?;
    }
    fiatlux_cli::report(format!("or in Python: {call}"));
    fiatlux_cli::report(
        "waiting for a run; start it with the command above and the name of your policy, or with the call in Python",
    );
    Ok(())
}

fn look(line: &ProgressLine, progress: &ExternalProgress) -> String {
    let ExternalProgress::Playing { run, policy, progress } = progress else {
        return "waiting for a run".into();
    };
    let RunProgress { episodes, done, successes, steps, steps_left, playing, .. } = progress;
    let left = if *steps > 0 { line.left(*steps, steps + steps_left) } else { "?".into() };
    let mut text = format!("{policy}, run {run}: {done}/{episodes} episodes, {successes} succeeded, about {left} left");
    for episode in playing {
        text += &format!("  {}", episode.name());
    }
    text
}
