//! The style sheet of the report and of its figures.

/// The page's style sheet, for other pages that should look like it.
pub const STYLE: &str = include_str!("style.css");
