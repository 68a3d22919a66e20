//! Limits of mesh files.

pub(super) const FILE_BYTES: u64 = 64 << 20;
pub(super) const TRIANGLES: usize = 500_000;
/// Triangles of all files together.
pub(super) const TOTAL_TRIANGLES: usize = 4_000_000;
pub(super) const LINE_BYTES: usize = 4096;
/// Farthest that a vertex may be from its link's origin, m.
pub(super) const REACH: f32 = 2.0;
/// Smallest that a link's longest side may be, m.
pub(super) const MIN_SIDE: f32 = 0.001;
