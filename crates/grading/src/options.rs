use std::path::{Path, PathBuf};
use std::time::Duration;

/// Options of [`grade`](crate::grade). By default a bag is judged as it was recorded.
#[derive(Debug, Clone, Default)]
pub struct GradeOptions {
    /// Thresholds in place of the recorded ones, as `key=value`.
    pub set: Vec<String>,
    pub published_counting: bool,
    /// Number of threads; 0 means one per core.
    pub workers: usize,
    /// Time limit for reading one bag; `None` means no limit. A bag that takes longer counts as cut, and is excluded.
    pub time_limit: Option<Duration>,
    /// Grade takes, which persons drove, and nothing else; otherwise takes are excluded.
    pub takes: bool,
    /// The folder of the results, to which names of bags are relative; empty means the current one.
    pub relative_to: PathBuf,
}

impl GradeOptions {
    pub(crate) fn folder(&self) -> &Path {
        if self.relative_to.as_os_str().is_empty() { Path::new(".") } else { &self.relative_to }
    }
}
