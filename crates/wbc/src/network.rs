//! The network: a multilayer perceptron that is its own mirror image.
//!
//! Hidden units come in pairs: the second has the weights of the first and sees the mirrored input. So a file holds the
//! weights of the first ones alone, and a layer is run twice, on its input and on the mirrored input.

use std::path::Path;

use fiatlux_safetensors::File;
use sha2::{Digest, Sha256};

use crate::standing::Standing;
use crate::{Contract, FRAME, MOVED, WbcError, mirrored_action, mirrored_frame};

/// Columns of weights that one pass of the inner loop sums.
const LANES: usize = 16;
/// Largest difference from what the network gave when it was exported.
const TOLERANCE: f32 = 1e-5;
/// Under which name a file carries the contract.
const CONTRACT: &str = "contract";
/// How a checkpoint begins, which is a zip archive.
const CHECKPOINT: &[u8] = b"PK\x03\x04";
/// The largest layer that is taken.
const WIDEST: usize = 1 << 12;

#[derive(Debug, Clone)]
struct Layer {
    /// Panels of [`LANES`] outputs, each with a row an input.
    weights: Vec<[f32; LANES]>,
    biases: Vec<[f32; LANES]>,
    inputs: usize,
    outputs: usize,
}

/// A controller's network, ready to run. It is exactly symmetric: mirrored inputs give mirrored actions.
#[derive(Debug, Clone)]
pub struct Network {
    contract: Contract,
    digest: String,
    layers: Vec<Layer>,
    /// Where each number of a mirrored observation comes from, and its sign.
    mirror: Vec<(usize, f32)>,
    standing: Standing,
}

/// Room for what a network works out on its way.
#[derive(Debug, Clone)]
pub(crate) struct Scratch {
    /// Each number as it is, and what stands in its place in the mirror.
    layers: [Vec<[f32; 2]>; 2],
}

impl Network {
    /// The controller that comes with this version.
    ///
    /// # Errors
    /// As [`Network::from_bytes`]; a test guards that there are none.
    pub fn shipped() -> Result<Self, WbcError> {
        Self::from_bytes(include_bytes!("../weights/wbc.safetensors"))
    }

    /// Reads a controller's file.
    ///
    /// # Errors
    /// A file that cannot be read, or see [`Network::from_bytes`].
    pub fn read(path: &Path) -> Result<Self, WbcError> {
        let bytes = std::fs::read(path).map_err(|source| WbcError::Read { path: path.into(), source })?;
        if bytes.starts_with(CHECKPOINT) {
            return Err(WbcError::Checkpoint { path: path.into() });
        }
        Self::from_bytes(&bytes)
    }

    /// Reads a controller's file from memory. The file holds an observation and what the network made of it when it was
    /// exported; the network is run on it once.
    ///
    /// # Errors
    /// [`WbcError`]: a damaged file, one of another engine, or numbers that are not finite.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, WbcError> {
        let file = File::parse(bytes)?;
        let contract = Contract::from_json(file.metadata(CONTRACT).ok_or(WbcError::NoContract)?)?;
        let sizes = &contract.layers;
        let last = sizes.len().saturating_sub(2);
        let is_sound = |(index, size): &(usize, &usize)| {
            (1..=WIDEST).contains(*size) && ((*index == 0 || *index > last) || *size % 2 == 0)
        };
        if let Some((_, size)) = sizes.iter().enumerate().find(|entry| !is_sound(entry)) {
            return Err(WbcError::Layer { size: *size, most: WIDEST });
        }
        let mut layers = Vec::new();
        for (index, pair) in sizes.windows(2).enumerate() {
            let inputs = if index == last && index > 0 { pair[0] / 2 } else { pair[0] };
            let outputs = if index < last { pair[1] / 2 } else { pair[1] };
            let weights = finite(&file, &format!("layer{index}.weight"), &[outputs, inputs])?;
            let biases = finite(&file, &format!("layer{index}.bias"), &[outputs])?;
            layers.push(Layer::new(inputs, outputs, &weights, &biases));
        }
        let example = finite(&file, "check.observation", &sizes[..1])?;
        let expected = finite(&file, "check.action", &[MOVED])?;
        let frames = contract.frames;
        let standing = Standing::new(&contract.joints)?;
        let digest = Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect();
        let network = Self { contract, digest, layers, mirror: mirror(frames), standing };
        let mut found = [0.0; MOVED];
        network.run(&example, &mut network.scratch(), &mut found);
        let differ = |(found, expected): (&f32, &f32)| (found - expected).abs() / expected.abs().max(1.0);
        let difference = found.iter().zip(&expected).map(differ).fold(0.0, f32::max);
        match difference <= TOLERANCE {
            true => Ok(network),
            false => Err(WbcError::Check(difference)),
        }
    }

    /// What it was made for.
    pub fn contract(&self) -> &Contract {
        &self.contract
    }

    /// SHA-256 of the file, hexadecimal.
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// For the robot and gains that it was made for; it has seen nothing.
    pub(crate) fn standing(&self) -> &Standing {
        &self.standing
    }

    pub(crate) fn scratch(&self) -> Scratch {
        let widest = self.contract.layers.iter().max().copied().unwrap_or_default().next_multiple_of(LANES);
        Scratch { layers: [(); 2].map(|()| vec![[0.0; 2]; widest]) }
    }

    /// The action for an observation.
    pub(crate) fn run(&self, observation: &[f32], scratch: &mut Scratch, action: &mut [f32; MOVED]) {
        let [from, to] = &mut scratch.layers;
        for (place, (number, (index, sign))) in from.iter_mut().zip(observation.iter().zip(&self.mirror)) {
            *place = [*number, sign * observation[*index]];
        }
        let last = self.layers.len() - 1;
        for (index, layer) in self.layers.iter().enumerate() {
            layer.run(from, to, index < last);
            std::mem::swap(from, to);
            if index + 1 < last {
                let (firsts, seconds) = from.split_at_mut(layer.outputs);
                firsts.iter().zip(seconds).for_each(|([seen, mirrored], second)| *second = [*mirrored, *seen]);
            }
        }
        for (index, place) in action.iter_mut().enumerate() {
            let (other, sign) = mirrored_action(index);
            *place = 0.5 * (from[index][0] + sign * from[other][1]);
        }
    }
}

/// The numbers of a tensor, all finite.
fn finite(file: &File<'_>, name: &str, shape: &[usize]) -> Result<Vec<f32>, WbcError> {
    let numbers = file.tensor(name, shape)?;
    match numbers.iter().all(|number| number.is_finite()) {
        true => Ok(numbers),
        false => Err(WbcError::Weights(name.into())),
    }
}

impl Layer {
    /// From weights with a row an output, as PyTorch has them.
    fn new(inputs: usize, outputs: usize, weights: &[f32], biases: &[f32]) -> Self {
        let panels = outputs.div_ceil(LANES);
        let entry = |output: usize, input: usize| {
            if output < outputs { weights[output * inputs + input] } else { 0.0 }
        };
        let rows = (0..panels).flat_map(|panel| (0..inputs).map(move |input| (panel, input)));
        let weights = rows.map(|(panel, input)| std::array::from_fn(|lane| entry(panel * LANES + lane, input)));
        let bias = |output: usize| biases.get(output).copied().unwrap_or_default();
        let biases = (0..panels).map(|panel| std::array::from_fn(|lane| bias(panel * LANES + lane)));
        Self { weights: weights.collect(), biases: biases.collect(), inputs, outputs }
    }

    /// Both columns at once, so that each weight is read once. Sums run in the order of the inputs on every machine.
    fn run(&self, from: &[[f32; 2]], to: &mut [[f32; 2]], is_hidden: bool) {
        let panels = self.weights.chunks_exact(self.inputs).zip(&self.biases);
        for ((panel, bias), place) in panels.zip(to.chunks_exact_mut(LANES)) {
            let (mut seen, mut mirrored) = (*bias, *bias);
            for (weights, [number, reflected]) in panel.iter().zip(from) {
                for lane in 0..LANES {
                    seen[lane] += weights[lane] * number;
                    mirrored[lane] += weights[lane] * reflected;
                }
            }
            if is_hidden {
                (seen, mirrored) = (seen.map(elu), mirrored.map(elu));
            }
            for lane in 0..LANES {
                place[lane] = [seen[lane], mirrored[lane]];
            }
        }
    }
}

/// The exponential linear unit. The exponential is a polynomial, the same on every machine and free of branches.
#[inline(always)]
fn elu(number: f32) -> f32 {
    const LOG2_E: f32 = std::f32::consts::LOG2_E;
    /// ln 2 in two parts, the first exact in the product below.
    const LN_2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];
    let x = number.clamp(-80.0, 0.0);
    // Halves are rounded up, which is as good here as to even.
    let shifted = x * LOG2_E + 127.5;
    let power = shifted as i32;
    let whole = (power - 127) as f32;
    let rest = (x - whole * LN_2[0]) - whole * LN_2[1];
    // Taylor's series, exact to 1e-7 within half of ln 2.
    let series = 1.0 / 720.0 + rest / 5040.0;
    let series = 1.0 / 24.0 + rest * (1.0 / 120.0 + rest * series);
    let series = 1.0 + rest * (1.0 + rest * (0.5 + rest * (1.0 / 6.0 + rest * series)));
    let exponential = series * f32::from_bits((power as u32) << 23);
    if number > 0.0 { number } else { exponential - 1.0 }
}

/// Reflection of an observation: field after field, each with all its frames.
fn mirror(frames: usize) -> Vec<(usize, f32)> {
    let mut mirror = Vec::new();
    let mut field_start = 0;
    for (_, count) in FRAME {
        for frame in 0..frames {
            for index in 0..count {
                let (from, sign) = mirrored_frame(field_start + index);
                mirror.push((field_start * frames + frame * count + from - field_start, sign));
            }
        }
        field_start += count;
    }
    mirror
}

#[cfg(test)]
mod tests {
    use super::elu;

    #[test]
    fn elu_is_the_closed_form() {
        for step in -4000..200 {
            let x = step as f32 * 0.005;
            let expected = if x > 0.0 { f64::from(x) } else { libm::expm1(f64::from(x)) };
            assert!((f64::from(elu(x)) - expected).abs() < 2e-7, "{x}: {} {expected}", elu(x));
        }
        assert_eq!(elu(-1e9), -1.0);
    }
}
