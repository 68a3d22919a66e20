//! The page on the command line: its options, and what serves it while takes are played.

use std::error::Error;
use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::Args;
use fiatlux_proto::{count, did_you_mean};
use fiatlux_robot::Robot;
use thiserror::Error;

use crate::serve::{Cockpit, Secure, ServeError};
use crate::station::Station;
use crate::studio::TakeError;
use crate::takes::Kept;

/// Port of the page over HTTPS.
const LAN_PORT: u16 = 8443;
/// Folder of the certificate, below that of the user.
const FOLDER: &str = ".config/fiatlux/teleop";

/// The robot that is driven.
#[derive(Debug, Clone, Args)]
pub struct RobotArgs {
    /// Robot to drive, by its name or that of its hands
    #[arg(long, value_name = "NAME", visible_alias = "hands", value_parser = robot, default_value = Robot::NAMES[0])]
    pub robot: &'static str,
}

fn robot(name: &str) -> Result<&'static str, String> {
    Robot::known(name).map_err(|error| format!("{error}{}", did_you_mean(name, Robot::NAMES)))
}

/// Where the page is served.
#[derive(Debug, Clone, Args)]
pub struct PageArgs {
    /// Port to listen on [default: a free one; 8443 with --lan, as browsers remember a certificate by address and port]
    #[arg(long, value_name = "N", value_parser = fiatlux_cli::whole::<u16>(0..=65_535))]
    port: Option<u16>,
    /// Serves headsets on the network too, over HTTPS with a certificate of this machine's own; opens no browser
    #[arg(long)]
    lan: bool,
    /// Name or address of this machine for its certificate, the one for the page's address first [default: its address and its
    /// name]; without --lan, the name of a tunnel that leads to the page. May be repeated
    #[arg(long, value_name = "NAME_OR_IP")]
    host: Vec<String>,
    /// Folder of the certificate, made where there is none [default: ~/.config/fiatlux/teleop]
    #[arg(long, value_name = "DIR", requires = "lan")]
    certificate: Option<PathBuf>,
    /// Opens no browser; the address is printed in any case.
    #[arg(long)]
    no_open: bool,
}

/// TLS for the page.
pub struct Secured {
    /// This machine's names, the one in the page's address first.
    pub names: Vec<String>,
    pub secure: Secure,
    /// For the user.
    pub said: String,
}

/// Why no takes were made.
#[derive(Debug, Error)]
pub enum CommandError {
    #[error("cannot listen for Ctrl-C")]
    Signals(#[source] io::Error),
    #[error("no home folder is known; name one with --certificate")]
    Home,
    #[error(transparent)]
    Tls(Box<dyn Error + Send + Sync>),
    #[error(transparent)]
    Serve(#[from] ServeError),
    #[error(transparent)]
    Takes(#[from] TakeError),
    #[error("the page's thread ended early")]
    Ended,
    #[error(transparent)]
    Print(#[from] io::Error),
}

impl PageArgs {
    /// Serves the page and plays takes until a signal ends them; prints the page's address, and then the takes that are kept.
    /// `secure` makes TLS with the certificate in a folder, for hosts, or for those that are this machine's.
    ///
    /// # Errors
    /// [`CommandError`].
    pub fn run<E: Into<Box<dyn Error + Send + Sync>>>(
        &self,
        secure: impl FnOnce(&Path, &[String]) -> Result<Secured, E>,
        play: impl FnOnce(&Arc<Station>, &Arc<AtomicBool>) -> Result<Kept, TakeError>,
    ) -> Result<(), CommandError> {
        let stop = fiatlux_cli::stop_on_signal().map_err(CommandError::Signals)?;
        let station = Arc::new(Station::default());
        let cockpit = self.cockpit(&station, secure)?;
        let url = cockpit.url();
        fiatlux_cli::print(format!("{url}\n"))?;
        // Kept until the end: nobody says when the browser has read it.
        let opened = if self.no_open || self.lan { None } else { fiatlux_cli::open_browser_secretly(&url) };
        let how = if opened.is_some() { "opened in the browser" } else { "open this address in a browser" };
        fiatlux_cli::report(format!("{how}; Ctrl-C ends it"));
        let kept = std::thread::scope(|scope| {
            let page = scope.spawn(|| {
                let served = cockpit.serve(&stop);
                stop.store(true, Ordering::Relaxed);
                served
            });
            let kept = play(&station, &stop);
            stop.store(true, Ordering::Relaxed);
            let served = page.join();
            let kept = kept?;
            served.map_err(|_| CommandError::Ended)??;
            Ok::<_, CommandError>(kept)
        })?;
        for bag in &kept.bags {
            fiatlux_cli::print(format!("{}\n", bag.display()))?;
        }
        fiatlux_cli::report(format!("{} kept, {} discarded", count(kept.bags.len(), "take"), kept.discarded));
        for bag in &kept.left {
            fiatlux_cli::report(format!("discarded, but still with its server: {}", bag.display()));
        }
        Ok(())
    }

    fn cockpit<E: Into<Box<dyn Error + Send + Sync>>>(
        &self,
        station: &Arc<Station>,
        secure: impl FnOnce(&Path, &[String]) -> Result<Secured, E>,
    ) -> Result<Cockpit, CommandError> {
        if !self.lan {
            let address = SocketAddr::from((Ipv4Addr::LOCALHOST, self.port.unwrap_or(0)));
            return Ok(Cockpit::bind(address, &self.host, Arc::clone(station))?);
        }
        let folder = match &self.certificate {
            Some(folder) => folder.clone(),
            None => std::env::home_dir().ok_or(CommandError::Home)?.join(FOLDER),
        };
        let is_v6 = self.host.first().is_some_and(|host| host.parse::<Ipv6Addr>().is_ok());
        let every: IpAddr = if is_v6 { Ipv6Addr::UNSPECIFIED.into() } else { Ipv4Addr::UNSPECIFIED.into() };
        let address = SocketAddr::from((every, self.port.unwrap_or(LAN_PORT)));
        let cockpit = Cockpit::bind(address, &[], Arc::clone(station))?;
        let Secured { names, secure, said } =
            secure(&folder, &self.host).map_err(|error| CommandError::Tls(error.into()))?;
        fiatlux_cli::report(&said);
        Ok(cockpit.over_tls(names, secure))
    }
}
