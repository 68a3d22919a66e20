//! The steps of a run, over an arena of numbers.

use std::ops::Range;

use fiatlux_nets::{Dense, Rounding, elu, sigmoid};

/// Reads numbers of the arena and writes others behind them.
#[derive(Debug)]
pub(super) enum Step {
    /// Copies runs of numbers, each given by start and length, one after another.
    Copy {
        runs: Vec<[usize; 2]>,
        to: usize,
    },
    Compute {
        kernel: Kernel,
        inputs: [Range<usize>; 2],
        output: Range<usize>,
    },
}

impl Step {
    pub fn run(&self, arena: &mut [f32]) {
        match self {
            Self::Copy { runs, to } => {
                let mut to = *to;
                for &[from, count] in runs {
                    arena.copy_within(from..from + count, to);
                    to += count;
                }
            }
            Self::Compute { kernel, inputs: [left, right], output } => {
                let (before, rest) = arena.split_at_mut(output.start);
                kernel.run(&before[left.clone()], &before[right.clone()], &mut rest[..output.len()]);
            }
        }
    }
}

#[derive(Debug)]
pub(super) enum Kernel {
    /// Elementwise.
    Map(Map),
    /// Two values elementwise.
    Zip(Zip),
    /// One number from each `width` of them.
    Reduce { reduction: Reduction, width: usize },
    /// Each `width` numbers shifted and scaled to mean 0 and variance 1 (plus `epsilon`).
    Standardize { width: usize, epsilon: f32 },
    /// Each row times constant weights.
    Dense(Dense),
}

#[derive(Debug, Clone, Copy)]
pub(super) enum Map {
    Abs,
    Ceil,
    Clip { least: f32, most: f32 },
    Elu { alpha: f32 },
    Erf,
    Exp,
    Floor,
    LeakyRelu { alpha: f32 },
    Log,
    Neg,
    Reciprocal,
    Relu,
    Round,
    Selu { alpha: f32, gamma: f32 },
    Sigmoid,
    Softplus,
    Sqrt,
    Tanh,
}

#[derive(Debug, Clone, Copy)]
pub(super) enum Zip {
    Add,
    Div,
    Max,
    Min,
    Mul,
    Pow,
    PRelu,
    Sub,
}

#[derive(Debug, Clone, Copy)]
pub(super) enum Reduction {
    L2,
    Max,
    Mean,
    Min,
    Sum,
}

impl Kernel {
    pub fn run(&self, left: &[f32], right: &[f32], out: &mut [f32]) {
        match self {
            Self::Map(map) => map.run(left, out),
            Self::Zip(zip) => zip.run(left, right, out),
            Self::Reduce { reduction, width } => {
                left.chunks_exact(*width).zip(out).for_each(|(row, place)| *place = reduction.of(row));
            }
            Self::Standardize { width, epsilon } => {
                left.chunks_exact(*width).zip(out.chunks_exact_mut(*width)).for_each(|(row, place)| {
                    standardize(row, *epsilon, place);
                });
            }
            Self::Dense(dense) => {
                let rows = left.chunks_exact(dense.inputs()).zip(out.chunks_exact_mut(dense.outputs()));
                rows.for_each(|(from, to)| dense.run(Rounding::Fused, [from], [to]));
            }
        }
    }
}

impl Map {
    fn run(self, from: &[f32], to: &mut [f32]) {
        match self {
            Self::Abs => each(from, to, f32::abs),
            Self::Ceil => each(from, to, f32::ceil),
            Self::Clip { least, most } => each(from, to, |x| {
                let x = if x < least { least } else { x };
                if x > most { most } else { x }
            }),
            Self::Elu { alpha } => each(from, to, |x| if x > 0.0 { x } else { alpha * elu(x) }),
            Self::Erf => each(from, to, libm::erff),
            Self::Exp => each(from, to, libm::expf),
            Self::Floor => each(from, to, f32::floor),
            Self::LeakyRelu { alpha } => each(from, to, |x| if x < 0.0 { alpha * x } else { x }),
            Self::Log => each(from, to, libm::logf),
            Self::Neg => each(from, to, |x| -x),
            Self::Reciprocal => each(from, to, |x| 1.0 / x),
            Self::Relu => each(from, to, |x| if x < 0.0 { 0.0 } else { x }),
            Self::Round => each(from, to, f32::round_ties_even),
            Self::Selu { alpha, gamma } => each(from, to, |x| gamma * if x > 0.0 { x } else { alpha * elu(x) }),
            Self::Sigmoid => each(from, to, sigmoid),
            Self::Softplus => each(from, to, |x| x.max(0.0) + libm::log1pf(libm::expf(-x.abs()))),
            Self::Sqrt => each(from, to, f32::sqrt),
            Self::Tanh => each(from, to, libm::tanhf),
        }
    }
}

impl Zip {
    fn run(self, left: &[f32], right: &[f32], to: &mut [f32]) {
        match self {
            Self::Add => pairs(left, right, to, |x, y| x + y),
            Self::Div => pairs(left, right, to, |x, y| x / y),
            // NaN is kept, so that the check of the output finds it.
            Self::Max => pairs(left, right, to, |x, y| if x > y || x.is_nan() { x } else { y }),
            Self::Min => pairs(left, right, to, |x, y| if x < y || x.is_nan() { x } else { y }),
            Self::Mul => pairs(left, right, to, |x, y| x * y),
            Self::Pow => pairs(left, right, to, libm::powf),
            Self::PRelu => pairs(left, right, to, |x, slope| if x < 0.0 { slope * x } else { x }),
            Self::Sub => pairs(left, right, to, |x, y| x - y),
        }
    }
}

impl Reduction {
    fn of(self, row: &[f32]) -> f32 {
        let numbers = row.iter().copied();
        match self {
            Self::L2 => numbers.map(|x| f64::from(x) * f64::from(x)).sum::<f64>().sqrt() as f32,
            Self::Max => numbers.fold(f32::NEG_INFINITY, |most, x| if x > most || x.is_nan() { x } else { most }),
            Self::Mean => (numbers.map(f64::from).sum::<f64>() / row.len() as f64) as f32,
            Self::Min => numbers.fold(f32::INFINITY, |least, x| if x < least || x.is_nan() { x } else { least }),
            Self::Sum => numbers.map(f64::from).sum::<f64>() as f32,
        }
    }
}

fn standardize(row: &[f32], epsilon: f32, to: &mut [f32]) {
    let count = row.len() as f64;
    let mean = row.iter().copied().map(f64::from).sum::<f64>() / count;
    let variance = row.iter().map(|x| (f64::from(*x) - mean) * (f64::from(*x) - mean)).sum::<f64>() / count;
    let scale = 1.0 / (variance + f64::from(epsilon)).sqrt();
    each(row, to, |x| ((f64::from(x) - mean) * scale) as f32);
}

#[inline(always)]
fn each(from: &[f32], to: &mut [f32], of: impl Fn(f32) -> f32) {
    from.iter().zip(to).for_each(|(x, place)| *place = of(*x));
}

#[inline(always)]
fn pairs(left: &[f32], right: &[f32], to: &mut [f32], of: impl Fn(f32, f32) -> f32) {
    left.iter().zip(right).zip(to).for_each(|((x, y), place)| *place = of(*x, *y));
}
