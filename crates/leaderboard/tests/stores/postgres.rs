//! A server of PostgreSQL for tests, in a folder of its own and on a socket in it alone.

use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Its server does not run as root: `nobody` does it then.
const NOBODY: u32 = 65_534;
const PATIENCE: Duration = Duration::from_secs(60);

/// A server that ends when it is dropped.
pub struct Postgres {
    folder: PathBuf,
    process: Child,
    is_durable: bool,
}

impl Postgres {
    /// Without what a crash of the machine would lose: tests do not look at it.
    pub fn start(name: &str) -> Self {
        Self::start_with(name, false)
    }

    /// As an operator has it: what it has answered is on the disk.
    pub fn start_durable(name: &str) -> Self {
        Self::start_with(name, true)
    }

    fn start_with(name: &str, is_durable: bool) -> Self {
        let folder = std::env::temp_dir().join(format!("fiatlux-postgres-{name}-{}", std::process::id()));
        drop(std::fs::remove_dir_all(&folder));
        std::fs::create_dir_all(&folder).unwrap();
        if is_root() {
            std::os::unix::fs::chown(&folder, Some(NOBODY), Some(NOBODY)).unwrap();
        }
        let data = folder.join("data");
        run(own("initdb")
            .args(["--username=board", "--auth=trust", "--no-sync", "--encoding=UTF8", "--locale=C.UTF-8", "-D"])
            .arg(&data));
        let process = serve(&folder, is_durable);
        let server = Self { folder, process, is_durable };
        server.wait();
        server
    }

    pub fn socket(&self) -> &Path {
        &self.folder
    }

    /// Kills it as a crash would, and starts it again.
    pub fn kill(&mut self) {
        self.process.kill().unwrap();
        self.process.wait().unwrap();
        // It does not start before all processes of the one before have noticed.
        let start = Instant::now();
        loop {
            self.process = serve(&self.folder, self.is_durable);
            std::thread::sleep(Duration::from_millis(200));
            if self.process.try_wait().unwrap().is_none() {
                break;
            }
            assert!(start.elapsed() < PATIENCE, "PostgreSQL does not start again");
        }
        self.wait();
    }

    /// Processor time of all its processes, those that ended included, ms.
    pub fn processor_ms(&self) -> f64 {
        let parent = self.process.id().to_string();
        let processes = std::fs::read_dir("/proc").unwrap().flatten();
        let times = processes.filter_map(|process| {
            let stat = std::fs::read_to_string(process.path().join("stat")).ok()?;
            let fields: Vec<&str> = stat.rsplit(')').next()?.split_whitespace().collect();
            let is_own = process.file_name().to_str()? == parent;
            // Its own time, and that of children that it has waited for.
            let times = if is_own { 11..15 } else { 11..13 };
            let is_part = is_own || fields.get(1)? == &parent;
            is_part.then(|| fields[times].iter().map(|ticks| ticks.parse::<f64>().unwrap_or(0.0) * 10.0).sum::<f64>())
        });
        times.sum()
    }

    /// Number of databases that tests have made.
    pub fn databases(&self) -> usize {
        let listed =
            run(client("psql", &self.folder).args(["-At", "-d", "postgres", "-c", "SELECT datname FROM pg_database"]));
        String::from_utf8_lossy(&listed.stdout)
            .lines()
            .filter(|name| !name.starts_with("template") && *name != "postgres")
            .count()
    }

    fn wait(&self) {
        let start = Instant::now();
        while !client("psql", &self.folder)
            .args(["-d", "postgres", "-c", "SELECT 1"])
            .output()
            .unwrap()
            .status
            .success()
        {
            assert!(start.elapsed() < PATIENCE, "PostgreSQL does not answer");
            std::thread::sleep(Duration::from_millis(50));
        }
    }
}

impl Drop for Postgres {
    fn drop(&mut self) {
        drop(self.process.kill());
        drop(self.process.wait());
        drop(std::fs::remove_dir_all(&self.folder));
    }
}

/// The address of a database, which is made if it is not there.
pub fn database(socket: &str, name: &str) -> String {
    let made = client("createdb", Path::new(socket)).arg(name).output().unwrap();
    let said = String::from_utf8_lossy(&made.stderr);
    assert!(made.status.success() || said.contains("already exists"), "{said}");
    // Tests number rows with SQLite's printf.
    let shim = "CREATE OR REPLACE FUNCTION printf(format TEXT, number BIGINT) RETURNS TEXT LANGUAGE SQL AS \
                $$ SELECT lpad(to_hex(number), CAST(substring(format FROM '[1-9][0-9]*') AS INT), '0') $$";
    if made.status.success() {
        run(client("psql", Path::new(socket)).args(["-q", "-d", name, "-c", shim]));
    }
    format!("postgres://board@localhost/{name}?host={socket}")
}

fn serve(folder: &Path, is_durable: bool) -> Child {
    let mut server = own("postgres");
    let fsync = if is_durable { "fsync=on" } else { "fsync=off" };
    // Without TCP.
    server.arg("-D").arg(folder.join("data")).arg("-k").arg(folder).args(["-c", "listen_addresses=", "-c", fsync]);
    server.args(["-c", "max_connections=400"]).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

fn is_root() -> bool {
    std::os::unix::fs::MetadataExt::uid(&std::fs::metadata("/proc/self").unwrap()) == 0
}

/// A program of the server, which Debian does not have in PATH.
fn own(name: &str) -> Command {
    let folders = std::fs::read_dir("/usr/lib/postgresql").into_iter().flatten().flatten();
    let mut found: Vec<PathBuf> =
        folders.map(|folder| folder.path().join("bin").join(name)).filter(|path| path.is_file()).collect();
    found.sort();
    let mut command = Command::new(found.pop().unwrap_or_else(|| name.into()));
    if is_root() {
        command.uid(NOBODY).gid(NOBODY);
    }
    // Its messages are read.
    command.env("LC_ALL", "C").current_dir(std::env::temp_dir());
    command
}

fn client(name: &str, socket: &Path) -> Command {
    let mut command = Command::new(name);
    command.args(["-U", "board", "-h"]).arg(socket).env("LC_ALL", "C");
    command
}

fn run(command: &mut Command) -> Output {
    let ended = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}; it needs Debian's postgresql"));
    assert!(ended.status.success(), "{command:?}: {}", String::from_utf8_lossy(&ended.stderr));
    ended
}
