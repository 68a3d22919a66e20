//! The command `fiatlux evaluate`.

mod external;
mod outcome;
mod pictures;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use clap::Args;
use fiatlux_cli::{BagForm, ProgressLine};
use fiatlux_client::{RunProgress, SeedList, SessionArgs, Shard, ShardRecord, TaskList};
use fiatlux_grading::tables;
use fiatlux_policies::{Entry, Policies};
use fiatlux_proto::plain;
use fiatlux_rules::{CONTROL_DT, Guest, Relay, Task};
use fiatlux_runs::{EvaluateError, EvaluateOptions, check_names, evaluate};
use fiatlux_world::{AssetArg, SceneConfig};
use outcome::finish;

const EXAMPLES: &str = "Examples:
  fiatlux evaluate --policy expert                        the twelve subtasks in rooms 0 to 3
  fiatlux evaluate --policy walk --tasks S05 --seeds fresh:16
                                                          16 rooms drawn afresh
  fiatlux evaluate --policy stand --tasks S05,S06 --seeds 0..9
  fiatlux evaluate --policy hold --tasks climb --seeds 0 --json
  fiatlux evaluate --policy expert --with S03=see:FILE --seeds fresh:16
                                                          the errand, and in it one subtask by another policy
  fiatlux evaluate --policy walk --seeds 0..99 --shard 2/4
                                                          every fourth episode; scorer merge makes one result
  fiatlux evaluate --external --name lab --listen tcp/0.0.0.0:7447 --out results/mine
                                                          the same for a policy on another machine

Exit codes: 0 ok, 1 failed, 2 usage, 3 finished with episodes that are missing.";

/// Shown below the options: the policies, each with a line, and examples.
pub fn after_help() -> String {
    let mut text = "Policies:\n".to_owned();
    for Entry { name, does, .. } in Policies::default().entries() {
        text += &format!("  {name:<16}{does}\n");
    }
    text + "\n" + EXAMPLES
}

/// Options of the command.
#[derive(Debug, Args)]
pub struct EvaluateArgs {
    /// Policy: expert, or another of those below and of `fiatlux policies`.
    #[arg(long, required_unless_present = "external")]
    policy: Option<String>,
    /// With --policy expert, in the task replace: another policy for one subtask of the errand, such as S03=see:FILE; repeat it
    /// for more. All else is the expert's. Results say how often that subtask was reached and done; such runs are never ranked.
    #[arg(long = "with", value_name = "SUBTASK=POLICY", requires = "policy")]
    guests: Vec<Guest>,
    /// Serve a policy that connects from elsewhere: start a server that records, print the command for its client, wait
    /// for the run, and grade it at the end.
    #[arg(long, conflicts_with = "policy")]
    external: bool,
    /// With --external: name of the server.
    #[arg(long, requires = "external", default_value = "evaluate", value_parser = external::name)]
    name: String,
    /// With --external: endpoint to listen on; port 0 picks a free one. Other machines can reach tcp/0.0.0.0:PORT.
    #[arg(short, long, requires = "external", value_name = "ENDPOINT", default_value = "tcp/127.0.0.1:0",
          value_parser = crate::network::parse_endpoint)]
    listen: String,
    /// Tasks: all (the twelve subtasks), or a list such as S01,S05,replace,climb (not with --external: the client
    /// chooses) [default: all].
    #[arg(long)]
    tasks: Option<TaskList>,
    /// Layout seeds: a range such as 0..3, which includes both ends, a list such as 0,7, or fresh:64, which draws 64 rooms that
    /// nobody has seen and keeps them in OUT/seeds.txt (not with --external: the client chooses) [default: 0..3].
    #[arg(long, allow_hyphen_values = true)]
    seeds: Option<SeedList>,
    /// Output folder [default: results/POLICY; with --shard results/POLICY-KofN; with --external results/NAME].
    #[arg(long)]
    out: Option<PathBuf>,
    /// Play part K of N of the episodes alone, such as 2/4: the second and every fourth after it. auto takes K and N from
    /// Slurm's array or Kubernetes' indexed Job. `scorer merge` makes one result of all parts.
    #[arg(long, value_name = "K/N", conflicts_with = "external")]
    shard: Option<Shard>,
    /// Form of the bags: thin keeps actions and result alone, a tenth of the size or less, and rows are simulated again when they are
    /// read, also to grade them at the end.
    #[arg(long, value_name = "FORM", value_enum, default_value_t)]
    bags: BagForm,
    /// Number of episodes at once; with --external, number of threads that step them [default: one for each core].
    #[arg(long, value_parser = fiatlux_cli::whole::<u16>(1..=256))]
    workers: Option<u16>,
    /// Print results.json instead of the table.
    #[arg(long)]
    json: bool,
    /// Folder of meshes of the robot's links in metres, LINK.stl or LINK.obj, such as those of Unitree's description:
    /// pictures show them instead of the built-in shapes. Runs whose policies see such pictures are not ranked.
    #[arg(long, value_name = "DIR")]
    meshes: Option<PathBuf>,
    /// Object in place of a thing of the room, such as crate=DIR, where DIR is what `python -m fiatlux.assets build` wrote;
    /// repeat it for more. Places are bench, crate, fixture, fresh_bulb and old_bulb. Such runs are ranked apart.
    #[arg(long = "asset", value_name = "PLACE=DIR")]
    assets: Vec<AssetArg>,
    #[command(flatten)]
    session: SessionArgs,
}

impl EvaluateArgs {
    /// Number of threads, or of episodes at once.
    fn workers(&self) -> usize {
        workers(self.workers)
    }
}

/// Tasks where none are named: a relay plays the errand alone.
fn default_tasks(guests: &[Guest]) -> &'static [Task] {
    if guests.is_empty() { &Task::SUBTASKS } else { &[Task::Replace] }
}

/// Number of threads, one for each core unless the user says otherwise.
pub(crate) fn workers(given: Option<u16>) -> usize {
    let cores = || std::thread::available_parallelism().map_or(1, usize::from);
    given.map_or_else(cores, usize::from)
}

/// Exit code for a wrong command line.
pub(crate) const USAGE: u8 = 2;

/// Why a policy cannot be evaluated.
pub(crate) fn unfit(policies: &Policies, name: &str) -> Option<String> {
    if fiatlux_policies::replayed_bag(name).is_some() {
        return Some(
            "a bag holds one episode; replay it with policy-client run, or compare it with scorer verify".into(),
        );
    }
    policies.make(name).err().map(|error| format!("{:#}", anyhow::Error::new(error)))
}

/// Runs the command: evaluates a policy, or waits for one that connects from elsewhere.
pub fn run(args: &EvaluateArgs, policies: Policies) -> anyhow::Result<ExitCode> {
    fiatlux_cli::init_quiet_log();
    let Some(host) = &args.policy else { return external::run(args) };
    let policy = &Relay { host: host.clone(), guests: args.guests.clone() }.to_string();
    if let Some(problem) = unfit(&policies, policy) {
        return Ok(fiatlux_cli::usage(format!("--policy {}: {problem}", plain(policy))));
    }
    if let Err(problem) = check_names(&args.session) {
        return Ok(fiatlux_cli::usage(problem));
    }
    let scene = match SceneConfig::default().with_assets(&args.assets) {
        Ok(scene) => scene,
        Err(error) => {
            fiatlux_cli::print_error(format!("--asset: {:#}", anyhow::Error::new(error)));
            return Ok(ExitCode::from(USAGE));
        }
    };
    // The name of a policy may be a path.
    let folder = policy.replace(|c: char| !c.is_ascii_alphanumeric() && c != '-', "_");
    let folder = args.shard.map_or_else(|| folder.clone(), |shard| shard.name(&folder));
    let out = args.out.clone().unwrap_or_else(|| PathBuf::from("results").join(folder));
    if args.shard.is_some() && args.seeds.as_ref().is_some_and(|seeds| seeds.fresh) {
        return Ok(fiatlux_cli::usage(
            "--shard: each shard would draw rooms of its own; name the same rooms in all of them, such as --seeds 0..63",
        ));
    }
    let mut session = args.session.clone();
    let seeds = match &args.seeds {
        Some(seeds) if seeds.fresh => {
            let file = out.join("seeds.txt");
            let drawn = seeds.clone().recorded(&file).with_context(|| file.display().to_string())?;
            fiatlux_cli::report(format!("rooms {}, in {}", tables::seeds(&drawn.seeds), file.display()));
            Some(drawn)
        }
        seeds => seeds.clone(),
    };
    let options = EvaluateOptions {
        policies,
        policy: policy.clone(),
        tasks: args.tasks.as_ref().map_or_else(|| default_tasks(&args.guests).to_vec(), |tasks| tasks.0.clone()),
        seeds: seeds.map_or_else(|| (0..=3).collect(), |seeds| seeds.seeds),
        out,
        thin: args.bags.is_thin(),
        workers: args.workers(),
        weights: session.split_weights(),
        meshes: args.meshes.clone(),
        scene,
        session,
        shard: args.shard.map(|shard| (shard, ShardRecord::again(command_line()))),
    };
    if let Some((shard, _)) = &options.shard
        && !(0..options.tasks.len() * options.seeds.len()).any(|index| shard.has(index))
    {
        fiatlux_cli::report(format!("shard {shard} has no episode: there are fewer episodes than shards"));
        return Ok(ExitCode::SUCCESS);
    }
    let stop = fiatlux_cli::stop_on_signal().context("cannot listen for Ctrl-C")?;
    let line = ProgressLine::default();
    let outcome = evaluate(&options, &stop, &mut |progress| line.show(|| look(&line, progress)));
    line.clear();
    let outcome = match outcome {
        Err(stopped @ EvaluateError::Stopped { .. }) => {
            fiatlux_cli::report(stopped.to_string());
            return Ok(ExitCode::from(3));
        }
        outcome => outcome?,
    };
    finish(args.json, &options.out, &outcome, "the rest will be played by the same command", &stop)
}

/// The command line of this process, with the name of its program alone.
fn command_line() -> impl Iterator<Item = String> {
    let words = fiatlux_cli::command_line().into_iter().map(|word| word.to_string_lossy().into_owned());
    std::iter::once("fiatlux".to_owned()).chain(words.skip(1))
}

fn look(line: &ProgressLine, progress: &RunProgress) -> String {
    let RunProgress { episodes, done, lost, steps, steps_left, playing, .. } = progress;
    let (finished, rate, left) = (done + lost, line.rate(*steps), line.left(*steps, steps + steps_left));
    let mut text = format!("{finished}/{episodes} episodes, {rate:.0} steps/s, about {left} left");
    for episode in playing {
        text += &format!("  {} at {:.0} s", episode.name(), episode.step as f64 * CONTROL_DT);
    }
    text
}
