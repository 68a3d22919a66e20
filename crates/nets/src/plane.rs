//! Images between the layers.

/// The largest tile that is written at once, in pixels.
const TILE: usize = 4;

/// An image of `channels` numbers per pixel, channels innermost, with a border of zeros: the padding of the convolution
/// that reads it. Writers leave the border unchanged.
#[derive(Debug, Clone)]
pub struct Plane {
    pub data: Vec<f32>,
    pub height: usize,
    pub width: usize,
    pub channels: usize,
    /// Pixels of border on each side. Below and to the right, more pixels complete the last tile of 4 x 4.
    pub border: usize,
}

impl Plane {
    pub fn new(height: usize, width: usize, channels: usize, border: usize) -> Self {
        let mut plane = Self { data: Vec::new(), height, width, channels, border };
        plane.data = vec![0.0; (height.next_multiple_of(TILE) + 2 * border) * plane.pitch()];
        plane
    }

    /// Numbers from one row to the next.
    pub fn pitch(&self) -> usize {
        (self.width.next_multiple_of(TILE) + 2 * self.border) * self.channels
    }

    /// Index of a pixel's first number.
    pub fn at(&self, y: usize, x: usize) -> usize {
        (y + self.border) * self.pitch() + (x + self.border) * self.channels
    }

    /// Index of the first number of a pixel of the bordered image.
    pub fn at_bordered(&self, y: usize, x: usize) -> usize {
        y * self.pitch() + x * self.channels
    }
}
