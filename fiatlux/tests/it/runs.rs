//! Whole runs by the library's client, on servers in this process: what is lost on the way changes nothing of what is played.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use fiatlux_bag::run::{EpisodeState, Ledger, journal_of, journals};
use fiatlux_bag::{Bag, Completeness};
use fiatlux_client::{
    Client, Command, EpisodeFate, Policy, PolicyError, RunError, RunFile, RunOptions, RunOutcome, RunProgress, Shard,
};
use fiatlux_grading::{GradeOptions, grade};
use fiatlux_link::{CarrierArgs, Role};
use fiatlux_policies::Zero;
use fiatlux_proto::v3::{Observation, OpenRequest, RunSpec, SessionInfo};
use fiatlux_rules::Task;
use fiatlux_server::{Server, ServerOptions};
use zenoh::{Session, Wait};

const EPISODES: usize = 12;

/// A policy of these tests: `Zero`, slowed down so that there is a half-way.
struct Slow {
    zero: Zero,
    wait: Duration,
}

impl Policy for Slow {
    fn name(&self) -> String {
        "slow".into()
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        self.zero.reset(info, first)
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        std::thread::sleep(self.wait);
        self.zero.act(observation)
    }
}

fn slow(wait_ms: u64) -> impl Fn() -> Result<Box<dyn Policy>, PolicyError> + Sync {
    move || Ok(Box::new(Slow { zero: Zero::default(), wait: Duration::from_millis(wait_ms) }))
}

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("runs").join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    folder
}

/// Short episodes: a robot that leans has fallen.
fn spec() -> RunSpec {
    let thresholds = [("fall_tilt_rad".to_string(), 0.05)].into();
    RunSpec {
        policy: "slow".into(),
        tasks: ["S01", "S05", "S08"].map(Into::into).to_vec(),
        seeds: vec![0, 1, 2, 3],
        session: Some(OpenRequest { thresholds, ..OpenRequest::default() }),
        ..RunSpec::default()
    }
}

fn server(zenoh: &Session, name: &str, folder: &Path) -> Server {
    let grace = Duration::from_millis(500);
    let record = Some(folder.join("bags"));
    let options = ServerOptions { name: name.into(), workers: 2, grace, record, ..ServerOptions::default() };
    Server::start(fiatlux_link::carrier(zenoh), options).unwrap()
}

fn options(folder: &Path, server: &str) -> RunOptions {
    let file = RunFile::open(&folder.join("RUN.toml"), &spec()).unwrap();
    let patience = Duration::from_secs(20);
    RunOptions { server: Some(server.into()), parallel: Some(4), patience, ..RunOptions::new(file) }
}

fn play(
    link: &Session,
    options: &RunOptions,
    wait_ms: u64,
    progress: &mut dyn FnMut(&RunProgress),
    stop: &AtomicBool,
) -> RunOutcome {
    Client::evaluate(&fiatlux_link::carrier(link), options, slow(wait_ms), progress, stop).unwrap()
}

fn digests(outcome: &RunOutcome) -> Vec<(String, u64, String)> {
    let of = |episode: &fiatlux_client::EpisodeOutcome| {
        assert_eq!(episode.fate, EpisodeFate::Played, "{episode:?}");
        (episode.task.clone(), episode.seed.unwrap(), episode.digest.clone())
    };
    outcome.episodes.iter().map(of).collect()
}

/// Digests of the run where nothing happens to it.
fn undisturbed() -> Vec<(String, u64, String)> {
    static DIGESTS: Mutex<Vec<(String, u64, String)>> = Mutex::new(Vec::new());
    let mut digests_of = DIGESTS.lock().unwrap();
    if digests_of.is_empty() {
        // Several tests come here, and each may be a process of its own.
        let name = format!("undisturbed-{}", std::process::id());
        let (folder, link) = (folder(&name), fiatlux_link::Link::embedded().unwrap().session().clone());
        let server = server(&link, "lab", &folder);
        let options = options(&folder, "lab");
        let outcome = play(&link, &options, 0, &mut |_| (), &AtomicBool::new(false));
        assert!(outcome.is_whole() && outcome.finished && !outcome.stopped, "{outcome:?}");
        let is_plain = |episode: &fiatlux_client::EpisodeOutcome| episode.attempts == 1 && !episode.digest.is_empty();
        assert!(outcome.episodes.iter().all(is_plain), "{outcome:?}");
        assert_eq!((outcome.episodes.len(), &outcome.servers[..]), (EPISODES, &["lab".to_string()][..]));
        assert_eq!(play(&link, &options, 0, &mut |_| (), &AtomicBool::new(false)), outcome, "it is over");
        server.shutdown(Duration::from_secs(10));
        check_bags(&folder, &outcome);
        fs::remove_dir_all(&folder).unwrap();
        *digests_of = digests(&outcome);
    }
    digests_of.clone()
}

/// Every episode that the outcome calls played has a whole bag with its digest, in the ledger of its server.
fn check_bags(folder: &Path, outcome: &RunOutcome) {
    let run = folder.join("bags").join(&outcome.run);
    for (index, episode) in outcome.episodes.iter().enumerate() {
        let Some(server) = &episode.server else { continue };
        let ledger = Ledger::read(journal_of(&run, server)).unwrap();
        let EpisodeState::Played(played) = &ledger.episodes()[index].state else {
            panic!("{:?}", ledger.episodes()[index])
        };
        let bag = Bag::open(run.join(&played.bag)).unwrap();
        let end = bag.result().unwrap().end.clone().unwrap();
        assert_eq!((bag.completeness(), &end.digest), (&Completeness::Whole, &episode.digest));
    }
}

#[test]
fn every_episode_is_played_once() {
    assert_eq!(undisturbed().len(), EPISODES);
}

/// Two servers of a group, each reached over TCP; one of them is lost half-way, with what it plays.
#[test]
fn a_run_survives_the_loss_of_a_server() {
    let folder = folder("loss");
    let endpoints = [0, 1].map(|_| fiatlux_link::choose_port("tcp/127.0.0.1:0").unwrap());
    let listen = |endpoint: &String| {
        CarrierArgs { listen: vec![endpoint.clone()], ..CarrierArgs::default() }
            .open(Role::Server)
            .unwrap()
            .session()
            .clone()
    };
    let links = endpoints.each_ref().map(listen);
    let _first = server(&links[0], "lab-1", &folder);
    let mut second = Some((server(&links[1], "lab-2", &folder), links[1].clone()));
    let link = CarrierArgs { connect: endpoints.to_vec(), ..CarrierArgs::default() }
        .open(Role::Client)
        .unwrap()
        .session()
        .clone();
    let (mut seen, mut lost) = (Vec::new(), Vec::new());
    let mut progress = |progress: &RunProgress| {
        let on_second = |server: &&str| *server == "lab-2";
        let there = progress.playing.iter().map(|episode| episode.server.as_str()).filter(on_second).count();
        seen.extend(progress.servers.iter().cloned());
        if progress.done >= 2
            && there > 0
            && let Some((server, link)) = second.take()
        {
            lost = progress.playing.clone();
            // As where its process is killed: the way to it goes first.
            link.close().wait().unwrap();
            drop(server);
        }
    };
    let outcome = play(&link, &options(&folder, "lab"), 40, &mut progress, &AtomicBool::new(false));
    assert!(!lost.is_empty(), "the second server has played nothing: {seen:?}");
    assert!(outcome.is_whole() && outcome.finished, "{outcome:?}");
    assert_eq!(outcome.servers, ["lab-1", "lab-2"]);
    assert_eq!(digests(&outcome), undisturbed());
    check_bags(&folder, &outcome);
    assert_eq!(journals(&folder.join("bags").join(&outcome.run)).unwrap().len(), 2);
}

/// The server dies and comes back with the same folder; the client waits for it.
#[test]
fn a_run_goes_on_when_its_server_is_back() {
    let (folder, link) = (folder("restart"), fiatlux_link::Link::embedded().unwrap().session().clone());
    let mut first = Some(server(&link, "lab", &folder));
    let mut again = None;
    let mut progress = |progress: &RunProgress| {
        if progress.done >= 2 && progress.playing.len() > 1 && first.is_some() {
            drop(first.take());
            again = Some(server(&link, "lab", &folder));
        }
    };
    let outcome = play(&link, &options(&folder, "lab"), 40, &mut progress, &AtomicBool::new(false));
    assert!(again.is_some() && outcome.is_whole() && outcome.finished, "{outcome:?}");
    assert!(outcome.episodes.iter().any(|episode| episode.attempts > 1), "some were begun again");
    assert_eq!(digests(&outcome), undisturbed());
    check_bags(&folder, &outcome);
}

/// Ctrl-C, and the same command once more.
#[test]
fn a_stopped_run_is_resumed_by_its_key() {
    let (folder, link) = (folder("stop"), fiatlux_link::Link::embedded().unwrap().session().clone());
    let _server = server(&link, "lab", &folder);
    let stop = AtomicBool::new(false);
    let mut progress = |progress: &RunProgress| stop.store(progress.done >= 2, Ordering::Relaxed);
    let outcome = play(&link, &options(&folder, "lab"), 40, &mut progress, &stop);
    let played = outcome.episodes.iter().filter(|episode| episode.fate == EpisodeFate::Played).count();
    assert!(outcome.stopped && !outcome.finished && (2..EPISODES).contains(&played), "{outcome:?}");
    let outcome = play(&link, &options(&folder, "lab"), 0, &mut |_| (), &AtomicBool::new(false));
    assert!(!outcome.stopped && outcome.finished);
    assert_eq!(digests(&outcome), undisturbed());

    // Another key is refused, and so is another policy under the same file.
    let mut stranger = options(&folder, "lab");
    stranger.file.key = "f".repeat(32);
    let error =
        Client::evaluate(&fiatlux_link::carrier(&link), &stranger, slow(0), &mut |_| (), &AtomicBool::new(false))
            .unwrap_err();
    assert!(
        matches!(&error, RunError::Client(error) if error.to_string().contains("the key is not the one")),
        "{error}"
    );
    let other = RunSpec { policy: "other".into(), ..spec() };
    assert!(RunFile::open(&folder.join("RUN.toml"), &other).is_err());
}

/// A server that comes when the run is under way takes its part.
#[test]
fn a_server_that_appears_later_joins() {
    let (folder, link) = (folder("later"), fiatlux_link::Link::embedded().unwrap().session().clone());
    let _first = server(&link, "lab-1", &folder);
    let mut second = None;
    let mut progress = |progress: &RunProgress| {
        if progress.done >= 1 && second.is_none() {
            second = Some(server(&link, "lab-2", &folder));
        }
    };
    let options = RunOptions { parallel: Some(2), ..options(&folder, "lab") };
    let outcome = play(&link, &options, 20, &mut progress, &AtomicBool::new(false));
    assert!(outcome.episodes.iter().any(|episode| episode.server.as_deref() == Some("lab-2")), "{outcome:?}");
    assert_eq!(digests(&outcome), undisturbed());
}

/// A policy that fails in one episode loses that one alone; the run is ended without it only where that is asked for.
#[test]
fn what_a_policy_cannot_play_is_lost() {
    struct Faulty(Zero, usize);
    impl Policy for Faulty {
        fn name(&self) -> String {
            "slow".into()
        }
        fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
            self.0.reset(info, first)
        }
        fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
            if self.1 == 1 { Ok(Command::Action(vec![f64::NAN; 53])) } else { self.0.act(observation) }
        }
    }
    let (folder, link) = (folder("faulty"), fiatlux_link::Link::embedded().unwrap().session().clone());
    let _server = server(&link, "lab", &folder);
    let made = AtomicUsize::new(0);
    let make = || {
        // The first one is made to see whether that works.
        let number = made.fetch_add(1, Ordering::Relaxed);
        Ok(Box::new(Faulty(Zero::default(), number)) as Box<dyn Policy>)
    };
    let mut options = options(&folder, "lab");
    let outcome =
        Client::evaluate(&fiatlux_link::carrier(&link), &options, make, &mut |_| (), &AtomicBool::new(false)).unwrap();
    let lost: Vec<_> = outcome.episodes.iter().filter(|episode| episode.fate == EpisodeFate::Lost).collect();
    assert!(lost.len() == 1 && lost[0].cause.contains("NaN") && !outcome.finished, "{lost:?}");

    options.give_up_lost = true;
    made.store(0, Ordering::Relaxed);
    let outcome =
        Client::evaluate(&fiatlux_link::carrier(&link), &options, make, &mut |_| (), &AtomicBool::new(false)).unwrap();
    let failed = outcome.episodes.iter().filter(|episode| episode.fate == EpisodeFate::Failed).count();
    assert!(outcome.finished && failed == 1, "{outcome:?}");
}

/// A policy that fits no session of the run is an error of the whole, not of one episode after the other.
#[test]
fn a_policy_that_does_not_fit_ends_the_call() {
    struct Unfit;
    impl Policy for Unfit {
        fn name(&self) -> String {
            "slow".into()
        }
        fn reset(&mut self, _: &SessionInfo, _: &Observation) -> Result<(), PolicyError> {
            Err(PolicyError::Sensor { policy: "slow", sensor: "camera" })
        }
        fn act(&mut self, _: &Observation) -> Result<Command, PolicyError> {
            Ok(Command::Action(Vec::new()))
        }
    }
    let (folder, link) = (folder("unfit"), fiatlux_link::Link::embedded().unwrap().session().clone());
    let _server = server(&link, "lab", &folder);
    let make = || Ok(Box::new(Unfit) as Box<dyn Policy>);
    let error = Client::evaluate(
        &fiatlux_link::carrier(&link),
        &options(&folder, "lab"),
        make,
        &mut |_| (),
        &AtomicBool::new(false),
    );
    assert!(matches!(error, Err(RunError::Policy(PolicyError::Sensor { sensor: "camera", .. }))), "{error:?}");
    let outcome = play(&link, &options(&folder, "lab"), 0, &mut |_| (), &AtomicBool::new(false));
    assert_eq!(digests(&outcome), undisturbed(), "nothing is lost by it");
}

/// Tasks that a policy does not play are refused before the run exists; those that it refuses all the same count as failed, and
/// the rest is played.
#[test]
fn tasks_that_a_policy_does_not_play_do_not_end_the_run() {
    struct Choosy {
        zero: Zero,
        says_so: bool,
    }
    impl Policy for Choosy {
        fn name(&self) -> String {
            "slow".into()
        }
        fn tasks(&self) -> &'static [Task] {
            if self.says_so { &[Task::S01, Task::S08] } else { &Task::ALL }
        }
        fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
            match info.task.as_ref().map(|task| task.task.as_str()) {
                Some("S05") => Err(PolicyError::Unfit { policy: "slow", reason: "not in S05".into() }),
                _ => self.zero.reset(info, first),
            }
        }
        fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
            self.zero.act(observation)
        }
    }
    let (folder, link) = (folder("choosy"), fiatlux_link::Link::embedded().unwrap().session().clone());
    let _server = server(&link, "lab", &folder);
    let play = |says_so: bool| {
        let make = move || Ok(Box::new(Choosy { zero: Zero::default(), says_so }) as Box<dyn Policy>);
        let carrier = fiatlux_link::carrier(&link);
        Client::evaluate(&carrier, &options(&folder, "lab"), make, &mut |_| (), &AtomicBool::new(false))
    };
    let error = play(true).unwrap_err().to_string();
    assert!(error.contains("does not play S05") && error.contains("--tasks S01,S08"), "{error}");
    let made = fs::read_dir(folder.join("bags")).unwrap().map(|entry| entry.unwrap().file_name());
    assert_eq!(made.collect::<Vec<_>>(), ["lab.lock"], "nothing is registered");

    let outcome = play(false).unwrap();
    let (failed, played): (Vec<_>, Vec<_>) = outcome.episodes.iter().partition(|episode| episode.task == "S05");
    assert!(outcome.finished && played.iter().all(|episode| episode.fate == EpisodeFate::Played), "{outcome:?}");
    let says_why = |episode: &&fiatlux_client::EpisodeOutcome| {
        episode.fate == EpisodeFate::Failed && episode.cause.contains("not in S05")
    };
    assert!(failed.len() == 4 && failed.iter().all(says_why), "{failed:?}");
}

/// To find out in the middle of an episode that a session does not fit is a failure of the policy, not a task that it refuses: the
/// run stays open, and the next call plays those episodes.
#[test]
fn a_policy_that_gives_up_after_its_first_step_loses_its_episode() {
    struct Late(Zero, bool);
    impl Policy for Late {
        fn name(&self) -> String {
            "slow".into()
        }
        fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
            self.1 = info.task.as_ref().is_some_and(|task| task.task == "S05");
            self.0.reset(info, first)
        }
        fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
            let unfit = || PolicyError::Unfit { policy: "slow", reason: "no pose".into() };
            if self.1 && observation.step == 3 { Err(unfit()) } else { self.0.act(observation) }
        }
    }
    let (folder, link) = (folder("late"), fiatlux_link::Link::embedded().unwrap().session().clone());
    let _server = server(&link, "lab", &folder);
    let make = || Ok(Box::new(Late(Zero::default(), false)) as Box<dyn Policy>);
    let (carrier, options) = (fiatlux_link::carrier(&link), options(&folder, "lab"));
    let outcome = Client::evaluate(&carrier, &options, make, &mut |_| (), &AtomicBool::new(false)).unwrap();
    let is_as_expected = |episode: &fiatlux_client::EpisodeOutcome| match episode.task.as_str() {
        "S05" => episode.fate == EpisodeFate::Lost && episode.cause.contains("no pose"),
        _ => episode.fate == EpisodeFate::Played,
    };
    assert!(!outcome.finished && outcome.episodes.iter().all(is_as_expected), "{outcome:?}");
    let outcome = play(&link, &options, 0, &mut |_| (), &AtomicBool::new(false));
    assert_eq!(digests(&outcome), undisturbed(), "the next call plays them");
}

/// A policy that plans by exact poses gets as much of a hosted room as of a public one: the same rows.
#[test]
fn walk_plays_hosted_rooms_as_public_ones() {
    let (folder, link) = (folder("walk"), fiatlux_link::Link::embedded().unwrap().session().clone());
    let _server = server(&link, "lab", &folder);
    let sensors: Vec<_> = ["proprioception", "hand_contact", "last_action", "privileged"].map(Into::into).into();
    let play = |name: &str, spec: RunSpec| {
        let file = RunFile::open(&folder.join(name), &spec).unwrap();
        let options = RunOptions { server: Some("lab".into()), ..RunOptions::new(file) };
        let make = || fiatlux_policies::Policies::default().make("walk");
        let carrier = fiatlux_link::carrier(&link);
        Client::evaluate(&carrier, &options, make, &mut |_| (), &AtomicBool::new(false)).unwrap()
    };
    let spec = RunSpec {
        policy: "walk".into(),
        tasks: ["S05", "S09"].map(Into::into).to_vec(),
        session: Some(OpenRequest { sensors, ..OpenRequest::default() }),
        ..RunSpec::default()
    };
    let hosted = play("hosted.toml", RunSpec { hosted_seeds: 3, ..spec.clone() });
    let mut seeds: Vec<u64> = hosted.episodes.iter().map(|episode| episode.seed.unwrap()).collect();
    seeds.sort_unstable();
    seeds.dedup();
    assert_eq!(seeds.len(), 3);
    let public = play("public.toml", RunSpec { seeds, ..spec });
    let sorted = |outcome: &RunOutcome| {
        let mut digests = digests(outcome);
        digests.sort();
        digests
    };
    assert_eq!(sorted(&hosted), sorted(&public));
}

#[test]
fn hosted_seeds_are_told_at_the_end() {
    let (folder, link) = (folder("hosted"), fiatlux_link::Link::embedded().unwrap().session().clone());
    let _servers = [server(&link, "lab", &folder), server(&link, "lab-2", &folder.join("2"))];
    let spec = RunSpec { seeds: Vec::new(), hosted_seeds: 1, ..spec() };
    let file = RunFile::open(&folder.join("RUN.toml"), &spec).unwrap();
    let options = RunOptions { server: Some("lab".into()), ..RunOptions::new(file) };
    let mut told = false;
    let mut progress = |progress: &RunProgress| told |= progress.playing.iter().any(|episode| episode.seed.is_some());
    let outcome = play(&link, &options, 2, &mut progress, &AtomicBool::new(false));
    assert!(outcome.is_whole() && outcome.finished && outcome.servers == ["lab"], "{outcome:?}");
    assert!(outcome.episodes.iter().all(|episode| episode.seed.is_some_and(|seed| seed > 1000)), "{outcome:?}");
}

/// Guards shards of one run: whoever plays the last episode on a server closes it, or each on a server of its own; the episodes are
/// those of one client either way.
#[test]
fn shards_play_each_episode_once() {
    const SHARDS: usize = 3;
    let folder = folder("shards");
    let of = |part| RunOptions { shard: Shard::new(part, SHARDS), ..options(&folder, "lab") };
    let expected: std::collections::BTreeSet<_> = undisturbed().into_iter().collect();
    let link = fiatlux_link::Link::embedded().unwrap().session().clone();
    let lab = server(&link, "lab", &folder);
    let mut played = Vec::new();
    for part in 1..=SHARDS {
        let outcome = play(&link, &of(part), 0, &mut |_| (), &AtomicBool::new(false));
        assert!(outcome.is_whole() && outcome.episodes.len() == EPISODES / SHARDS, "{outcome:?}");
        assert_eq!(outcome.finished, part == SHARDS, "{outcome:?}");
        played.extend(digests(&outcome));
    }
    lab.shutdown(Duration::from_secs(10));
    assert_eq!((played.len(), played.into_iter().collect()), (EPISODES, expected));

    let mut runs = Vec::new();
    for part in 1..=SHARDS {
        let options = RunOptions { is_alone: true, ..of(part) };
        let own = folder.join(format!("machine-{part}"));
        let link = fiatlux_link::Link::embedded().unwrap().session().clone();
        let name = format!("lab-{part}");
        let server = server(&link, &name, &own);
        let outcome = play(&link, &options, 0, &mut |_| (), &AtomicBool::new(false));
        server.shutdown(Duration::from_secs(10));
        assert!(outcome.is_whole() && outcome.finished, "{outcome:?}");
        runs.push(own.join("bags").join(&outcome.run));
    }
    let one = grade(&[folder.join("bags")], &GradeOptions::default(), &|_| ()).unwrap();
    let many = grade(&runs, &GradeOptions::default(), &|_| ()).unwrap();
    let rows = |results: &fiatlux_grading::Results| {
        let rows = results.episodes.iter().map(|one| (one.task.clone(), one.seed, one.state_digest.clone()));
        rows.collect::<Vec<_>>()
    };
    assert_eq!((rows(&many), &many.score), (rows(&one), &one.score));
    let run = many.run.unwrap();
    assert!(run.finished && run.failures.is_empty() && run.notes.is_empty(), "{run:?}");
    fs::remove_dir_all(&folder).unwrap();
}
