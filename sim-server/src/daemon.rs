//! The server as a process of its own.

use std::io::Write as _;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context;
use clap::Args;
use fiatlux_link::{DEFAULT_ENDPOINT, LinkArgs, LinkMode, Role};
use fiatlux_sim::{Server, ServerOptions};
use fiatlux_world::SceneConfig;
use zenoh::Wait;

/// How long recorders have after an interrupt.
const SHUTDOWN: Duration = Duration::from_secs(12);

#[derive(Debug, Args)]
#[command(next_help_heading = "Server")]
pub struct DaemonArgs {
    /// Name by which clients find this server: letters, digits, - and _; unique on its network.
    #[arg(long, default_value = "local")]
    name: String,
    /// Threads that step sessions [default: one for each core].
    #[arg(long)]
    workers: Option<usize>,
    /// Sessions that can be open at once.
    #[arg(long, default_value_t = 64)]
    capacity: usize,
    /// How long a session waits for a client that is gone, s.
    #[arg(long, value_name = "SECONDS", default_value = "10", value_parser = seconds)]
    grace: Duration,
    /// How long a session waits for an action, s.
    #[arg(long, value_name = "SECONDS", default_value = "60", value_parser = seconds)]
    action_timeout: Duration,
    /// Scene config: what it names replaces the published values. Runs in another scene are not ranked.
    #[arg(long, value_name = "FILE.toml")]
    scene: Option<PathBuf>,
    /// Folder of safetensors files with weights of ResNet-18; a session names one of them for the camera's features.
    #[arg(long, value_name = "DIR")]
    weights: Option<PathBuf>,
    /// Folder of meshes of the robot's links in metres, LINK.stl or LINK.obj such as those of Unitree's description: pictures
    /// show them in place of our own shapes. Runs whose policies see such pictures are not ranked.
    #[arg(long, value_name = "DIR")]
    meshes: Option<PathBuf>,
    /// Records every session itself, below this folder, and keeps runs there: the form for ranked runs. Bags of a run go to
    /// DIR/RUN/, those of other sessions to DIR/SERVER/SESSION/.
    #[arg(long, value_name = "DIR")]
    record: Option<PathBuf>,
    #[command(flatten)]
    link: LinkArgs,
}

fn seconds(text: &str) -> Result<Duration, String> {
    let parsed = text.parse().ok().filter(|secs| (0.01..=1e6).contains(secs));
    parsed.map(Duration::from_secs_f64).ok_or_else(|| "it is a number of seconds from 0.01 to 1e6".into())
}

pub fn run(args: DaemonArgs) -> anyhow::Result<()> {
    fiatlux_link::init_log();
    let scene = match &args.scene {
        None => SceneConfig::default(),
        Some(path) => {
            let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
            SceneConfig::from_toml(&text).with_context(|| path.display().to_string())?
        }
    };
    let mut options = ServerOptions {
        name: args.name,
        capacity: args.capacity,
        grace: args.grace,
        action_timeout: args.action_timeout,
        scene,
        weights: args.weights,
        meshes: args.meshes,
        record: args.record,
        ..ServerOptions::default()
    };
    options.workers = args.workers.unwrap_or(options.workers);

    // Before the server can be found: an interrupt that comes early is not lost.
    let stop = fiatlux_link::stop_on_signal()?;
    let mut link = args.link;
    for endpoint in &mut link.listen {
        let free = fiatlux_link::choose_port(endpoint);
        *endpoint = free.with_context(|| format!("no free port for {endpoint}; is its host one of this machine's?"))?;
    }
    let zenoh = link.open(Role::Server)?;
    let server = Server::start(zenoh.clone(), options)?;
    let mut stdout = std::io::stdout();
    writeln!(stdout, "{} as {}", reachable(&link), server.name())?;
    stdout.flush()?;

    fiatlux_link::wait_for(&stop);
    tracing::info!("interrupted: {} sessions are ended", server.open_sessions());
    if !server.shutdown(SHUTDOWN) {
        tracing::warn!("a recorder has not taken everything within {} s; its bag is cut", SHUTDOWN.as_secs());
    }
    zenoh.close().wait().map_err(|error| anyhow::anyhow!("cannot close the Zenoh session: {error}"))
}

/// Where clients find the server.
fn reachable(link: &LinkArgs) -> String {
    if !link.listen.is_empty() {
        format!("listening on {}", link.listen.join(", "))
    } else if !link.connect.is_empty() {
        format!("connected to {}", link.connect.join(", "))
    } else if let Some(path) = &link.config {
        format!("listening as {} says", path.display())
    } else if link.mode == Some(LinkMode::Client) {
        format!("connected to {DEFAULT_ENDPOINT}")
    } else {
        format!("listening on {DEFAULT_ENDPOINT}")
    }
}
