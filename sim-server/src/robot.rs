//! The world as a robot: `sim-server --unitree`.

use std::net::IpAddr;

use clap::Args;
use fiatlux_cli::whole;
use fiatlux_rules::Task;
use fiatlux_server::ServerOptions;

#[derive(Debug, Args)]
#[command(next_help_heading = "As a robot")]
pub struct RobotArgs {
    /// Be a Unitree G1 in a domain of DDS instead of serving sessions: states on rt/lowstate, commands on rt/lowcmd. The episode begins with the first command. With --record it leaves a bag. Needs a build with
    /// --features unitree.
    #[arg(long)]
    pub unitree: bool,
    /// Domain [default: 1, that of Unitree's own simulator; a robot is in 0].
    #[arg(long, value_name = "N", value_parser = whole::<u16>(0..=232))]
    domain: Option<u16>,
    /// Address of this machine on the network to use, such as 127.0.0.1 [default: all networks].
    #[arg(long, value_name = "ADDRESS")]
    dds_address: Option<IpAddr>,
    /// Task of the episode: S01 to S12, replace or climb [default: S07].
    #[arg(long)]
    task: Option<Task>,
    /// Its room: layout seed [default: 0].
    #[arg(long, value_parser = whole::<u64>(0..))]
    seed: Option<u64>,
    /// Go on after ten commands a control step, as programs of 500 Hz send them, instead of with the clock.
    #[arg(long)]
    lockstep: bool,
}

impl RobotArgs {
    /// Refuses flags of a robot where none is asked for: a server of sessions takes task and room from its clients.
    ///
    /// # Errors
    /// Its text names the flag.
    pub fn check(&self) -> anyhow::Result<()> {
        let flags = [
            ("--domain", self.domain.is_some()),
            ("--dds-address", self.dds_address.is_some()),
            ("--task", self.task.is_some()),
            ("--seed", self.seed.is_some()),
            ("--lockstep", self.lockstep),
        ];
        match flags.iter().find(|(_, given)| *given && !self.unitree) {
            Some((flag, _)) => anyhow::bail!("{flag} is for --unitree: add that, or leave {flag} out"),
            None => Ok(()),
        }
    }
}

/// Plays the episode.
#[cfg(not(feature = "unitree"))]
pub fn run(_: &RobotArgs, _: ServerOptions) -> anyhow::Result<bool> {
    anyhow::bail!("--unitree needs DDS, which this build lacks; build sim-server with `--features unitree`")
}

/// Plays the episode.
#[cfg(feature = "unitree")]
pub fn run(args: &RobotArgs, options: ServerOptions) -> anyhow::Result<bool> {
    use anyhow::Context;
    use fiatlux_client::{Client, request_of};
    use fiatlux_proto::v3::Mode;
    use fiatlux_server::{BagEnd, LocalBags, LocalServer, Naming, RecordsTo};
    use fiatlux_unitree::{Pace, StandIn};

    let stop = fiatlux_cli::stop_on_signal()?;
    let pace = if args.lockstep { Pace::Commands } else { Pace::Clock };
    let (domain, task, seed) = (args.domain.unwrap_or(1), args.task.unwrap_or(Task::S07), args.seed.unwrap_or(0));
    let mut program = StandIn::join(domain, args.dds_address, pace)?;
    let (sender, reports) = std::sync::mpsc::channel();
    let bags = options.record.as_ref().map(|out| {
        std::fs::create_dir_all(out).with_context(|| format!("cannot make {}", out.display()))?;
        // The report comes before the server has stopped, and the receiver lives until then.
        let on_bag = Box::new(move |report| drop(sender.send(report)));
        anyhow::Ok(LocalBags { out: out.clone(), naming: Naming::Flat, thin: options.thin, on_bag })
    });
    let recorded = bags.is_some();
    let name = options.name.clone();
    let options = ServerOptions { workers: 1, record: None, records_to: RecordsTo::Nobody, ..options };
    let server = LocalServer::start(fiatlux_carrier::memory(), options, bags.transpose()?)?;
    let mut request = request_of(&program);
    request.task = task.to_string();
    request.seed = seed;
    request.mode = if args.lockstep { Mode::Lockstep } else { Mode::RealTime }.into();
    request.recorded = recorded;
    let mut client = Client::open(server.carrier(), Some(&name), request)?;
    fiatlux_cli::print(format!("a G1 in domain {domain}: {task} in room {seed}\n"))?;
    let played = client.run_episode(0, &mut program, &mut |_| {}, &stop);
    let closed = client.close();
    server.stop();
    drop(program);
    let mut is_whole = true;
    for report in reports.try_iter() {
        is_whole &= matches!(report.end, BagEnd::Whole(_));
        fiatlux_cli::print(format!("{}\n", report.path.display()))?;
    }
    match played {
        Ok(end) => {
            closed?;
            fiatlux_cli::print(format!("ended after {}: {}\n", fiatlux_proto::count(end.steps, "step"), end.cause))?;
            Ok(is_whole)
        }
        Err(fiatlux_client::ClientError::Stopped) => Ok(is_whole),
        Err(error) => Err(error.into()),
    }
}
