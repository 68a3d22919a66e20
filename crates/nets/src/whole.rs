//! The matrix product in whole numbers: the same sums on every processor, in half the instructions of one in f32.
//!
//! Both factors have 16 bits, and a sum 32. Weights are rounded to steps that differ from column to column, as fine as 16 bits and the
//! sum's room allow.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, dispatch, f32x16, i16x32, i32x16};

use crate::plane::Plane;
use crate::product::{Gathered, LANES, Target, WIDE_PANELS, WIDE_ROWS, is_wide};
use crate::{Finish, MAX_KERNEL};

/// Numbers of 16 bits that are multiplied at once and summed: neighbours in the depth.
pub const PAIR: usize = 2;

/// Rows that one pass of the inner loop sums, as in f32.
const ROWS: usize = 6;

/// Output pixels that are multiplied before the next.
const CHUNK: usize = 96;

/// Steps from zero to the largest number of a convolution's input.
const STEPS: i32 = 2047;

/// The right-hand matrix in whole numbers, as panels of [`LANES`] columns.
#[derive(Debug, Clone)]
pub struct WholePanels {
    /// For each pair of rows, the two numbers of each column side by side.
    data: Vec<[i16; PAIR * LANES]>,
    pairs: usize,
    /// Value of a step in each column.
    steps: Vec<f32>,
}

impl WholePanels {
    /// Packs the matrix whose entry in row `k` and column `n` is `entry(k, n)`, for rows of numbers from `-largest` to `largest`: then no
    /// sum leaves 32 bits. Zeros fill the last panel and an odd depth.
    pub fn new(depth: usize, columns: usize, largest: i32, entry: impl Fn(usize, usize) -> f32) -> Self {
        let (pairs, padded) = (depth.div_ceil(PAIR), columns.next_multiple_of(LANES));
        let mut data = vec![[0; PAIR * LANES]; pairs * padded / LANES];
        let mut steps = vec![0.0; padded];
        for column in 0..columns {
            let numbers = || (0..depth).map(|k| f64::from(entry(k, column)));
            let (peak, total) =
                numbers().fold((0.0, 0.0), |(peak, total): (f64, f64), x| (peak.max(x.abs()), total + x.abs()));
            // Each number may be rounded up by half a step.
            let room = f64::from(i32::MAX) / f64::from(largest) - 0.5 * depth as f64;
            let per_unit = (f64::from(i16::MAX) / peak).min(room / total);
            if !per_unit.is_finite() {
                continue;
            }
            steps[column] = (1.0 / per_unit) as f32;
            for (k, number) in numbers().enumerate() {
                let place = &mut data[column / LANES * pairs + k / PAIR][column % LANES * PAIR + k % PAIR];
                let scaled = number * per_unit;
                // Saturates; rounded away from zero at the half.
                *place = (scaled + 0.5_f64.copysign(scaled)) as i16;
            }
        }
        Self { data, pairs, steps }
    }
}

/// Steps of numbers of 16 bits, two to an i32, and the value of a step.
#[derive(Debug, Clone, Default)]
pub struct Steps {
    pub data: Vec<i32>,
    pub value: f32,
}

impl Steps {
    /// Rounds a plane to steps of which `most` are its largest absolute value. Pixels stand as in the plane, each with `channels` numbers: as
    /// many as there, or one more. A plane with a number that is not finite has steps of no value.
    #[inline(always)]
    pub fn take<S: Simd>(&mut self, simd: S, plane: &Plane, channels: usize, most: i32) {
        let numbers = plane.data.len() / plane.channels.max(1) * channels;
        // A row of an odd number of numbers reads one more.
        let length = numbers.div_ceil(PAIR) + 1;
        // Only grows: the numbers between are overwritten.
        if self.data.len() < length {
            self.data.resize(length, 0);
        }
        let (blocks, rest) = plane.data.as_chunks::<LANES>();
        let mut peaks = f32x16::splat(simd, 0.0);
        for block in blocks {
            peaks = peaks.max(f32x16::from_slice(simd, block).abs());
        }
        let mut lanes = [0.0; LANES];
        peaks.store_slice(&mut lanes);
        let peak = lanes.iter().chain(rest).fold(0.0_f32, |peak, x| if x.abs() > peak { x.abs() } else { peak });
        self.value = peak / most as f32;
        let per_unit = if peak > 0.0 { most as f32 / peak } else { 0.0 };
        let numbers: &mut [i16] = &mut bytemuck::cast_slice_mut(&mut self.data)[..numbers];
        let round = |x: f32| (x * per_unit + if x < 0.0 { -0.5 } else { 0.5 }) as i16;
        if channels != plane.channels {
            for (to, from) in numbers.chunks_exact_mut(channels).zip(plane.data.chunks_exact(plane.channels)) {
                to.iter_mut().zip(from).for_each(|(to, from)| *to = round(*from));
            }
            return;
        }
        let (zero, factor) = (f32x16::splat(simd, 0.0), f32x16::splat(simd, per_unit));
        let (up, down) = (f32x16::splat(simd, 0.5), f32x16::splat(simd, -0.5));
        let whole = |from: &[f32]| {
            let x = f32x16::from_slice(simd, from);
            i32x16::truncate_from(x * factor + x.simd_lt(zero).select(down, up))
        };
        let (places, last) = numbers.as_chunks_mut::<{ 2 * LANES }>();
        let (pairs, tail) = plane.data.as_chunks::<{ 2 * LANES }>();
        for (to, from) in places.iter_mut().zip(pairs) {
            let narrow: i16x32<S> = whole(&from[..LANES]).saturating_narrow(whole(&from[LANES..]));
            narrow.store_slice(to);
        }
        last.iter_mut().zip(tail).for_each(|(to, from)| *to = round(*from));
    }
}

/// `left * right * value + bias`, where `value` is that of a step of the left side, and a bias of `None` is zero. Sums are exact, and what
/// follows is rounded after each operation.
#[inline(always)]
pub fn multiply_whole<S: Simd>(
    simd: S,
    left: Gathered<'_, i32>,
    right: &WholePanels,
    value: f32,
    bias: Option<&[f32]>,
    target: &mut Target<'_>,
) {
    let panels = right.data.len() / right.pairs;
    let mut panel = 0;
    if is_wide::<S>() {
        while panel + WIDE_PANELS <= panels {
            rows::<S, WIDE_ROWS, WIDE_PANELS>(simd, left, right, value, bias, target, panel);
            panel += WIDE_PANELS;
        }
    }
    for panel in panel..panels {
        rows::<S, ROWS, 1>(simd, left, right, value, bias, target, panel);
    }
}

/// All rows, at most `N` at once, for the columns of `P` panels from `first` on.
#[inline(always)]
fn rows<S: Simd, const N: usize, const P: usize>(
    simd: S,
    left: Gathered<'_, i32>,
    right: &WholePanels,
    value: f32,
    bias: Option<&[f32]>,
    target: &mut Target<'_>,
    first: usize,
) {
    let mut panels = [[].as_slice(); P];
    let mut ends = [[f32x16::splat(simd, 0.0); 2]; P];
    for p in 0..P {
        let column = (first + p) * LANES;
        panels[p] = &right.data[(first + p) * right.pairs..][..right.pairs];
        ends[p][0] = f32x16::from_slice(simd, &right.steps[column..column + LANES]) * f32x16::splat(simd, value);
        if let Some(bias) = bias {
            ends[p][1] = f32x16::from_slice(simd, &bias[column..column + LANES]);
        }
    }
    let mut row = 0;
    row = blocks::<S, N, P>(simd, left, panels, ends, target, row, first * LANES);
    row = blocks::<S, 4, P>(simd, left, panels, ends, target, row, first * LANES);
    row = blocks::<S, 2, P>(simd, left, panels, ends, target, row, first * LANES);
    blocks::<S, 1, P>(simd, left, panels, ends, target, row, first * LANES);
}

/// Multiplies complete blocks of `N` rows from `row` on, for the columns of `P` panels, each with its step and bias. Returns the first row
/// left.
#[inline(always)]
fn blocks<S: Simd, const N: usize, const P: usize>(
    simd: S,
    left: Gathered<'_, i32>,
    panels: [&[[i16; PAIR * LANES]]; P],
    ends: [[f32x16<S>; 2]; P],
    target: &mut Target<'_>,
    mut row: usize,
    column: usize,
) -> usize {
    while row + N <= left.rows.len() {
        let mut sums = [[i32x16::splat(simd, 0); P]; N];
        for (index, &tap) in left.taps.iter().enumerate() {
            // Cut to one length here, where the compiler sees it, they need no bounds checks in the loop.
            let depth = left.run;
            let mut pieces = [[].as_slice(); N];
            for n in 0..N {
                pieces[n] = &left.data[left.rows[row + n] + tap..][..depth];
            }
            let mut run = [[].as_slice(); P];
            for p in 0..P {
                run[p] = &panels[p][index * depth..][..depth];
            }
            for k in 0..depth {
                let mut weights = [i16x32::splat(simd, 0); P];
                for p in 0..P {
                    weights[p] = i16x32::from_slice(simd, &run[p][k]);
                }
                for n in 0..N {
                    let pair: i16x32<S> = i32x16::splat(simd, pieces[n][k]).bitcast();
                    for p in 0..P {
                        sums[n][p] += pair.pairwise_dot_product(weights[p]);
                    }
                }
            }
        }
        for n in 0..N {
            for p in 0..P {
                let [step, start] = ends[p];
                let at = target.rows[row + n] + column + p * LANES;
                let sum = f32x16::float_from(sums[n][p]) * step + start;
                target.finish.write(simd, sum, &mut target.data[at..][..LANES]);
            }
        }
        row += N;
    }
    row
}

/// Weights and bias of a convolution in whole numbers. As [`Convolution`](crate::Convolution) otherwise.
#[derive(Debug, Clone)]
pub struct WholeConvolution {
    panels: WholePanels,
    bias: Vec<f32>,
    /// Numbers of a pixel: its channels, filled up to an even number unless windows start at even numbers anyway.
    channels: usize,
    kernel: usize,
    stride: usize,
}

impl WholeConvolution {
    /// As of [`Convolution::new`](crate::Convolution::new).
    ///
    /// # Panics
    /// As there.
    pub fn new(
        inputs: usize,
        kernel: usize,
        stride: usize,
        weight: impl Fn(usize, usize, usize, usize) -> f32,
        bias: Vec<f32>,
    ) -> Self {
        let outputs = bias.len();
        assert!(outputs.is_multiple_of(LANES), "{outputs} output channels");
        assert!((1..=MAX_KERNEL).contains(&kernel), "a window of {kernel} pixels");
        let channels = if stride.is_multiple_of(PAIR) { inputs } else { inputs.next_multiple_of(PAIR) };
        // Each row of the window ends with a pair.
        let run = (kernel * channels).next_multiple_of(PAIR);
        let panels = WholePanels::new(kernel * run, outputs, STEPS, |k, output| {
            let (y, x, input) = (k / run, k % run / channels, k % run % channels);
            if x < kernel && input < inputs { weight(output, input, y, x) } else { 0.0 }
        });
        Self { panels, bias, channels, kernel, stride }
    }

    /// As [`WholeConvolution::run`], with the widest vector instructions that the CPU has.
    pub fn run_here(&self, input: &Plane, output: &mut Plane, finish: Finish, steps: &mut Steps) {
        dispatch!(Level::new(), simd => self.run(simd, input, output, finish, steps));
    }

    /// Reads `input` (with a border of at least half the window) and writes `output`; `steps` is room for the input in steps.
    ///
    /// # Panics
    /// `input` has an odd number of channels and a border that is longer than half the window by an odd number of pixels.
    #[inline(always)]
    pub fn run<S: Simd>(&self, simd: S, input: &Plane, output: &mut Plane, finish: Finish, steps: &mut Steps) {
        steps.take(simd, input, self.channels, STEPS);
        let edge = input.border - self.kernel / 2;
        assert!((edge * self.channels).is_multiple_of(PAIR), "a border of {} pixels", input.border);
        let pixels_across = input.pitch() / input.channels;
        let at = |y: usize, x: usize| (y * pixels_across + x) * self.channels / PAIR;
        let mut taps = [0; MAX_KERNEL];
        for (ky, tap) in taps[..self.kernel].iter_mut().enumerate() {
            *tap = at(ky + edge, edge);
        }
        let mut rows = [0; CHUNK];
        let mut out_rows = [0; CHUNK];
        let pixels = output.height * output.width;
        for first in (0..pixels).step_by(CHUNK) {
            let count = CHUNK.min(pixels - first);
            for i in 0..count {
                let (y, x) = ((first + i) / output.width, (first + i) % output.width);
                rows[i] = at(y * self.stride, x * self.stride);
                out_rows[i] = output.at(y, x);
            }
            let left = Gathered {
                data: &steps.data,
                rows: &rows[..count],
                taps: &taps[..self.kernel],
                run: (self.kernel * self.channels).div_ceil(PAIR),
            };
            let mut target = Target { data: &mut output.data, rows: &out_rows[..count], finish };
            multiply_whole(simd, left, &self.panels, steps.value, Some(&self.bias), &mut target);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Convolution;

    fn number(seed: usize) -> f32 {
        (seed * 2_654_435_761 % 1000) as f32 * 1e-3 - 0.5
    }

    /// The convolution in f32 within the rounding of its factors, and the same bytes with the widest and the narrowest vectors, for sizes
    /// that leave blocks of each number of rows, and for an odd number of channels.
    #[test]
    fn convolutions_are_those_in_f32_and_equal_on_two_levels() {
        for (inputs, kernel, stride, side) in [(3, 7, 2, 9), (3, 3, 1, 4), (4, 3, 1, 5), (16, 1, 2, 7), (6, 3, 2, 13)] {
            let weight = |o: usize, i: usize, y: usize, x: usize| number(o * 977 + i * 31 + y * 7 + x);
            let bias: Vec<f32> = (0..2 * LANES).map(number).collect();
            let single = Convolution::new(inputs, kernel, stride, weight, bias.clone());
            let whole = WholeConvolution::new(inputs, kernel, stride, weight, bias);
            let mut input = Plane::new(side, side, inputs, kernel / 2);
            for y in 0..side {
                let at = input.at(y, 0);
                input.data[at..at + side * inputs]
                    .iter_mut()
                    .enumerate()
                    .for_each(|(i, x)| *x = 3.0 * number(i + 91 * y));
            }
            let plane = || Plane::new(side.div_ceil(stride), side.div_ceil(stride), 2 * LANES, 1);
            let [mut expected, mut wide, mut narrow] = [(); 3].map(|()| plane());
            single.run_here(&input, &mut expected, Finish::Relu);
            whole.run_here(&input, &mut wide, Finish::Relu, &mut Steps::default());
            let mut steps = Steps::default();
            dispatch!(Level::baseline(), simd => whole.run(simd, &input, &mut narrow, Finish::Relu, &mut steps));
            assert_eq!(wide.data, narrow.data);
            let peak = expected.data.iter().copied().fold(0.0, f32::max);
            for (found, expected) in wide.data.iter().zip(&expected.data) {
                assert!((found - expected).abs() < 1e-3 * peak, "{inputs} {kernel}: {found}, expected {expected}");
            }
        }
    }

    /// The largest factors on both sides leave no sum beyond 32 bits.
    #[test]
    fn no_sum_overflows() {
        for depth in [2, 64, 4608] {
            let panels = WholePanels::new(depth, LANES, 32_700, |k, n| if n == 0 { 1.0 } else { number(k * 31 + n) });
            let all: Vec<i32> = vec![bytemuck::cast([32_700_i16; PAIR]); depth / PAIR];
            let mut found = vec![0.0; LANES];
            let left = Gathered { data: &all, rows: &[0], taps: &[0], run: depth / PAIR };
            let mut target = Target { data: &mut found, rows: &[0], finish: Finish::Keep };
            dispatch!(Level::new(), simd => multiply_whole(simd, left, &panels, 1.0 / 32_700.0, None, &mut target));
            assert!((found[0] / depth as f32 - 1.0).abs() < 0.02, "{depth}: {}", found[0]);
        }
    }
}
