//! The network's weights: from a file, or drawn from a seed.

use std::path::Path;

use data_encoding::HEXLOWER;
use fiatlux_safetensors::File;
use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::Rng as _;
use sha2::{Digest, Sha256};

use crate::FeatureError;
use crate::layers::{Layer, NORM_TENSORS, Network, network};

/// Name and version of the generator of seeded weights; the seed follows behind a colon.
pub const SEEDED_NAME: &str = "fiatlux-resnet18-seeded/1";

/// The largest file that is read: five times a ResNet-18 in f32.
const FILE_LIMIT: u64 = 256 << 20;

/// A layer with its tensors, in the order of [`Layer::tensors`].
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LayerWeights {
    pub layer: Layer,
    pub tensors: [Vec<f32>; 5],
}

/// The weights of a ResNet-18 without its classifier, all finite, and where they come from.
#[derive(Debug, Clone, PartialEq)]
pub struct Weights {
    network: Network<LayerWeights>,
    label: String,
}

impl Weights {
    /// Reads a safetensors file with torchvision's `resnet18` state dict in f32, of at most 256 MiB. `fc.*` and
    /// `*.num_batches_tracked` are ignored; any other unknown tensor is an error, because the file is another
    /// network's.
    pub fn from_safetensors(path: impl AsRef<Path>) -> Result<Self, FeatureError> {
        let path = path.as_ref();
        let bytes = fiatlux_files::read(path, FILE_LIMIT).map_err(|source| match source.kind() {
            std::io::ErrorKind::FileTooLarge => FeatureError::FileSize { path: path.to_owned(), limit: FILE_LIMIT },
            _ => FeatureError::Read { path: path.to_owned(), source },
        })?;
        Self::from_safetensors_bytes(&bytes)
    }

    pub fn from_safetensors_bytes(bytes: &[u8]) -> Result<Self, FeatureError> {
        let file = File::parse(bytes)?;
        let network = network().try_map(|layer| read_layer(&file, layer))?;
        let known = |name: &str| {
            name.starts_with("fc.")
                || name.ends_with(".num_batches_tracked")
                || network.iter().any(|filled| filled.layer.tensors().iter().any(|(tensor, _)| tensor == name))
        };
        if let Some(name) = file.names().find(|name| !known(name)) {
            return Err(FeatureError::Unexpected { tensor: name.into() });
        }
        let digest: String = HEXLOWER.encode(&Sha256::digest(bytes));
        Ok(Self { network, label: format!("safetensors:{digest}") })
    }

    /// Untrained weights that anyone can draw again to the bit.
    ///
    /// One stream of PCG64-MCG (XSL-RR 128/64) draws all of them. Its state is the first 16 bytes, little-endian, of
    /// the SHA-256 of [`SEEDED_NAME`], a zero byte and the seed (8 bytes, little-endian), with the lowest bit set. The
    /// convolutions come in torchvision's order, each as `[outputs][inputs][rows][columns]`. A weight is `(2 u - 1)
    /// sqrt(6 / n)`, in f64 and then rounded to f32, where `u` is the next 64 bits shifted right by 11, times 2^-53,
    /// and `n` the number of inputs that one output sums: uniform with variance `2 / n`, that of He et al., "Delving
    /// Deep into Rectifiers", 2015, equation 10. Batch norms have weight 1, bias 0, mean 0 and variance 1.
    pub fn seeded(seed: u64) -> Self {
        let mut hash = Sha256::new();
        hash.update(SEEDED_NAME);
        hash.update([0]);
        hash.update(seed.to_le_bytes());
        let mut state = [0; 16];
        state.copy_from_slice(&hash.finalize()[..16]);
        let mut random = Pcg64Mcg::new(u128::from_le_bytes(state));
        let network = network().map(|layer| draw_layer(&mut random, layer));
        Self { network, label: format!("{SEEDED_NAME}:{seed}") }
    }

    /// The name of the weights in records: `fiatlux-resnet18-seeded/1:SEED`, or `safetensors:` and the SHA-256 of the
    /// file in hexadecimal.
    pub fn label(&self) -> String {
        self.label.clone()
    }

    /// The weights as the bytes of a safetensors file, without the classifier.
    pub fn to_safetensors(&self) -> Vec<u8> {
        fiatlux_safetensors::write(self.network.iter().flat_map(|LayerWeights { layer, tensors }| {
            layer.tensors().into_iter().zip(tensors).map(|((name, shape), numbers)| (name, shape, numbers.as_slice()))
        }))
    }

    pub(crate) fn network(&self) -> &Network<LayerWeights> {
        &self.network
    }
}

fn read_layer(file: &File<'_>, layer: &Layer) -> Result<LayerWeights, FeatureError> {
    let mut tensors = <[Vec<f32>; 5]>::default();
    for ((name, shape), numbers) in layer.tensors().into_iter().zip(&mut tensors) {
        *numbers = file.tensor(&name, &shape)?;
        let variance = name.ends_with(NORM_TENSORS[3]);
        let usable = |number: f32| number.is_finite() && (!variance || number >= 0.0);
        if let Some(index) = numbers.iter().position(|&number| !usable(number)) {
            let expected = if variance { "finite numbers of at least 0" } else { "finite numbers" };
            return Err(FeatureError::Number { tensor: name, expected, found: numbers[index], index });
        }
    }
    Ok(LayerWeights { layer: layer.clone(), tensors })
}

fn draw_layer(random: &mut Pcg64Mcg, layer: &Layer) -> LayerWeights {
    const UNIT: f64 = 1.0 / (1_u64 << 53) as f64;
    let bound = (6.0 / layer.fan_in() as f64).sqrt();
    let mut weight = || ((2.0 * ((random.next_u64() >> 11) as f64 * UNIT) - 1.0) * bound) as f32;
    let conv = (0..layer.outputs * layer.fan_in()).map(|_| weight()).collect();
    let all = |value: f32| vec![value; layer.outputs];
    LayerWeights { layer: layer.clone(), tensors: [conv, all(1.0), all(0.0), all(0.0), all(1.0)] }
}
