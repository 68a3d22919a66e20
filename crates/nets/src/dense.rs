//! A dense layer: one or a few rows times a matrix, so that the time goes into reading the weights.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, dispatch, f32x16};

use crate::product::{LANES, Panels, add};

/// Panels of weights that one pass of the inner loop reads, so that enough sums are in progress at once.
const PANELS: usize = 4;

/// Rounding when a product is added to a sum.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rounding {
    /// Rounded once where the CPU can, which is more exact and faster; CPUs differ in the last digits.
    Fused,
    /// Rounded after the product and after the sum: the same bytes on every machine.
    Separate,
}

/// A matrix of weights, packed, and a bias.
#[derive(Debug, Clone)]
pub struct Dense {
    panels: Panels,
    /// Padded to whole panels.
    bias: Vec<f32>,
    outputs: usize,
}

impl Dense {
    /// A layer whose weight from input `i` to output `o` is `weight(i, o)`, with the bias `bias(o)`.
    pub fn new(
        inputs: usize,
        outputs: usize,
        weight: impl Fn(usize, usize) -> f32,
        bias: impl Fn(usize) -> f32,
    ) -> Self {
        let columns = outputs.next_multiple_of(LANES);
        let bias = (0..columns).map(|output| if output < outputs { bias(output) } else { 0.0 }).collect();
        Self { panels: Panels::new(inputs, outputs, weight), bias, outputs }
    }

    pub fn inputs(&self) -> usize {
        self.panels.depth
    }

    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// `from * weights + bias` for `N` rows at once, so that each weight is read once for all of them.
    ///
    /// # Panics
    /// A row of `from` is shorter than [`Self::inputs`], or one of `to` than [`Self::outputs`].
    pub fn run<const N: usize>(&self, rounding: Rounding, from: [&[f32]; N], to: [&mut [f32]; N]) {
        match rounding {
            Rounding::Fused => dispatch!(Level::new(), simd => self.run_on::<_, N, true>(simd, from, to)),
            Rounding::Separate => dispatch!(Level::new(), simd => self.run_on::<_, N, false>(simd, from, to)),
        }
    }

    #[inline(always)]
    fn run_on<S: Simd, const N: usize, const FUSED: bool>(&self, simd: S, from: [&[f32]; N], mut to: [&mut [f32]; N]) {
        let panels = self.bias.len() / LANES;
        let mut panel = 0;
        while panel + PANELS <= panels {
            self.block::<S, N, PANELS, FUSED>(simd, from, &mut to, panel);
            panel += PANELS;
        }
        for panel in panel..panels {
            self.block::<S, N, 1, FUSED>(simd, from, &mut to, panel);
        }
    }

    /// The columns of `P` panels from `first` on.
    #[inline(always)]
    fn block<S: Simd, const N: usize, const P: usize, const FUSED: bool>(
        &self,
        simd: S,
        from: [&[f32]; N],
        to: &mut [&mut [f32]; N],
        first: usize,
    ) {
        let depth = self.inputs();
        let panels = std::array::from_fn(|p| &self.panels.data[(first + p) * depth..][..depth]);
        let mut sums = [[f32x16::splat(simd, 0.0); P]; N];
        for p in 0..P {
            let bias = f32x16::from_slice(simd, &self.bias[(first + p) * LANES..][..LANES]);
            for n in 0..N {
                sums[n][p] = bias;
            }
        }
        add::<S, N, P, FUSED>(simd, from, panels, &mut sums);
        for n in 0..N {
            for p in 0..P {
                let column = (first + p) * LANES;
                let to = &mut to[n][column..self.outputs.min(column + LANES)];
                let mut numbers = [0.0; LANES];
                sums[n][p].store_slice(&mut numbers);
                to.copy_from_slice(&numbers[..to.len()]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Dense, Rounding};

    /// Guards widths with and without a partial panel, against sums in f64.
    #[test]
    fn every_column_is_the_sum_of_its_products() {
        for (inputs, outputs) in [(0, 3), (1, 1), (7, 15), (33, 64), (40, 100), (129, 144)] {
            let number = |seed: usize| ((seed * 2654435761) % 1000) as f32 * 1e-3 - 0.5;
            let weight = |i: usize, o: usize| number(i * 977 + o * 31 + 7);
            let layer = Dense::new(inputs, outputs, weight, number);
            assert_eq!((layer.inputs(), layer.outputs()), (inputs, outputs));
            let rows: [Vec<f32>; 2] = [3, 11].map(|seed| (0..inputs).map(|i| number(i * 53 + seed)).collect());
            for rounding in [Rounding::Fused, Rounding::Separate] {
                let (mut one, mut two) = (vec![f32::NAN; outputs], vec![f32::NAN; outputs]);
                layer.run(rounding, [&rows[0], &rows[1]], [&mut one, &mut two]);
                for (row, found) in rows.iter().zip([&one, &two]) {
                    for o in 0..outputs {
                        let products = row.iter().enumerate().map(|(i, x)| f64::from(*x) * f64::from(weight(i, o)));
                        let expected = f64::from(number(o)) + products.sum::<f64>();
                        assert!((f64::from(found[o]) - expected).abs() < 1e-5, "{inputs} {outputs} {rounding:?} {o}");
                    }
                }
                // One row alone gives the same bytes.
                let mut alone = vec![f32::NAN; outputs];
                layer.run(rounding, [&rows[0]], [&mut alone]);
                assert_eq!(alone, one);
            }
            // Rounded after each operation, in the order of the inputs.
            let mut found = vec![0.0; outputs];
            layer.run(Rounding::Separate, [&rows[0]], [&mut found]);
            let in_order = |o: usize| rows[0].iter().enumerate().fold(number(o), |sum, (i, x)| sum + x * weight(i, o));
            assert_eq!(found, (0..outputs).map(in_order).collect::<Vec<_>>());
        }
    }
}
