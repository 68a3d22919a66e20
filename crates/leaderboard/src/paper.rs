//! Results of the benchmark's paper for its baselines. This project neither played nor verified them.

/// Scores of a policy in the paper: S by its judge and its way of counting, over four rooms.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PaperRow {
    pub policy: &'static str,
    pub score: f64,
    pub std: Option<f64>,
}

/// In order of S. No policy of the paper had a success.
pub(crate) const PAPER: [PaperRow; 3] = [
    PaperRow { policy: "GR00T", score: 0.0876, std: Some(0.0261) },
    PaperRow { policy: "zero", score: 0.0861, std: Some(0.0322) },
    PaperRow { policy: "random", score: 0.0569, std: Some(0.0293) },
];

#[cfg(test)]
mod tests {
    use super::PAPER;

    #[test]
    fn the_readme_and_the_notes_have_the_same_figures() {
        let pages = [include_str!("../../../README.md"), include_str!("../../../docs/notes/earlier_versions.md")];
        for row in PAPER {
            let score = format!("{:.3}", row.score);
            let line = match row.policy {
                "GR00T" => format!("S = {score} |"),
                policy => format!("{score} for `{policy}`"),
            };
            assert!(pages.iter().any(|page| page.contains(&line)), "{line}");
        }
    }
}
