//! `fiatlux teleop`.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use anyhow::Context;
use clap::Args;
use fiatlux_rules::Task;
use fiatlux_teleop::{Cockpit, Station, TakeOptions, takes};

use crate::view_command::open_browser;

/// Shown below the options.
pub const EXAMPLES: &str = "Examples:
  fiatlux teleop --task S07                               drive in room 0, and record takes into takes/
  fiatlux teleop --task S08 --seed 5 --out takes/grab     the same in another room
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
    /// Port of 127.0.0.1 to listen on [default: a free one]
    #[arg(long, value_name = "N", default_value_t = 0, hide_default_value = true,
          value_parser = fiatlux_cli::whole::<u16>(0..=65_535))]
    port: u16,
    /// Opens no browser; the address is printed in any case.
    #[arg(long)]
    no_open: bool,
}

/// Runs the command: serves the page, and plays takes until Ctrl-C.
pub fn run(args: &TeleopArgs) -> anyhow::Result<ExitCode> {
    fiatlux_cli::init_quiet_log();
    let stop = fiatlux_cli::stop_on_signal().context("cannot listen for Ctrl-C")?;
    let station = Arc::new(Station::default());
    let address = SocketAddr::from((IpAddr::from(Ipv4Addr::LOCALHOST), args.port));
    let cockpit = Cockpit::bind(address, Arc::clone(&station))?;
    let url = cockpit.url();
    fiatlux_cli::print(format!("{url}\n"))?;
    let opened = !args.no_open && open_browser(&url);
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
