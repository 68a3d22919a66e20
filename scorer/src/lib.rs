//! Grades bags.
