//! The small file that lets a run be resumed.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::{Path, PathBuf};

use data_encoding::HEXLOWER;
use fiatlux_proto::v3::RunSpec;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Length of a run's key, bytes; it is written in hexadecimal digits.
const KEY_BYTES: usize = 16;

/// Largest file that is read, bytes: enough for thousands of seeds.
const MAX_FILE: u64 = 1 << 20;

const HEAD: &str = "# A registered run. The call or command that made it continues it with this file.\n\
                    # Keep it secret: whoever has the key can continue the run too.\n";

/// A run's name, its secret key, and what it plays.
#[derive(Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunFile {
    /// Name of the run.
    pub run: String,
    /// Its secret key in hexadecimal digits.
    pub key: String,
    /// Digest of the policy's code and weights, where its name does not say which they are; empty if not known.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub policy_digest: String,
    /// The policy, tasks, seeds and session to register.
    pub spec: RunSpec,
}

/// Why the file of a run cannot be used.
#[derive(Debug, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum RunFileError {
    #[error("cannot {what} the run file {}; name another one with --run-file", path.display())]
    Io { what: &'static str, path: PathBuf, source: std::io::Error },
    #[error("{} is not the file of a run: {reason}; name another one with --run-file", path.display())]
    Content { path: PathBuf, reason: String },
    #[error(
        "{} belongs to the run {run}, which differs in {}; repeat its command to continue it, or name another file with \
         --run-file to begin a new run", path.display(), differs.join(", ")
    )]
    Other { path: PathBuf, run: String, differs: Vec<&'static str> },
}

impl RunFile {
    /// Opens the run of a file, for a policy whose name says all.
    ///
    /// # Errors
    /// As [`RunFile::open_of`].
    pub fn open(path: &Path, spec: &RunSpec) -> Result<Self, RunFileError> {
        Self::open_of(path, spec, "")
    }

    /// Opens the run of a file. If the file does not exist, draws a new run with a new key and writes it, readable only
    /// by its owner (mode 0600). The file never changes afterwards.
    ///
    /// # Errors
    /// [`RunFileError`], most often because the file's run plays something else.
    pub fn open_of(path: &Path, spec: &RunSpec, policy_digest: &str) -> Result<Self, RunFileError> {
        let io = |what| move |source| RunFileError::Io { what, path: path.into(), source };
        match fiatlux_files::read_text(path, MAX_FILE) {
            Ok(text) => {
                let content = |reason: String| RunFileError::Content { path: path.into(), reason };
                let found: Self = toml::from_str(&text).map_err(|error| content(error.message().into()))?;
                let mut differs = differences(&found.spec, spec);
                if ![found.policy_digest.as_str(), policy_digest].contains(&"") && found.policy_digest != policy_digest
                {
                    differs.insert(
                        0,
                        "the policy's code or weights (its attribute `digest`, if it has one, says what it is)",
                    );
                }
                match differs {
                    differs if differs.is_empty() => Ok(found),
                    differs => Err(RunFileError::Other { path: path.into(), run: found.run, differs }),
                }
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                let run = Self::draw(spec).map_err(io("draw a key for"))?;
                let run = Self { policy_digest: policy_digest.into(), ..run };
                match run.write(path) {
                    Ok(()) => Ok(run),
                    // Of several shards that begin at once, one draws.
                    Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {
                        Self::open_of(path, spec, policy_digest)
                    }
                    Err(error) => Err(io("create")(error)),
                }
            }
            Err(error) => Err(io("read")(error)),
        }
    }

    /// The protocol of the run's episodes, whose judge says what a success is.
    pub fn protocol(&self) -> &str {
        let named = self.spec.session.as_ref().map_or("", |session| session.episode_protocol.as_str());
        if named.is_empty() { "strict" } else { named }
    }

    /// Draws a new run: the policy's name with a random suffix, and a key that nobody can guess.
    fn draw(spec: &RunSpec) -> std::io::Result<Self> {
        // Not from a device: a container need not have one.
        let bytes = fiatlux_access::random::<{ KEY_BYTES + 4 }>().map_err(std::io::Error::other)?;
        let (key, tail) = bytes.split_at(KEY_BYTES);
        let plain = |c: char| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' };
        let policy: String = spec.policy.chars().map(plain).take(40).collect();
        let run = format!("{policy}-{}", HEXLOWER.encode(tail));
        Ok(Self { run, key: HEXLOWER.encode(key), policy_digest: String::new(), spec: spec.clone() })
    }

    /// Writes a new file, whole from the moment it is there, never over an existing one.
    fn write(&self, path: &Path) -> std::io::Result<()> {
        let text = toml::to_string(self).map_err(std::io::Error::other)?;
        let mut options = OpenOptions::new();
        options.write(true).create_new(true);
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
        let part = path.with_file_name(format!(".{}.part", self.run));
        let mut file = options.open(&part)?;
        let written = file.write_all(format!("{HEAD}{text}").as_bytes()).and_then(|()| file.sync_all());
        let written = written.and_then(|()| std::fs::hard_link(&part, path));
        std::fs::remove_file(&part)?;
        written
    }
}

/// Keeps the key out of logs.
impl std::fmt::Debug for RunFile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RunFile").field("run", &self.run).field("spec", &self.spec).finish_non_exhaustive()
    }
}

/// Names of the settings in which two runs differ.
fn differences(left: &RunSpec, right: &RunSpec) -> Vec<&'static str> {
    [
        ("the policy", left.policy == right.policy),
        ("the policy's version", left.policy_version == right.policy_version),
        ("the link", left.policy_link == right.policy_link),
        ("the tasks", left.tasks == right.tasks),
        ("the seeds", (&left.seeds, left.hosted_seeds) == (&right.seeds, right.hosted_seeds)),
        ("what its sessions are opened with", left.session == right.session),
    ]
    .into_iter()
    .filter(|(_, same)| !same)
    .map(|(name, _)| name)
    .collect()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use fiatlux_proto::v3::OpenRequest;

    use super::*;

    fn path(name: &str) -> PathBuf {
        let path = std::env::temp_dir().join(format!("fiatlux-run-{name}-{}.toml", std::process::id()));
        let _ = std::fs::remove_file(&path);
        path
    }

    fn spec() -> RunSpec {
        let session = OpenRequest {
            sensors: vec!["lidar".into()],
            thresholds: [("fragility_n".to_string(), 30.5)].into(),
            ..OpenRequest::default()
        };
        let tasks = vec!["S01".into(), "climb".into()];
        RunSpec { policy: "a/b ü".into(), tasks, seeds: vec![0, 7], session: Some(session), ..RunSpec::default() }
    }

    #[test]
    fn the_same_command_finds_its_run_again() {
        let path = path("same");
        let first = RunFile::open(&path, &spec()).unwrap();
        assert!(first.run.starts_with("a_b__-") && fiatlux_proto::keys::is_name(&first.run), "{}", first.run);
        assert!(first.key.len() == 32 && first.key.bytes().all(|byte| byte.is_ascii_hexdigit()));
        assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        assert_eq!(RunFile::open(&path, &spec()).unwrap(), first);
        assert!(!format!("{first:?}").contains(&first.key));
        std::fs::remove_file(&path).unwrap();
        assert_ne!(RunFile::open(&path, &spec()).unwrap().key, first.key, "drawn anew");
        std::fs::remove_file(&path).unwrap();
    }

    /// Guards shards that begin at once: all have the run of the first, and none reads half a file.
    #[test]
    fn of_many_that_begin_at_once_one_draws() {
        let path = path("once");
        let runs: Vec<RunFile> = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..8).map(|_| scope.spawn(|| RunFile::open(&path, &spec()).unwrap())).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        });
        assert!(runs.iter().all(|run| *run == runs[0]), "{runs:?}");
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn another_policy_of_the_same_name_is_refused() {
        let path = path("digest");
        let first = RunFile::open_of(&path, &spec(), "1a").unwrap();
        assert_eq!(RunFile::open_of(&path, &spec(), "1a").unwrap(), first);
        let error = RunFile::open_of(&path, &spec(), "2b").unwrap_err().to_string();
        assert!(error.contains("which differs in the policy's code or weights ("), "{error}");
        // The programs know no digest, and neither do older files.
        assert_eq!(RunFile::open(&path, &spec()).unwrap(), first);
        std::fs::remove_file(&path).unwrap();
        RunFile::open(&path, &spec()).unwrap();
        assert_eq!(RunFile::open_of(&path, &spec(), "2b").unwrap().policy_digest, "");
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn the_file_of_another_run_is_left_as_it_is() {
        let path = path("other");
        RunFile::open(&path, &spec()).unwrap();
        let text = std::fs::read(&path).unwrap();
        let other = RunSpec { policy: "zero".into(), seeds: vec![1], ..spec() };
        let error = RunFile::open(&path, &other).unwrap_err().to_string();
        assert!(error.contains("which differs in the policy, the seeds;") && error.contains("--run-file"), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), text);
        for wrong in ["run = 3", "not toml", ""] {
            std::fs::write(&path, wrong).unwrap();
            let error = RunFile::open(&path, &spec()).unwrap_err().to_string();
            assert!(error.contains("is not the file of a run"), "{error}");
        }
        std::fs::remove_file(&path).unwrap();
        // Reading a pipe that nobody writes to would wait.
        assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
        assert!(matches!(RunFile::open(&path, &spec()), Err(RunFileError::Io { what: "read", .. })));
        std::fs::remove_file(&path).unwrap();
        let nowhere = path.join("RUN.toml");
        assert!(matches!(RunFile::open(&nowhere, &spec()), Err(RunFileError::Io { what: "create", .. })));
    }
}
