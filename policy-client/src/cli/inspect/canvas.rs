//! A picture to draw on, with letters of 3 x 5 dots.

/// Dots of a letter, columns and rows.
const LETTER: [usize; 2] = [3, 5];

/// Red, green, blue.
pub type Color = [u8; 3];

/// A picture: 8-bit sRGB.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Canvas {
    pub width: usize,
    pub height: usize,
    /// Row by row from the top, three bytes a pixel.
    pub rgb: Vec<u8>,
}

impl Canvas {
    /// All of one colour.
    pub fn new(width: usize, height: usize, color: Color) -> Self {
        Self { width, height, rgb: color.repeat(width * height) }
    }

    /// Colours a pixel; what is outside is passed over.
    pub fn set(&mut self, x: i64, y: i64, color: Color) {
        let inside = |at: i64, size: usize| usize::try_from(at).ok().filter(|at| *at < size);
        if let (Some(x), Some(y)) = (inside(x, self.width), inside(y, self.height)) {
            let at = 3 * (y * self.width + x);
            self.rgb[at..at + 3].copy_from_slice(&color);
        }
    }

    /// Colours a rectangle.
    pub fn fill(&mut self, x: i64, y: i64, width: i64, height: i64, color: Color) {
        for row in y..y + height {
            for column in x..x + width {
                self.set(column, row, color);
            }
        }
    }

    /// A line of that thickness.
    pub fn line(&mut self, from: [f64; 2], to: [f64; 2], thick: i64, color: Color) {
        let length = (to[0] - from[0]).hypot(to[1] - from[1]).ceil().clamp(1.0, 1e4);
        for step in 0..=length as i64 {
            let share = step as f64 / length;
            let [x, y] = [0, 1].map(|axis| (from[axis] + share * (to[axis] - from[axis])).round() as i64);
            self.fill(x - thick / 2, y - thick / 2, thick, thick, color);
        }
    }

    /// Letters twice their size, from their top left corner on.
    pub fn write(&mut self, x: i64, y: i64, text: &str, color: Color) {
        const SIZE: i64 = 2;
        let [columns, rows] = LETTER.map(|dots| dots as i64);
        for (index, letter) in text.chars().enumerate() {
            let dots = dots(letter.to_ascii_uppercase());
            let left = x + index as i64 * SIZE * (columns + 1);
            for row in 0..rows {
                for column in 0..columns {
                    if dots >> (3 * (rows - 1 - row) + columns - 1 - column) & 1 == 1 {
                        self.fill(left + SIZE * column, y + SIZE * row, SIZE, SIZE, color);
                    }
                }
            }
        }
    }

    /// Letters with their middle at `x`.
    pub fn write_at(&mut self, x: i64, y: i64, text: &str, color: Color) {
        self.write(x - 4 * text.chars().count() as i64 + 1, y, text, color);
    }

    /// Each pixel as a square of so many.
    pub fn enlarged(&self, times: usize) -> Self {
        let mut rgb = Vec::with_capacity(self.rgb.len() * times * times);
        for row in self.rgb.chunks_exact((3 * self.width).max(1)) {
            let wide: Vec<u8> = row.as_chunks::<3>().0.iter().flat_map(|pixel| pixel.repeat(times)).collect();
            (0..times).for_each(|_| rgb.extend_from_slice(&wide));
        }
        Self { width: times * self.width, height: times * self.height, rgb }
    }

    /// The bytes of a PNG file.
    ///
    /// # Errors
    /// A picture without pixels.
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

/// Five rows of three dots, an octal digit a row.
fn dots(letter: char) -> u32 {
    match letter {
        '0' => 0o75557,
        '1' => 0o26227,
        '2' => 0o71747,
        '3' => 0o71717,
        '4' => 0o55711,
        '5' => 0o74717,
        '6' => 0o74757,
        '7' => 0o71122,
        '8' => 0o75757,
        '9' => 0o75717,
        'A' => 0o25755,
        'B' => 0o65656,
        'C' => 0o34443,
        'D' => 0o65556,
        'E' => 0o74647,
        'F' => 0o74644,
        'G' => 0o34553,
        'H' => 0o55755,
        'I' => 0o72227,
        'K' => 0o55655,
        'L' => 0o44447,
        'M' => 0o57755,
        'N' => 0o65555,
        'O' => 0o25552,
        'P' => 0o65644,
        'R' => 0o65655,
        'S' => 0o34216,
        'T' => 0o72222,
        'U' => 0o55557,
        'V' => 0o55552,
        'W' => 0o55775,
        'X' => 0o55255,
        'Y' => 0o55222,
        '.' => 0o00002,
        ',' => 0o00024,
        '-' => 0o00700,
        '+' => 0o02720,
        _ => 0,
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn pixels_become_squares_and_come_back_from_the_file() {
        let mut canvas = Canvas::new(2, 1, [1, 2, 3]);
        canvas.set(1, 0, [7, 8, 9]);
        // Outside.
        canvas.fill(2, 0, 5, 5, [0; 3]);
        canvas.set(-1, 0, [0; 3]);
        let large = canvas.enlarged(2);
        let row = [1, 2, 3, 1, 2, 3, 7, 8, 9, 7, 8, 9];
        assert_eq!((large.width, large.height, large.rgb.clone()), (4, 2, [row, row].concat()));
        let mut reader = png::Decoder::new(std::io::Cursor::new(large.to_png().unwrap())).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        assert_eq!(pixels, large.rgb);
        assert!(Canvas::new(0, 0, [0; 3]).to_png().is_err());
    }

    #[test]
    fn letters_stand_upright() {
        let mut canvas = Canvas::new(6, 10, [0; 3]);
        canvas.write(0, 0, "l", [1; 3]);
        let rows: Vec<usize> =
            canvas.rgb.chunks(18).map(|row| row.iter().filter(|byte| **byte == 1).count() / 3).collect();
        assert_eq!(rows, [2, 2, 2, 2, 2, 2, 2, 2, 6, 6]);
    }
}
