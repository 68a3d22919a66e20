//! Speed of sessions: the same episode in one process and over TCP, recorded or not, and many clients at once.

use std::fmt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use fiatlux_carrier::Reach;
use fiatlux_client::Client;
use fiatlux_link::{CarrierArgs, Role, choose_port};
use fiatlux_proto::keys::ServerKeys;
use fiatlux_proto::v3::OpenRequest;
use fiatlux_server::{LocalBags, LocalServer, Naming, ServerOptions};
use serde::Serialize;

use super::machine::machine;
use super::report::write_table;

/// A robot that stands from start to time-out with a bulb in the hand: every step costs the same.
const TASK: &str = "S05";
const POLICY: &str = "stand";
const SERVER: &str = "bench";
/// Longest time for client processes to open their sessions.
const START_TIME: Duration = Duration::from_secs(60);

/// Extent of the measurement.
#[derive(Debug, Clone)]
pub struct ServiceOptions {
    pub sessions: usize,
    /// Duration of the cases with client processes, s.
    pub seconds: f64,
    pub policy_client: PathBuf,
}

/// Result of `bench service`.
#[derive(Debug, Clone, Serialize)]
pub struct ServiceReport {
    pub machine: String,
    pub cases: Vec<ServiceCase>,
}

/// Speed of one session, or of several at once.
#[derive(Debug, Clone, Serialize)]
pub struct ServiceCase {
    pub name: String,
    pub sessions: usize,
    pub steps_per_s: f64,
    pub real_time_factor: f64,
    /// Median time from sending an action to the arrival of the observation that answers it, us.
    pub p50_us: Option<f64>,
    pub p99_us: Option<f64>,
    /// `steps_per_s` over that of the case that it is compared with.
    pub ratio: Option<f64>,
    pub compared_with: Option<&'static str>,
}

/// Why a case could not be run.
#[derive(Debug, thiserror::Error)]
#[error("case '{case}': {problem}")]
pub struct ServiceError {
    pub case: String,
    pub problem: String,
}

/// Measures all cases.
pub fn run(options: &ServiceOptions) -> Result<ServiceReport, ServiceError> {
    let mut cases = Vec::new();
    for (name, over_tcp, recorded) in [
        ("one process", false, false),
        ("one process, recorded", false, true),
        ("TCP loopback", true, false),
        ("TCP loopback, recorded", true, true),
    ] {
        let mut case = one_session(name, over_tcp, recorded).map_err(|problem| failed(name, problem))?;
        if over_tcp {
            let base: &ServiceCase = &cases[usize::from(recorded)];
            case.ratio = Some(case.steps_per_s / base.steps_per_s);
            case.compared_with = Some(if recorded { "one process, recorded" } else { "one process" });
        }
        cases.push(case);
    }
    let mut two = f64::NAN;
    for sessions in [2, options.sessions] {
        let name = format!("{sessions} client processes, recorded");
        let mut case = processes(&name, sessions, options).map_err(|problem| failed(&name, problem))?;
        if sessions == 2 {
            two = case.steps_per_s;
        } else {
            case.ratio = Some(case.steps_per_s / two);
            case.compared_with = Some("2 client processes, recorded");
        }
        cases.push(case);
    }
    Ok(ServiceReport { machine: machine(), cases })
}

fn failed(case: &str, problem: String) -> ServiceError {
    ServiceError { case: case.into(), problem }
}

/// A server, with a recorder if requested, which writes to a temporary folder.
struct Service {
    server: LocalServer,
    folder: PathBuf,
}

impl Service {
    fn start(listen: Option<String>, recorded: bool) -> Result<Self, String> {
        let link = match listen {
            None => fiatlux_carrier::memory(),
            Some(endpoint) => {
                let link = CarrierArgs { listen: vec![endpoint], ..CarrierArgs::default() }.open(Role::Server);
                link.map_err(text)?.carrier()
            }
        };
        let folder = std::env::temp_dir().join(format!("fiatlux-bench-{}", std::process::id()));
        let bags = LocalBags { out: folder.clone(), naming: Naming::BySession, thin: false, on_bag: Box::new(|_| ()) };
        let options = ServerOptions { name: SERVER.into(), capacity: 1024, ..ServerOptions::default() };
        let server = LocalServer::start(link, options, recorded.then_some(bags)).map_err(text)?;
        Ok(Self { server, folder })
    }

    fn stop(self) {
        self.server.stop();
        drop(std::fs::remove_dir_all(self.folder));
    }
}

/// Plays one episode with one client in this process.
fn one_session(name: &str, over_tcp: bool, recorded: bool) -> Result<ServiceCase, String> {
    let endpoint = over_tcp.then(free_endpoint).transpose()?;
    let service = Service::start(endpoint.clone(), recorded)?;
    let link = match endpoint {
        None => service.server.carrier().clone(),
        Some(endpoint) => {
            let link = CarrierArgs { connect: vec![endpoint], ..CarrierArgs::default() }.open(Role::Client);
            link.map_err(text)?.carrier()
        }
    };
    let request = OpenRequest { task: TASK.into(), policy: POLICY.into(), recorded, ..OpenRequest::default() };
    let mut policy = fiatlux_policies::Policies::default().make(POLICY).map_err(text)?;
    let mut client = Client::open(&link, Some(SERVER), request).map_err(text)?;
    let mut start = Instant::now();
    let mut first_step = |step| {
        if step == 1 {
            start = Instant::now();
        }
    };
    let end = client.run_episode(0, policy.as_mut(), &mut first_step, &AtomicBool::new(false)).map_err(text)?;
    let steps_per_s = end.steps.saturating_sub(1) as f64 / start.elapsed().as_secs_f64();
    let quantile = |share| client.round_trips().quantile_s(share).map(|s| s * 1e6);
    let (p50_us, p99_us) = (quantile(0.5), quantile(0.99));
    client.close().map_err(text)?;
    service.stop();
    Ok(ServiceCase { p50_us, p99_us, ..case(name, 1, steps_per_s) })
}

/// Runs many client processes, and counts the rows that the server publishes while all of them play.
fn processes(name: &str, sessions: usize, options: &ServiceOptions) -> Result<ServiceCase, String> {
    let endpoint = free_endpoint()?;
    let service = Service::start(Some(endpoint.clone()), true)?;
    let rows = Arc::new(AtomicU64::new(0));
    let counted = Arc::clone(&rows);
    let subscriber = service.server.carrier().subscribe(
        &ServerKeys::new(SERVER).session("*").truth_row(),
        Reach::Everywhere,
        move |_| {
            counted.fetch_add(1, Ordering::Relaxed);
        },
    );
    let subscriber = subscriber.map_err(text)?;
    let clients = (0..sessions).map(|seed| Player::start(&options.policy_client, &endpoint, seed));
    let clients = clients.collect::<Result<Vec<_>, _>>()?;
    let start = Instant::now();
    while service.server.open_sessions() < sessions {
        if start.elapsed() > START_TIME {
            let open = service.server.open_sessions();
            return Err(format!("only {open} of {sessions} clients opened a session within {START_TIME:?}"));
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    // The last of them are still staging their episodes.
    std::thread::sleep(Duration::from_secs(2));
    let (start, before) = (Instant::now(), rows.load(Ordering::Relaxed));
    std::thread::sleep(Duration::from_secs_f64(options.seconds));
    let (played, open) = (rows.load(Ordering::Relaxed) - before, service.server.open_sessions());
    let steps_per_s = played as f64 / start.elapsed().as_secs_f64();
    if open < sessions {
        return Err(format!(
            "{} clients were done before the end; watch for less than {} s",
            sessions - open,
            options.seconds
        ));
    }
    drop(subscriber);
    drop(clients);
    service.stop();
    Ok(case(name, sessions, steps_per_s))
}

fn case(name: &str, sessions: usize, steps_per_s: f64) -> ServiceCase {
    ServiceCase {
        name: name.into(),
        sessions,
        steps_per_s,
        real_time_factor: steps_per_s * fiatlux_rules::CONTROL_DT,
        p50_us: None,
        p99_us: None,
        ratio: None,
        compared_with: None,
    }
}

/// A client process, which is killed on drop.
struct Player(Child);

impl Player {
    fn start(program: &Path, endpoint: &str, seed: usize) -> Result<Self, String> {
        let seed = seed.to_string();
        let episode = ["run", "--policy", POLICY, "--task", TASK, "--episodes", "100", "--recorded", "--seed", &seed];
        let mut command = Command::new(program);
        command.args(episode).args(["--server", SERVER, "-e", endpoint]);
        let child = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
        let remedy = "build it with cargo build --release --bins --workspace, or name it with --policy-client";
        child.map(Self).map_err(|error| format!("cannot start {}: {error}; {remedy}", program.display()))
    }
}

impl Drop for Player {
    fn drop(&mut self) {
        drop(self.0.kill());
        drop(self.0.wait());
    }
}

fn free_endpoint() -> Result<String, String> {
    choose_port("tcp/127.0.0.1:0").map_err(|error| format!("no free port: {error}"))
}

fn text(error: impl fmt::Display) -> String {
    format!("{error:#}")
}

impl fmt::Display for ServiceReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.machine)?;
        writeln!(f, "Control steps of 20 ms, task {TASK}, policy {POLICY}:\n")?;
        let header = ["case", "steps/s", "x real time", "p50, us", "p99, us", "ratio", "to"];
        let mut rows = vec![header.map(str::to_owned).to_vec()];
        for case in &self.cases {
            let number = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.0}"));
            rows.push(vec![
                case.name.clone(),
                number(Some(case.steps_per_s)),
                number(Some(case.real_time_factor)),
                number(case.p50_us),
                number(case.p99_us),
                case.ratio.map_or("-".into(), |ratio| format!("{ratio:.2}")),
                case.compared_with.unwrap_or("-").into(),
            ]);
        }
        write_table(f, &rows)
    }
}
