//! Winograd's transforms in one dimension (Lavin and Gray, "Fast Algorithms for Convolutional Neural Networks", 2015,
//! section 4). Applied to columns and then to rows they give those of a tile.

use fearless_simd::{Simd, f32x8};

/// Makes `OUT = IN - 2` pixels from `IN` pixels and a window of 3, with `IN` products.
pub(crate) trait Tile<const IN: usize, const OUT: usize> {
    /// Transform of a window: `G g`.
    fn weights(g: [f64; 3]) -> [f64; IN];
    /// Transform of the pixels: `B' d`.
    fn input<S: Simd>(d: [f32x8<S>; IN]) -> [f32x8<S>; IN];
    /// Pixels from the products: `A' m`.
    fn output<S: Simd>(m: [f32x8<S>; IN]) -> [f32x8<S>; OUT];
}

/// F(2, 3), with the points 0, 1 and -1: 16 products instead of 36 for 2 x 2 pixels.
#[derive(Debug, Clone, Copy)]
pub(crate) struct F2;

impl Tile<4, 2> for F2 {
    fn weights([a, b, c]: [f64; 3]) -> [f64; 4] {
        [a, (a + b + c) / 2.0, (a - b + c) / 2.0, c]
    }

    #[inline(always)]
    fn input<S: Simd>([a, b, c, d]: [f32x8<S>; 4]) -> [f32x8<S>; 4] {
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
    fn weights([a, b, c]: [f64; 3]) -> [f64; 6] {
        let (at_1, at_2) = (a + c, a + 4.0 * c);
        [a / 4.0, -(at_1 + b) / 6.0, -(at_1 - b) / 6.0, (at_2 + 2.0 * b) / 24.0, (at_2 - 2.0 * b) / 24.0, c]
    }

    #[inline(always)]
    fn input<S: Simd>([a, b, c, d, e, f]: [f32x8<S>; 6]) -> [f32x8<S>; 6] {
        let (even_1, odd_1) = (e - c * 4.0, d - b * 4.0);
        let (even_2, odd_2) = (e - c, (d - b) * 2.0);
        [a * 4.0 - c * 5.0 + e, even_1 + odd_1, even_1 - odd_1, even_2 + odd_2, even_2 - odd_2, b * 4.0 - d * 5.0 + f]
    }

    #[inline(always)]
    fn output<S: Simd>([a, b, c, d, e, f]: [f32x8<S>; 6]) -> [f32x8<S>; 4] {
        let (even_1, odd_1, even_2, odd_2) = (b + c, b - c, d + e, d - e);
        [a + even_1 + even_2, odd_1 + odd_2 * 2.0, even_1 + even_2 * 4.0, odd_1 + odd_2 * 8.0 + f]
    }
}
