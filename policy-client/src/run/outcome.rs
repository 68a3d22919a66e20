//! What is said of a run, while it goes on and at its end.

/// What became of an episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EpisodeFate {
    /// Played to its end and on the server's disk.
    Played,
    /// The server counts it as a failure.
    Failed,
    /// It was not played to its end; the same call tries again.
    Lost,
}

/// What came of one episode.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeOutcome {
    /// Short name of the task.
    pub task: String,
    /// Seed; `None` where it is hosted and the run is not finished.
    pub seed: Option<u64>,
    /// What became of it.
    pub fate: EpisodeFate,
    /// What ended it, or why it was not played.
    pub cause: String,
    /// Success, by the protocol of the run.
    pub success: bool,
    /// Digest of its rows; may be empty.
    pub digest: String,
    /// How often its server began it.
    pub attempts: u32,
    /// Server that has its bag; `None` where it was not played.
    pub server: Option<String>,
}

/// What came of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct RunOutcome {
    /// Name of the run.
    pub run: String,
    /// All episodes, by index.
    pub episodes: Vec<EpisodeOutcome>,
    /// No more episodes can be played.
    pub finished: bool,
    /// A stop was asked for before the end.
    pub stopped: bool,
    /// Servers that took part in this call.
    pub servers: Vec<String>,
}

impl RunOutcome {
    /// Whether every episode was played to its end.
    pub fn is_whole(&self) -> bool {
        self.episodes.iter().all(|episode| episode.fate == EpisodeFate::Played)
    }
}

/// An episode under way.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Playing {
    /// Short name of the task.
    pub task: String,
    /// Seed; `None` where it is hosted.
    pub seed: Option<u64>,
    /// Server that it is on.
    pub server: String,
    /// Control step that it is at.
    pub step: u64,
}

/// A look at a run under way.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct RunProgress {
    /// Episodes of the run; 0 until a server has taken it.
    pub episodes: usize,
    /// Episodes played, or failed, by now.
    pub done: usize,
    /// Those of them that succeeded.
    pub successes: usize,
    /// Episodes given up for now.
    pub lost: usize,
    /// Episodes that are open for another client of the same run, or for one that died.
    pub held: usize,
    /// Control steps of this call.
    pub steps: u64,
    /// Most steps that could still follow: every episode goes on to its horizon.
    pub steps_left: u64,
    /// What is being played.
    pub playing: Vec<Playing>,
    /// Servers that take part now.
    pub servers: Vec<String>,
}
