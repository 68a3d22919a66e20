//! The command `fiatlux demonstrate`.

mod lerobot;
mod recipe;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use clap::Args;
use fiatlux_cli::ProgressLine;
use fiatlux_client::{RunProgress, SessionArgs};
use fiatlux_policies::Policies;
use fiatlux_proto::v3::OpenRequest;
use fiatlux_proto::{count, plain};
use fiatlux_rules::{CONTROL_DT, SeedOwner, Task};
use fiatlux_runs::{BAGS, DemonstrateOptions, Demonstrated, EvaluateOptions, check_names, demonstrate};
use fiatlux_world::SceneConfig;
use lerobot::LeRobot;
use serde_json::json;

use crate::evaluate_command::{USAGE, unfit, workers};

/// Shown below the options.
pub const EXAMPLES: &str = "Examples:
  fiatlux demonstrate --task S08 --episodes 100 --out demos/s08
  fiatlux demonstrate --task S08 --episodes 100 --out demos/s08 --lerobot --python venv/bin/python
                                                          and a LeRobot data set in demos/s08/lerobot
  fiatlux demonstrate --task S05 --policy walk --episodes 20 --out demos/s05 --record camera@25 --image 128x128
  fiatlux demonstrate --task S08 --episodes 5 --out demos/s08 --no-pictures --recipe demonstrations.txt
                                                          the public ones, made again and compared
  python -m fiatlux.lerobot demos/s08/bags --out set --fps 10 --action command
                                                          a data set of other columns and rates, from the same bags

Exit codes: 0 ok, 1 failed, 2 usage, 3 stopped, or fewer episodes than asked for.";

/// Options of the command.
#[derive(Debug, Args)]
pub struct DemonstrateArgs {
    /// Task to demonstrate, such as S08.
    #[arg(long)]
    task: Task,
    /// Number of demonstrations.
    #[arg(long, value_name = "N", default_value = "100", value_parser = fiatlux_cli::whole::<u32>(1..=100_000))]
    episodes: u32,
    /// Output folder; one for each task.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Policy that demonstrates: expert or another of those that `fiatlux policies` lists.
    #[arg(long, default_value = "expert")]
    policy: String,
    /// Keep episodes that failed, or in which a bulb was dropped or broken, too: the first N that are played.
    #[arg(long)]
    unclean: bool,
    /// Also make a LeRobot data set in OUT/lerobot. Needs a Python with the Fiatlux wheel and its extra `lerobot`.
    #[arg(long)]
    lerobot: bool,
    /// Record no pictures: bags of a fraction of the size, in a fraction of the time.
    #[arg(long, conflicts_with = "record")]
    no_pictures: bool,
    /// Compares the demonstrations with a list of rooms and digests, and fails where one is another episode.
    #[arg(long, value_name = "FILE")]
    recipe: Option<PathBuf>,
    /// Writes room and digest of each demonstration into such a list, in place of those that it has of the task.
    #[arg(long, value_name = "FILE", conflicts_with = "recipe")]
    write_recipe: Option<PathBuf>,
    /// With --lerobot: that Python [default: python3].
    #[arg(long, value_name = "PROGRAM", requires = "lerobot")]
    python: Option<PathBuf>,
    /// Seed of the first room; rooms from 1000 on are for training.
    #[arg(long, value_name = "SEED", value_parser = fiatlux_client::parse_seed,
          default_value_t = *SeedOwner::Training.seeds().start())]
    first_seed: u64,
    /// Number of rooms to play at most [default: four times the episodes].
    #[arg(long, value_name = "N", value_parser = fiatlux_cli::whole::<u32>(1..=400_000))]
    max_rooms: Option<u32>,
    /// Number of episodes at once [default: one for each core].
    #[arg(long, value_parser = fiatlux_cli::whole::<u16>(1..=256))]
    workers: Option<u16>,
    /// Print the outcome as JSON.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    session: SessionArgs,
}

impl DemonstrateArgs {
    /// The session of each room: with pictures in its bag, unless the user wants none.
    fn recorded(&self) -> SessionArgs {
        let session = self.session.clone();
        if self.no_pictures { session } else { session.recording("camera") }
    }

    /// Mistakes of the command line.
    fn problem(&self, policies: &Policies) -> Option<String> {
        if let Some(problem) = unfit(policies, &self.policy) {
            return Some(format!("--policy {}: {problem}", plain(&self.policy)));
        }
        if let Err(error) = SeedOwner::check_training(self.first_seed) {
            return Some(format!("--first-seed: {error}"));
        }
        if let Err(problem) = check_names(&self.session) {
            return Some(problem.to_string());
        }
        let mut request = OpenRequest::default();
        self.session.apply(&mut request);
        (request.episode_protocol == "published")
            .then(|| "--protocol published: demonstrations are judged by the strict protocol; leave it out".into())
    }
}

/// Runs the command.
pub fn run(args: &DemonstrateArgs, policies: Policies) -> anyhow::Result<ExitCode> {
    fiatlux_cli::init_quiet_log();
    if let Some(problem) = args.problem(&policies) {
        fiatlux_cli::print_error(problem);
        return Ok(ExitCode::from(USAGE));
    }
    // Before an hour is spent on bags.
    let list = args.recipe.as_deref().map(recipe::read).transpose()?;
    let lerobot = args.lerobot.then(|| LeRobot::find(args.python.as_deref(), &args.out)).transpose()?;
    let mut session = args.recorded();
    let options = DemonstrateOptions {
        evaluation: EvaluateOptions {
            policies,
            policy: args.policy.clone(),
            tasks: Vec::new(),
            seeds: Vec::new(),
            out: args.out.clone(),
            thin: false,
            workers: workers(args.workers),
            weights: session.split_weights(),
            meshes: None,
            scene: SceneConfig::default(),
            session,
            shard: None,
        },
        task: args.task,
        episodes: args.episodes as usize,
        first_seed: args.first_seed,
        max_rooms: args.max_rooms.unwrap_or(4 * args.episodes) as usize,
        unclean: args.unclean,
    };
    let stop = fiatlux_cli::stop_on_signal().context("cannot listen for Ctrl-C")?;
    let line = ProgressLine::default();
    let done = demonstrate(&options, &stop, &mut |rooms, now| line.show(|| look(&line, rooms, now)));
    line.clear();
    let done = done?;
    for lost in &done.outcome.lost {
        fiatlux_cli::report(format!("lost: {lost}"));
    }
    let is_whole = done.kept.len() >= options.episodes;
    let data_set = match lerobot {
        Some(lerobot) if is_whole => Some(lerobot.export(&args.out.join(BAGS), &done.kept)?),
        _ => None,
    };
    print(args, &done, data_set.as_ref())?;
    let is_equal = follow_recipe(args, &done, list.as_deref())?;
    if !is_whole {
        let goes_on = if done.outcome.stopped {
            "stopped before the end; the same command goes on from here"
        } else {
            "too few were clean; raise --max-rooms, keep failures with --unclean, or use another policy"
        };
        fiatlux_cli::report(format!("{} of {} demonstrations; {goes_on}", done.kept.len(), options.episodes));
    }
    Ok(match (is_equal, is_whole) {
        (false, _) => ExitCode::FAILURE,
        (true, true) => ExitCode::SUCCESS,
        (true, false) => ExitCode::from(3),
    })
}

/// Compares the demonstrations with a list, or writes one; false where an episode is another one.
fn follow_recipe(args: &DemonstrateArgs, done: &Demonstrated, list: Option<&[recipe::Entry]>) -> anyhow::Result<bool> {
    if list.is_none() && args.write_recipe.is_none() {
        return Ok(true);
    }
    let played = recipe::entries(args.task, &args.policy, &done.kept)?;
    if let Some(path) = &args.write_recipe {
        recipe::write(path, &played)?;
    }
    let Some(list) = list else { return Ok(true) };
    let compared = recipe::compare(&played, list);
    let unlisted = compared.unlisted.len();
    fiatlux_cli::report(format!("{} of {} are those of the list, {unlisted} not in it", compared.equal, played.len()));
    if let Some(first) = compared.different.first() {
        let count = compared.different.len();
        fiatlux_cli::report(format!(
            "{count} are other episodes, room {first} the first: another version made the list, or the options differ"
        ));
    }
    Ok(compared.different.is_empty())
}

fn print(args: &DemonstrateArgs, done: &Demonstrated, data_set: Option<&PathBuf>) -> anyhow::Result<()> {
    let seconds = done.kept.iter().map(|kept| kept.steps as f64 * CONTROL_DT).fold(0.0, |sum, seconds| sum + seconds);
    if args.json {
        let episodes = done
            .kept
            .iter()
            .map(|kept| json!({ "seed": kept.seed, "bag": kept.bag, "steps": kept.steps, "clean": kept.clean }));
        let text = json!({
            "task": args.task.short_id(),
            "policy": args.policy,
            "rooms": done.rooms,
            "clean": done.clean,
            "simulated_seconds": seconds,
            "episodes": episodes.collect::<Vec<_>>(),
            "bags": args.out.join(BAGS),
            "lerobot": data_set,
            "stopped": done.outcome.stopped,
        });
        fiatlux_cli::print(serde_json::to_string_pretty(&text)? + "\n")?;
        return Ok(());
    }
    let share = 100.0 * done.clean as f64 / done.rooms.max(1) as f64;
    let minutes = seconds / 60.0;
    fiatlux_cli::print(format!(
        "{}: {} of {}, {minutes:.1} min of motion; {} of {} clean ({share:.0} %)\n",
        args.out.join(BAGS).display(),
        count(done.kept.len(), "demonstration"),
        args.task,
        done.clean,
        count(done.rooms, "room"),
    ))?;
    if let Some(data_set) = data_set {
        fiatlux_cli::print(format!("{}: LeRobot data set\n", data_set.display()))?;
    }
    Ok(())
}

/// Steps of all episodes, if those that are left take as long as those that ended. Episodes end long before their time-out.
fn expected_steps(progress: &RunProgress, done: usize) -> u64 {
    let playing: u64 = progress.playing.iter().map(|playing| playing.step).sum();
    let ended = progress.steps.saturating_sub(playing);
    let left = progress.episodes.saturating_sub(done + progress.lost) as u64;
    ended + ended.div_ceil(done as u64) * left
}

fn look(line: &ProgressLine, rooms: usize, progress: &RunProgress) -> String {
    let RunProgress { episodes, done, lost, successes, steps, .. } = progress;
    let before = rooms.saturating_sub(*episodes);
    let finished = before + done + lost;
    let text = format!("{finished}/{rooms} rooms");
    if *steps == 0 {
        return text;
    }
    let left = match done {
        // Before one has ended, only the longest time is known.
        0 => return format!("{text}, {:.0} steps/s", line.rate(*steps)),
        done => line.left(*steps, (*steps).max(expected_steps(progress, *done))),
    };
    let rate = line.rate(*steps);
    format!("{text}, {successes} of {done} succeeded, {rate:.0} steps/s, about {left} left")
}

#[cfg(test)]
mod tests {
    use super::*;
    use fiatlux_client::Playing;

    /// Guards the time that is foretold: rooms to come last as long as those that ended, and no time-out is expected of them.
    #[test]
    fn rooms_to_come_are_expected_to_last_as_those_that_ended() {
        let playing = |step| Playing { task: "S08".into(), seed: Some(1000), server: "local".into(), step };
        // 400 steps in the two rooms that ended, and three rooms to come, of which two have begun.
        let mut progress = RunProgress { episodes: 5, done: 2, steps: 500, ..RunProgress::default() };
        progress.playing = vec![playing(70), playing(30)];
        assert_eq!(expected_steps(&progress, 2), 400 + 3 * 200);
        // One that is given up for now is not waited for.
        progress.lost = 1;
        assert_eq!(expected_steps(&progress, 2), 400 + 2 * 200);
        let over = RunProgress { episodes: 2, done: 2, steps: 401, ..RunProgress::default() };
        assert_eq!(expected_steps(&over, 2), 401);
    }
}
