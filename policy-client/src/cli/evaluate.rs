//! The command `policy-client evaluate`.

mod plan;
mod report;

use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context as _;
use clap::Args;
use fiatlux_cli::{ProgressLine, stop_on_signal};
use fiatlux_client::{
    AccessArgs, Client, Policy, PolicyError, RunFile, RunFileError, RunOptions, RunProgress, SeedList, SessionArgs,
    Shard, TaskList,
};
use fiatlux_link::{CarrierArgs, Role};
use fiatlux_policies::{Policies, VlaArgs, VlaSource, relayed};
use fiatlux_rules::{CONTROL_DT, Guest, Relay};

use super::{Failure, model_server};

/// Name of the policy that plays a model server's actions.
const VLA: &str = "vla";
/// Largest number of running episodes that the progress line names.
const MAX_SHOWN: usize = 3;

/// Options of the command `evaluate`.
#[derive(Debug, Args)]
#[command(after_help = "What happens:
  The run is registered on the server, under a name and a secret key, which are drawn here and kept in the run file.
  Each episode, one for each task and seed, is then played once, several at a time, and recorded by the server, which
  keeps the score. With the run file the same command continues after Ctrl-C, a crash or the loss of a server; an
  episode that was cut off is played again from its start, and the server compares its rows. When all are played the
  run is closed: nothing can be added to it.

Several servers:
  --server lab plays on all servers named lab or lab-SOMETHING that can be reached. If one is lost, its episodes go to
  the others; one that appears later joins. Hosted seeds are drawn by one server, which then has to play the whole run;
  with --shared-seeds by servers that were started with one --seed-key and --seed-group, each of which plays its part.

Examples:
  policy-client evaluate --policy stand -e tcp/192.168.1.7:7447
  policy-client evaluate --policy stand -e tcp/lab:7447 --tasks S01,S05 --seeds 0..9 --parallel 4
  policy-client evaluate --policy stand -e tcp/lab:7447 --hosted 4 --policy-version 1.2 --link https://example.org/stand
  policy-client evaluate --policy vla --dialect gr00t --model tcp://lab:5555 -e tcp/lab:7447
  policy-client evaluate --policy expert --with S03=vla --dialect openpi --model ws://lab:8000 -e tcp/lab:7447
  policy-client evaluate --policy zero -e tcp/a:7447 -e tcp/b:7447 --server lab --run-file zero.toml

A policy of your own, in Rust: `fiatlux_client::Client::evaluate`.

Exit codes: 0 all played, 1 failed, 2 usage, 3 some episodes were not played or count as failures, or stopped by Ctrl-C;
130 where Ctrl-C is pressed twice.")]
pub struct EvaluateArgs {
    /// Name of the policy, see `policy-client list --policies`; vla takes --dialect and --model, and replay:BAG plays the one
    /// episode of its bag
    #[arg(short, long, value_name = "NAME")]
    policy: String,
    /// With --policy expert, in the task replace: another policy for one subtask of the errand, such as S03=vla; repeat it for
    /// more. All else is the expert's. Such runs are never ranked
    #[arg(long = "with", value_name = "SUBTASK=POLICY")]
    guests: Vec<Guest>,
    /// Tasks: all (the twelve subtasks), or a list such as S01,S05,replace,climb [default: all]
    #[arg(short, long, value_name = "LIST")]
    tasks: Option<TaskList>,
    /// Layout seeds: a range such as 0..3, which includes both ends, a list such as 0,7, or fresh:64, which draws 64 rooms that
    /// nobody has seen and keeps them next to the run file [default: 0..3]
    #[arg(short, long, value_name = "LIST", allow_hyphen_values = true)]
    seeds: Option<SeedList>,
    /// Number of seeds to be drawn by the server when the run is registered; it discloses them when the run is over
    #[arg(long, value_name = "N", conflicts_with = "seeds", value_parser = fiatlux_cli::whole::<u32>(1..=10_000))]
    hosted: Option<u32>,
    /// With --hosted: play on all servers of the group, which draw the same seeds (sim-server --seed-group)
    #[arg(long, requires_all = ["hosted", "server"])]
    shared_seeds: bool,
    /// Name of the server, or of a group of servers; not needed if there is only one
    #[arg(long, value_name = "NAME")]
    server: Option<String>,
    /// Episodes to play at once, over all servers [default: as many as the servers accept, at most 8 each]
    #[arg(long, value_name = "N", value_parser = fiatlux_cli::whole::<u16>(1..=1024))]
    parallel: Option<u16>,
    /// Version of the policy, for the record
    #[arg(long, value_name = "VERSION", default_value = "")]
    policy_version: String,
    /// Address with a description of the policy, for the record
    #[arg(long = "link", value_name = "URL", default_value = "")]
    policy_link: String,
    /// File with the run's name and secret key; created if it does not exist
    #[arg(long, value_name = "PATH", default_value = "RUN.toml")]
    run_file: PathBuf,
    /// Close the run even if episodes could not be played: they count as failures and can no longer be played
    #[arg(long)]
    finish: bool,
    /// Longest wait for servers that are gone, do not answer, or do not let anything be played, s
    #[arg(long, value_name = "SECONDS", default_value_t = 60, value_parser = fiatlux_cli::whole::<u32>(1..=86_400))]
    patience: u32,
    /// Play part K of N of the episodes alone, such as 2/4: the second and every fourth after it; auto takes K and N from
    /// Slurm's array or Kubernetes' indexed Job. All parts have one --run-file; whoever plays the last episode closes the run.
    /// With --finish a part closes it on its servers, which no other part may use then
    #[arg(long, value_name = "K/N", conflicts_with = "hosted")]
    shard: Option<Shard>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    vla: VlaArgs,
    #[command(flatten)]
    session: SessionArgs,
    #[command(flatten)]
    access: AccessArgs,
    #[command(flatten)]
    connection: CarrierArgs,
}

impl EvaluateArgs {
    /// The policy that takes --model: the one of the relay that does, if there is one.
    fn of_model(&self) -> &str {
        let of_guest = self.guests.iter().map(|guest| guest.policy.as_str()).find(|policy| *policy == VLA);
        of_guest.unwrap_or(&self.policy)
    }

    /// Makes the policy, where it needs one with its model server.
    fn make(&self, model: Option<&VlaSource>) -> Result<Box<dyn Policy>, PolicyError> {
        let make = |name: &str| match model {
            Some(source) if name == VLA => Ok(Box::new(source.policy()) as Box<dyn Policy>),
            _ => Policies::default().make(name),
        };
        if self.guests.is_empty() {
            return make(&self.policy);
        }
        relayed(&Relay { host: self.policy.clone(), guests: self.guests.clone() }, make)
    }
}

/// Plays the run and prints the outcome; returns whether every episode was played.
pub fn evaluate(args: &EvaluateArgs) -> Result<bool, Failure> {
    let model = model_server(args.of_model(), &args.vla, args.session.robot(), false)?;
    let mut spec = plan::spec(args, model.as_ref())?;
    if let Some(seeds) = args.seeds.as_ref().filter(|seeds| seeds.fresh) {
        let file = args.run_file.with_extension("seeds");
        let drawn = seeds.clone().recorded(&file).with_context(|| file.display().to_string())?;
        spec.seeds = drawn.seeds;
        let list: Vec<String> = spec.seeds.iter().map(u64::to_string).collect();
        fiatlux_cli::report(format!("rooms {}, in {}", list.join(", "), file.display()));
    }
    let stop = stop_on_signal()?;
    let open = || {
        RunFile::open(&args.run_file, &spec).map_err(|error| match error {
            RunFileError::Other { .. } => Failure::Usage(error.to_string()),
            other => other.into(),
        })
    };
    // A file that does not fit is reported at once; a new one is written only when a server is there to register with.
    let known = if args.run_file.exists() { Some(open()?) } else { None };
    // One of several servers may be down at the start: the others play meanwhile.
    let role = if args.connection.connect.len() > 1 { Role::Server } else { Role::Client };
    let link = args.connection.open_unless(role, &stop)?;
    let file = known.map_or_else(open, Ok)?;
    let options = RunOptions {
        server: args.server.clone(),
        parallel: args.parallel.map(usize::from),
        give_up_lost: args.finish,
        access: args.access.read()?,
        patience: Duration::from_secs(args.patience.into()),
        shard: args.shard,
        is_alone: args.finish,
        shares_seeds: args.shared_seeds,
        ..RunOptions::new(file)
    };
    let line = ProgressLine::default();
    let make_policy = || args.make(model.as_ref());
    let mut progress = |progress: &RunProgress| line.show(|| look(&line, progress, options.file.protocol()));
    let outcome = Client::evaluate(&link.carrier(), &options, make_policy, &mut progress, &stop);
    line.clear();
    let outcome = outcome?;
    let printed = report::print(&outcome, &args.policy, args.json);
    report::tell(&outcome, &args.run_file, args.shard);
    printed?;
    Ok(outcome.is_whole() && (outcome.finished || args.shard.is_some()))
}

fn look(line: &ProgressLine, progress: &RunProgress, protocol: &str) -> String {
    let RunProgress { episodes, done, successes, lost, held, steps, steps_left, playing, servers } = progress;
    if *episodes == 0 {
        return "the run is being registered".into();
    }
    let (rate, left) = (line.rate(*steps), line.left(*steps, steps + steps_left));
    let mut text =
        format!("{done}/{episodes} episodes, {successes} {protocol} success, {rate:.0} steps/s, about {left} left");
    if *lost > 0 {
        text += &format!(", {lost} lost");
    }
    if *held > 0 {
        text += &format!(", {held} open for another client of this run");
    }
    if servers.is_empty() {
        text += ", waiting for a server";
    }
    for episode in playing.iter().take(MAX_SHOWN) {
        text += &format!("  {} at {:.0} s", episode.name(), episode.step as f64 * CONTROL_DT);
        if servers.len() > 1 {
            text += &format!(" on {}", episode.server);
        }
    }
    if let Some(more @ 1..) = playing.len().checked_sub(MAX_SHOWN) {
        text += &format!("  and {more} more");
    }
    text
}
