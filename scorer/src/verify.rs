//! `scorer verify`: plays bags again, on one server or many.

use std::collections::{BTreeMap, VecDeque};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use anyhow::{Context, Result, anyhow, bail};
use clap::Args;
use fiatlux_access::{KnownServers, PublicKey};
use fiatlux_bag::BagFiles;
use fiatlux_carrier::Carrier;
use fiatlux_cli::{INTERRUPTED, ProgressLine, print, report as tell};
use fiatlux_client::{Access, AccessArgs, find_server};
use fiatlux_grading::find_bags;
use fiatlux_link::{CarrierArgs, Role};
use fiatlux_proto::{count, plain};
use fiatlux_verify::verify;

use crate::UNVERIFIED;

/// Simulate recorded episodes again on a server, and compare bit for bit
///
/// Needs a server: start one with `sim-server`. Checks each bag as grade does, opens a session with the conditions in its
/// header, sends its actions again, and compares header, rows and result of the second run with those in the bag. Prints the
/// first difference with both values, and which server signed the bag. Exit code 0: all are equal to the last bit and, with
/// --signers, signed by a trusted server; 4: one differs, is not signed, was never finished, or could not be simulated; 1:
/// there is no server or no bag; 130: interrupted before all were simulated.
///
/// `verify` checks single bags. Use `grade` as well: it finds missing, repeated and unregistered ones.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sim-server &
  scorer verify results/zero/bags/S01-s0-e0.mcap
  scorer verify results/zero                           all bags of a run
  scorer verify results/zero --server a,b --parallel 4 two servers, four bags at a time on each")]
pub struct VerifyArgs {
    /// Bags to verify, or folders to search for *.mcap, including subfolders
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Name of the server, if several can be reached; several, such as a,b,c, share the bags
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    server: Vec<String>,
    /// Bags at a time on each server; a server uses one core for each
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = fiatlux_cli::whole::<usize>(1..=1024))]
    parallel: usize,
    /// File with the keys of servers that you trust, one line NAME ed25519:BASE64 each; a bag that none of them signed
    /// fails
    #[arg(long, value_name = "FILE")]
    signers: Option<PathBuf>,
    #[command(flatten)]
    access: AccessArgs,
    #[command(flatten)]
    link: CarrierArgs,
}

/// Period at which a worker without a bag looks for one that another has put back.
const LOOK: Duration = Duration::from_millis(50);
/// Pause of a worker whose server has no room, and how often it tries before it gives up.
const PAUSE: Duration = Duration::from_secs(2);
const TRIES: u32 = 6;

/// The bags that wait for a server.
#[derive(Default)]
struct Queue {
    waiting: VecDeque<PathBuf>,
    in_work: usize,
    ended: usize,
    good: usize,
    /// Bags by the digests of their header and rows.
    episodes: BTreeMap<(String, String), Vec<PathBuf>>,
}

/// Shared by all workers.
struct Work<'a> {
    queue: Mutex<Queue>,
    all: usize,
    line: ProgressLine,
    link: &'a Carrier,
    access: &'a Access,
    signers: Option<&'a KnownServers>,
    stop: &'a AtomicBool,
}

pub fn run(args: &VerifyArgs) -> Result<ExitCode> {
    let stop = fiatlux_cli::stop_on_signal().context("cannot listen for Ctrl-C")?;
    let access = args.access.read()?;
    let signers = args.signers.as_deref().map(KnownServers::read).transpose()?;
    let BagFiles { bags, unfinished, .. } = find_bags(&args.paths)?;
    for part in &unfinished {
        let part = part.display().to_string();
        tell(format!("warning: {}: its recording was never finished, so it cannot be verified", plain(&part)));
    }
    let all = bags.len() + unfinished.len();
    if bags.is_empty() {
        bail!("there is no bag to verify");
    }
    let (link, servers) = match connect(args) {
        Err(_) if stop.load(Relaxed) => return Ok(interrupted(all, all)),
        connected => connected?,
    };
    let workers = args.parallel.min(bags.len());
    let work = Work {
        queue: Mutex::new(Queue { waiting: bags.into(), ..Queue::default() }),
        all,
        line: ProgressLine::default(),
        link: &link,
        access: &access,
        signers: signers.as_ref(),
        stop: &stop,
    };
    std::thread::scope(|scope| {
        let work = &work;
        let places = servers.iter().flat_map(|server| std::iter::repeat_n(server, workers));
        let threads: Vec<_> = places.map(|server| scope.spawn(move || work.on(server))).collect();
        let ends =
            threads.into_iter().map(|thread| thread.join().unwrap_or_else(|_| Err(anyhow!("a thread panicked"))));
        ends.collect::<Vec<Result<()>>>().into_iter().collect::<Result<()>>()
    })?;
    let Queue { waiting, good, episodes, .. } = work.queue.into_inner().unwrap_or_else(PoisonError::into_inner);
    for copies in episodes.into_values().filter(|bags| bags.len() > 1) {
        let names: Vec<_> = copies.iter().map(|bag| bag.display().to_string()).collect();
        print(format!("{} bags are the same episode: {}\n", names.len(), plain(&names.join(", "))))?;
    }
    if all > 1 {
        print(format!("{good} of {all} bags are verified\n"))?;
    }
    if stop.load(Relaxed) && !waiting.is_empty() {
        return Ok(interrupted(waiting.len(), all));
    }
    if !waiting.is_empty() {
        tell(format!("warning: {} of {} not simulated again", waiting.len(), count(all, "bag")));
    }
    Ok(if good == all { ExitCode::SUCCESS } else { ExitCode::from(UNVERIFIED) })
}

/// The link, and the servers on it. Found once, and not for each bag: a server that is not there is waited for.
fn connect(args: &VerifyArgs) -> Result<(Carrier, Vec<String>)> {
    let link = args.link.open(Role::Client).context("cannot connect to a server")?.carrier();
    let servers = match args.server.as_slice() {
        [] => vec![find_server(&link, None)?],
        named => named.iter().map(|name| find_server(&link, Some(name))).collect::<Result<_, _>>()?,
    };
    Ok((link, servers))
}

/// Says that it was the user who ended it, and no fault of a server or a bag.
fn interrupted(left: usize, all: usize) -> ExitCode {
    tell(format!("interrupted: {left} of {} not simulated again", count(all, "bag")));
    ExitCode::from(INTERRUPTED)
}

impl Work<'_> {
    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The next bag; waits while others may still put theirs back.
    fn next(&self) -> Option<PathBuf> {
        loop {
            let mut queue = self.queue();
            if let Some(bag) = queue.waiting.pop_front() {
                queue.in_work += 1;
                return Some(bag);
            }
            if queue.in_work == 0 {
                return None;
            }
            drop(queue);
            std::thread::sleep(LOOK);
        }
    }

    /// Writes a line to stderr, in which names of files and a server's words may stand.
    fn complain(&self, what: &str) {
        self.line.write_over(|| tell(format!("warning: {}", plain(what))));
    }

    /// Verifies bags on a server until none is left, or the server takes no more.
    fn on(&self, server: &str) -> Result<()> {
        let mut tries = 0;
        while let Some(bag) = self.next() {
            let mut show = |step, steps| {
                let (done, of, what) = match self.all as u64 {
                    1 => (step, steps, "steps"),
                    all => (self.queue().ended as u64, all, "bags"),
                };
                self.line.show(|| format!("{done} of {of} {what}, {} left", self.line.left(done, of)));
            };
            let verified = verify(&bag, self.link, Some(server), self.access, &mut show, self.stop);
            let mut queue = self.queue();
            queue.in_work -= 1;
            match verified {
                Ok(verified) => {
                    let (said, is_trusted) = signature(verified.signer.as_ref(), self.signers);
                    tries = 0;
                    queue.ended += 1;
                    queue.good += usize::from(verified.is_equal() && is_trusted);
                    let episode = (verified.header_digest.clone(), verified.recorded.digest.clone());
                    queue.episodes.entry(episode).or_default().push(bag);
                    drop(queue);
                    let written = self.line.write_over(|| print(format!("{verified}{said}\n")));
                    written.inspect_err(|_| self.queue().waiting.clear())?;
                }
                Err(error) if self.stop.load(Relaxed) || error.is_of_server() => {
                    queue.waiting.push_front(bag);
                    drop(queue);
                    if self.stop.load(Relaxed) {
                        return Ok(());
                    }
                    tries += 1;
                    if !error.is_busy() || tries >= TRIES {
                        let error = anyhow::Error::from(error);
                        self.complain(&format!("server {server}: {error:#}; it gets no more bags"));
                        return Ok(());
                    }
                    std::thread::sleep(PAUSE);
                }
                Err(error) => {
                    queue.ended += 1;
                    drop(queue);
                    let error = anyhow::Error::from(error);
                    self.complain(&format!("{}: {error:#}", bag.display()));
                }
            }
        }
        Ok(())
    }
}

/// Says who signed the bag, and whether that is enough: without a list of trusted keys, it always is.
fn signature(signer: Option<&PublicKey>, signers: Option<&KnownServers>) -> (String, bool) {
    match (signer, signers) {
        (None, None) => ("not signed (its server had no --identity)".into(), true),
        (None, Some(_)) => ("fails: not signed, and --signers asks for a signature".into(), false),
        (Some(key), None) => (format!("signed by {key}; use --signers FILE to say whom you trust"), true),
        (Some(key), Some(signers)) => match signers.name_of(key) {
            Some(name) => (format!("signed by {name}, {key}"), true),
            None => (format!("fails: signed by {key}, which is not among the trusted keys"), false),
        },
    }
}
