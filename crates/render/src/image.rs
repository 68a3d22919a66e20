use crate::RenderError;

/// A picture: 8-bit sRGB, row by row from the top left.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) rgb: Vec<u8>,
}

impl Image {
    pub(crate) fn new(width: usize, height: usize) -> Self {
        Self { width, height, rgb: vec![0; 3 * width * height] }
    }

    /// A picture from its bytes; `None` where they are not `3 * width * height`, or none.
    pub fn of_rgb(width: usize, height: usize, rgb: Vec<u8>) -> Option<Self> {
        let bytes = width.checked_mul(height)?.checked_mul(3)?;
        (bytes > 0 && rgb.len() == bytes).then_some(Self { width, height, rgb })
    }

    /// A black picture of that size in pixels, for others to be put on.
    pub fn black(width: usize, height: usize) -> Self {
        Self::new(width, height)
    }

    /// Puts another picture on this one, its upper left corner at a pixel. What reaches beyond the edge is left out.
    pub fn paste(&mut self, other: &Image, left: usize, top: usize) {
        let bytes = 3 * other.width.min(self.width.saturating_sub(left));
        let rows = if bytes == 0 { 0 } else { other.height.min(self.height.saturating_sub(top)) };
        for y in 0..rows {
            let (to, from) = (3 * ((top + y) * self.width + left), 3 * y * other.width);
            self.rgb[to..to + bytes].copy_from_slice(&other.rgb[from..from + bytes]);
        }
    }

    /// The picture at a `factor`-th of its size: each pixel is the mean of `factor` by `factor`. What is left over at the
    /// right and lower edges is left out.
    pub fn reduced(&self, factor: usize) -> Image {
        let n = factor.max(1);
        let mut reduced = Image::new(self.width / n, self.height / n);
        let mut sums = vec![0_u32; 3 * reduced.width];
        let count = (n * n) as u32;
        for y in 0..reduced.height {
            sums.fill(0);
            for row in self.rgb.chunks_exact(3 * self.width).skip(y * n).take(n) {
                for (sum, pixels) in sums.chunks_exact_mut(3).zip(row.chunks_exact(3 * n)) {
                    for pixel in pixels.chunks_exact(3) {
                        sum.iter_mut().zip(pixel).for_each(|(sum, byte)| *sum += u32::from(*byte));
                    }
                }
            }
            let row = &mut reduced.rgb[3 * y * reduced.width..3 * (y + 1) * reduced.width];
            row.iter_mut().zip(&sums).for_each(|(byte, sum)| *byte = ((sum + count / 2) / count) as u8);
        }
        reduced
    }

    /// Pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows of pixels, from the top.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Red, green, blue of all pixels: `3 * width * height` bytes.
    pub fn rgb(&self) -> &[u8] {
        &self.rgb
    }

    /// Red, green, blue of a pixel.
    ///
    /// # Panics
    /// If the pixel is outside the picture.
    pub fn pixel(&self, x: usize, y: usize) -> [u8; 3] {
        assert!(x < self.width && y < self.height, "pixel ({x}, {y}) of {} x {}", self.width, self.height);
        let at = 3 * (y * self.width + x);
        [self.rgb[at], self.rgb[at + 1], self.rgb[at + 2]]
    }

    /// The picture as the bytes of a PNG file.
    ///
    /// # Errors
    /// [`RenderError::Png`] for a picture without pixels.
    pub fn to_png(&self) -> Result<Vec<u8>, RenderError> {
        self.encode(png::Compression::High)
    }

    /// Like [`Image::to_png`], in a twentieth of the time and half as large again: for records of many pictures.
    ///
    /// # Errors
    /// [`RenderError::Png`] for a picture without pixels.
    pub fn to_png_fast(&self) -> Result<Vec<u8>, RenderError> {
        self.encode(png::Compression::Fast)
    }

    fn encode(&self, compression: png::Compression) -> Result<Vec<u8>, RenderError> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        encoder.set_compression(compression);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.rgb)?;
        writer.finish()?;
        Ok(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_on_another() {
        let mut image = Image::black(3, 2);
        let other = Image { width: 2, height: 2, rgb: (1..=12).collect() };
        image.paste(&other, 2, 1);
        assert_eq!(image.rgb(), [[0; 3], [0; 3], [0; 3], [0; 3], [0; 3], [1, 2, 3]].concat());
        image.paste(&other, 0, 0);
        assert_eq!(image.pixel(1, 1), [10, 11, 12]);
        image.paste(&other, 7, 0);
        image.paste(&other, 0, 7);
        assert_eq!(image.pixel(2, 1), [1, 2, 3]);
    }

    #[test]
    fn a_mean_of_pixels() {
        let rgb = [[0, 0, 4], [8, 0, 4], [9, 9, 9], [0, 2, 4], [0, 3, 4], [9, 9, 9]].concat();
        let image = Image { width: 3, height: 2, rgb };
        assert_eq!(image.reduced(2), Image { width: 1, height: 1, rgb: vec![2, 1, 4] });
        assert_eq!((image.reduced(1), image.reduced(0)), (image.clone(), image));
    }
}
