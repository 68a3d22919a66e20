//! The server as a process.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use clap::Args;
use fiatlux_access::{Identity, RecorderKey, Tokens};
use fiatlux_cli::{BagForm, whole};
use fiatlux_link::{CarrierArgs, Role};
use fiatlux_proto::count;
use fiatlux_server::{RecordsTo, Server, ServerOptions, SharedSeeds};
use fiatlux_world::{AssetArg, SceneConfig};

use crate::metrics::Metrics;
use crate::robot::{self, RobotArgs};

/// Largest scene file, bytes.
const MAX_SCENE_BYTES: u64 = 16 << 20;
/// Time that recorders have after an interrupt.
const SHUTDOWN: Duration = Duration::from_secs(12);

#[derive(Debug, Args)]
#[command(next_help_heading = "Server")]
pub struct DaemonArgs {
    /// Name by which clients find this server: letters, digits, - and _; unique on its network.
    #[arg(long, default_value = "local")]
    name: String,
    /// Threads that step sessions [default: one for each core].
    #[arg(long, value_name = "N", value_parser = whole::<usize>(1..=1024))]
    workers: Option<usize>,
    /// Sessions that can be open at once.
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = whole::<usize>(1..=65_536))]
    capacity: usize,
    /// Longest wait of a session for a client that is gone, s.
    #[arg(long, value_name = "SECONDS", default_value = "10", value_parser = seconds)]
    grace: Duration,
    /// Longest wait of a session for an action in real time, s.
    #[arg(long, value_name = "SECONDS", default_value = "60", value_parser = seconds)]
    action_timeout: Duration,
    /// Longest wait for an action in lockstep, of a client that is there, s.
    #[arg(long, value_name = "SECONDS", default_value = "600", value_parser = seconds)]
    lockstep_timeout: Duration,
    /// Scene config; its values replace the published ones. Runs in another scene are not ranked.
    #[arg(long, value_name = "FILE.toml")]
    scene: Option<PathBuf>,
    /// Object in place of a thing of the room, such as crate=DIR, where DIR is what `python -m fiatlux.assets build` wrote;
    /// repeat it for more. Places are bench, crate, fixture, fresh_bulb and old_bulb. Such runs are ranked apart.
    #[arg(long = "asset", value_name = "PLACE=DIR")]
    assets: Vec<AssetArg>,
    /// Folder of safetensors files with ResNet-18 weights; a session can name one of them for the camera's features.
    #[arg(long, value_name = "DIR")]
    weights: Option<PathBuf>,
    /// Folder of meshes of the robot's links in metres, LINK.stl or LINK.obj, such as those of Unitree's description:
    /// pictures show them instead of the built-in shapes. Runs whose policies see such pictures are not ranked.
    #[arg(long, value_name = "DIR")]
    meshes: Option<PathBuf>,
    /// Record every session below this folder, and keep runs there: needed for ranked runs. Bags of a run go to
    /// DIR/RUN/, those of other sessions to DIR/SERVER/SESSION/.
    #[arg(long, value_name = "DIR")]
    record: Option<PathBuf>,
    /// File with the key from which all servers of --seed-group draw the same hosted seeds: a copy of one that `fiatlux keys` made as
    /// recorder_key, for this alone. Whoever has it knows all hosted seeds.
    #[arg(long, value_name = "FILE")]
    seed_key: Option<PathBuf>,
    /// Names of all servers that share hosted runs, each with a folder of its own, this one among them: each episode belongs to one of them
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    seed_group: Vec<String>,
    /// Form of the bags below --record: thin keeps actions and result alone; rows are simulated again when they are read.
    #[arg(long, value_name = "FORM", value_enum, default_value_t)]
    bags: BagForm,
    /// File with the key shared with separate recorders (`fiatlux keys` makes one). Without it and without --record,
    /// sessions cannot be recorded, and records stay in the server.
    #[arg(long, value_name = "FILE", conflicts_with = "record")]
    recorder_key: Option<PathBuf>,
    /// File with the server's own key, by which clients recognise it (`fiatlux keys` makes one) [default: drawn at each
    /// start]
    #[arg(long, value_name = "FILE")]
    identity: Option<PathBuf>,
    /// File of those who may open sessions, one line ID SECRET LIMIT for each [default: everybody may]
    #[arg(long, value_name = "FILE")]
    tokens: Option<PathBuf>,
    /// Address of /metrics, for Prometheus: sessions, records and bags. Whoever reaches it may read them [default: nowhere]
    #[arg(long, value_name = "HOST:PORT", conflicts_with = "unitree")]
    metrics: Option<SocketAddr>,
    #[command(flatten)]
    link: CarrierArgs,
    #[command(flatten)]
    pub robot: RobotArgs,
}

fn seconds(text: &str) -> Result<Duration, String> {
    let parsed = text.parse().ok().filter(|secs| (0.01..=1e6).contains(secs));
    parsed.map(Duration::from_secs_f64).ok_or_else(|| "use a number of seconds from 0.01 to 1e6".into())
}

fn shared_seeds(key: Option<&Path>, mut group: Vec<String>, records: bool) -> anyhow::Result<Option<SharedSeeds>> {
    // Each of them stands by itself in a file of settings, so that the parser cannot ask for the others.
    anyhow::ensure!(key.is_some() != group.is_empty(), "--seed-key and --seed-group go together: give both or neither");
    anyhow::ensure!(key.is_none() || records, "--seed-key needs --record: a hosted run is kept in a folder");
    group.sort();
    group.dedup();
    key.map(|key| Ok(SharedSeeds { key: RecorderKey::read(key)?, group })).transpose()
}

/// Serves until it is told to stop; returns whether recorders then have every record.
pub fn run(args: DaemonArgs) -> anyhow::Result<bool> {
    fiatlux_cli::init_log();
    args.robot.check()?;
    let scene = match &args.scene {
        None => SceneConfig::default(),
        Some(path) => {
            let text = fiatlux_files::read_stream(path, MAX_SCENE_BYTES)
                .with_context(|| format!("cannot read {}", path.display()))?;
            SceneConfig::from_toml(&text).with_context(|| path.display().to_string())?
        }
    };
    let scene = scene.with_assets(&args.assets).context("--asset")?;
    let shared_seeds = shared_seeds(args.seed_key.as_deref(), args.seed_group, args.record.is_some())?;
    let mut options = ServerOptions {
        name: args.name,
        capacity: args.capacity,
        grace: args.grace,
        action_timeout: args.action_timeout,
        lockstep_timeout: args.lockstep_timeout,
        scene,
        weights: args.weights,
        meshes: args.meshes,
        record: args.record,
        shared_seeds,
        thin: args.bags.is_thin(),
        records_to: match &args.recorder_key {
            Some(path) => RecordsTo::Recorders(RecorderKey::read(path)?),
            None => RecordsTo::Nobody,
        },
        identity: args.identity.as_deref().map(Identity::read).transpose()?.map(Arc::new),
        tokens: args.tokens.as_deref().map(Tokens::read).transpose()?,
        ..ServerOptions::default()
    };
    options.workers = args.workers.unwrap_or(options.workers);
    if args.robot.unitree {
        return robot::run(&args.robot, options);
    }

    let metrics = args.metrics.map(Metrics::bind).transpose()?;
    // Set up before the server can be found, so that an early interrupt is not lost.
    let stop = fiatlux_cli::stop_on_signal()?;
    let mut link = args.link;
    link.asks_tokens = args.tokens.is_some();
    link.serves = Some(options.name.clone());
    for endpoint in &mut link.listen {
        let free = fiatlux_link::choose_port(endpoint);
        *endpoint = free.with_context(|| format!("no free port for {endpoint}; is its host one of this machine's?"))?;
    }
    let session = link.open_unless(Role::Server, &stop)?;
    let server = Server::start(session.carrier(), options)?;
    if let Some(metrics) = metrics {
        metrics.serve(server.counts())?;
    }
    fiatlux_cli::print(format!("{} as {}\n", link.place(Role::Server)?, server.name()))?;

    fiatlux_cli::wait_for(&stop);
    tracing::info!("interrupted: ending {}", count(server.open_sessions(), "session"));
    let is_whole = server.shutdown(SHUTDOWN);
    if !is_whole {
        fiatlux_cli::report(format!(
            "recorders have not taken all records of the sessions above within {} s; their bags are cut",
            SHUTDOWN.as_secs()
        ));
    }
    session.close()?;
    Ok(is_whole)
}
