//! The progress of a run, and its outcome.

/// The fate of an episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EpisodeFate {
    /// Played to its end, and on the server's disk.
    Played,
    /// The server counts it as a failure.
    Failed,
    /// Not played to its end; the same call tries again.
    Lost,
}

/// The outcome of one episode.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeOutcome {
    /// Id of the task, such as `S01`.
    pub task: String,
    /// Layout seed; `None` if it is hosted and the run is not finished.
    pub seed: Option<u64>,
    /// Played, failed or lost.
    pub fate: EpisodeFate,
    /// Cause of its end, or the reason why it was not played.
    pub cause: String,
    /// It succeeded by the protocol of the run.
    pub success: bool,
    /// Digest of its rows; empty if it has none.
    pub digest: String,
    /// Number of times that its server began it.
    pub attempts: u32,
    /// Server that has its bag; `None` if it was not played.
    pub server: Option<String>,
}

/// The outcome of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct RunOutcome {
    /// Name of the run, as registered.
    pub run: String,
    /// Every episode of the run, or of its shard, by index.
    pub episodes: Vec<EpisodeOutcome>,
    /// The run is closed, so that no more episodes can be played.
    pub finished: bool,
    /// The caller stopped it before the end.
    pub stopped: bool,
    /// Names of the servers that took part in this call.
    pub servers: Vec<String>,
    /// The protocol of the run, whose judge says what a success is: `strict` or `published`.
    pub protocol: String,
}

impl RunOutcome {
    /// True if every episode was played to its end.
    pub fn is_whole(&self) -> bool {
        self.episodes.iter().all(|episode| episode.fate == EpisodeFate::Played)
    }
}

/// An episode that is being played.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Playing {
    /// Id of the task, such as `S01`.
    pub task: String,
    /// Layout seed; `None` if it is hosted.
    pub seed: Option<u64>,
    /// Name of the server that simulates it.
    pub server: String,
    /// Control step that it has reached.
    pub step: u64,
}

impl Playing {
    /// Task and seed, such as `S01/0`; the task alone if the seed is hosted.
    pub fn name(&self) -> String {
        let seed = self.seed.map_or_else(String::new, |seed| format!("/{seed}"));
        format!("{}{seed}", self.task)
    }
}

/// The progress of a run.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct RunProgress {
    /// Number of episodes; 0 until a server has accepted the run.
    pub episodes: usize,
    /// Number of episodes that are played or failed.
    pub done: usize,
    /// Number of those that succeeded.
    pub successes: usize,
    /// Number of episodes given up for now.
    pub lost: usize,
    /// Number of episodes that are open for another client of the same run, or for one that died.
    pub held: usize,
    /// Control steps played in this call.
    pub steps: u64,
    /// Largest number of steps still to come, if every episode goes on to its horizon.
    pub steps_left: u64,
    /// Episodes that are being played now.
    pub playing: Vec<Playing>,
    /// Names of the servers that take part now.
    pub servers: Vec<String>,
}
