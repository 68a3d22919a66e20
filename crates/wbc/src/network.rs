//! The network: a multilayer perceptron that is its own mirror image.
//!
//! Hidden units come in pairs: the second has the weights of the first and sees the mirrored input. So a file holds the
//! weights of the first ones alone, and a layer is run twice, on its input and on the mirrored input.

use std::path::Path;

use data_encoding::HEXLOWER;
use fiatlux_nets::{Dense, Rounding, elu, largest_difference};
use fiatlux_safetensors::File;
use sha2::{Digest, Sha256};

use crate::standing::Standing;
use crate::{Contract, FRAME, MOVED, WbcError, mirrored_action, mirrored_frame};

/// Largest file, bytes.
const MAX_FILE_BYTES: u64 = 128 << 20;
/// Largest difference from what the network gave when it was exported.
const TOLERANCE: f32 = 1e-5;
/// Under which name a file carries the contract.
const CONTRACT: &str = "contract";
/// First bytes of a checkpoint, which is a zip archive.
const CHECKPOINT: &[u8] = b"PK\x03\x04";
/// The largest layer that is taken.
const WIDEST: usize = 1 << 12;

/// A controller's network, ready to run. It is exactly symmetric: mirrored inputs give mirrored actions.
#[derive(Debug, Clone)]
pub struct Network {
    contract: Contract,
    digest: String,
    layers: Vec<Dense>,
    /// Where each number of a mirrored observation comes from, and its sign.
    mirror: Vec<(usize, f32)>,
    standing: Standing,
}

/// Room for what a network works out on its way.
#[derive(Debug, Clone)]
pub(crate) struct Scratch {
    /// Of a layer's input and its output: each number as it is, and what stands in its place in the mirror.
    layers: [[Vec<f32>; 2]; 2],
}

impl Network {
    /// The controller that comes with this version.
    ///
    /// # Errors
    /// As [`Network::from_bytes`]; a test guards that it never fails.
    pub fn shipped() -> Result<Self, WbcError> {
        Self::from_bytes(include_bytes!("../weights/wbc.safetensors"))
    }

    /// Reads a controller's file.
    ///
    /// # Errors
    /// A file that cannot be read, or see [`Network::from_bytes`].
    pub fn read(path: &Path) -> Result<Self, WbcError> {
        let bytes =
            fiatlux_files::read(path, MAX_FILE_BYTES).map_err(|source| WbcError::Read { path: path.into(), source })?;
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
            layers.push(Dense::new(inputs, outputs, |i, o| weights[o * inputs + i], |o| biases[o]));
        }
        let example = finite(&file, "check.observation", &sizes[..1])?;
        let expected = finite(&file, "check.action", &[MOVED])?;
        let frames = contract.frames;
        let standing = Standing::new(&contract.joints)?;
        let digest = HEXLOWER.encode(&Sha256::digest(bytes));
        let network = Self { contract, digest, layers, mirror: mirror(frames), standing };
        let mut found = [0.0; MOVED];
        network.run(&example, &mut network.scratch(), &mut found);
        let difference = largest_difference(&found, &expected);
        match difference <= TOLERANCE {
            true => Ok(network),
            false => Err(WbcError::Check(difference)),
        }
    }

    /// Contract of its file.
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
        let widest = self.contract.layers.iter().max().copied().unwrap_or_default();
        Scratch { layers: [(); 2].map(|()| [(); 2].map(|()| vec![0.0; widest])) }
    }

    pub(crate) fn run(&self, observation: &[f32], scratch: &mut Scratch, action: &mut [f32; MOVED]) {
        let [from, to] = &mut scratch.layers;
        let [seen, mirrored] = from;
        for (place, (index, sign)) in self.mirror.iter().enumerate() {
            (seen[place], mirrored[place]) = (observation[place], sign * observation[*index]);
        }
        let last = self.layers.len() - 1;
        for (index, layer) in self.layers.iter().enumerate() {
            // Both rows at once, so that each weight is read once; sums are the same on every machine.
            layer.run(Rounding::Separate, from.each_ref().map(Vec::as_slice), to.each_mut().map(Vec::as_mut_slice));
            let [seen, mirrored] = &mut *to;
            let count = layer.outputs();
            if index < last {
                seen[..count].iter_mut().chain(&mut mirrored[..count]).for_each(|number| *number = elu(*number));
            }
            if index + 1 < last {
                seen[count..2 * count].copy_from_slice(&mirrored[..count]);
                mirrored[count..2 * count].copy_from_slice(&seen[..count]);
            }
            std::mem::swap(from, to);
        }
        let [seen, mirrored] = from;
        for (index, place) in action.iter_mut().enumerate() {
            let (other, sign) = mirrored_action(index);
            *place = 0.5 * (seen[index] + sign * mirrored[other]);
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
