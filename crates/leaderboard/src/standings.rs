//! Entries and their results as tables: one for each division, in order of strict clean success.
