//! `scorer merge`: shards of an evaluation, or the folders of a run's servers, as one folder.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use clap::Args;
use fiatlux_bag::run::{EpisodeState, Ledger, NOT_RUN, journals};
use fiatlux_bag::{BAGS, BagFiles, bag_name};
use fiatlux_cli::report as tell;
use fiatlux_client::{Shard, ShardRecord};
use fiatlux_grading::{Fault, GradeOptions, Results, find_bags, report, tables};
use fiatlux_proto::plain;

use crate::DATA_LOSS;
use crate::files::{graded, make, write};

/// Marks a folder whose files may be removed by the next merge: all are in the shards.
const MARK: &str = "merged.json";
/// Largest number of missing episodes that are named.
const MAX_NAMED: usize = 20;

/// Make one folder of the shards of an evaluation
///
/// Takes the folders that `--shard` filled, and those of several servers of one run. OUT then has all bags and journals, with
/// results.json and report.html as one process would have written them; verify and submit take it like any other. Files are
/// linked where OUT is on the same disk, and copied otherwise. What is missing is named, with the command that plays it; run
/// merge again afterwards.
///
/// Refused are shards of different policies, conditions or versions, runs with different run files, and a room that was
/// played twice with different rows. Exit codes: 0 all episodes are there; 1 refused or failed; 3 some are missing or altered.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scorer merge results/walk results/walk-*of4          four shards of `fiatlux evaluate --policy walk --shard K/4`
  scorer merge results/mine lab-1/bags/RUN lab-2/bags/RUN
                                                       a run on two servers, each with a folder of its own")]
pub struct MergeArgs {
    /// Folder for the whole evaluation: new, empty, or of an earlier merge
    #[arg(value_name = "OUT")]
    out: PathBuf,
    /// Folders of the shards
    #[arg(required = true, value_name = "SHARD")]
    shards: Vec<PathBuf>,
    /// Threads [default: one for each core]
    #[arg(long, value_name = "N", value_parser = fiatlux_cli::whole::<usize>(1..=1024))]
    workers: Option<usize>,
}

pub fn run(args: &MergeArgs) -> Result<ExitCode> {
    let records = records(&args.shards)?;
    let found = find_bags(&args.shards)?;
    check_runs(&found)?;
    let options = GradeOptions { workers: args.workers.unwrap_or_default(), ..GradeOptions::default() };
    let mut results = graded(&args.shards, &options)?;
    check_versions(&results)?;
    clear(&args.out, &args.shards)?;
    match results.run.is_some() {
        true => place_run(&args.out, &found, &mut results)?,
        false => place_loose(&args.out, &mut results)?,
    }
    let missing = missing(&mut results, records.first().map(|(_, record)| record));
    let page = report::html_in(&results, &args.out);
    for (name, text) in [("results.json", results.to_json()?), ("report.html", page)] {
        write(&args.out.join(name), &text)?;
    }
    fiatlux_cli::print_headed(tables::text(&results))?;
    tell(format!("{} episodes of {} folders are in {}", played(&results), args.shards.len(), args.out.display()));
    say_missing(&missing, &records);
    Ok(if missing.is_empty() && !results.has_data_loss() { ExitCode::SUCCESS } else { ExitCode::from(DATA_LOSS) })
}

fn played(results: &Results) -> usize {
    results.episodes.iter().filter(|episode| !episode.bag.is_empty()).count()
}

/// An episode that the whole evaluation lacks.
struct Missing {
    /// In the list of all episodes; `None` where no folder has the list.
    index: Option<usize>,
    name: String,
    reason: String,
}

/// The records of the folders that have one.
fn records(shards: &[PathBuf]) -> Result<Vec<(PathBuf, ShardRecord)>> {
    let mut records: Vec<(PathBuf, ShardRecord)> = Vec::new();
    for folder in shards {
        let file = folder.join(ShardRecord::FILE);
        let Some(record) = ShardRecord::read(folder).with_context(|| file.display().to_string())? else { continue };
        let count = |record: &ShardRecord| record.shard().map(|shard| shard.with(0));
        if let Some((first, known)) = records.first()
            && (&known.tasks, &known.seeds, count(known)) != (&record.tasks, &record.seeds, count(&record))
        {
            bail!(
                "{} and {} are shards of different evaluations: of other tasks or rooms, or of another number of shards; merge \
                 them apart",
                first.display(),
                folder.display()
            );
        }
        records.push((folder.clone(), record));
    }
    Ok(records)
}

/// Refuses journals of several runs, and a room that two servers played with different rows.
fn check_runs(found: &BagFiles) -> Result<()> {
    let mut runs = BTreeMap::new();
    let mut rows: BTreeMap<usize, (String, PathBuf)> = BTreeMap::new();
    for folder in &found.runs {
        for path in journals(folder)? {
            let ledger = Ledger::read(&path)?;
            let registration = ledger.registration();
            runs.entry((registration.run.clone(), registration.key_sha256.clone())).or_insert_with(|| folder.clone());
            if runs.len() > 1 {
                let folders: Vec<String> = runs.values().map(|folder| folder.display().to_string()).collect();
                bail!(
                    "{} are of different runs; give all shards one run file and play them again, or grade these together with \
                     scorer grade",
                    folders.join(" and ")
                );
            }
            for (index, episode) in ledger.episodes().iter().enumerate() {
                let EpisodeState::Played(played) = &episode.state else { continue };
                let (digest, first) =
                    rows.entry(index).or_insert_with(|| (played.digest.to_ascii_lowercase(), folder.clone()));
                if !digest.eq_ignore_ascii_case(&played.digest) {
                    let planned = &registration.episodes[index];
                    bail!(
                        "{}, seed {} is in {} and in {} with different rows: a policy that is not deterministic, or another \
                         machine; leave out the folder that is not to count",
                        planned.task,
                        planned.seed,
                        first.display(),
                        folder.display()
                    );
                }
            }
        }
    }
    Ok(())
}

fn check_versions(results: &Results) -> Result<()> {
    for (what, versions) in [("server", &results.versions.server), ("protocol", &results.versions.protocol)] {
        if versions.len() > 1 {
            bail!("the shards are of different versions of the {what}: {}; play all with one", versions.join(" and "));
        }
    }
    Ok(())
}

/// Makes the folder, or empties that of an earlier merge.
fn clear(out: &Path, shards: &[PathBuf]) -> Result<()> {
    make(out)?;
    let place = out.canonicalize()?;
    for shard in shards {
        if shard.canonicalize()?.starts_with(&place) || place.starts_with(shard.canonicalize()?) {
            bail!("{} and {} are in each other; name another OUT", out.display(), shard.display());
        }
    }
    let mark = out.join(MARK);
    if mark.exists() {
        for folder in [BAGS, "runs"].map(|name| out.join(name)) {
            if folder.exists() {
                fs::remove_dir_all(&folder).with_context(|| format!("cannot empty {}", folder.display()))?;
            }
        }
    } else if fs::read_dir(out)?.next().is_some() {
        bail!("{} has other files; name a new folder as OUT", out.display());
    }
    let names: Vec<String> = shards.iter().map(|shard| shard.display().to_string()).collect();
    write(&mark, &(serde_json::to_string(&names)? + "\n"))
}

/// Brings the bags and journals of a run into OUT, where its results then are.
fn place_run(out: &Path, found: &BagFiles, results: &mut Results) -> Result<()> {
    let Some(run) = &mut results.run else { return Ok(()) };
    let folder = format!("runs/{}", run.name);
    let files = found.runs.iter().map(|run| journals(run)).collect::<Result<Vec<_>, _>>()?;
    for file in files.iter().flatten().chain(&found.bags) {
        link(file, &out.join(&folder).join(file.file_name().unwrap_or_default()))?;
    }
    let name = |bag: &String| format!("{folder}/{}", bag.rsplit('/').next().unwrap_or(bag));
    results.episodes.iter_mut().filter(|episode| !episode.bag.is_empty()).for_each(|one| one.bag = name(&one.bag));
    results.excluded.iter_mut().for_each(|one| one.bag = name(&one.bag));
    run.folder = folder;
    Ok(())
}

/// Brings the bags that count into OUT.
fn place_loose(out: &Path, results: &mut Results) -> Result<()> {
    for episode in &mut results.episodes {
        let name = format!("{BAGS}/{}", bag_name(&episode.task, episode.seed, episode.episode));
        link(Path::new(&episode.bag), &out.join(&name))?;
        episode.bag = name;
    }
    Ok(())
}

fn link(from: &Path, to: &Path) -> Result<()> {
    to.parent().map_or(Ok(()), fs::create_dir_all)?;
    if to.exists() {
        bail!("{} and another file would both be {}; leave one of them out", from.display(), to.display());
    }
    fs::hard_link(from, to)
        .or_else(|_| fs::copy(from, to).map(drop))
        .with_context(|| format!("cannot copy {}", from.display()))
}

/// The episodes that are not there. Of loose bags what cannot be scored is not in OUT, and the results do not name it.
fn missing(results: &mut Results, record: Option<&ShardRecord>) -> Vec<Missing> {
    if let Some(run) = &results.run {
        // Others were played, or given up for good.
        let is_missing = |cause: &str| [NOT_RUN, "open", "bag lost", Fault::Altered.name()].contains(&cause);
        let missing = run.failures.iter().filter(|failure| is_missing(&failure.cause)).map(|failure| Missing {
            index: usize::try_from(failure.index).ok(),
            name: format!("{}, seed {}", failure.task, failure.seed),
            reason: if failure.detail.is_empty() { failure.cause.clone() } else { failure.detail.clone() },
        });
        return missing.collect();
    }
    let excluded = std::mem::take(&mut results.excluded);
    let excluded: Vec<_> = excluded.into_iter().filter(|bag| bag.reason != Fault::Duplicate).collect();
    let Some(record) = record else {
        let named = excluded.into_iter();
        return named.map(|bag| Missing { index: None, name: bag.bag, reason: bag.detail }).collect();
    };
    let there: BTreeSet<(&str, u64)> = results.episodes.iter().map(|one| (&*one.task, one.seed)).collect();
    let all = record.tasks.iter().flat_map(|task| record.seeds.iter().map(move |&seed| (task, seed)));
    let missing = all.enumerate().filter(|(_, (task, seed))| !there.contains(&(task.as_str(), *seed)));
    let missing = missing.map(|(index, (task, seed))| {
        let file = bag_name(task, seed, 0);
        let why = excluded.iter().find(|bag| bag.bag.rsplit('/').next() == Some(&*file));
        let reason = why.map_or("it was not played".into(), |bag| format!("{}: {}", bag.bag, bag.detail));
        Missing { index: Some(index), name: format!("{task}, seed {seed}"), reason }
    });
    missing.collect()
}

/// Names what is missing, and the commands that play it.
fn say_missing(missing: &[Missing], records: &[(PathBuf, ShardRecord)]) {
    for Missing { name, reason, .. } in missing.iter().take(MAX_NAMED) {
        tell(plain(&format!("missing: {name}: {reason}")));
    }
    if let Some(more @ 1..) = missing.len().checked_sub(MAX_NAMED) {
        tell(format!("and {more} more"));
    }
    let Some((folder, record)) = records.first() else {
        if !missing.is_empty() {
            tell("play them with the command of their run, and merge again");
        }
        return;
    };
    let Some(any) = record.shard() else { return };
    let shards: BTreeSet<Shard> = missing.iter().filter_map(|one| one.index).map(|index| any.with(index)).collect();
    for shard in shards {
        let own = records.iter().find(|(_, record)| record.shard() == Some(shard)).map(|(folder, _)| folder.clone());
        // By the name of its neighbour.
        let neighbour = folder.file_name().unwrap_or_default().to_string_lossy();
        let base = neighbour.strip_suffix(&any.name("")).unwrap_or(&neighbour).to_owned();
        let out = own.unwrap_or_else(|| folder.with_file_name(shard.name(&base)));
        tell(plain(&format!("play shard {shard} with: {}", record.command(shard, &out))));
    }
}
