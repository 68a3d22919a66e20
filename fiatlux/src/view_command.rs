//! `fiatlux view`.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use crate::part_of;
use anyhow::{Context, bail};
use clap::Args;
use fiatlux_proto::count;
use fiatlux_replay::{Bags, Replay, Viewer, standalone};

/// Shown below the options.
pub const EXAMPLES: &str = "Examples:
  fiatlux view results/stand                              every episode of a run
  fiatlux view results/stand/bags/S05-s0-e0.mcap          one episode
  fiatlux view results/stand/bags/S05-s0-e0.mcap --out S05.html
                                                          a file that opens anywhere, without this program

Exit codes: 0 ok, 1 failed, 2 usage.";

/// Options of the command.
#[derive(Debug, Args)]
pub struct ViewArgs {
    /// Bag of an episode, or a folder with bags, such as that of a run. A bag that is cut or still being recorded is shown as
    /// far as it goes.
    #[arg(value_name = "BAG|DIR")]
    path: PathBuf,
    /// Port of 127.0.0.1 to listen on [default: a free one]
    #[arg(long, value_name = "N", default_value_t = 0, hide_default_value = true,
          value_parser = fiatlux_cli::whole::<u16>(0..=65_535))]
    port: u16,
    /// Opens no browser; the address is printed in any case.
    #[arg(long)]
    no_open: bool,
    /// Writes the replay of a bag into one HTML file that needs nothing else, and serves nothing.
    #[arg(long, value_name = "FILE.html", conflicts_with_all = ["port", "no_open"])]
    out: Option<PathBuf>,
    /// With --out: replaces a file of that name.
    #[arg(long, requires = "out")]
    force: bool,
}

/// Runs the command: serves replays of bags, or writes one as a file.
pub fn run(args: &ViewArgs) -> anyhow::Result<ExitCode> {
    fiatlux_cli::init_quiet_log();
    let bags = Bags::find(&args.path)?;
    match &args.out {
        Some(out) => write(&bags, &args.path, out, args.force)?,
        None => serve(bags, args)?,
    }
    Ok(ExitCode::SUCCESS)
}

fn serve(bags: Bags, args: &ViewArgs) -> anyhow::Result<()> {
    // One bag is read before its address is given out, so that what is wrong with it is said here.
    if let (1, Some(bag)) = (bags.count(), bags.file(0)) {
        for note in &Replay::open(bag)?.document().notes {
            fiatlux_cli::report(format!("note: {note}"));
        }
    }
    let stop = fiatlux_cli::stop_on_signal().context("cannot listen for Ctrl-C")?;
    let viewer = Viewer::bind(bags, args.port)?;
    let address = format!("http://{}/", viewer.address());
    fiatlux_cli::print(format!("{address}\n"))?;
    let opened = !args.no_open && fiatlux_cli::open_browser(&address);
    fiatlux_cli::report(format!(
        "{}; Ctrl-C ends it",
        if opened { "opened in the browser" } else { "open this address in a browser" }
    ));
    Ok(viewer.serve(&stop)?)
}

fn write(bags: &Bags, path: &Path, out: &Path, force: bool) -> anyhow::Result<()> {
    let (1, Some(bag)) = (bags.count(), bags.file(0)) else {
        bail!("{} has {}; name one of them with --out", path.display(), count(bags.count(), "bag"));
    };
    if out.exists() && !force {
        bail!("{} exists already; replace it with --force, or choose another name", out.display());
    }
    let replay = Replay::open(bag)?;
    for note in &replay.document().notes {
        fiatlux_cli::report(format!("note: {note}"));
    }
    let part = part_of(out);
    let written = || {
        if let Some(folder) = out.parent() {
            fs::create_dir_all(folder)?;
        }
        let mut file = fs::File::create_new(&part)?;
        file.write_all(standalone(&replay).as_bytes())?;
        fs::rename(&part, out)
    };
    let written: std::io::Result<()> = written();
    if written.is_err() {
        // Nothing half is left under a name that somebody looks for.
        let _ = fs::remove_file(&part);
    }
    written.with_context(|| format!("cannot write {}; check its folder and the space that is left", out.display()))?;
    fiatlux_cli::print(format!("{}\n", out.display()))?;
    Ok(())
}
