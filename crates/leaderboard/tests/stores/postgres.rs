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
}

impl Postgres {
    pub fn start(name: &str) -> Self {
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
        let process = serve(&folder);
        let server = Self { folder, process };
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
            self.process = serve(&self.folder);
            std::thread::sleep(Duration::from_millis(200));
            if self.process.try_wait().unwrap().is_none() {
                break;
            }
            assert!(start.elapsed() < PATIENCE, "PostgreSQL does not start again");
        }
        self.wait();
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

fn serve(folder: &Path) -> Child {
    let mut server = own("postgres");
    // Without TCP. What a crash of the machine would lose, tests do not look at.
    server.arg("-D").arg(folder.join("data")).arg("-k").arg(folder).args([
        "-c",
        "listen_addresses=",
        "-c",
        "fsync=off",
    ]);
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
