/// Why a file is not a network that can be run.
#[derive(Debug)]
pub(crate) enum Refusal {
    /// It is damaged, or has something that is not supported; says what.
    Problem(String),
    /// A constant is not finite.
    NotFinite {
        /// Name of the tensor in the file.
        tensor: String,
        /// Index of the number in the flat tensor.
        index: usize,
    },
    /// Its input or output has another type or shape.
    Shape {
        /// `input` or `output`.
        side: &'static str,
        /// Type and shape in the file.
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
