//! The matrix product: rows gathered from a layer's input times packed weights.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16};

/// Columns of a panel of weights.
pub const LANES: usize = 16;

/// Rows that one pass of the inner loop sums: 6 rows of 16 columns fill 12 of AVX2's 16 registers.
const ROWS: usize = 6;

/// The right-hand matrix, `depth` x `columns`, as panels of [`LANES`] columns so that the inner loop reads it in order.
#[derive(Debug, Clone)]
pub struct Panels {
    pub(crate) data: Vec<[f32; LANES]>,
    pub(crate) depth: usize,
}

impl Panels {
    /// Packs the matrix whose entry in row `k` and column `n` is `entry(k, n)`. Zeros fill the last panel.
    pub fn new(depth: usize, columns: usize, entry: impl Fn(usize, usize) -> f32) -> Self {
        let entry = |k, column| if column < columns { entry(k, column) } else { 0.0 };
        let rows = (0..columns.div_ceil(LANES)).flat_map(|panel| (0..depth).map(move |k| (panel, k)));
        let data = rows.map(|(panel, k)| std::array::from_fn(|lane| entry(k, panel * LANES + lane))).collect();
        Self { data, depth }
    }
}

/// The left-hand matrix. Row `i` consists of pieces of `run` numbers, one for each tap, at `rows[i] + tap` in `data`:
/// with the taps of a convolution's window this is im2col without the copy.
#[derive(Debug, Clone, Copy)]
pub struct Gathered<'a, T = f32> {
    pub data: &'a [T],
    /// Index in `data` of the start of each row.
    pub rows: &'a [usize],
    /// Start of each piece, relative to the row's start.
    pub taps: &'a [usize],
    pub run: usize,
}

/// The last operation on a sum.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Finish {
    Keep,
    /// Negative values become zero.
    Relu,
    /// The value in the output is added, and negative values become zero: the end of a residual block.
    AddRelu,
}

impl Finish {
    /// Writes one vector to the start of `out`.
    #[inline(always)]
    pub fn write<S: Simd, V: SimdFloat<S, Element = f32>>(self, simd: S, sum: V, out: &mut [f32]) {
        let zero = V::splat(simd, 0.0);
        let value = match self {
            Finish::Keep => sum,
            // In this order x86 passes on a NaN, which the last check then finds.
            Finish::Relu => zero.max(sum),
            Finish::AddRelu => zero.max(sum + V::from_slice(simd, out)),
        };
        value.store_slice(out);
    }
}

/// The destination of a product: its row `i` goes to `data[rows[i]..]`.
#[derive(Debug)]
pub struct Target<'a> {
    pub data: &'a mut [f32],
    /// Index in `data` of the start of each row.
    pub rows: &'a [usize],
    pub finish: Finish,
}

/// Rows and panels that one pass of the inner loop sums where vectors hold a panel and there are 32 registers of them: sums enough to hide
/// how long one takes.
pub(crate) const WIDE_ROWS: usize = 8;
pub(crate) const WIDE_PANELS: usize = 2;

/// True where one vector holds the columns of a panel.
pub(crate) const fn is_wide<S: Simd>() -> bool {
    S::f32s::LEN >= LANES
}

/// `left * right + bias`, where a bias of `None` is zero and the number of columns is a multiple of [`LANES`]. Each
/// number is summed in the order of the depth, for any number of rows.
#[inline(always)]
pub fn multiply<S: Simd>(simd: S, left: Gathered<'_>, right: &Panels, bias: Option<&[f32]>, target: &mut Target<'_>) {
    let panels = right.data.len() / right.depth;
    let mut panel = 0;
    if is_wide::<S>() {
        while panel + WIDE_PANELS <= panels {
            rows::<S, WIDE_ROWS, WIDE_PANELS>(simd, left, right, bias, target, panel);
            panel += WIDE_PANELS;
        }
    }
    for panel in panel..panels {
        rows::<S, ROWS, 1>(simd, left, right, bias, target, panel);
    }
}

/// All rows, at most `N` at once, for the columns of `P` panels from `first` on.
#[inline(always)]
fn rows<S: Simd, const N: usize, const P: usize>(
    simd: S,
    left: Gathered<'_>,
    right: &Panels,
    bias: Option<&[f32]>,
    target: &mut Target<'_>,
    first: usize,
) {
    let mut panels = [[].as_slice(); P];
    let mut starts = [f32x16::splat(simd, 0.0); P];
    for p in 0..P {
        panels[p] = &right.data[(first + p) * right.depth..][..right.depth];
        if let Some(bias) = bias {
            starts[p] = f32x16::from_slice(simd, &bias[(first + p) * LANES..][..LANES]);
        }
    }
    let mut row = 0;
    row = blocks::<S, N, P>(simd, left, panels, starts, target, row, first * LANES);
    row = blocks::<S, 4, P>(simd, left, panels, starts, target, row, first * LANES);
    row = blocks::<S, 2, P>(simd, left, panels, starts, target, row, first * LANES);
    blocks::<S, 1, P>(simd, left, panels, starts, target, row, first * LANES);
}

/// Multiplies complete blocks of `N` rows from `row` on, for the columns of `P` panels. Returns the first row left.
#[inline(always)]
fn blocks<S: Simd, const N: usize, const P: usize>(
    simd: S,
    left: Gathered<'_>,
    panels: [&[[f32; LANES]]; P],
    starts: [f32x16<S>; P],
    target: &mut Target<'_>,
    mut row: usize,
    column: usize,
) -> usize {
    while row + N <= left.rows.len() {
        let mut sums = [starts; N];
        for (index, &tap) in left.taps.iter().enumerate() {
            let mut pieces = [[].as_slice(); N];
            for n in 0..N {
                pieces[n] = &left.data[left.rows[row + n] + tap..][..left.run];
            }
            let mut run = [[].as_slice(); P];
            for p in 0..P {
                run[p] = &panels[p][index * left.run..][..left.run];
            }
            add::<S, N, P, true>(simd, pieces, run, &mut sums);
        }
        for n in 0..N {
            for p in 0..P {
                let at = target.rows[row + n] + column + p * LANES;
                target.finish.write(simd, sums[n][p], &mut target.data[at..][..LANES]);
            }
        }
        row += N;
    }
    row
}

/// Adds the products of `N` rows with `P` panels, all of one depth, to their sums; rounded once for each product and
/// sum if the CPU can, or (not `FUSED`) twice on every CPU.
#[inline(always)]
pub(crate) fn add<S: Simd, const N: usize, const P: usize, const FUSED: bool>(
    simd: S,
    rows: [&[f32]; N],
    panels: [&[[f32; LANES]]; P],
    sums: &mut [[f32x16<S>; P]; N],
) {
    // Cut to one length here, where the compiler sees it, they need no bounds checks in the loop.
    let depth = panels[0].len();
    let mut cut = [[].as_slice(); N];
    for n in 0..N {
        cut[n] = &rows[n][..depth];
    }
    let mut blocks = [[].as_slice(); P];
    for p in 0..P {
        blocks[p] = &panels[p][..depth];
    }
    for k in 0..depth {
        for p in 0..P {
            let weights = f32x16::from_slice(simd, &blocks[p][k]);
            for n in 0..N {
                let number = f32x16::splat(simd, cut[n][k]);
                sums[n][p] = if FUSED { number.mul_add(weights, sums[n][p]) } else { sums[n][p] + number * weights };
            }
        }
    }
}
