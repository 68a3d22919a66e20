/// The reason why a network cannot be run.
#[derive(Debug)]
pub(crate) enum Refusal {
    /// It is damaged, or has an unsupported part.
    Problem(String),
    NotFinite {
        tensor: String,
        index: usize,
    },
    Shape {
        side: &'static str,
        found: String,
    },
}

impl From<String> for Refusal {
    fn from(problem: String) -> Self {
        Self::Problem(problem)
    }
}

impl From<&str> for Refusal {
    fn from(problem: &str) -> Self {
        Self::Problem(problem.into())
    }
}
