//! How an episode ended, as a message.

use fiatlux_proto::v3;
use fiatlux_rules::Summary;

/// What an episode amounts to, with the cause of its end (`aborted` where no row ended it), all causes that its last row
/// met, and the digest of its rows, hexadecimal.
pub fn end_message(summary: &Summary, cause: &str, causes: Vec<String>, digest: String) -> v3::EpisodeEnd {
    v3::EpisodeEnd {
        cause: cause.into(),
        causes,
        steps: summary.steps,
        success: summary.success,
        digest,
        gate_progress: summary.gate_progress,
        broken: summary.broken,
        dropped: summary.dropped,
    }
}
