//! Resizes pictures to the size that a model expects.

use crate::{BridgeError, Tensor};

/// The rule for fitting a picture to another size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Resize {
    /// Refuses pictures of another size.
    Exact,
    /// Scales width and height independently.
    Stretch,
    /// Keeps the whole picture and adds black bars, as openpi's `resize_with_pad`.
    Pad,
    /// Keeps the middle of the picture and adds no bars.
    Crop,
}

impl Resize {
    pub fn by_name(name: &str) -> Option<Self> {
        Some(match name {
            "exact" => Self::Exact,
            "stretch" => Self::Stretch,
            "pad" => Self::Pad,
            "crop" => Self::Crop,
            _ => return None,
        })
    }
}

/// An RGB picture: rows from the top, three bytes for each pixel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    width: usize,
    height: usize,
    rgb: Vec<u8>,
}

impl Picture {
    /// Makes a picture of `3 * width * height` bytes.
    pub fn new(width: u32, height: u32, rgb: Vec<u8>) -> Result<Self, BridgeError> {
        let sides = (usize::try_from(width).unwrap_or(0), usize::try_from(height).unwrap_or(0));
        let bytes = sides.0.checked_mul(sides.1).and_then(|pixels| pixels.checked_mul(3));
        if bytes != Some(rgb.len()) || rgb.is_empty() {
            let what = format!("a picture of {width}x{height} pixels (it has {} bytes)", rgb.len());
            return Err(BridgeError::Sensed { what, remedy: "ask for the camera again" });
        }
        Ok(Self { width: sides.0, height: sides.1, rgb })
    }

    /// Makes a black picture, for a camera that our robot does not have.
    pub fn black([width, height]: [u32; 2]) -> Self {
        let (width, height) = (width as usize, height as usize);
        Self { width, height, rgb: vec![0; 3 * width * height] }
    }

    /// Red, green and blue of each pixel, rows from the top.
    pub fn rgb(&self) -> &[u8] {
        &self.rgb
    }

    pub fn fitted(&self, [width, height]: [u32; 2], rule: Resize) -> Result<Self, BridgeError> {
        let (width, height) = (width as usize, height as usize);
        if (width, height) == (self.width, self.height) {
            return Ok(self.clone());
        }
        match rule {
            Resize::Exact => {
                let what = format!("pictures of {width}x{height} pixels instead of {}x{}", self.width, self.height);
                Err(BridgeError::Sensed { what, remedy: "leave --image out, or name a resize rule in the mapping" })
            }
            Resize::Stretch => Ok(self.scaled(width, height)),
            Resize::Pad => {
                let ratio = (self.width as f64 / width as f64).max(self.height as f64 / height as f64);
                let side = |side: usize, most: usize| ((side as f64 / ratio) as usize).clamp(1, most);
                let inner = self.scaled(side(self.width, width), side(self.height, height));
                let (left, top) = ((width - inner.width) / 2, (height - inner.height) / 2);
                let mut outer = Self { width, height, rgb: vec![0; 3 * width * height] };
                for (row, line) in inner.rgb.chunks_exact(3 * inner.width).enumerate() {
                    let at = 3 * ((top + row) * width + left);
                    outer.rgb[at..at + line.len()].copy_from_slice(line);
                }
                Ok(outer)
            }
            Resize::Crop => {
                let ratio = (self.width as f64 / width as f64).min(self.height as f64 / height as f64);
                let side = |side: usize, most: usize| ((side as f64 * ratio).round() as usize).clamp(1, most);
                let (inner_width, inner_height) = (side(width, self.width), side(height, self.height));
                let (left, top) = ((self.width - inner_width) / 2, (self.height - inner_height) / 2);
                let lines = self.rgb.chunks_exact(3 * self.width).skip(top).take(inner_height);
                let rgb = lines.flat_map(|line| &line[3 * left..3 * (left + inner_width)]).copied().collect();
                Ok(Self { width: inner_width, height: inner_height, rgb }.scaled(width, height))
            }
        }
    }

    /// Scales by a triangle filter that widens with the factor when the picture shrinks, as Pillow's BILINEAR.
    fn scaled(&self, width: usize, height: usize) -> Self {
        let (columns, rows) = (weights(self.width, width), weights(self.height, height));
        let mut across = vec![0.0_f32; 3 * width * self.height];
        for (line, out) in self.rgb.chunks_exact(3 * self.width).zip(across.chunks_exact_mut(3 * width)) {
            for ((first, weights), pixel) in columns.iter().zip(out.chunks_exact_mut(3)) {
                for (weight, from) in weights.iter().zip(line[3 * first..].chunks_exact(3)) {
                    pixel.iter_mut().zip(from).for_each(|(to, from)| *to += weight * f32::from(*from));
                }
            }
        }
        let mut rgb = Vec::with_capacity(3 * width * height);
        for (first, weights) in &rows {
            for at in 0..3 * width {
                let lines = weights.iter().enumerate();
                let sum: f32 = lines.map(|(line, weight)| weight * across[(first + line) * 3 * width + at]).sum();
                rgb.push(sum.round().clamp(0.0, 255.0) as u8);
            }
        }
        Self { width, height, rgb }
    }
}

/// For each pixel of the result, the first source pixel and the weights from there on.
fn weights(from: usize, to: usize) -> Vec<(usize, Vec<f32>)> {
    let factor = from as f64 / to as f64;
    let reach = factor.max(1.0);
    let weigh = |at: usize| {
        let middle = (at as f64 + 0.5) * factor;
        let first = (middle - reach + 0.5).max(0.0) as usize;
        let end = ((middle + reach + 0.5) as usize).min(from).max(first + 1);
        let weight = |pixel: usize| (1.0 - ((pixel as f64 + 0.5 - middle) / reach).abs()).max(0.0);
        let sum: f64 = (first..end).map(weight).sum();
        (first, (first..end).map(|pixel| (weight(pixel) / sum) as f32).collect())
    };
    (0..to).map(weigh).collect()
}

/// Stacks the frames of a camera into one tensor of shape (frames, height, width, 3).
pub(crate) fn stacked(frames: &[Picture]) -> Result<Tensor, BridgeError> {
    let Some(first) = frames.first() else { return Tensor::u8(vec![0, 0, 0, 3], Vec::new()) };
    let data = frames.iter().flat_map(|frame| &frame.rgb).copied().collect();
    Tensor::u8(vec![frames.len(), first.height, first.width, 3], data)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn a_grey_picture_stays_grey_and_bars_are_black() {
        let grey = Picture::new(64, 48, vec![100; 3 * 64 * 48]).unwrap();
        let stretched = grey.fitted([32, 32], Resize::Stretch).unwrap();
        assert!(stretched.rgb().iter().all(|byte| *byte == 100));
        let padded = grey.fitted([32, 32], Resize::Pad).unwrap();
        // 32 x 24 in the middle: four lines of bars above and below.
        let bright = padded.rgb().chunks_exact(3 * 32).map(|line| line[0]).collect::<Vec<_>>();
        assert_eq!(bright.iter().filter(|byte| **byte == 0).count(), 8);
        assert_eq!((bright[3], bright[4], bright[27], bright[28]), (0, 100, 100, 0));
        let error = grey.fitted([32, 32], Resize::Exact).unwrap_err().to_string();
        assert!(error.contains("32x32 pixels instead of 64x48"), "{error}");
    }

    /// The result that Pillow 13 gives for a ramp (`Image.resize((4, 1), BILINEAR)`).
    #[test]
    fn shrinking_is_that_of_pillow() {
        let rgb = (0..8).flat_map(|x| [x * 30; 3]).collect();
        let ramp = Picture::new(8, 1, rgb).unwrap().fitted([4, 1], Resize::Stretch).unwrap();
        let reds: Vec<u8> = ramp.rgb().chunks_exact(3).map(|pixel| pixel[0]).collect();
        assert_eq!(reds, [21, 75, 135, 189]);
        let cropped = Picture::new(8, 2, vec![9; 48]).unwrap().fitted([2, 2], Resize::Crop).unwrap();
        assert_eq!(cropped.rgb(), [9; 12]);
    }
}
