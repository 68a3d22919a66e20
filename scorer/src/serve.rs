//! `scorer serve`: runs the leaderboard.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, Result};
use clap::Args;
use fiatlux_access::KnownServers;
use fiatlux_cli::whole;
use fiatlux_leaderboard::{Jobs, Limits, Proxies, Service, ServiceOptions, Store};

use crate::work::{StoreArgs, VerifierArgs, joined, stopped};

/// Serve the leaderboard: accept submissions, grade and verify them, and show them
///
/// Everything is kept in one folder, which is created on the first start: a database, the bags by their content, and
/// incomplete uploads. Episodes are simulated again on the sim-servers that -e names, over one link for each; without any,
/// they wait. Create accounts and tokens with `scorer admin`. For TLS, run a proxy in front of it, and name it with --proxy where it is on another machine or in a container.
///
/// When it is ready it prints one line on stdout; its log goes to stderr. On SIGINT or SIGTERM it ends its requests and exits
/// with 0. It may be killed at any moment: after a restart, work on accepted submissions goes on.
///
/// Several may serve one store: a folder on this machine, or with --database and --files on any. `scorer work` adds processes that only
/// verify. A file is uploaded through one of them, so a proxy sends an address always to the same one.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scorer serve --folder board                                     pages and API on http://127.0.0.1:8080/
  scorer serve --folder board -e tcp/127.0.0.1:7447               and verify on a server on this machine
  scorer serve --folder board -e tcp/10.0.0.5:7447 -e tcp/10.0.0.6:7447 --parallel 8 --signers known_servers --runs runs
  scorer serve --folder work --database postgres://board@db/board --files s3://bags/board
  scorer serve --folder board -e tcp/10.0.0.9:7447 --server 'lab-*'   and on all servers behind this router whose names begin so")]
pub struct ServeArgs {
    /// Folder of the service, created if it does not exist
    #[arg(long, value_name = "DIR")]
    folder: PathBuf,
    #[command(flatten)]
    store: StoreArgs,
    /// Address of pages and API; port 0 picks a free one
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:8080")]
    http: SocketAddr,
    /// File with the keys of your own servers, one line NAME ed25519:BASE64 each: their signatures make a run hosted
    #[arg(long, value_name = "FILE")]
    signers: Option<PathBuf>,
    /// Proxy in front of the service that says in X-Forwarded-For who asks: its address, a network such as 10.0.0.0/8, or `private` for all
    /// private networks, such as those of containers; may be repeated. One on this machine needs no option
    #[arg(long, value_name = "ADDRESS")]
    proxy: Vec<Proxies>,
    /// Folder into which a server of yours records runs (its --record): hosted runs that nobody submits count as failures; may be
    /// repeated
    #[arg(long, value_name = "DIR")]
    runs: Vec<PathBuf>,
    /// Threads that grade [default: one for each core]
    #[arg(long, value_name = "N", value_parser = whole::<usize>(1..=1024))]
    workers: Option<usize>,
    /// Address of /metrics, for Prometheus; the address of the pages does not have it [default: nowhere]
    #[arg(long, value_name = "HOST:PORT")]
    metrics: Option<SocketAddr>,
    /// Connections that may be open at the same time; further ones wait
    #[arg(long, value_name = "N", default_value_t = 512, value_parser = whole::<usize>(1..=65_536))]
    connections: usize,
    /// Largest number of files of a submission
    #[arg(long, value_name = "N", default_value_t = Limits::default().files, value_parser = whole::<usize>(1..=20_000))]
    max_files: usize,
    /// Largest size of a file, bytes
    #[arg(long, value_name = "BYTES", default_value_t = Limits::default().file_bytes, value_parser = whole::<u64>(1..=1 << 40))]
    max_file_bytes: u64,
    /// Largest size of a submission, bytes
    #[arg(long, value_name = "BYTES", default_value_t = Limits::default().bytes, value_parser = whole::<u64>(1..=1 << 50))]
    max_bytes: u64,
    #[command(flatten)]
    verifiers: VerifierArgs,
}

/// Serves until a signal asks it to stop.
pub fn run(args: &ServeArgs) -> Result<ExitCode> {
    fiatlux_cli::init_log();
    // Before it can be reached, so that an early interrupt is not lost.
    let stop = fiatlux_cli::stop_on_signal().context("cannot listen for Ctrl-C")?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().context("cannot start threads")?;
    let served = runtime.block_on(serve(args, stop));
    // An unfinished grading is repeated after the next start.
    runtime.shutdown_background();
    served.map(|()| ExitCode::SUCCESS)
}

async fn serve(args: &ServeArgs, stop: Arc<AtomicBool>) -> Result<()> {
    let store = Store::open_at(&args.store.place(&args.folder)).await?;
    let _joined = joined(&store, &args.folder).await?;
    let options = ServiceOptions {
        limits: Limits { files: args.max_files, file_bytes: args.max_file_bytes, bytes: args.max_bytes },
        signers: args.signers.as_deref().map(KnownServers::read).transpose()?.unwrap_or_default(),
        proxies: args.proxy.iter().cloned().collect(),
        grade_workers: args.workers.unwrap_or_default(),
        runs: args.runs.clone(),
        refusal_pause: args.verifiers.refusal_pause(),
        ..ServiceOptions::default()
    };
    let service = Arc::new(Service::new(store, options));
    let listen = |flag, address| {
        let refused = move || format!("cannot listen on {address}; choose another address with --{flag}");
        fiatlux_leaderboard::listen(address).with_context(refused)
    };
    let listener = listen("http", args.http)?;
    if let Some(address) = args.metrics {
        let listener = listen("metrics", address)?;
        tracing::info!("metrics are on http://{}/metrics", listener.local_addr()?);
        tokio::spawn(fiatlux_leaderboard::serve_metrics(Arc::clone(&service), listener));
    }
    let verifiers = args.verifiers.verifiers()?;
    if verifiers.is_empty() {
        tracing::warn!("there is no server to verify on: name one with -e; until then episodes wait");
    }
    let jobs = Jobs::start(&service, verifiers, args.verifiers.parallel).context("cannot start threads")?;
    fiatlux_cli::print(format!("serving http://{}/\n", listener.local_addr()?))?;
    let served = fiatlux_leaderboard::serve(service, listener, args.connections, stopped(&stop)).await;
    tracing::info!("interrupted: stopping verifications; unfinished ones are repeated");
    tokio::task::spawn_blocking(|| jobs.stop()).await.context("the background jobs panicked")?;
    served.context("the listener failed")
}
