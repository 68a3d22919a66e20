//! `scorer merge`: shards of an evaluation, or the folders of a run's servers, as one folder.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io;
use std::path::{Component, Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use clap::Args;
use fiatlux_bag::run::{EpisodeState, Ledger, NOT_RUN, journals};
use fiatlux_bag::{BAGS, BagFiles, bag_name, lock_folder};
use fiatlux_cli::report as tell;
use fiatlux_client::{Shard, ShardRecord};
use fiatlux_grading::{Fault, GradeOptions, Results, find_bags, report, tables};
use fiatlux_proto::{count, plain};

use crate::DATA_LOSS;
use crate::files::{graded, make, write};

/// Lists the files that the next merge may remove from OUT: all are in the shards.
const MARK: &str = "merged.json";
const MAX_MARK_BYTES: u64 = 1 << 26;
/// The file that an evaluation locks in its folder.
const LOCK: &str = "evaluate.lock";
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
    let files = files(&found, &mut results)?;
    let _lock = place(&args.out, &args.shards, &files)?;
    let missing = missing(&mut results, records.first().map(|(_, record)| record));
    let page = report::html_in(&results, &args.out);
    for (name, text) in [("results.json", results.to_json()?), ("report.html", page)] {
        write(&args.out.join(name), &text)?;
    }
    fiatlux_cli::print_headed(tables::text(&results))?;
    let played = results.episodes.iter().filter(|episode| !episode.bag.is_empty()).count();
    let (played, folders) = (count(played, "episode"), count(args.shards.len(), "folder"));
    tell(format!("{played} of {folders} in {}", args.out.display()));
    say_missing(&missing, &records);
    Ok(if missing.is_empty() && !results.has_data_loss() { ExitCode::SUCCESS } else { ExitCode::from(DATA_LOSS) })
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

/// The files of OUT by their names in it, and where they come from. The results name them there from now on.
fn files(found: &BagFiles, results: &mut Results) -> Result<BTreeMap<String, PathBuf>> {
    let mut files = BTreeMap::new();
    let mut add = |name: String, from: PathBuf| match files.insert(name.clone(), from.clone()) {
        Some(other) => {
            bail!("{} and {} would both be {name}; leave one of them out", other.display(), from.display())
        }
        None => Ok(()),
    };
    let Some(run) = &mut results.run else {
        for episode in &mut results.episodes {
            let name = format!("{BAGS}/{}", bag_name(&episode.task, episode.seed, episode.episode));
            add(name.clone(), std::mem::replace(&mut episode.bag, name).into())?;
        }
        return Ok(files);
    };
    run.folder = format!("runs/{}", run.name);
    let name = |path: &str| format!("{}/{}", run.folder, path.rsplit('/').next().unwrap_or(path));
    let all = found.runs.iter().map(|run| journals(run)).collect::<Result<Vec<_>, _>>()?;
    for file in all.into_iter().flatten().chain(found.bags.iter().cloned()) {
        add(name(&file.to_string_lossy()), file)?;
    }
    let scored = results.episodes.iter_mut().map(|episode| &mut episode.bag).filter(|bag| !bag.is_empty());
    scored.chain(results.excluded.iter_mut().map(|bag| &mut bag.bag)).for_each(|bag| *bag = name(bag));
    Ok(files)
}

/// Brings files into OUT, in place of those of an earlier merge. The lock keeps other merges and evaluations out.
fn place(out: &Path, shards: &[PathBuf], files: &BTreeMap<String, PathBuf>) -> Result<File> {
    make(out)?;
    let folder = out.canonicalize()?;
    for shard in shards {
        let shard = shard.canonicalize()?;
        if shard.starts_with(&folder) || folder.starts_with(&shard) {
            bail!("{} and {} are in each other; name another OUT", out.display(), shard.display());
        }
    }
    let mark = out.join(MARK);
    let earlier: BTreeSet<String> = match mark.exists() {
        true => serde_json::from_slice(&fiatlux_files::read(&mark, MAX_MARK_BYTES)?)
            .with_context(|| mark.display().to_string())?,
        false => BTreeSet::new(),
    };
    let is_file = |entry: io::Result<fs::DirEntry>| entry.is_ok_and(|entry| entry.file_name() != LOCK);
    if !mark.exists() && fs::read_dir(out)?.any(is_file) {
        bail!("{} has other files; name a new folder as OUT", out.display());
    }
    let there = BagFiles::find(&[out.to_owned()])?;
    let is_other = |path: &&PathBuf| {
        let name = path.strip_prefix(out).unwrap_or(path);
        name.to_str().is_none_or(|name| !earlier.contains(name))
    };
    if let Some(other) = there.bags.iter().chain(&there.unfinished).find(is_other) {
        bail!("{} is not of an earlier merge; name a new folder as OUT", other.display());
    }
    let lock = lock_folder(out, LOCK)?
        .with_context(|| format!("another merge or evaluation is at work in {}; wait for its end", out.display()))?;
    let is_inside = |name: &&String| Path::new(name).components().all(|part| matches!(part, Component::Normal(_)));
    for old in earlier.iter().filter(is_inside).map(|name| out.join(name)).filter(|old| old.exists()) {
        fs::remove_file(&old).with_context(|| format!("cannot remove {}", old.display()))?;
    }
    // Before the files: a merge that was interrupted is an earlier one.
    write(&mark, &(serde_json::to_string(&files.keys().collect::<Vec<_>>())? + "\n"))?;
    for (name, from) in files {
        let to = out.join(name);
        to.parent().map_or(Ok(()), fs::create_dir_all)?;
        // Whoever goes on with a run writes into its journal, which has to be one of OUT's own.
        let linked = from.extension().is_some_and(|kind| kind == "mcap") && fs::hard_link(from, &to).is_ok();
        if !linked {
            fs::copy(from, &to).with_context(|| format!("cannot copy {} to {}", from.display(), to.display()))?;
        }
    }
    Ok(lock)
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
