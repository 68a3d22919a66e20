//! Convolutions of 3 x 3 at stride 1 by Winograd's method: tiles of the input and the weights are transformed so that a
//! convolution becomes one matrix product over the channels for each number of a tile.

use std::marker::PhantomData;

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, i16x16};
use fiatlux_nets::{Finish, Gathered, PAIR, Panels, Plane, Steps, Target, WholePanels, multiply, multiply_whole};

use crate::folded::Folded;
use crate::tiles::Tile;

/// Tiles that are multiplied before the next: they stay in the cache for all output channels.
const CHUNK: usize = 48;

/// Numbers between the matrices of the scratch memory, so that they do not fall on the same lines of the cache.
const GAP: usize = 16;

const LANES: usize = 8;

/// Scratch memory, shared by all layers.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    tiles: Vec<f32>,
    products: Vec<f32>,
    /// In whole numbers: the input of a layer, and its tiles, two numbers to an i32.
    pub steps: Steps,
    whole_tiles: Vec<i32>,
}

/// A convolution with its weights transformed and packed, for tiles of `IN` x `IN` input and `OUT` x `OUT` output
/// pixels.
#[derive(Debug)]
pub(crate) struct Winograd<T, const IN: usize, const OUT: usize> {
    /// One matrix for each number of a tile.
    panels: Vec<Panels>,
    bias: Vec<f32>,
    inputs: usize,
    outputs: usize,
    tile: PhantomData<T>,
}

impl<T: Tile<IN, OUT>, const IN: usize, const OUT: usize> Winograd<T, IN, OUT> {
    pub fn new(folded: &Folded) -> Self {
        let (inputs, outputs) = (folded.inputs, folded.outputs);
        let transformed = transformed::<T, IN, OUT>(folded);
        let of = |at: usize| {
            Panels::new(inputs, outputs, |input, output| transformed[input * outputs + output][at / IN][at % IN])
        };
        let panels = (0..IN * IN).map(of).collect();
        Self { panels, bias: folded.bias.clone(), inputs, outputs, tile: PhantomData }
    }

    /// Reads `input` (border 1) and writes `output`, both of the same size.
    #[inline(always)]
    pub fn run<S: Simd>(&self, simd: S, input: &Plane, output: &mut Plane, finish: Finish, scratch: &mut Scratch) {
        let across = output.width.div_ceil(OUT);
        let tiles = across * output.height.div_ceil(OUT);
        let chunk = CHUNK.min(tiles);
        let tile_pitch = chunk * self.inputs + GAP;
        let product_pitch = chunk * self.outputs + GAP;
        // Only grows: old values are overwritten before they are read.
        grow(&mut scratch.tiles, IN * IN * tile_pitch);
        grow(&mut scratch.products, IN * IN * product_pitch);
        let rows: [usize; CHUNK] = std::array::from_fn(|i| i * self.inputs);
        let out_rows: [usize; CHUNK] = std::array::from_fn(|i| i * self.outputs);
        for first in (0..tiles).step_by(chunk) {
            let count = chunk.min(tiles - first);
            for i in 0..count {
                let (y, x) = ((first + i) / across * OUT, (first + i) % across * OUT);
                let to = &mut scratch.tiles[i * self.inputs..];
                self.transform_tile(simd, input, y, x, to, tile_pitch);
            }
            for (at, panels) in self.panels.iter().enumerate() {
                let left = Gathered {
                    data: &scratch.tiles[at * tile_pitch..],
                    rows: &rows[..count],
                    taps: &[0],
                    run: self.inputs,
                };
                let data = &mut scratch.products[at * product_pitch..];
                let mut target = Target { data, rows: &out_rows[..count], finish: Finish::Keep };
                multiply(simd, left, panels, None, &mut target);
            }
            for i in 0..count {
                let (y, x) = ((first + i) / across * OUT, (first + i) % across * OUT);
                let from = &scratch.products[i * self.outputs..];
                finish_tile::<S, T, IN, OUT>(simd, from, product_pitch, &self.bias, output, [y, x], finish);
            }
        }
    }

    /// `B' d B` of the tile whose first pixel is (`y`, `x`) of the bordered image; its number `i` goes to `to[i *
    /// pitch..]`.
    #[inline(always)]
    fn transform_tile<S: Simd>(&self, simd: S, input: &Plane, y: usize, x: usize, to: &mut [f32], pitch: usize) {
        let zero = f32x8::splat(simd, 0.0);
        let run = IN * self.inputs;
        let rows: [&[f32]; IN] = std::array::from_fn(|i| &input.data[input.at_bordered(y + i, x)..][..run]);
        for channel in (0..self.inputs).step_by(LANES) {
            let mut half = [[zero; IN]; IN];
            for j in 0..IN {
                let at = j * self.inputs + channel;
                let mut column = [zero; IN];
                for i in 0..IN {
                    column[i] = f32x8::from_slice(simd, &rows[i][at..at + LANES]);
                }
                let column = T::input(column);
                for i in 0..IN {
                    half[i][j] = column[i];
                }
            }
            for i in 0..IN {
                let row = T::input(half[i]);
                for j in 0..IN {
                    row[j].store_slice(&mut to[(IN * i + j) * pitch + channel..][..LANES]);
                }
            }
        }
    }
}

/// `A' m A` plus bias: the output pixels of the tile whose first is (`y`, `x`).
#[inline(always)]
fn finish_tile<S: Simd, T: Tile<IN, OUT>, const IN: usize, const OUT: usize>(
    simd: S,
    from: &[f32],
    pitch: usize,
    bias: &[f32],
    output: &mut Plane,
    [y, x]: [usize; 2],
    finish: Finish,
) {
    let (zero, outputs) = (f32x8::splat(simd, 0.0), bias.len());
    // The last tile may hang over the edge.
    let (height, width) = (OUT.min(output.height - y), OUT.min(output.width - x));
    for channel in (0..outputs).step_by(LANES) {
        let bias = f32x8::from_slice(simd, &bias[channel..channel + LANES]);
        let mut half = [[zero; IN]; OUT];
        for j in 0..IN {
            let mut column = [zero; IN];
            for i in 0..IN {
                column[i] = f32x8::from_slice(simd, &from[(IN * i + j) * pitch + channel..][..LANES]);
            }
            let column = T::output(column);
            for i in 0..OUT {
                half[i][j] = column[i];
            }
        }
        for i in 0..height {
            let at = output.at(y + i, x) + channel;
            let row = T::output(half[i]);
            for j in 0..width {
                finish.write(simd, row[j] + bias, &mut output.data[at + j * outputs..][..LANES]);
            }
        }
    }
}

/// A convolution as of [`Winograd`], whose products are of whole numbers: the input in steps, its tiles without rounding, and the
/// transformed weights in steps of their own for each output channel and number of a tile.
#[derive(Debug)]
pub(crate) struct WholeWinograd<T, const IN: usize, const OUT: usize> {
    panels: Vec<WholePanels>,
    bias: Vec<f32>,
    inputs: usize,
    tile: PhantomData<T>,
}

/// Channels whose tiles are transformed at once in whole numbers.
const WHOLE_LANES: usize = 16;

impl<T: Tile<IN, OUT>, const IN: usize, const OUT: usize> WholeWinograd<T, IN, OUT> {
    /// Steps from zero to the largest number of the input: as many as leave the numbers of a tile within 16 bits, and at most 2047.
    const STEPS: i32 = {
        let most = i16::MAX as i32 / T::GROWTH;
        if most < 2047 { most } else { 2047 }
    };

    pub fn new(folded: &Folded) -> Self {
        let (inputs, outputs) = (folded.inputs, folded.outputs);
        let transformed = transformed::<T, IN, OUT>(folded);
        let of = |at: usize| {
            WholePanels::new(inputs, outputs, Self::STEPS * T::GROWTH, |input, output| {
                transformed[input * outputs + output][at / IN][at % IN]
            })
        };
        Self { panels: (0..IN * IN).map(of).collect(), bias: folded.bias.clone(), inputs, tile: PhantomData }
    }

    /// As [`Winograd::run`].
    #[inline(always)]
    pub fn run<S: Simd>(&self, simd: S, input: &Plane, output: &mut Plane, finish: Finish, scratch: &mut Scratch) {
        let Scratch { steps, whole_tiles, products, .. } = scratch;
        steps.take(simd, input, self.inputs, Self::STEPS);
        let (pairs, outputs) = (self.inputs / PAIR, self.bias.len());
        let across = output.width.div_ceil(OUT);
        let tiles = across * output.height.div_ceil(OUT);
        let chunk = CHUNK.min(tiles);
        let tile_pitch = chunk * pairs + GAP;
        let product_pitch = chunk * outputs + GAP;
        grow(whole_tiles, IN * IN * tile_pitch);
        grow(products, IN * IN * product_pitch);
        let rows: [usize; CHUNK] = std::array::from_fn(|i| i * pairs);
        let out_rows: [usize; CHUNK] = std::array::from_fn(|i| i * outputs);
        let numbers: &[i16] = bytemuck::cast_slice(&steps.data);
        for first in (0..tiles).step_by(chunk) {
            let count = chunk.min(tiles - first);
            for i in 0..count {
                let (y, x) = ((first + i) / across * OUT, (first + i) % across * OUT);
                let to: &mut [i16] = bytemuck::cast_slice_mut(&mut whole_tiles[i * pairs..]);
                let tile = |row: usize| &numbers[input.at_bordered(y + row, x)..][..IN * self.inputs];
                self.transform_tile(simd, std::array::from_fn(tile), to, PAIR * tile_pitch);
            }
            for (at, panels) in self.panels.iter().enumerate() {
                let left =
                    Gathered { data: &whole_tiles[at * tile_pitch..], rows: &rows[..count], taps: &[0], run: pairs };
                let data = &mut products[at * product_pitch..];
                let mut target = Target { data, rows: &out_rows[..count], finish: Finish::Keep };
                multiply_whole(simd, left, panels, steps.value, None, &mut target);
            }
            for i in 0..count {
                let place = [(first + i) / across * OUT, (first + i) % across * OUT];
                let from = &products[i * outputs..];
                finish_tile::<S, T, IN, OUT>(simd, from, product_pitch, &self.bias, output, place, finish);
            }
        }
    }

    /// `B' d B` of a tile, in whole numbers.
    #[inline(always)]
    fn transform_tile<S: Simd>(&self, simd: S, rows: [&[i16]; IN], to: &mut [i16], pitch: usize) {
        let zero = i16x16::splat(simd, 0);
        for channel in (0..self.inputs).step_by(WHOLE_LANES) {
            let mut half = [[zero; IN]; IN];
            for j in 0..IN {
                let at = j * self.inputs + channel;
                let mut column = [zero; IN];
                for i in 0..IN {
                    column[i] = i16x16::from_slice(simd, &rows[i][at..at + WHOLE_LANES]);
                }
                let column = T::input(column);
                for i in 0..IN {
                    half[i][j] = column[i];
                }
            }
            for i in 0..IN {
                let row = T::input(half[i]);
                for j in 0..IN {
                    row[j].store_slice(&mut to[(IN * i + j) * pitch + channel..][..WHOLE_LANES]);
                }
            }
        }
    }
}

/// The transformed windows, by input and then output channel.
fn transformed<T: Tile<IN, OUT>, const IN: usize, const OUT: usize>(folded: &Folded) -> Vec<[[f32; IN]; IN]> {
    let (inputs, outputs) = (folded.inputs, folded.outputs);
    (0..inputs * outputs)
        .map(|i| transform_weights::<T, IN, OUT>(|y, x| folded.weight(i % outputs, i / outputs, y, x)))
        .collect()
}

/// `G g G'` of one 3 x 3 window, rounded once.
fn transform_weights<T: Tile<IN, OUT>, const IN: usize, const OUT: usize>(
    weight: impl Fn(usize, usize) -> f32,
) -> [[f32; IN]; IN] {
    let rows: [[f64; IN]; 3] = std::array::from_fn(|y| T::weights(std::array::from_fn(|x| f64::from(weight(y, x)))));
    let columns: [[f64; IN]; IN] = std::array::from_fn(|x| T::weights([rows[0][x], rows[1][x], rows[2][x]]));
    std::array::from_fn(|y| std::array::from_fn(|x| columns[x][y] as f32))
}

fn grow<T: Copy + Default>(scratch: &mut Vec<T>, len: usize) {
    if scratch.len() < len {
        scratch.resize(len, T::default());
    }
}

#[cfg(test)]
mod tests {
    use fearless_simd::{Level, dispatch};

    use super::*;
    use crate::layers::Layer;
    use crate::tiles::{F2, F4};
    use crate::weights::LayerWeights;

    const CHANNELS: usize = 16;

    fn numbers(count: usize) -> Vec<f32> {
        (0..count).map(|i| (i * 37 % 101) as f32 / 50.0 - 1.0).collect()
    }

    fn image(height: usize, width: usize) -> Plane {
        let mut plane = Plane::new(height, width, CHANNELS, 1);
        for y in 0..height {
            let at = plane.at(y, 0);
            plane.data[at..at + width * CHANNELS]
                .copy_from_slice(&numbers((y + 1) * width * CHANNELS)[y..][..width * CHANNELS]);
        }
        plane
    }

    /// Both tiles against the sum over the window, on sizes that leave tiles hanging over the edge, with the widest and
    /// the narrowest vectors of the machine. The borders stay zero.
    #[test]
    fn tiles_give_the_convolution_whatever_the_size() {
        let layer = Layer {
            conv: String::new(),
            norm: String::new(),
            inputs: CHANNELS,
            outputs: CHANNELS,
            kernel: 3,
            stride: 1,
        };
        let all = |value| vec![value; CHANNELS];
        let tensors = [numbers(CHANNELS * CHANNELS * 9), all(1.0), numbers(CHANNELS), all(0.0), all(1.0)];
        let folded = Folded::new(&LayerWeights { layer, tensors });
        let direct = folded.direct();
        let small = Winograd::<F2, 4, 2>::new(&folded);
        let large = Winograd::<F4, 6, 4>::new(&folded);
        let whole_small = WholeWinograd::<F2, 4, 2>::new(&folded);
        let whole_large = WholeWinograd::<F4, 6, 4>::new(&folded);
        let mut scratch = Scratch::default();
        for (height, width) in [(1, 1), (2, 5), (3, 4), (4, 4), (7, 30)] {
            let input = image(height, width);
            for (level, finish) in [(Level::new(), Finish::AddRelu), (Level::baseline(), Finish::Keep)] {
                let [mut expected, mut of_small, mut of_large] = [(); 3].map(|()| image(height, width));
                dispatch!(level, simd => direct.run(simd, &input, &mut expected, finish));
                dispatch!(level, simd => small.run(simd, &input, &mut of_small, finish, &mut scratch));
                dispatch!(level, simd => large.run(simd, &input, &mut of_large, finish, &mut scratch));
                for (found, bar) in [(&of_small, 1e-5), (&of_large, 5e-5)] {
                    for (found, expected) in found.data.iter().zip(&expected.data) {
                        assert!((found - expected).abs() < bar, "{height} x {width}: {found}, expected {expected}");
                    }
                }
                assert!(expected.data.iter().any(|&value| value > 1.0));
                let [mut of_small, mut of_large] = [(); 2].map(|()| image(height, width));
                dispatch!(level, simd => whole_small.run(simd, &input, &mut of_small, finish, &mut scratch));
                dispatch!(level, simd => whole_large.run(simd, &input, &mut of_large, finish, &mut scratch));
                let peak = expected.data.iter().fold(0.0_f32, |peak, value| peak.max(value.abs()));
                for (found, bar) in [(&of_small, 1e-3), (&of_large, 0.02)] {
                    for (found, expected) in found.data.iter().zip(&expected.data) {
                        assert!(
                            (found - expected).abs() < bar * peak,
                            "{height} x {width}: {found}, expected {expected}"
                        );
                    }
                }
            }
        }
    }
}
