//! Winograd's transforms in one dimension (Lavin and Gray, "Fast Algorithms for Convolutional Neural Networks", 2015,
//! section 4). Applied to columns and then to rows they give those of a tile.

use std::ops::{Add, Sub};

use fearless_simd::{Simd, f32x8, i16x16};

/// A vector that tiles of pixels are made of: in f32, or in whole numbers.
pub(crate) trait Lanes: Copy + Add<Output = Self> + Sub<Output = Self> {
    fn times(self, factor: i16) -> Self;
}

impl<S: Simd> Lanes for f32x8<S> {
    #[inline(always)]
    fn times(self, factor: i16) -> Self {
        self * f32::from(factor)
    }
}

impl<S: Simd> Lanes for i16x16<S> {
    #[inline(always)]
    fn times(self, factor: i16) -> Self {
        self * factor
    }
}

/// Makes `OUT = IN - 2` pixels from `IN` pixels and a window of 3, with `IN` products.
pub(crate) trait Tile<const IN: usize, const OUT: usize> {
    /// Largest number that [`Tile::input`] makes, in both dimensions, of pixels from -1 to 1.
    const GROWTH: i32;
    /// Transform of a window: `G g`.
    fn weights(g: [f64; 3]) -> [f64; IN];
    /// Transform of the pixels: `B' d`.
    fn input<V: Lanes>(d: [V; IN]) -> [V; IN];
    /// Pixels from the products: `A' m`.
    fn output<S: Simd>(m: [f32x8<S>; IN]) -> [f32x8<S>; OUT];
}

/// F(2, 3), with the points 0, 1 and -1: 16 products instead of 36 for 2 x 2 pixels.
#[derive(Debug, Clone, Copy)]
pub(crate) struct F2;

impl Tile<4, 2> for F2 {
    const GROWTH: i32 = 4;

    fn weights([a, b, c]: [f64; 3]) -> [f64; 4] {
        [a, (a + b + c) / 2.0, (a - b + c) / 2.0, c]
    }

    #[inline(always)]
    fn input<V: Lanes>([a, b, c, d]: [V; 4]) -> [V; 4] {
        [a - c, b + c, c - b, b - d]
    }

    #[inline(always)]
    fn output<S: Simd>([a, b, c, d]: [f32x8<S>; 4]) -> [f32x8<S>; 2] {
        [a + b + c, b - c - d]
    }
}

/// F(4, 3), with the points 0, 1, -1, 2 and -2: 36 products instead of 144 for 4 x 4 pixels. It rounds less well.
#[derive(Debug, Clone, Copy)]
pub(crate) struct F4;

impl Tile<6, 4> for F4 {
    const GROWTH: i32 = 100;

    fn weights([a, b, c]: [f64; 3]) -> [f64; 6] {
        let (at_1, at_2) = (a + c, a + 4.0 * c);
        [a / 4.0, -(at_1 + b) / 6.0, -(at_1 - b) / 6.0, (at_2 + 2.0 * b) / 24.0, (at_2 - 2.0 * b) / 24.0, c]
    }

    #[inline(always)]
    fn input<V: Lanes>([a, b, c, d, e, f]: [V; 6]) -> [V; 6] {
        let (even_1, odd_1) = (e - c.times(4), d - b.times(4));
        let (even_2, odd_2) = (e - c, (d - b).times(2));
        let (first, last) = (a.times(4) - c.times(5) + e, b.times(4) - d.times(5) + f);
        [first, even_1 + odd_1, even_1 - odd_1, even_2 + odd_2, even_2 - odd_2, last]
    }

    #[inline(always)]
    fn output<S: Simd>([a, b, c, d, e, f]: [f32x8<S>; 6]) -> [f32x8<S>; 4] {
        let (even_1, odd_1, even_2, odd_2) = (b + c, b - c, d + e, d - e);
        [a + even_1 + even_2, odd_1 + odd_2 * 2.0, even_1 + even_2 * 4.0, odd_1 + odd_2 * 8.0 + f]
    }
}
