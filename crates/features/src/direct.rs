//! Convolutions as one matrix product over the window: the first layer, those of stride 2 and those of 1 x 1.

use fearless_simd::Simd;
use fiatlux_nets::{Finish, Gathered, Panels, Target, multiply};

use crate::folded::Folded;
use crate::plane::Plane;

/// Output pixels that are multiplied before the next: their windows stay in the cache for all output channels.
const CHUNK: usize = 96;

#[derive(Debug, Clone)]
pub(crate) struct Direct {
    panels: Panels,
    bias: Vec<f32>,
    inputs: usize,
    kernel: usize,
    stride: usize,
}

impl Direct {
    pub fn new(folded: &Folded) -> Self {
        let &Folded { inputs, outputs, kernel, stride, ref bias, .. } = folded;
        let panels = Panels::new(kernel * kernel * inputs, outputs, |k, output| {
            folded.weight(output, k % inputs, k / inputs / kernel, k / inputs % kernel)
        });
        Self { panels, bias: bias.clone(), inputs, kernel, stride }
    }

    /// Reads `input` (with a border of at least half the window) and writes `output`, whose size gives the number of
    /// pixels.
    #[inline(always)]
    pub fn run<S: Simd>(&self, simd: S, input: &Plane, output: &mut Plane, finish: Finish) {
        // The pixels of one row of the window are adjacent in memory, so a tap is a whole row.
        let edge = input.border - self.kernel / 2;
        let mut taps = [0; 7];
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
