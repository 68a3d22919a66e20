//! The part of a submission's results that the tables show.

use fiatlux_grading::Results;
use serde::{Deserialize, Serialize};

use super::{PlayedEpisodes, Standing, SubtaskResults};

/// The layout of stored summaries. Give it the next number when a field changes, or what it is computed from: those of other layouts
/// are made again.
pub(crate) const LAYOUT: i64 = 1;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Summary {
    /// `None` for results without all twelve subtasks.
    pub standing: Option<Standing>,
    pub tried: SubtaskResults,
    pub played: PlayedEpisodes,
}

impl Summary {
    pub fn of(results: &Results) -> Self {
        Self {
            standing: Standing::of(results),
            tried: SubtaskResults::of(results),
            played: PlayedEpisodes::of(results),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{hosted, results};
    use super::*;

    /// Guards that tables are the same after a restart: a summary that was stored says what the results say.
    #[test]
    fn a_stored_summary_is_that_of_the_results() {
        let mut part = results(5);
        part.subtasks.truncate(3);
        for results in [results(7), hosted(12), part] {
            let summary = Summary::of(&results);
            let text = serde_json::to_string(&summary).expect("text");
            assert_eq!(serde_json::from_str::<Summary>(&text).expect("a summary"), summary);
        }
    }

    /// Guards stored summaries of an older program: one of other fields must have another [`LAYOUT`].
    #[test]
    fn the_layout_has_a_number() {
        let text = serde_json::to_string(&Summary::of(&results(1))).expect("text");
        let fields: std::collections::BTreeSet<&str> =
            text.split('"').skip(1).step_by(2).filter(|word| text.contains(&format!("\"{word}\":"))).collect();
        let expected = "cells clean episodes failed_tries hits hosted id interval name played published published_clean rooms score \
                        seeds standing std strict strict_clean strict_interval tried version";
        assert_eq!(fields.into_iter().collect::<Vec<_>>().join(" "), expected, "give it the layout after {LAYOUT}");
    }
}
