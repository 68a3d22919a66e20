//! The option `--bags`.

use clap::ValueEnum;

/// The form in which bags are kept.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum BagForm {
    /// With all rows and what the sensors read.
    #[default]
    Full,
    /// Actions, result and signature: a tenth of the size or less. Rows are simulated again when they are read.
    Thin,
}

impl BagForm {
    pub fn is_thin(self) -> bool {
        self == Self::Thin
    }
}
