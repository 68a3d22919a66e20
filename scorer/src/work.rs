//! `scorer work`: verifies episodes of a leaderboard that other processes serve.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::Args;
use fiatlux_access::{SERVER_OR_GROUP, is_server_or_group};
use fiatlux_cli::whole;
use fiatlux_client::AccessArgs;
use fiatlux_leaderboard::{
    DatabaseUrl, FilesUrl, Jobs, Joined, Place, ServerGroup, ServerVerifier, Service, ServiceOptions, Store, Verifiers,
};
use fiatlux_link::CarrierArgs;

/// Period of its checks for a stop.
const LOOK: Duration = Duration::from_millis(50);

/// Verify episodes of a leaderboard: claims them one by one and has them simulated again, next to `scorer serve` on the same store
///
/// Every process claims other episodes. What one that is killed had claimed goes to another one after 20 s. It never grades and serves no
/// pages. On SIGINT or SIGTERM it gives its episodes back and exits with 0.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scorer work --folder board -e tcp/10.0.0.7:7447 --parallel 8    eight episodes at a time on one more server
  scorer work --folder work --database postgres://board@db/board --files s3://bags/board -e tcp/10.0.0.7:7447")]
pub struct WorkArgs {
    /// Folder of the service, on this machine
    #[arg(long, value_name = "DIR")]
    folder: PathBuf,
    #[command(flatten)]
    store: StoreArgs,
    #[command(flatten)]
    verifiers: VerifierArgs,
}

/// The parts of a store that are not in its folder.
#[derive(Debug, Args)]
pub struct StoreArgs {
    /// Database, if it is not in the folder: sqlite:FILE, or postgres://USER@HOST/NAME for scorers on several machines; its password is
    /// in PGPASSWORD or ~/.pgpass
    #[arg(long, value_name = "URL", global = true)]
    database: Option<DatabaseUrl>,
    /// Bags and results, if they are not in the folder: another folder, or s3://BUCKET/PREFIX; endpoint and keys are in AWS_ENDPOINT_URL,
    /// AWS_ACCESS_KEY_ID and so on
    #[arg(long, value_name = "DIR", global = true)]
    files: Option<FilesUrl>,
}

impl StoreArgs {
    pub fn place(&self, folder: &Path) -> Place {
        let Place { folder, database, files } = Place::folder(folder);
        let (database, files) = (self.database.clone().unwrap_or(database), self.files.clone().unwrap_or(files));
        Place { folder, database, files }
    }
}

/// The servers that verify.
#[derive(Debug, Args)]
pub struct VerifierArgs {
    /// Name of a server that verifies, or of a group: 'lab-*' stands for all whose names begin with lab-, as they come and go. May be
    /// repeated if several are behind one router
    #[arg(long, value_name = "NAME", value_parser = server_or_group)]
    server: Vec<String>,
    /// Episodes to verify at the same time on each server
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = whole::<usize>(1..=256))]
    pub parallel: usize,
    /// Seconds between two refusals of an episode by servers of its version that count: after three, its submission is refused
    #[arg(long, value_name = "S", default_value_t = ServiceOptions::default().refusal_pause.as_secs(), value_parser = whole::<u64>(0..=86_400))]
    refusal_pause: u64,
    #[command(flatten)]
    access: AccessArgs,
    #[command(flatten)]
    link: CarrierArgs,
}

impl VerifierArgs {
    pub fn refusal_pause(&self) -> Duration {
        Duration::from_secs(self.refusal_pause)
    }

    /// One verifier for each pair of an endpoint and a server's name, one group for each of an endpoint and a group's name.
    pub fn verifiers(&self) -> Result<Verifiers> {
        let access = Arc::new(self.access.read()?);
        let CarrierArgs { connect, config, .. } = &self.link;
        let mut links: Vec<CarrierArgs> = connect
            .iter()
            .map(|endpoint| CarrierArgs { connect: vec![endpoint.clone()], ..self.link.clone() })
            .collect();
        if links.is_empty() && config.is_some() {
            links.push(self.link.clone());
        }
        let names: Vec<Option<&str>> = if self.server.is_empty() {
            vec![None]
        } else {
            self.server.iter().map(|name| Some(name.as_str())).collect()
        };
        let mut verifiers = Verifiers::default();
        for (link, name) in links.iter().flat_map(|link| names.iter().map(move |name| (link.clone(), *name))) {
            match name.and_then(|name| name.strip_suffix('*')) {
                Some(start) => verifiers.groups.push(Arc::new(ServerGroup::new(link, start.into(), &access))),
                None => verifiers.servers.push(Arc::new(ServerVerifier::new(link, name.map(Into::into), &access))),
            }
        }
        Ok(verifiers)
    }
}

fn server_or_group(text: &str) -> Result<String, String> {
    is_server_or_group(text).then(|| text.to_owned()).ok_or_else(|| SERVER_OR_GROUP.into())
}

/// Verifies until a signal asks it to stop.
pub fn run(args: &WorkArgs) -> Result<ExitCode> {
    fiatlux_cli::init_log();
    let stop = fiatlux_cli::stop_on_signal().context("cannot listen for Ctrl-C")?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().context("cannot start threads")?;
    runtime.block_on(work(args, &stop)).map(|()| ExitCode::SUCCESS)
}

async fn work(args: &WorkArgs, stop: &AtomicBool) -> Result<()> {
    let verifiers = args.verifiers.verifiers()?;
    if verifiers.is_empty() {
        bail!("there is no server to verify on; name one with -e tcp/HOST:PORT");
    }
    let store = Store::open_existing(&args.store.place(&args.folder)).await?;
    let _joined = joined(&store, &args.folder).await?;
    let options = ServiceOptions { refusal_pause: args.verifiers.refusal_pause(), ..ServiceOptions::default() };
    let service = Arc::new(Service::new(store, options));
    let jobs = Jobs::verify(&service, verifiers, args.verifiers.parallel).context("cannot start threads")?;
    fiatlux_cli::print(format!("working on {}\n", args.folder.display()))?;
    stopped(stop).await;
    tracing::info!("interrupted: stopping verifications; unfinished ones are repeated");
    tokio::task::spawn_blocking(|| jobs.stop()).await.context("the background jobs panicked")
}

/// A place among the scorers of a folder.
pub async fn joined(store: &Store, folder: &Path) -> Result<Joined> {
    let Some(joined) = store.join().await? else {
        bail!("a scorer of an older version is running on {}; stop it first, or use another folder", folder.display());
    };
    if joined.halves > 0 {
        tracing::info!(joined.halves, "halves of bags that a killed service left are removed");
    }
    Ok(joined)
}

/// Waits until a signal asks the program to stop.
pub async fn stopped(stop: &AtomicBool) {
    while !stop.load(Ordering::Relaxed) {
        tokio::time::sleep(LOOK).await;
    }
}
