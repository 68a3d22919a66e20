//! A convolution with its batch norm folded in.

use fiatlux_nets::{Convolution, WholeConvolution};

use crate::weights::LayerWeights;

/// Added to the variance by batch norm; torchvision's default.
const EPSILON: f64 = 1e-5;

/// A convolution with bias: `weight * g / sqrt(v + e)` and `b - m * g / sqrt(v + e)`, computed in f64.
#[derive(Debug, Clone)]
pub(crate) struct Folded {
    /// Kernel weights in the order `[outputs][inputs][rows][columns]`.
    weights: Vec<f32>,
    pub bias: Vec<f32>,
    pub inputs: usize,
    pub outputs: usize,
    pub kernel: usize,
    pub stride: usize,
}

impl Folded {
    pub fn new(LayerWeights { layer, tensors }: &LayerWeights) -> Self {
        let [conv, gain, shift, mean, variance] = tensors;
        let scales: Vec<f64> =
            gain.iter().zip(variance).map(|(&g, &v)| f64::from(g) / (f64::from(v) + EPSILON).sqrt()).collect();
        let of_output = conv.chunks_exact(layer.fan_in()).zip(&scales);
        Self {
            weights: of_output.flat_map(|(w, scale)| w.iter().map(move |&w| (f64::from(w) * scale) as f32)).collect(),
            bias: (0..layer.outputs).map(|i| (f64::from(shift[i]) - f64::from(mean[i]) * scales[i]) as f32).collect(),
            inputs: layer.inputs,
            outputs: layer.outputs,
            kernel: layer.kernel,
            stride: layer.stride,
        }
    }

    /// The weight of an input channel's pixel (`y`, `x`) of the window.
    pub fn weight(&self, output: usize, input: usize, y: usize, x: usize) -> f32 {
        self.weights[((output * self.inputs + input) * self.kernel + y) * self.kernel + x]
    }

    /// For the first layer, those of stride 2 and those of 1 x 1.
    pub fn direct(&self) -> Convolution {
        let weight = |output, input, y, x| self.weight(output, input, y, x);
        Convolution::new(self.inputs, self.kernel, self.stride, weight, self.bias.clone())
    }

    /// The same in whole numbers.
    pub fn whole(&self) -> WholeConvolution {
        let weight = |output, input, y, x| self.weight(output, input, y, x);
        WholeConvolution::new(self.inputs, self.kernel, self.stride, weight, self.bias.clone())
    }
}
