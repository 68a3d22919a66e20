//! Starts our programs as processes of their own, each with its own port and its log kept until the test has passed.

mod service;

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU16, AtomicUsize, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

pub use service::{
    Played, Service, Watch, alone, client, connect, endpoint, grade, played, record, router, wait_until,
};

/// Longest wait of a test for a program.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// Path of one of our programs; the examples that tests start are in the folder next to it. They are built in the profile of the running test,
/// unless `FIATLUX_PROGRAMS` names the folder of programs that are built already.
///
/// # Panics
/// Where they do not build.
pub fn program(name: &str) -> PathBuf {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| std::env::var_os("FIATLUX_PROGRAMS").map_or_else(build, PathBuf::from)).join(name)
}

/// Builds all programs and those examples; returns their folder.
fn build() -> PathBuf {
    let test = std::env::current_exe().expect("a test has a path");
    let folder = test.parent().and_then(Path::parent).expect("tests are built below the profile's folder");
    let mut cargo = Command::new(env!("CARGO"));
    // All packages, as the tests are built: for some of them alone others' features differ, and Zenoh is built once more.
    cargo.args([
        "build",
        "--quiet",
        "--locked",
        "--workspace",
        "--bins",
        "--example",
        "router",
        "--example",
        "wave",
        "--features",
        "network,rapier",
        "--target-dir",
    ]);
    cargo.arg(folder.parent().expect("target"));
    if folder.ends_with("release") {
        cargo.arg("--release");
    }
    // Cargo tells a test of its package. The build script of ring takes that for a change, and all above it is built anew.
    for (name, _) in std::env::vars_os() {
        if ["CARGO_PKG_", "CARGO_MANIFEST_"].iter().any(|start| name.to_string_lossy().starts_with(start)) {
            cargo.env_remove(name);
        }
    }
    assert!(cargo.status().expect("cargo runs").success(), "the programs do not build");
    folder.into()
}

/// A port that is free now. It is below those that the system gives to outgoing connections, which would take it while a program is
/// started again.
///
/// # Panics
/// Where none is.
pub fn free_port() -> u16 {
    static COUNT: AtomicU16 = AtomicU16::new(0);
    const PORTS: std::ops::Range<u16> = 12_000..32_000;
    let start = std::process::id().wrapping_mul(61) % u32::from(PORTS.end - PORTS.start);
    let next = || {
        let port = start + u32::from(COUNT.fetch_add(1, Ordering::Relaxed));
        PORTS.start + (port % u32::from(PORTS.end - PORTS.start)) as u16
    };
    let mut ports = PORTS.map(|_| next());
    ports.find(|port| TcpListener::bind(("127.0.0.1", *port)).is_ok()).expect("a port is free")
}

/// A folder of the test's own; removed when it is dropped, unless the test failed.
#[derive(Debug)]
pub struct Scratch(PathBuf);

impl Scratch {
    /// An empty folder.
    ///
    /// # Panics
    /// Where none can be made.
    pub fn new(name: &str) -> Self {
        static COUNT: AtomicUsize = AtomicUsize::new(0);
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("fiatlux-{name}-{}-{count}", std::process::id()));
        std::fs::create_dir_all(&path).expect("a temporary folder");
        Self(path)
    }

    /// Path of the folder.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// All files below it whose name ends so, sorted.
    pub fn files(&self, ending: &str) -> Vec<PathBuf> {
        let mut found = Vec::new();
        let mut folders = vec![self.0.clone()];
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
                let path = entry.path();
                if path.is_dir() {
                    folders.push(path);
                } else if path.to_string_lossy().ends_with(ending) {
                    found.push(path);
                }
            }
        }
        found.sort();
        found
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("kept: {}", self.0.display());
        } else {
            drop(std::fs::remove_dir_all(&self.0));
        }
    }
}

/// A program that runs. Killed when dropped; its log is shown where the test failed.
#[derive(Debug)]
pub struct Running {
    name: String,
    child: Child,
    lines: Receiver<String>,
    said: Vec<String>,
    log: PathBuf,
}

impl Running {
    /// Starts a program; its log goes to a file in the folder.
    ///
    /// # Panics
    /// Where it does not start.
    pub fn start(name: &str, args: &[&str], folder: &Scratch) -> Self {
        let mut command = Command::new(program(name));
        command.args(args);
        Self::spawn(name, command, folder)
    }

    /// Starts a command line of a shell in the folder itself.
    ///
    /// # Panics
    /// Where it does not start.
    pub fn start_line(line: &str, folder: &Scratch) -> Self {
        let mut command = Command::new("bash");
        command.args(["-c", &format!("exec {line}")]).current_dir(folder.path());
        Self::spawn("bash", command, folder)
    }

    /// As [`Running::start`]; the system lets it write no file of more than that many times 512 bytes, as a full disk
    /// would.
    ///
    /// # Panics
    /// Where it does not start.
    pub fn start_limited(name: &str, args: &[&str], folder: &Scratch, blocks: u32) -> Self {
        let mut command = Command::new("sh");
        command.args(["-c", "trap '' XFSZ; ulimit -f \"$1\"; shift; exec \"$@\"", "sh", &blocks.to_string()]);
        command.arg(program(name)).args(args);
        Self::spawn(name, command, folder)
    }

    /// Starts a command under this name; its log goes to a file in the folder.
    ///
    /// # Panics
    /// Where it does not start.
    pub fn spawn(name: &str, mut command: Command, folder: &Scratch) -> Self {
        static COUNT: AtomicUsize = AtomicUsize::new(0);
        let file = format!("{}-{}.log", name.replace('/', "-"), COUNT.fetch_add(1, Ordering::Relaxed));
        let log = folder.path().join(file);
        let mut child = command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(File::create(&log).expect("a log file"))
            .spawn()
            .unwrap_or_else(|error| panic!("{name} does not start: {error}"));
        let stdout = child.stdout.take().expect("stdout is piped");
        let (sender, lines) = mpsc::channel();
        std::thread::spawn(move || {
            for line in BufReader::new(stdout).lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    break;
                }
            }
        });
        Self { name: name.into(), child, lines, said: Vec::new(), log }
    }

    /// Waits for a line of output that contains a text, and returns it.
    ///
    /// # Panics
    /// Where it does not come.
    pub fn wait_for(&mut self, text: &str) -> String {
        let start = Instant::now();
        loop {
            match self.lines.recv_timeout(PATIENCE.saturating_sub(start.elapsed())) {
                Ok(line) => {
                    self.said.push(line.clone());
                    if line.contains(text) {
                        return line;
                    }
                }
                Err(RecvTimeoutError::Timeout) => panic!("{} did not say '{text}'; it said {:?}", self.name, self.said),
                Err(RecvTimeoutError::Disconnected) => {
                    panic!("{} ended before it said '{text}'; it said {:?}; log:\n{}", self.name, self.said, self.log())
                }
            }
        }
    }

    /// Waits for its end; returns how it ended and all that it wrote to stdout.
    ///
    /// # Panics
    /// Where it goes on.
    pub fn finish(&mut self, patience: Duration) -> (ExitStatus, String) {
        let start = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait().expect("a child can be waited for") {
                break status;
            }
            assert!(start.elapsed() < patience, "{} did not end within {patience:?}", self.name);
            std::thread::sleep(Duration::from_millis(5));
        };
        while let Ok(line) = self.lines.recv_timeout(Duration::from_secs(5)) {
            self.said.push(line);
        }
        (status, self.said.join("\n"))
    }

    /// Ends it at once, as a crash would.
    pub fn kill(&mut self) {
        drop(self.child.kill());
        drop(self.child.wait());
    }

    /// Asks it to end, as Ctrl-C or an init system would: `INT` or `TERM`.
    ///
    /// # Panics
    /// Where there is no `kill`.
    pub fn signal(&self, signal: &str) {
        let done = Command::new("kill").args([&format!("-{signal}"), &self.child.id().to_string()]).status();
        assert!(done.expect("kill runs").success());
    }

    /// Memory that it has now, MB.
    ///
    /// # Panics
    /// Where it has ended.
    pub fn memory_mb(&self) -> f64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).expect("it runs");
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")?.trim().strip_suffix(" kB"));
        line.and_then(|kb| kb.parse::<f64>().ok()).expect("Linux tells it") / 1000.0
    }

    pub fn is_running(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    /// Its stderr so far.
    pub fn log(&self) -> String {
        let mut text = String::new();
        if let Ok(mut file) = File::open(&self.log) {
            drop(file.read_to_string(&mut text));
        }
        text
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.kill();
        if std::thread::panicking() {
            eprintln!("--- stdout of {}: {:?}\n--- log:\n{}", self.name, self.said, self.log());
        }
    }
}
