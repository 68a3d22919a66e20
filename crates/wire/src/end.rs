//! Ends of episodes and judgements, as messages.

use fiatlux_proto::v3;
use fiatlux_rules::{Judge, Summary};

/// Summary of an episode by the judge in force, with the cause of its end (`aborted` where no row ended it), all causes that
/// its last row met, and the digest of its rows, hexadecimal.
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

/// Judgement of one judge, from the rows up to its end.
pub fn judgement_message(judge: &Judge) -> v3::Judgement {
    let summary = judge.summary();
    let end = summary.end;
    v3::Judgement {
        success: summary.success,
        cause: end.map(|end| end.cause().name().to_owned()).unwrap_or_default(),
        causes: end.iter().flat_map(|end| end.causes.iter()).map(|cause| cause.name().to_owned()).collect(),
        steps: summary.steps,
        broken: summary.broken,
        dropped: summary.dropped,
        gate_progress: summary.gate_progress,
        peak_hand_force_n: summary.peak_hand_force_n,
        control_effort: summary.control_effort,
        start_count: judge.start_count().unwrap_or_default(),
        best_count: judge.verdict().best_count,
        leapt: judge.verdict().leapt,
    }
}
