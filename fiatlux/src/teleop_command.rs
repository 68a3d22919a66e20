//! `fiatlux teleop`.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use anyhow::Context;
use clap::Args;
use fiatlux_rules::Task;
use fiatlux_teleop::{Cockpit, Station, TakeOptions, takes};

use crate::network::over_tls;
use crate::view_command::open_browser;

/// Shown below the options.
pub const EXAMPLES: &str = "Examples:
  fiatlux teleop --task S07                               drive in room 0, and record takes into takes/
  fiatlux teleop --task S08 --seed 5 --out takes/grab     the same in another room
  fiatlux teleop --task S08 --lan                         from a headset on the network, over HTTPS
  scorer grade --takes takes                              the table of all takes

Exit codes: 0 ok, 1 failed, 2 usage.";

/// Options of the command.
#[derive(Debug, Args)]
pub struct TeleopArgs {
    /// Task to drive, such as S07.
    #[arg(long)]
    task: Task,
    /// Layout seed of the first room.
    #[arg(long, default_value_t = 0, value_parser = fiatlux_client::parse_seed, allow_hyphen_values = true)]
    seed: u64,
    /// Folder of the takes, a bag each.
    #[arg(long, value_name = "DIR", default_value = "takes")]
    out: PathBuf,
    /// Port to listen on [default: a free one; 8443 with --lan, as browsers remember a certificate by address and port]
    #[arg(long, value_name = "N", value_parser = fiatlux_cli::whole::<u16>(0..=65_535))]
    port: Option<u16>,
    /// Serves headsets on the network too, over HTTPS with a certificate of this machine's own; opens no browser
    #[arg(long)]
    lan: bool,
    /// Name or address of this machine for its certificate, the one for the page's address first; may be repeated [default:
    /// its address and its name]
    #[arg(long, value_name = "NAME_OR_IP", requires = "lan")]
    host: Vec<String>,
    /// Folder of the certificate, made where there is none [default: ~/.config/fiatlux/teleop]
    #[arg(long, value_name = "DIR", requires = "lan")]
    certificate: Option<PathBuf>,
    /// Opens no browser; the address is printed in any case.
    #[arg(long)]
    no_open: bool,
}

/// Port of the page over HTTPS.
const LAN_PORT: u16 = 8443;
/// Folder of the certificate, below that of the user.
const FOLDER: &str = ".config/fiatlux/teleop";

fn cockpit(args: &TeleopArgs, station: &Arc<Station>) -> anyhow::Result<Cockpit> {
    if !args.lan {
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, args.port.unwrap_or(0)));
        return Ok(Cockpit::bind(address, Arc::clone(station))?);
    }
    let folder = match &args.certificate {
        Some(folder) => folder.clone(),
        None => std::env::home_dir().context("no home folder is known; name one with --certificate")?.join(FOLDER),
    };
    let is_v6 = args.host.first().is_some_and(|host| host.parse::<Ipv6Addr>().is_ok());
    let every: IpAddr = if is_v6 { Ipv6Addr::UNSPECIFIED.into() } else { Ipv4Addr::UNSPECIFIED.into() };
    let address = SocketAddr::from((every, args.port.unwrap_or(LAN_PORT)));
    let (cockpit, said) = over_tls(Cockpit::bind(address, Arc::clone(station))?, &folder, &args.host)?;
    eprintln!("{said}");
    Ok(cockpit)
}

/// Runs the command: serves the page, and plays takes until Ctrl-C.
pub fn run(args: &TeleopArgs) -> anyhow::Result<ExitCode> {
    fiatlux_cli::init_quiet_log();
    let stop = fiatlux_cli::stop_on_signal().context("cannot listen for Ctrl-C")?;
    let station = Arc::new(Station::default());
    let cockpit = cockpit(args, &station)?;
    let url = cockpit.url();
    fiatlux_cli::print(format!("{url}\n"))?;
    let opened = !args.no_open && !args.lan && open_browser(&url);
    eprintln!("{}; Ctrl-C ends it", if opened { "opened in the browser" } else { "open this address in a browser" });
    let options = TakeOptions { task: args.task, seed: args.seed, out: args.out.clone() };
    let kept = std::thread::scope(|scope| {
        let page = scope.spawn(|| {
            let served = cockpit.serve(&stop);
            stop.store(true, Ordering::Relaxed);
            served
        });
        let kept = takes::play(&options, &station, &stop);
        stop.store(true, Ordering::Relaxed);
        let served = page.join();
        kept.map_err(anyhow::Error::new).and_then(|kept| match served {
            Ok(served) => Ok(served.map(|()| kept)?),
            Err(_) => anyhow::bail!("the page's thread ended early"),
        })
    })?;
    for bag in &kept.bags {
        fiatlux_cli::print(format!("{}\n", bag.display()))?;
    }
    eprintln!("{} takes kept, {} discarded", kept.bags.len(), kept.discarded);
    Ok(ExitCode::SUCCESS)
}
