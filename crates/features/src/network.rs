//! The network: layers in order, and the images between them.

use std::sync::Arc;

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, dispatch, f32x16};
use fiatlux_nets::{Convolution, Finish, LANES, Plane, WholeConvolution};

use crate::folded::Folded;
use crate::layers::{Block, Network, STAGES};
use crate::tiles::{F2, F4};
use crate::winograd::{Scratch, WholeWinograd, Winograd};
use crate::{FeatureError, Weights};

pub const FEATURES: usize = 512;

/// Both sides of an image must be multiples of it: the network halves them five times.
pub const SIDE_STEP: usize = 32;

/// The longest side of an image, in pixels.
pub const SIDE_LIMIT: usize = 1024;

/// Mean of each colour over ImageNet, as torchvision's pretrained networks expect it.
pub const MEAN: [f32; 3] = [0.485, 0.456, 0.406];

/// Standard deviation of each colour over ImageNet.
pub const STD: [f32; 3] = [0.229, 0.224, 0.225];

/// A convolution in the form that is fastest for it.
#[derive(Debug)]
enum Conv {
    Direct(Convolution),
    /// For many channels: the weights of larger tiles would take longer to read than they save.
    Small(Winograd<F2, 4, 2>),
    Large(Winograd<F4, 6, 4>),
    WholeDirect(WholeConvolution),
    WholeSmall(WholeWinograd<F2, 4, 2>),
    WholeLarge(WholeWinograd<F4, 6, 4>),
}

/// The numbers that products are computed in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Arithmetic {
    /// In f32, with fused multiplication where the CPU has it: two kinds of CPU differ in the last digits.
    #[default]
    Single,
    /// In whole numbers of at most 16 bits, and sums of 32, which are the same on every CPU; so are the features, to the bit. The label of
    /// the weights then ends with [`INT8`].
    Int8,
}

impl Arithmetic {
    /// The name of weights without its ending, and the arithmetic that it asks for: `NAME+int8`, or `int8` for weights without a name.
    pub fn of_name(name: &str) -> (&str, Self) {
        let whole = name.strip_suffix(INT8).or((name == &INT8[1..]).then_some(""));
        whole.map_or((name, Self::Single), |name| (name, Self::Int8))
    }
}

/// End of the label of weights whose network computes in whole numbers.
pub const INT8: &str = "+int8";

/// From this number of channels on, tiles are small.
const SMALL_TILES: usize = 512;

impl Conv {
    fn new(folded: &Folded, arithmetic: Arithmetic) -> Self {
        match ((folded.kernel, folded.stride), arithmetic) {
            ((3, 1), Arithmetic::Single) if folded.inputs >= SMALL_TILES => Self::Small(Winograd::new(folded)),
            ((3, 1), Arithmetic::Single) => Self::Large(Winograd::new(folded)),
            (_, Arithmetic::Single) => Self::Direct(folded.direct()),
            ((3, 1), Arithmetic::Int8) if folded.inputs >= SMALL_TILES => Self::WholeSmall(WholeWinograd::new(folded)),
            ((3, 1), Arithmetic::Int8) => Self::WholeLarge(WholeWinograd::new(folded)),
            (_, Arithmetic::Int8) => Self::WholeDirect(folded.whole()),
        }
    }

    fn run(&self, level: Level, input: &Plane, output: &mut Plane, finish: Finish, scratch: &mut Scratch) {
        match self {
            Self::Direct(conv) => dispatch!(level, simd => conv.run(simd, input, output, finish)),
            Self::Small(conv) => dispatch!(level, simd => conv.run(simd, input, output, finish, scratch)),
            Self::Large(conv) => dispatch!(level, simd => conv.run(simd, input, output, finish, scratch)),
            Self::WholeDirect(conv) => {
                dispatch!(level, simd => conv.run(simd, input, output, finish, &mut scratch.steps));
            }
            Self::WholeSmall(conv) => dispatch!(level, simd => conv.run(simd, input, output, finish, scratch)),
            Self::WholeLarge(conv) => dispatch!(level, simd => conv.run(simd, input, output, finish, scratch)),
        }
    }
}

/// A stage's image and the one between the two convolutions of a block.
#[derive(Debug)]
struct Stage {
    image: Plane,
    between: Plane,
}

/// The images for one size of input.
#[derive(Debug)]
struct Planes {
    input: Plane,
    first: Plane,
    stages: [Stage; STAGES.len()],
}

impl Planes {
    fn new(width: usize, height: usize) -> Self {
        let mut shrink = 4;
        let stages = STAGES.map(|channels| {
            let plane = || Plane::new(height / shrink, width / shrink, channels, 1);
            let stage = Stage { image: plane(), between: plane() };
            shrink *= 2;
            stage
        });
        let first = Plane::new(height / 2, width / 2, STAGES[0], 1);
        Self { input: Plane::new(height, width, 3, 3), first, stages }
    }
}

/// ResNet-18 up to the average over the last image, with batch norm folded into the convolutions. It runs on the
/// calling thread and allocates only when the size of the image changes.
///
/// The same build on the same machine gives the same bytes. The widest vector instructions that the CPU has are chosen
/// when it is made, so another CPU may round otherwise.
#[derive(Debug)]
pub struct ResNet18 {
    level: Level,
    label: String,
    convs: Arc<Network<Conv>>,
    /// The normalised value of each byte, by colour.
    normalised: [[f32; 3]; 256],
    planes: Planes,
    scratch: Scratch,
    features: [f32; FEATURES],
}

impl ResNet18 {
    /// Folds and packs the weights: some 95 MB.
    pub fn new(weights: &Weights) -> Self {
        Self::with(weights, Arithmetic::Single)
    }

    /// As [`ResNet18::new`], with that arithmetic.
    pub fn with(weights: &Weights, arithmetic: Arithmetic) -> Self {
        let ending = if arithmetic == Arithmetic::Int8 { INT8 } else { "" };
        Self {
            level: Level::new(),
            label: weights.label() + ending,
            convs: Arc::new(weights.network().map(|filled| Conv::new(&Folded::new(filled), arithmetic))),
            normalised: std::array::from_fn(|byte| {
                std::array::from_fn(|colour| (byte as f32 / 255.0 - MEAN[colour]) / STD[colour])
            }),
            planes: Planes::new(0, 0),
            scratch: Scratch::default(),
            features: [0.0; FEATURES],
        }
    }

    /// A second network with the same weights, which both share, and with memory of its own for the images in between.
    pub fn twin(&self) -> Self {
        Self {
            level: self.level,
            label: self.label.clone(),
            convs: Arc::clone(&self.convs),
            normalised: self.normalised,
            planes: Planes::new(0, 0),
            scratch: Scratch::default(),
            features: [0.0; FEATURES],
        }
    }

    pub fn label(&self) -> &str {
        &self.label
    }

    pub fn last(&self) -> &[f32; FEATURES] {
        &self.features
    }

    /// The features of an image: 512 numbers, none negative, each the mean of a channel of the last layer. `rgb` has 3
    /// bytes a pixel, rows from the top, as the head camera gives them (256 x 256); any sides that are multiples of
    /// [`SIDE_STEP`] up to [`SIDE_LIMIT`] will do. A byte becomes `(byte / 255 - MEAN) / STD` of its colour; nothing is
    /// resized or cropped.
    pub fn features(&mut self, rgb: &[u8], width: usize, height: usize) -> Result<&[f32; FEATURES], FeatureError> {
        let fits = |side: usize| side > 0 && side <= SIDE_LIMIT && side.is_multiple_of(SIDE_STEP);
        if !fits(width) || !fits(height) {
            return Err(FeatureError::ImageSize { width, height, limit: SIDE_LIMIT });
        }
        let (expected, found) = (3 * width * height, rgb.len());
        if found != expected {
            return Err(FeatureError::ImageBytes { width, height, expected, found });
        }
        if (self.planes.input.width, self.planes.input.height) != (width, height) {
            self.planes = Planes::new(width, height);
        }
        self.normalise(rgb);
        self.run();
        match self.features.iter().position(|feature| !feature.is_finite()) {
            None => Ok(&self.features),
            Some(index) => {
                let (label, found) = (self.label.clone(), self.features[index]);
                Err(FeatureError::Overflow { label, index, found })
            }
        }
    }

    fn normalise(&mut self, rgb: &[u8]) {
        let input = &mut self.planes.input;
        for (y, row) in rgb.chunks_exact(3 * input.width).enumerate() {
            let at = input.at(y, 0);
            for (pixel, bytes) in input.data[at..].as_chunks_mut::<3>().0.iter_mut().zip(row.as_chunks::<3>().0) {
                *pixel = std::array::from_fn(|colour| self.normalised[usize::from(bytes[colour])][colour]);
            }
        }
    }

    fn run(&mut self) {
        let Self { level, convs, planes, scratch, features, .. } = self;
        let mut conv = |conv: &Conv, input: &Plane, output: &mut Plane, finish| {
            conv.run(*level, input, output, finish, scratch);
        };
        let Planes { input, first, stages } = planes;
        conv(&convs.first, input, first, Finish::Relu);
        dispatch!(*level, simd => max_pool(simd, first, &mut stages[0].image));
        for (i, blocks) in convs.blocks.chunks(2).enumerate() {
            let (before, stages) = stages.split_at_mut(i);
            let Stage { image, between } = &mut stages[0];
            for Block { conv1, conv2, shortcut } in blocks {
                // The shortcut's result is written first, and the other is added to it in place.
                match (shortcut, before.last()) {
                    (Some(shortcut), Some(before)) => {
                        conv(conv1, &before.image, between, Finish::Relu);
                        conv(shortcut, &before.image, image, Finish::Keep);
                    }
                    _ => conv(conv1, image, between, Finish::Relu),
                }
                conv(conv2, between, image, Finish::AddRelu);
            }
        }
        average(&stages[STAGES.len() - 1].image, features);
    }
}

/// The largest of 3 x 3 pixels at stride 2. The border of zeros is not part of the image, but no pixel is below zero.
#[inline(always)]
fn max_pool<S: Simd>(simd: S, input: &Plane, output: &mut Plane) {
    let channels = input.channels;
    for y in 0..output.height {
        for x in 0..output.width {
            let to = output.at(y, x);
            let rows: [usize; 3] = std::array::from_fn(|dy| input.at_bordered(2 * y + dy, 2 * x));
            for channel in (0..channels).step_by(LANES) {
                let mut largest = f32x16::splat(simd, 0.0);
                for at in rows {
                    for dx in 0..3 {
                        let from = at + dx * channels + channel;
                        largest = f32x16::from_slice(simd, &input.data[from..from + LANES]).max(largest);
                    }
                }
                largest.store_slice(&mut output.data[to + channel..][..LANES]);
            }
        }
    }
}

/// The mean over all pixels, row by row.
fn average(image: &Plane, features: &mut [f32; FEATURES]) {
    features.fill(0.0);
    for y in 0..image.height {
        for x in 0..image.width {
            let at = image.at(y, x);
            for (sum, &value) in features.iter_mut().zip(&image.data[at..at + FEATURES]) {
                *sum += value;
            }
        }
    }
    let pixels = (image.height * image.width) as f32;
    features.iter_mut().for_each(|sum| *sum /= pixels);
}

#[cfg(test)]
mod tests;
