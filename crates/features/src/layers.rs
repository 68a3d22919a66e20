//! The network's layers: its convolutions and their tensors, named and ordered as in torchvision's `resnet18` (He et
//! al., "Deep Residual Learning for Image Recognition", 2015, table 1).

use std::convert::Infallible;

pub(crate) const STAGES: [usize; 4] = [64, 128, 256, 512];

/// A convolution without bias and the batch norm behind it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Layer {
    /// Name of the convolution's tensors, such as `layer2.0.downsample.0`.
    pub conv: String,
    pub norm: String,
    pub inputs: usize,
    pub outputs: usize,
    /// Pixels along the side of the window; the padding is half of it, rounded down.
    pub kernel: usize,
    pub stride: usize,
}

/// The tensors of a batch norm, in the order of torchvision.
pub(crate) const NORM_TENSORS: [&str; 4] = ["weight", "bias", "running_mean", "running_var"];

impl Layer {
    fn new(conv: String, norm: String, inputs: usize, outputs: usize, kernel: usize, stride: usize) -> Self {
        Self { conv, norm, inputs, outputs, kernel, stride }
    }

    /// Inputs that one output sums.
    pub fn fan_in(&self) -> usize {
        self.inputs * self.kernel * self.kernel
    }

    /// Names and shapes of its tensors: the weight as `[outputs, inputs, rows, columns]`, then [`NORM_TENSORS`].
    pub fn tensors(&self) -> [(String, Vec<usize>); 5] {
        let [weight, bias, mean, variance] =
            NORM_TENSORS.map(|tensor| (format!("{}.{tensor}", self.norm), vec![self.outputs]));
        let shape = vec![self.outputs, self.inputs, self.kernel, self.kernel];
        [(format!("{}.weight", self.conv), shape), weight, bias, mean, variance]
    }
}

/// A value for each of the 20 convolutions.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Network<T> {
    pub first: T,
    /// Two of each stage.
    pub blocks: Vec<Block<T>>,
}

/// A residual block. Without `shortcut` its input is added unchanged.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Block<T> {
    pub conv1: T,
    pub conv2: T,
    pub shortcut: Option<T>,
}

pub(crate) fn network() -> Network<Layer> {
    let mut blocks = Vec::new();
    let mut inputs = STAGES[0];
    for (stage, outputs) in STAGES.into_iter().enumerate() {
        for block in 0..2 {
            let stride = if stage > 0 && block == 0 { 2 } else { 1 };
            let name = |part: &str| format!("layer{}.{block}.{part}", stage + 1);
            let shortcut = || Layer::new(name("downsample.0"), name("downsample.1"), inputs, outputs, 1, stride);
            blocks.push(Block {
                conv1: Layer::new(name("conv1"), name("bn1"), inputs, outputs, 3, stride),
                conv2: Layer::new(name("conv2"), name("bn2"), outputs, outputs, 3, 1),
                shortcut: (stride == 2).then(shortcut),
            });
            inputs = outputs;
        }
    }
    Network { first: Layer::new("conv1".into(), "bn1".into(), 3, STAGES[0], 7, 2), blocks }
}

impl<T> Network<T> {
    /// Visits the convolutions in torchvision's order: the first, then those of each block, the shortcut's last.
    pub fn try_map<U, E>(&self, mut f: impl FnMut(&T) -> Result<U, E>) -> Result<Network<U>, E> {
        let first = f(&self.first)?;
        let block = |block: &Block<T>| {
            Ok(Block {
                conv1: f(&block.conv1)?,
                conv2: f(&block.conv2)?,
                shortcut: block.shortcut.as_ref().map(&mut f).transpose()?,
            })
        };
        Ok(Network { first, blocks: self.blocks.iter().map(block).collect::<Result<_, _>>()? })
    }

    /// Like [`Network::try_map`], without errors.
    pub fn map<U>(&self, mut f: impl FnMut(&T) -> U) -> Network<U> {
        let Ok(network) = self.try_map(|item| Ok::<_, Infallible>(f(item)));
        network
    }

    pub fn iter(&self) -> impl Iterator<Item = &T> {
        let blocks =
            self.blocks.iter().flat_map(|block| [&block.conv1, &block.conv2].into_iter().chain(&block.shortcut));
        std::iter::once(&self.first).chain(blocks)
    }
}
