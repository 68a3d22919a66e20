//! A picture in memory that `embedded-graphics` draws on.

use std::convert::Infallible;

use embedded_graphics::mono_font::iso_8859_1::FONT_7X13;
use embedded_graphics::mono_font::{MonoTextStyle, MonoTextStyleBuilder};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::primitives::{PrimitiveStyle, Rectangle};
use embedded_graphics::text::{Alignment, Baseline, Text, TextStyleBuilder};

/// An image in 8-bit sRGB.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    pub width: usize,
    pub height: usize,
    /// Three bytes for each pixel, row by row from the top.
    pub rgb: Vec<u8>,
}

/// A text with a background, anchored at the left end, the middle or the right end of its top.
pub type Label<'a> = Text<'a, MonoTextStyle<'static, Rgb888>>;

impl Picture {
    /// A picture in a single colour.
    pub fn new(width: usize, height: usize, color: Rgb888) -> Self {
        Self { width, height, rgb: [color.r(), color.g(), color.b()].repeat(width * height) }
    }

    /// Draws something; parts outside the picture are ignored.
    pub fn put<T>(&mut self, drawable: &impl Drawable<Color = Rgb888, Output = T>) -> T {
        let Ok(output) = drawable.draw(self);
        output
    }

    /// Fills a rectangle with one colour; parts outside the picture are ignored.
    pub fn fill(&mut self, left: i32, top: i32, width: u32, height: u32, color: Rgb888) {
        let area = Rectangle::new(Point::new(left, top), Size::new(width, height));
        self.put(&area.into_styled(PrimitiveStyle::with_fill(color)));
    }

    /// The picture with each pixel as a square of `times` by `times` pixels.
    pub fn enlarged(&self, times: usize) -> Self {
        let mut rgb = Vec::with_capacity(self.rgb.len() * times * times);
        for row in self.rgb.chunks_exact((3 * self.width).max(1)) {
            let wide: Vec<u8> = row.as_chunks::<3>().0.iter().flat_map(|pixel| pixel.repeat(times)).collect();
            (0..times).for_each(|_| rgb.extend_from_slice(&wide));
        }
        Self { width: times * self.width, height: times * self.height, rgb }
    }

    /// Encodes the picture as a PNG file.
    ///
    /// # Errors
    /// The picture has no pixels.
    pub fn to_png(&self) -> Result<Vec<u8>, png::EncodingError> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.rgb)?;
        writer.finish()?;
        Ok(bytes)
    }
}

/// A label that can be measured and drawn.
pub fn label(text: &str, at: Point, alignment: Alignment, color: Rgb888, ground: Rgb888) -> Label<'_> {
    let letters = MonoTextStyleBuilder::new().font(&FONT_7X13).text_color(color).background_color(ground).build();
    let style = TextStyleBuilder::new().alignment(alignment).baseline(Baseline::Top).build();
    Text::with_text_style(text, at, letters, style)
}

impl OriginDimensions for Picture {
    fn size(&self) -> Size {
        Size::new(self.width as u32, self.height as u32)
    }
}

impl DrawTarget for Picture {
    type Color = Rgb888;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(&mut self, pixels: I) -> Result<(), Infallible> {
        let area = self.bounding_box();
        for Pixel(at, color) in pixels.into_iter().filter(|pixel| area.contains(pixel.0)) {
            let start = 3 * (at.y as usize * self.width + at.x as usize);
            self.rgb[start..start + 3].copy_from_slice(&[color.r(), color.g(), color.b()]);
        }
        Ok(())
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn pixels_become_squares_and_come_back_from_the_file() {
        let mut picture = Picture::new(2, 1, Rgb888::new(1, 2, 3));
        picture.put(&Pixel(Point::new(1, 0), Rgb888::new(7, 8, 9)));
        // Pixels outside the picture.
        picture.fill(2, 0, 5, 5, Rgb888::BLACK);
        picture.put(&Pixel(Point::new(-1, 0), Rgb888::BLACK));
        let large = picture.enlarged(2);
        let row = [1, 2, 3, 1, 2, 3, 7, 8, 9, 7, 8, 9];
        assert_eq!((large.width, large.height, large.rgb.clone()), (4, 2, [row, row].concat()));
        let mut reader = png::Decoder::new(std::io::Cursor::new(large.to_png().unwrap())).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        assert_eq!(pixels, large.rgb);
        assert!(Picture::new(0, 0, Rgb888::BLACK).to_png().is_err());
    }

    /// The foot of an L is at the bottom and wider than the rest.
    #[test]
    fn letters_stand_upright() {
        let mut picture = Picture::new(7, 13, Rgb888::BLACK);
        let at = Point::zero();
        picture.put(&label("L", at, Alignment::Left, Rgb888::WHITE, Rgb888::BLACK));
        let rows = picture.rgb.chunks(21).map(|row| row.iter().filter(|byte| **byte == 255).count() / 3);
        let inked: Vec<usize> = rows.filter(|count| *count > 0).collect();
        let [stem @ .., foot] = inked.as_slice() else { panic!("no ink") };
        assert!(stem.len() > 5 && stem.iter().all(|width| *width == 1) && *foot > 3, "{inked:?}");
    }
}
