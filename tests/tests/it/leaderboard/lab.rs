//! A server that plays and verifies, and a leaderboard over it.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::atomic::AtomicBool;

use fiatlux_access::{Identity, KnownServers};
use fiatlux_leaderboard::{Submit, SubmitProgress, Upload};
use fiatlux_tests::programs::{PATIENCE, Running, Scratch, Service, endpoint, free_port, program, wait_until};
use serde_json::Value;

/// A server that records, keeps runs and signs.
pub struct Lab {
    service: Service,
    keys: Scratch,
}

impl Lab {
    pub fn start(name: &str) -> Self {
        let keys = Scratch::new(&format!("{name}-keys"));
        let identity = Identity::generate().unwrap();
        let [secret, runs] = ["identity", "runs"].map(|file| keys.path().join(file));
        identity.write(&secret).unwrap();
        let [secret, runs] = [secret, runs].map(|path| path.display().to_string());
        let service = Service::start(name, &["--record", &runs, "--identity", &secret]);
        let known = service.folder.path().join("known_servers");
        std::fs::write(known, KnownServers::line("test", &identity.public())).unwrap();
        Self { service, keys }
    }

    pub fn port(&self) -> u16 {
        self.service.port
    }

    pub fn folder(&self) -> &Scratch {
        &self.service.folder
    }

    /// The file of the server's key.
    pub fn known_servers(&self) -> PathBuf {
        self.folder().path().join("known_servers")
    }

    /// The server's key, with which it signs.
    pub fn identity(&self) -> Identity {
        Identity::read(&self.keys.path().join("identity")).unwrap()
    }

    /// The files of a folder that are wanted, in a folder of their own.
    pub fn copy(&self, from: &Path, name: &str, wanted: impl Fn(&str) -> bool) -> PathBuf {
        let to = self.folder().path().join(name);
        std::fs::create_dir_all(&to).unwrap();
        for entry in std::fs::read_dir(from).unwrap() {
            let entry = entry.unwrap();
            let file = entry.file_name().into_string().unwrap();
            if wanted(&file) {
                std::fs::copy(entry.path(), to.join(file)).unwrap();
            }
        }
        to
    }
}

/// A whole run of policy `random`: falls and drops in twelve subtasks. Its folder.
pub fn played_run(lab: &Lab, name: &str, seeds: &[&str]) -> PathBuf {
    played_by(lab, "random", name, seeds)
}

/// A run of this policy. Its folder.
pub fn played_by(lab: &Lab, policy: &str, name: &str, seeds: &[&str]) -> PathBuf {
    let file = lab.folder().path().join(format!("{name}.toml")).display().to_string();
    let link = endpoint(lab.port());
    let mut args = vec!["evaluate", "--policy", policy, "-e", &link, "--run-file", &file, "--json"];
    args.extend(seeds);
    let mut client = Running::start("policy-client", &args, lab.folder());
    let (status, text) = client.finish(5 * PATIENCE);
    assert!(status.success(), "{text}\n{}", client.log());
    let run = std::fs::read_to_string(&file).unwrap();
    let run = run
        .lines()
        .find_map(|line| line.strip_prefix("run = \"")?.strip_suffix('"'))
        .unwrap_or_else(|| panic!("{run}"));
    let runs = lab.keys.path().join("runs").join(run);
    assert!(runs.is_dir(), "{}", runs.display());
    runs
}

/// A store that is not in the board's folder: options and variables with which programs find it.
#[derive(Debug, Default, Clone)]
pub struct Elsewhere {
    pub options: Vec<String>,
    pub variables: Vec<(&'static str, String)>,
}

/// A leaderboard of a test's own.
pub struct Board<'a> {
    lab: &'a Lab,
    store: Elsewhere,
    service: Running,
    args: Vec<String>,
    port: u16,
}

impl<'a> Board<'a> {
    /// That verifies on the lab's server.
    pub fn start(lab: &'a Lab, args: &[&str]) -> Self {
        Self::start_with(lab, &[&endpoint(lab.port())], args)
    }

    /// That verifies on those servers.
    pub fn start_with(lab: &'a Lab, servers: &[&str], args: &[&str]) -> Self {
        Self::start_on(lab, Elsewhere::default(), servers, args)
    }

    /// The same, with its store elsewhere.
    pub fn start_on(lab: &'a Lab, store: Elsewhere, servers: &[&str], args: &[&str]) -> Self {
        let port = free_port();
        for args in [&["init"][..], &["account", "lab", "--submissions-a-day", "100000"], &["token", "lab"]] {
            std::fs::write(lab.folder().path().join("token"), admin(lab, &store, args)).unwrap();
        }
        let folder = lab.folder().path().join("board").display().to_string();
        let http = format!("127.0.0.1:{port}");
        let mut all: Vec<String> = ["serve", "--folder", &folder, "--http", &http].map(str::to_owned).into();
        all.extend(store.options.iter().cloned());
        all.extend(args.iter().map(|&arg| arg.to_owned()));
        let service = serve(lab, &store, "scorer", &all, servers);
        Self { lab, store, service, args: all, port }
    }

    /// Another service on the same folder, which verifies on no server.
    pub fn another(&self) -> Self {
        let (lab, store, port) = (self.lab, self.store.clone(), free_port());
        let own = format!("127.0.0.1:{}", self.port);
        let args = self.args.iter().map(|arg| if *arg == own { format!("127.0.0.1:{port}") } else { arg.clone() });
        let args: Vec<String> = args.collect();
        Self { service: serve(lab, &store, "scorer", &args, &[]), lab, store, args, port }
    }

    /// Kills it and starts it again.
    pub fn restart(&mut self, servers: &[&str]) {
        self.service.kill();
        self.service = serve(self.lab, &self.store, "scorer", &self.args, servers);
    }

    /// Asks it to end, as an init system would, and starts another program in its place.
    pub fn upgrade(&mut self, scorer: &str, servers: &[&str]) {
        self.service.signal("TERM");
        assert!(self.service.finish(PATIENCE).0.success(), "{}", self.service.log());
        self.service = serve(self.lab, &self.store, scorer, &self.args, servers);
    }

    /// The log of the service since it was started.
    pub fn log(&self) -> String {
        self.service.log()
    }

    /// `scorer admin` on its store: what it prints.
    pub fn admin(&self, args: &[&str]) -> String {
        String::from_utf8(admin(self.lab, &self.store, args)).unwrap()
    }

    pub fn submitter(&self) -> Submitter {
        Submitter { url: self.url(), token: std::fs::read_to_string(self.token()).unwrap() }
    }

    pub fn stop(&mut self) {
        self.service.kill();
    }

    pub fn folder(&self) -> PathBuf {
        self.lab.folder().path().join("board")
    }

    pub fn url(&self) -> String {
        format!("http://127.0.0.1:{}", self.port)
    }

    /// The file of the account's token.
    pub fn token(&self) -> PathBuf {
        self.lab.folder().path().join("token")
    }

    /// `scorer submit --wait --json`: its exit code and what it prints.
    pub fn submit(&self, folder: &Path, args: &[&str]) -> (i32, Value) {
        self.submit_with(folder, &[args, &["--wait"]].concat())
    }

    pub fn submit_without_waiting(&self, folder: &Path) -> (i32, Value) {
        self.submit_with(folder, &[])
    }

    fn submit_with(&self, folder: &Path, args: &[&str]) -> (i32, Value) {
        self.submit_by(&self.token(), folder, args)
    }

    fn submit_by(&self, token: &Path, folder: &Path, args: &[&str]) -> (i32, Value) {
        let [folder, token] = [folder, token].map(|path| path.display().to_string());
        let url = self.url();
        let mut all = vec!["submit", &folder, "--to", &url, "--token", &token, "--json"];
        all.extend(args);
        // A forger would not let the program leave out the rows that he made up.
        if !args.contains(&"--bags") {
            all.extend(["--bags", "full"]);
        }
        let mut client = Running::start("scorer", &all, self.lab.folder());
        let (status, text) = client.finish(PATIENCE);
        let said = serde_json::from_str(&text);
        (
            status.code().unwrap(),
            said.unwrap_or_else(|error| panic!("{error}; log:\n{}{}", client.log(), self.service.log())),
        )
    }

    /// The same, from another account.
    pub fn submit_as(&self, account: &str, folder: &Path, args: &[&str]) -> (i32, Value) {
        let token = self.lab.folder().path().join(format!("token-{account}"));
        // It may be there.
        drop(run_admin(self.lab, &self.store, &["account", account]));
        std::fs::write(&token, self.admin(&["token", account])).unwrap();
        self.submit_by(&token, folder, &[args, &["--wait"]].concat())
    }

    /// Removes a submission.
    pub fn remove(&self, entry: &Value) {
        self.admin(&["remove", entry["id"].as_str().unwrap()]);
    }

    /// The service's answer to its account, as JSON.
    pub fn get(&self, address: &str) -> Value {
        serde_json::from_slice(&self.fetch(address)).unwrap()
    }

    /// The body of what the service answers to its account.
    pub fn fetch(&self, address: &str) -> Vec<u8> {
        let token = std::fs::read_to_string(self.token()).unwrap();
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let token = token.trim();
        write!(
            stream,
            "GET {address} HTTP/1.1\r\nHost: board\r\nConnection: close\r\nAuthorization: Bearer {token}\r\n\r\n"
        )
        .unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        let end = answer.windows(4).position(|end| end == b"\r\n\r\n").unwrap() + 4;
        let body = answer.split_off(end);
        assert!(answer.starts_with(b"HTTP/1.1 200"), "{address}: {}", String::from_utf8_lossy(&answer));
        body
    }
}

/// Who submits to a board with its account's token, also while it is killed.
pub struct Submitter {
    url: String,
    token: String,
}

impl Submitter {
    /// Sends one bag, or a folder of them, until it is accepted; returns the submission's id.
    pub fn send(&self, bags: &Path, note: &str) -> String {
        let mut upload = Upload::find(bags).unwrap();
        upload.manifest.note = note.into();
        let (never, mut quiet) = (AtomicBool::new(false), |_: SubmitProgress| {});
        Submit::to(&self.url, &self.token, &mut quiet, &never).unwrap().send(&upload).unwrap().id
    }
}

fn run_admin(lab: &Lab, store: &Elsewhere, args: &[&str]) -> Output {
    let mut scorer = Command::new(program("scorer"));
    scorer.args(["admin", "--folder"]).arg(lab.folder().path().join("board")).args(&store.options).args(args);
    scorer.envs(store.variables.iter().cloned()).output().unwrap()
}

fn admin(lab: &Lab, store: &Elsewhere, args: &[&str]) -> Vec<u8> {
    let done = run_admin(lab, store, args);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    done.stdout
}

fn serve(lab: &Lab, store: &Elsewhere, scorer: &str, args: &[String], servers: &[&str]) -> Running {
    let mut command = Command::new(program(scorer));
    command.args(args).args(servers.iter().flat_map(|server| ["-e", server]));
    command.envs(store.variables.iter().cloned());
    let mut service = Running::spawn("scorer", command, lab.folder());
    service.wait_for("serving http://127.0.0.1:");
    service
}

pub fn wait_for_state(board: &Board<'_>, id: &str, state: &str) {
    let address = format!("/api/v1/submissions/{id}");
    wait_until(state, PATIENCE, || board.get(&address)["state"] == state);
}
