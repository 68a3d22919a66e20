//! Prints the episodes of `run`, as text or as JSON.

use std::io;

use fiatlux_cli::print;
use fiatlux_client::RoundTrips;
use fiatlux_proto::v3::{EpisodeEnd, SessionInfo};
use fiatlux_proto::{count, plain};
use serde_json::{Value, json};

/// The outcome of one episode.
pub struct Episode {
    pub index: u64,
    pub end: EpisodeEnd,
    pub wall_s: f64,
}

/// The outcome of all episodes so far.
pub struct Report {
    head: Value,
    episodes: Vec<Value>,
    /// Simulated time of a step, s.
    control_dt: f64,
    /// Digest of the recorded episode that is being replayed.
    digest: Option<String>,
    equal: bool,
}

impl Report {
    pub fn new(policy: &str, info: &SessionInfo, digest: Option<String>) -> Self {
        let task = info.task.as_ref().map_or("", |task| task.task.as_str());
        let head = json!({
            "policy": policy, "task": task, "seed": info.seed, "server": info.server, "session": info.session,
            "mode": info.mode().as_str_name(), "gains": info.gains, "protocol": info.episode_protocol,
        });
        Self { head, episodes: Vec::new(), control_dt: info.control_dt, digest, equal: true }
    }

    /// True if every replayed episode equals its recording.
    pub fn is_equal(&self) -> bool {
        self.equal
    }

    /// Adds an episode, and prints it at once unless the output is JSON.
    pub fn add(&mut self, episode: Episode, as_json: bool) -> io::Result<()> {
        let Episode { index, end, wall_s } = episode;
        let equal = self.digest.as_ref().map(|digest| *digest == end.digest);
        self.equal &= equal.unwrap_or(true);
        if !as_json {
            print(format!(
                "{} seed {} episode {index}: {}{} success; ended by {} after {}\n    {:.2} s simulated in {wall_s:.1} s\n    digest {}\n",
                self.head["task"].as_str().unwrap_or_default(),
                self.head["seed"],
                if end.success { "" } else { "no " },
                self.head["protocol"].as_str().unwrap_or_default(),
                plain(&end.cause),
                count(end.steps, "step"),
                end.steps as f64 * self.control_dt,
                plain(&end.digest)
            ))?;
            match (equal, &self.digest) {
                (Some(true), _) => print("    digest equal\n")?,
                (Some(false), Some(recorded)) => print(format!(
                    "    digest differs: the bag has {recorded}\n    the rows are not the same: compare the versions, \
                     the model and scene digests and the options with the bag's header\n"
                ))?,
                _ => {}
            }
        }
        self.episodes.push(json!({
            "episode": index, "cause": end.cause, "causes": end.causes, "steps": end.steps, "success": end.success,
            "digest": end.digest, "wall_s": wall_s, "recorded_digest": self.digest, "digest_equal": equal,
        }));
        Ok(())
    }

    /// Prints the summary at the end.
    pub fn finish(&self, trips: &RoundTrips, as_json: bool) -> io::Result<()> {
        let [p50, p99] = [0.5, 0.99].map(|share| trips.quantile_s(share).map(|seconds| seconds * 1e6));
        if as_json {
            let mut all = self.head.clone();
            all["episodes"] = json!(self.episodes);
            all["round_trip"] = json!({ "count": trips.count(), "p50_us": p50, "p99_us": p99 });
            print(format!("{all:#}\n"))?;
        } else if let (Some(p50), Some(p99)) = (p50, p99) {
            tracing::info!("a step took {p50:.0} us (median), {p99:.0} us (99th percentile)");
        }
        Ok(())
    }
}
