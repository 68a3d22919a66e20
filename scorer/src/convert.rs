//! `scorer thin` and `scorer fill`: bags without rows, and with them.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::Ordering;

use anyhow::{Context, Result};
use clap::Args;
use fiatlux_bag::{Bag, BagError, convert};
use fiatlux_cli::{ProgressLine, in_full, report as tell};
use fiatlux_grading::find_bags;
use fiatlux_proto::{count, plain};

use crate::DATA_LOSS;

/// Bags to bring into another form, in their places.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scorer thin results/walk                             every bag below the folder, without its rows
  scorer fill results/walk/bags/S05-s0-e0.mcap         and this one with them again")]
pub struct ConvertArgs {
    /// Bags, or folders to search for *.mcap, including subfolders
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
}

/// Converts them; a bag that is refused stays as it is.
pub fn run(args: &ConvertArgs, thin: bool) -> Result<ExitCode> {
    let bags = find_bags(&args.paths)?.bags;
    let size = || bags.iter().filter_map(|bag| bag.metadata().ok()).map(|file| file.len()).sum::<u64>();
    let (line, before) = (ProgressLine::default(), size());
    // A bag that is begun is brought to its end.
    let stop = fiatlux_cli::stop_on_signal().context("cannot listen for Ctrl-C")?;
    let (mut changed, mut refused) = (0, Vec::new());
    for (index, bag) in bags.iter().enumerate().take_while(|_| !stop.load(Ordering::Relaxed)) {
        line.show(|| format!("{index} of {} bags, {} left", bags.len(), line.left(index as u64, bags.len() as u64)));
        match checked(bag, thin) {
            Ok(is_changed) => changed += usize::from(is_changed),
            Err(error) => refused.push(in_full(&error)),
        }
    }
    line.clear();
    refused.iter().for_each(|why| tell(plain(why)));
    let (form, mib) = (if thin { "thin" } else { "full" }, |bytes: u64| bytes as f64 / f64::from(1 << 20));
    fiatlux_cli::print(format!(
        "{changed} of {} made {form}, {} left as before: {:.1} MiB before, {:.1} MiB after\n",
        count(bags.len(), "bag"),
        bags.len() - changed,
        mib(before),
        mib(size())
    ))?;
    let is_whole = refused.is_empty() && !stop.load(Ordering::Relaxed);
    Ok(if is_whole { ExitCode::SUCCESS } else { ExitCode::from(DATA_LOSS) })
}

/// Nothing is lost: rows are removed only if this program makes them again.
fn checked(path: &Path, thin: bool) -> Result<bool, BagError> {
    let bag = Bag::open(path)?;
    if thin && !bag.is_thin() {
        bag.check_actions()?;
    }
    convert(path, thin)
}
