//! Servers that share a folder, the client of a run on them, and what must hold of the run in the end.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Mutex;

use fiatlux_bag::run::{EpisodeState, Ledger, LedgerEpisode, journals};
use fiatlux_tests::programs::{PATIENCE, Running, Scratch, endpoint, free_port, grade};
use serde_json::Value;

/// Task and seed of an episode.
pub type Name = (String, u64);

/// A run as its user asks for it.
#[derive(Debug, Clone, Copy)]
pub struct RunArgs {
    pub tasks: &'static str,
    pub seeds: &'static str,
    pub episodes: usize,
    /// Most episodes at once, as given to the client.
    pub parallel: &'static str,
}

/// The benchmark: 12 tasks in 4 rooms. `zero` falls in a second or so; a robot that leans on something is made to count as
/// fallen, so that no episode takes a minute.
pub const BENCHMARK: RunArgs = RunArgs { tasks: "all", seeds: "0..3", episodes: 48, parallel: "4" };

/// Servers `lab-1`, `lab-2` and so on, which record into one folder.
pub struct Lab {
    servers: Vec<Option<Running>>,
    ports: Vec<u16>,
    asked: RunArgs,
    /// They record into one folder.
    shares: bool,
    /// Largest file of a server, in units of 512 bytes.
    file_blocks: Option<u32>,
    /// Where they record; dropped last, after its users.
    pub folder: Scratch,
}

impl Lab {
    pub fn start(name: &str, servers: usize, asked: RunArgs) -> Self {
        Self::start_with(name, servers, asked, true, None)
    }

    pub fn start_with(name: &str, servers: usize, asked: RunArgs, shares: bool, file_blocks: Option<u32>) -> Self {
        let ports = (0..servers).map(|_| free_port()).collect();
        let folder = Scratch::new(name);
        let mut lab = Self { servers: Vec::new(), ports, asked, shares, file_blocks, folder };
        lab.servers.resize_with(servers, || None);
        (0..servers).for_each(|server| lab.revive(server));
        lab
    }

    /// Starts a server, or starts it again.
    pub fn revive(&mut self, server: usize) {
        let (name, bags) = (format!("lab-{}", server + 1), self.bags(server).display().to_string());
        let listen = endpoint(self.ports[server]);
        let args = ["--name", &name, "-l", &listen, "--record", &bags, "--grace", "1", "--workers", "2"];
        let server = &mut self.servers[server];
        *server = Some(match self.file_blocks {
            None => Running::start("sim-server", &args, &self.folder),
            Some(blocks) => Running::start_limited("sim-server", &args, &self.folder, blocks),
        });
        server.as_mut().unwrap().wait_for("listening on ");
    }

    pub fn server(&mut self, server: usize) -> &mut Running {
        self.servers[server].as_mut().unwrap()
    }

    pub fn kill(&mut self, server: usize) {
        self.server(server).kill();
    }

    /// The folder of a server.
    fn bags(&self, server: usize) -> PathBuf {
        self.folder.path().join(if self.shares { "bags".into() } else { format!("bags-{server}") })
    }

    /// `policy-client evaluate` on all servers; called again it goes on with the run.
    pub fn client(&self) -> Running {
        self.client_with(&[])
    }

    /// The same with more options.
    pub fn client_with(&self, options: &[&str]) -> Running {
        let run_file = self.folder.path().join("RUN.toml").display().to_string();
        let RunArgs { tasks, seeds, parallel, .. } = self.asked;
        let mut args =
            ["evaluate", "--json", "--policy", "zero", "--server", "lab", "--set", "fall_tilt_rad=0.05"].to_vec();
        // A condition of the sessions, which a verification has to keep too.
        args.extend(["--action-delay", "40"]);
        args.extend(["--tasks", tasks, "--seeds", seeds, "--parallel", parallel, "--run-file", &run_file]);
        args.extend(options);
        let endpoints: Vec<String> = self.ports.iter().map(|port| endpoint(*port)).collect();
        endpoints.iter().for_each(|endpoint| args.extend(["-e", endpoint]));
        Running::start("policy-client", &args, &self.folder)
    }

    /// The folders of the one run: one where the servers share it.
    pub fn runs(&self) -> Vec<PathBuf> {
        let of =
            |server| std::fs::read_dir(self.bags(server)).into_iter().flatten().flatten().map(|entry| entry.path());
        let mut runs: Vec<PathBuf> = (0..self.ports.len()).flat_map(of).collect();
        runs.retain(|folder| journals(folder).is_ok_and(|found| !found.is_empty()));
        runs.sort();
        runs.dedup();
        runs
    }

    /// Episodes that are played, over all servers; each as its digest, by index.
    pub fn on_disk(&self) -> Vec<(usize, String)> {
        let journals = self.runs().into_iter().flat_map(|run| journals(&run).unwrap());
        let digest = |episode: &LedgerEpisode| match &episode.state {
            EpisodeState::Played(played) => Some(played.digest.clone()),
            _ => None,
        };
        let of = |ledger: Ledger| {
            let episodes = ledger.episodes().iter().enumerate();
            episodes.filter_map(|(index, episode)| Some((index, digest(episode)?))).collect::<Vec<_>>()
        };
        journals.filter_map(|path| Ledger::read(path).ok()).flat_map(of).collect()
    }

    pub fn played(&self) -> usize {
        self.on_disk().len()
    }

    /// Checks a run that is over: its client knows every episode as played, the scorer grades them all and has
    /// nothing to remark, and every digest is that of the run that nobody disturbs.
    pub fn assert_whole(&self, client: &mut Running) {
        let (status, text) = client.finish(PATIENCE);
        assert!(status.success(), "{status}: {text}\nlog:\n{}", client.log());
        let outcome: Value = serde_json::from_str(&text).unwrap();
        assert_eq!((&outcome["finished"], &outcome["stopped"]), (&true.into(), &false.into()), "{outcome:#}");
        let expected = undisturbed(self.asked);
        let states = outcome["episodes"].as_array().unwrap().iter().map(|episode| episode["state"].as_str().unwrap());
        assert!(states.clone().count() == self.asked.episodes && states.clone().all(|state| state == "played"));
        assert_eq!(digests(&outcome, "digest"), expected);
        self.assert_graded(expected);
    }

    /// A server that is left simulates an episode of the run again, to the same bytes.
    pub fn assert_verified(&self, server: usize) {
        let bag = self.folder.files(".mcap").remove(0).display().to_string();
        let mut scorer = Running::start("scorer", &["verify", &bag, "-e", &endpoint(self.ports[server])], &self.folder);
        let (status, text) = scorer.finish(PATIENCE);
        assert!(status.success() && text.starts_with("equal: "), "{text}\n{}", scorer.log());
    }

    /// The scorer grades every episode from its bag, and finds these rows.
    fn assert_graded(&self, expected: BTreeMap<Name, String>) {
        let (code, results) = grade(&self.runs()[0], &self.folder);
        let run = &results["run"];
        assert_eq!((code, run["failures"].as_array().map(Vec::len)), (0, Some(0)), "{run:#}");
        assert_eq!((&run["finished"], &run["played"]), (&true.into(), &self.asked.episodes.into()), "{run:#}");
        assert_eq!(digests(&results, "state_digest"), expected);
    }
}

/// The digest of every episode, by its name in a list of JSON.
pub fn digests(list: &Value, field: &str) -> BTreeMap<Name, String> {
    let digest = |episode: &Value| {
        let name = (episode["task"].as_str().unwrap().to_owned(), episode["seed"].as_u64().unwrap());
        (name, episode[field].as_str().unwrap().to_owned())
    };
    list["episodes"].as_array().unwrap().iter().map(digest).collect()
}

/// Every episode's digest where nothing happens to the run. Played once for all tests of a process.
pub fn undisturbed(asked: RunArgs) -> BTreeMap<Name, String> {
    static KNOWN: Mutex<BTreeMap<[&str; 2], BTreeMap<Name, String>>> = Mutex::new(BTreeMap::new());
    let mut known = KNOWN.lock().unwrap();
    let digests = known.entry([asked.tasks, asked.seeds]).or_insert_with(|| {
        let lab = Lab::start("undisturbed", 1, asked);
        let (status, text) = lab.client().finish(PATIENCE);
        assert!(status.success(), "{status}: {text}");
        let digests = digests(&serde_json::from_str(&text).unwrap(), "digest");
        assert_eq!(digests.len(), asked.episodes);
        lab.assert_graded(digests.clone());
        digests
    });
    digests.clone()
}
