//! The program `recorder`: records sessions into bags.

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::Context;
use clap::Parser;
use fiatlux_access::RecorderKey;
use fiatlux_bag::lock_folder;
use fiatlux_carrier::Carrier;
use fiatlux_cli::BagForm;
use fiatlux_link::{CarrierArgs, Role, WaitLog};
use fiatlux_proto::count;
use fiatlux_proto::keys::{ServerKeys, any_alive, any_truth_row};
use fiatlux_proto::v3::EpisodeEnd;
use fiatlux_server::{BagEnd, BagReport, Naming, Recorder, RecorderOptions, RecordsFrom};

/// Records the sessions of simulation servers, with one MCAP file for each episode.
///
/// Prints a line for each bag that ends, and for each session with records that are in no bag. Exit codes: 0 all bags
/// whole, 1 failed, 2 usage, 3 some bags are cut or records lost.
#[derive(Debug, Parser)]
// Either flag may also stand in the settings file, so clap itself would show neither as required.
#[command(name = "recorder", version, override_usage = "recorder --out <DIR> --recorder-key <FILE> [OPTIONS]", after_help = EXAMPLES)]
struct Cli {
    /// Folder of the bags
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Record only this server [default: all]
    #[arg(long, value_name = "NAME")]
    server: Option<String>,
    /// Name of this recorder, for the servers' logs
    #[arg(long, value_name = "NAME", default_value = "recorder")]
    name: String,
    /// Put all bags into one folder instead of SERVER/SESSION/
    #[arg(long)]
    flat: bool,
    /// Form of the bags: thin keeps actions and result alone; rows are simulated again when they are read
    #[arg(long, value_name = "FORM", value_enum, default_value_t)]
    bags: BagForm,
    /// File with the key that the servers have too (`fiatlux keys` makes one): records are sealed with it
    #[arg(long, value_name = "FILE")]
    recorder_key: PathBuf,
    #[command(flatten)]
    link: CarrierArgs,
}

const EXAMPLES: &str = "\
Examples:
  recorder --out bags --recorder-key recorder.key    sessions of the server on this machine
  recorder --settings recorder.toml                  with the flags that a file has; deploy/settings/recorder.toml shows all";

/// Exit code for data loss.
const CUT: u8 = 3;

/// Its command line, for completions and pages of `man`.
pub fn command() -> clap::Command {
    fiatlux_cli::command_with_settings::<Cli>()
}

/// The program `recorder`: reads the arguments of this process.
///
/// Exit code 0 all bags whole, 1 failed, 2 usage, 3 some bags are cut or records lost.
pub fn run() -> ExitCode {
    let cli: Cli = fiatlux_cli::parse_with_settings();
    fiatlux_cli::init_log();
    match record(cli) {
        Ok(false) => ExitCode::SUCCESS,
        Ok(true) => ExitCode::from(CUT),
        Err(error) => fiatlux_cli::failure(error),
    }
}

/// Records until it is told to stop; returns whether any bag is cut or unfinished.
fn record(cli: Cli) -> anyhow::Result<bool> {
    let stop = fiatlux_cli::stop_on_signal().context("cannot listen for signals")?;
    std::fs::create_dir_all(&cli.out).with_context(|| format!("cannot make the folder {}", cli.out.display()))?;
    let taken =
        || anyhow::anyhow!("another recorder writes into {}; name another folder with --out", cli.out.display());
    let lock = lock_folder(&cli.out, "recorder.lock");
    let _lock = lock.with_context(|| format!("cannot lock {}", cli.out.display()))?.ok_or_else(taken)?;
    let key = RecorderKey::read(&cli.recorder_key)?;
    if !cli.link.may_subscribe(&any_truth_row(cli.server.as_deref()), Role::Client)? {
        anyhow::bail!(
            "the access rules of the config let this program receive no records; start it with the recorder's, which \
             `fiatlux keys` writes as recorder.json5"
        );
    }
    let session = cli.link.open_unless(Role::Client, &stop)?;
    tracing::info!("bags go to {}; Ctrl-C finishes them", cli.out.display());
    let any_cut = Arc::new(AtomicBool::new(false));
    let [seen, missed] = [Arc::clone(&any_cut), Arc::clone(&any_cut)];
    let server = cli.server.clone();
    let recorder = Recorder::start(
        session.carrier(),
        RecorderOptions {
            out: cli.out,
            server: cli.server,
            name: cli.name,
            naming: if cli.flat { Naming::Flat } else { Naming::BySession },
            thin: cli.bags.is_thin(),
            records: RecordsFrom::Servers(key),
            on_bag: Box::new(move |report| {
                seen.fetch_or(matches!(report.end, BagEnd::Cut(_)), Ordering::Relaxed);
                print(&line(&report));
            }),
            on_loss: Box::new(move |session, records| {
                missed.store(true, Ordering::Relaxed);
                print(&format!("{session}: lost: {records} records are in no bag"));
            }),
        },
    )?;
    wait_for_servers(&session.carrier(), server.as_deref(), &stop);
    fiatlux_cli::wait_for(&stop);
    let unfinished = recorder.stop();
    for part in &unfinished {
        tracing::warn!("{} is unfinished; a recorder started now with the same --out continues it", part.display());
    }
    Ok(any_cut.load(Ordering::Relaxed) || !unfinished.is_empty())
}

/// Prints a line. That it cannot does not end a recording.
fn print(line: &str) {
    if let Err(error) = fiatlux_cli::print(format!("{}\n", fiatlux_proto::plain(line))) {
        tracing::error!("{error}: {line}");
    }
}

/// Says that no server is there, until one is or the program is to stop.
fn wait_for_servers(link: &Carrier, server: Option<&str>, stop: &AtomicBool) {
    let (alive, who) = match server {
        Some(name) => (ServerKeys::new(name).alive(), format!("server {name}")),
        None => (any_alive(), "a server".into()),
    };
    let is_there = || link.tokens(&alive, Duration::from_secs(1)).is_ok_and(|tokens| !tokens.is_empty());
    let mut waiting = WaitLog::default();
    while !stop.load(Ordering::Relaxed) && !is_there() {
        waiting
            .say(|| format!("{who}: none is on this network; does it run, and does -e name its endpoint or router?"));
        std::thread::sleep(Duration::from_millis(200));
    }
}

/// The line for one bag.
fn line(BagReport { path, end, .. }: &BagReport) -> String {
    let path = path.display();
    match end {
        BagEnd::Whole(result) => {
            let EpisodeEnd { cause, steps, gate_progress, .. } = result.end.clone().unwrap_or_default();
            format!("{path}: {cause} after {}, progress {gate_progress:.3}", count(steps, "step"))
        }
        BagEnd::Cut(reason) => format!("{path}: cut: {reason}"),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn the_example_settings_show_every_flag() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/settings/recorder.toml");
        fiatlux_cli::check_example::<Cli>(path.as_ref()).unwrap();
    }
}
