//! Starts a service in this process, on a port of its own, and sends it requests, byte by byte.

#[path = "../../../grading/tests/common/mod.rs"]
pub mod bags;

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use data_encoding::HEXLOWER;
use fiatlux_leaderboard::{Jobs, Place, Quota, Service, ServiceOptions, Store};
use fiatlux_rules::Task;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use tokio::runtime::Runtime;
use tokio::sync::oneshot;

use bags::{Folder, Story};

/// Time limit for an event that must happen.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// A service that runs until it is dropped.
pub struct Board {
    pub folder: Folder,
    pub address: SocketAddr,
    pub metrics: SocketAddr,
    pub store: Store,
    pub runtime: Runtime,
    jobs: Option<Jobs>,
    stop: Option<oneshot::Sender<()>>,
}

/// The place of the store of a test.
pub fn place(folder: &Path) -> Place {
    let mut place = Place::folder(folder);
    if let Some((database, files)) = crate::stores::addresses(folder) {
        (place.database, place.files) = (database.parse().unwrap(), files.parse().unwrap());
    }
    place
}

impl Board {
    pub fn start(name: &str, options: ServiceOptions) -> Self {
        let folder = Folder::new(&format!("leaderboard-{name}"));
        let store = place(&folder.0.join("board"));
        Self::over(folder, &store, options)
    }

    /// A service on an existing folder, such as a backup.
    pub fn on(name: &str, store: &Path) -> Self {
        Self::over(Folder::new(&format!("leaderboard-{name}")), &Place::folder(store), ServiceOptions::default())
    }

    fn over(folder: Folder, store: &Place, options: ServiceOptions) -> Self {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
        let (stop, stopped) = oneshot::channel();
        let (address, metrics, store, jobs) = runtime.block_on(async {
            let store = Store::open_at(store).await.unwrap();
            let service = Arc::new(Service::new(store.clone(), options));
            let jobs = Jobs::start(&service, Vec::new(), 1).unwrap();
            let [listener, metrics] =
                [0, 0].map(|port| fiatlux_leaderboard::listen(SocketAddr::from(([127, 0, 0, 1], port))).unwrap());
            let [address, at] = [&listener, &metrics].map(|listener| listener.local_addr().unwrap());
            tokio::spawn(fiatlux_leaderboard::serve_metrics(Arc::clone(&service), metrics));
            let stop = async { drop(stopped.await) };
            tokio::spawn(async move { fiatlux_leaderboard::serve(service, listener, 64, stop).await });
            (address, at, store, jobs)
        });
        Self { folder, address, metrics, store, runtime, jobs: Some(jobs), stop: Some(stop) }
    }

    /// Runs a statement on its database, as a hand would.
    pub fn execute(&self, statement: &'static str) {
        sqlx::any::install_default_drivers();
        let folder = self.folder.0.join("board");
        let own = || format!("sqlite://{}/leaderboard.sqlite", folder.display());
        let url = crate::stores::addresses(&folder).map_or_else(own, |(database, _)| database);
        self.runtime.block_on(async {
            let pool = sqlx::AnyPool::connect(&url).await.unwrap();
            sqlx::query(statement).execute(&pool).await.unwrap();
            pool.close().await;
        });
    }

    pub fn token(&self, account: &str) -> String {
        self.runtime.block_on(async {
            self.store.make_account(account, Quota::default()).await.unwrap();
            self.store.make_token(account, 1).await.unwrap()
        })
    }

    /// Sends bytes on a new connection; returns everything that comes back until the service closes it.
    pub fn raw(&self, bytes: &[u8]) -> Vec<u8> {
        Self::raw_at(self.address, bytes)
    }

    fn raw_at(address: SocketAddr, bytes: &[u8]) -> Vec<u8> {
        let mut stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        // The service may hang up before everything is sent.
        drop(stream.write_all(bytes));
        drop(stream.shutdown(std::net::Shutdown::Write));
        let mut answer = Vec::new();
        drop(stream.read_to_end(&mut answer));
        answer
    }

    /// The service's metrics.
    pub fn metrics(&self) -> String {
        let answer = Self::raw_at(self.metrics, b"GET /metrics HTTP/1.1\r\nHost: board\r\nConnection: close\r\n\r\n");
        read(&answer).unwrap().1
    }

    /// Sends a request; returns status and body of the answer.
    pub fn ask(&self, method: &str, address: &str, token: Option<&str>, body: &[u8]) -> (u16, String) {
        let token = token.map_or(String::new(), |token| format!("Authorization: Bearer {token}\r\n"));
        let head = format!(
            "{method} {address} HTTP/1.1\r\nHost: board\r\nConnection: close\r\n{token}Content-Length: {}\r\n\r\n",
            body.len()
        );
        let answer = self.raw(&[head.as_bytes(), body].concat());
        read(&answer).unwrap_or_else(|| panic!("{method} {address}: {}", String::from_utf8_lossy(&answer)))
    }

    /// Like [`Board::ask`], with JSON in both directions.
    pub fn json(&self, method: &str, address: &str, token: Option<&str>, body: &Value) -> (u16, Value) {
        let body = if body.is_null() { String::new() } else { body.to_string() };
        let (status, text) = self.ask(method, address, token, body.as_bytes());
        (status, serde_json::from_str(&text).unwrap_or_else(|error| panic!("{method} {address}: {error}: {text}")))
    }

    /// Sends a whole submission; returns its id.
    pub fn submit(&self, token: &str, manifest: &Value, files: &[PathBuf]) -> String {
        let (status, begun) = self.json("POST", "/api/v1/submissions", Some(token), &wish(manifest, files));
        assert_eq!(status, 201, "{begun}");
        let id = begun["id"].as_str().unwrap().to_owned();
        for file in begun["files"].as_array().unwrap() {
            let path = files.iter().find(|path| path.file_name().unwrap() == file["name"].as_str().unwrap()).unwrap();
            let address = format!("/api/v1/submissions/{id}/files/{}?offset=0", file["place"]);
            let (status, answer) = self.ask("PUT", &address, Some(token), &std::fs::read(path).unwrap());
            assert_eq!(status, 200, "{answer}");
        }
        let (status, finished) =
            self.json("POST", &format!("/api/v1/submissions/{id}/finish"), Some(token), &Value::Null);
        assert_eq!(status, 202, "{finished}");
        id
    }

    /// Waits until a submission is graded or refused; this service has no sim-server to verify on.
    pub fn decided(&self, id: &str, token: &str) -> Value {
        let start = Instant::now();
        loop {
            let (status, entry) = self.json("GET", &format!("/api/v1/submissions/{id}"), Some(token), &Value::Null);
            assert_eq!(status, 200, "{entry}");
            if ["graded", "refused"].contains(&entry["state"].as_str().unwrap()) {
                return entry;
            }
            assert!(start.elapsed() < PATIENCE, "{entry}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(jobs) = self.jobs.take() {
            jobs.stop();
        }
    }
}

/// Status and body of an answer; `None` if it is not an HTTP response.
pub fn read(answer: &[u8]) -> Option<(u16, String)> {
    let text = String::from_utf8_lossy(answer);
    let (head, body) = text.split_once("\r\n\r\n")?;
    let status = head.strip_prefix("HTTP/1.1 ")?.get(..3)?.parse().ok()?;
    if !head.to_ascii_lowercase().contains("transfer-encoding: chunked") {
        return Some((status, body.to_owned()));
    }
    let (mut rest, mut whole) = (body, String::new());
    while let Some((length, after)) = rest.split_once("\r\n") {
        let length = usize::from_str_radix(length, 16).ok()?;
        whole += after.get(..length)?;
        rest = after.get(length + 2..)?;
    }
    Some((status, whole))
}

/// The body of the request that begins a submission of these files.
pub fn wish(manifest: &Value, files: &[PathBuf]) -> Value {
    let file = |path: &PathBuf| {
        let bytes = std::fs::read(path).unwrap();
        json!({ "name": path.file_name().unwrap().to_str().unwrap(), "bytes": bytes.len(), "sha256": sha256(&bytes) })
    };
    json!({ "manifest": manifest, "files": files.iter().map(file).collect::<Vec<_>>() })
}

pub fn sha256(bytes: &[u8]) -> String {
    HEXLOWER.encode(&Sha256::digest(bytes))
}

pub fn manifest() -> Value {
    json!({ "policy": "zero", "licence": "Apache-2.0" })
}

/// Writes a bag with a unique name to a folder.
pub fn bag(folder: &Path, seed: u64) -> PathBuf {
    let path = folder.join(format!("S01-s{seed}-e0.mcap"));
    bags::write(&path, Task::S01, seed, Story::Succeeds(30));
    path
}
