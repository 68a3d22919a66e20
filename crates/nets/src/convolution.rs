//! A convolution as one matrix product over its window.

use fearless_simd::{Level, Simd, dispatch};

use crate::plane::Plane;
use crate::product::{Finish, Gathered, LANES, Panels, Target, multiply};

/// Output pixels that are multiplied before the next: their windows stay in the cache for all output channels.
const CHUNK: usize = 96;

/// The largest window, pixels along its side.
pub const MAX_KERNEL: usize = 7;

/// Weights and bias of a convolution, packed. The padding is half its window, rounded down.
#[derive(Debug, Clone)]
pub struct Convolution {
    panels: Panels,
    bias: Vec<f32>,
    inputs: usize,
    kernel: usize,
    stride: usize,
}

impl Convolution {
    /// A square window of `kernel` pixels along each side, whose weight from input channel `i` at row `y` and column `x` to output channel
    /// `o` is `weight(o, i, y, x)`.
    ///
    /// # Panics
    /// The number of output channels is not a multiple of [`LANES`], or not that of the biases; the window is larger than [`MAX_KERNEL`].
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
        let panels = Panels::new(kernel * kernel * inputs, outputs, |k, output| {
            weight(output, k % inputs, k / inputs / kernel, k / inputs % kernel)
        });
        Self { panels, bias, inputs, kernel, stride }
    }

    /// As [`Convolution::run`], with the widest vector instructions that the CPU has.
    pub fn run_here(&self, input: &Plane, output: &mut Plane, finish: Finish) {
        dispatch!(Level::new(), simd => self.run(simd, input, output, finish));
    }

    pub fn outputs(&self) -> usize {
        self.bias.len()
    }

    /// Reads `input` (with a border of at least half the window) and writes `output`, whose size gives the number of
    /// pixels.
    #[inline(always)]
    pub fn run<S: Simd>(&self, simd: S, input: &Plane, output: &mut Plane, finish: Finish) {
        // The pixels of one row of the window are adjacent in memory, so a tap is a whole row.
        let edge = input.border - self.kernel / 2;
        let mut taps = [0; MAX_KERNEL];
        for (ky, tap) in taps[..self.kernel].iter_mut().enumerate() {
            *tap = input.at_bordered(ky + edge, edge);
        }
        let mut rows = [0; CHUNK];
        let mut out_rows = [0; CHUNK];
        let pixels = output.height * output.width;
        for first in (0..pixels).step_by(CHUNK) {
            let count = CHUNK.min(pixels - first);
            for i in 0..count {
                let (y, x) = ((first + i) / output.width, (first + i) % output.width);
                rows[i] = input.at_bordered(y * self.stride, x * self.stride);
                out_rows[i] = output.at(y, x);
            }
            let left = Gathered {
                data: &input.data,
                rows: &rows[..count],
                taps: &taps[..self.kernel],
                run: self.kernel * self.inputs,
            };
            let mut target = Target { data: &mut output.data, rows: &out_rows[..count], finish };
            multiply(simd, left, &self.panels, Some(&self.bias), &mut target);
        }
    }
}
