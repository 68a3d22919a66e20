//! From light to bytes.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, u32x8};

use crate::paint::encode;
use crate::single::Vec3;

/// Exposure before the tone curve.
const EXPOSURE: f32 = 0.92;

/// From linear light to 8-bit sRGB by way of a curve with a soft toe and shoulder.
#[derive(Debug, Clone)]
pub(crate) struct Tone {
    /// The curve, by the upper bits of the number: finer where it is darker, as the eye is.
    curve: Vec<f32>,
    /// sRGB of the curve's value.
    bytes: Vec<u8>,
    /// sRGB, by the square root of a mean of the curve's values.
    of_mean: Vec<u8>,
}

impl Tone {
    /// Steps within each doubling of light, as bits.
    const FINE: u32 = 9;
    /// Least and largest light that differ from what is beyond them, as exponents of their numbers.
    const RANGE: [u32; 2] = [127 - 12, 127 + 5];

    const FIRST: u32 = Self::RANGE[0] << Self::FINE;

    pub(crate) fn new() -> Self {
        let steps = (Self::RANGE[1] - Self::RANGE[0]) << Self::FINE;
        let curve: Vec<f32> = (0..steps)
            .map(|k| {
                let x = f32::from_bits((Self::FIRST + k) << (23 - Self::FINE)) * EXPOSURE;
                (x * (1.9 * x + 0.18) / (x * (1.75 * x + 0.85) + 0.16)).min(1.0)
            })
            .collect();
        let bytes = curve.iter().map(|c| encode(f64::from(*c))).collect();
        let of_mean = (0..4096).map(|k| encode((f64::from(k) / 4095.0) * (f64::from(k) / 4095.0))).collect();
        Self { curve, bytes, of_mean }
    }

    #[inline]
    fn index(&self, light: f32) -> usize {
        // Negative numbers and NaN count as dark.
        let bits = light.max(0.0).to_bits() >> (23 - Self::FINE);
        (bits.saturating_sub(Self::FIRST) as usize).min(self.curve.len() - 1)
    }

    /// Places in the curve of eight numbers of at least 0, given by their bits.
    #[inline(always)]
    pub(crate) fn indices<S: Simd>(&self, simd: S, light: u32x8<S>) -> u32x8<S> {
        let first = u32x8::splat(simd, Self::FIRST);
        let last = u32x8::splat(simd, self.curve.len() as u32 - 1);
        ((light >> (23 - Self::FINE)).max(first) - first).min(last)
    }

    /// sRGB at a place of the curve.
    #[inline(always)]
    pub(crate) fn byte_at(&self, index: u32) -> u8 {
        self.bytes[index as usize]
    }

    /// The curve's values, in [0, 1].
    pub(crate) fn curve(&self, light: Vec3) -> Vec3 {
        light.map(|c| self.curve[self.index(c)])
    }

    /// sRGB of the curve's value.
    #[inline]
    pub(crate) fn byte(&self, light: f32) -> u8 {
        self.bytes[self.index(light)]
    }

    /// sRGB of a mean of the curve's values.
    pub(crate) fn byte_of_mean(&self, mean: f32) -> u8 {
        self.of_mean[((mean.max(0.0).sqrt() * 4095.0) as usize).min(4095)]
    }
}
