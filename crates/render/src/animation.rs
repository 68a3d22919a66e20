//! Moving pictures: an animated PNG, which browsers show without a player.

use crate::{Image, RenderError};

/// Pictures of one size as the bytes of an animated PNG that repeats for ever, each shown for `frame_ms`. After the first
/// one, only the rectangle that changes is stored: a camera that stands still makes small files.
///
/// # Errors
/// [`RenderError::Png`] without pictures, or with one that has no pixels or another size than the first.
pub fn animation(frames: &[Image], frame_ms: u16) -> Result<Vec<u8>, RenderError> {
    let (width, height) = frames.first().map_or((0, 0), |first| (first.width, first.height));
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::High);
    encoder.set_animated(frames.len() as u32, 0)?;
    encoder.set_frame_delay(frame_ms, 1000)?;
    let mut writer = encoder.write_header()?;
    for (index, frame) in frames.iter().enumerate() {
        let Some(before) = index.checked_sub(1).map(|before| &frames[before]) else {
            writer.write_image_data(&frame.rgb)?;
            continue;
        };
        let [left, top, right, bottom] = changed(before, frame);
        writer.set_frame_position(0, 0)?;
        writer.set_frame_dimension((right - left) as u32, (bottom - top) as u32)?;
        writer.set_frame_position(left as u32, top as u32)?;
        let row = |y: usize| frame.rgb.get(3 * (y * width + left)..3 * (y * width + right)).unwrap_or_default();
        let part: Vec<u8> = (top..bottom).flat_map(row).copied().collect();
        writer.write_image_data(&part)?;
    }
    writer.finish()?;
    Ok(bytes)
}

/// The smallest rectangle outside of which two pictures are equal, at least a pixel large: left, top, right, bottom.
fn changed(a: &Image, b: &Image) -> [usize; 4] {
    let rows = a.rgb.chunks_exact(3 * b.width).zip(b.rgb.chunks_exact(3 * b.width));
    let mut found = [b.width, b.height, 0, 0];
    for (y, (row_a, row_b)) in rows.enumerate() {
        let differs = |(a, b): (&[u8], &[u8])| a != b;
        let mut pixels = row_a.chunks_exact(3).zip(row_b.chunks_exact(3));
        let Some(first) = pixels.position(differs) else { continue };
        let last = pixels.rposition(differs).map_or(first, |last| first + 1 + last);
        found = [found[0].min(first), found[1].min(y), found[2].max(last + 1), y + 1];
    }
    if found[2] == 0 { [0, 0, 1, 1] } else { found }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn picture(pixels: &[(usize, usize)]) -> Image {
        let mut image = Image::black(8, 6);
        for (x, y) in pixels {
            image.rgb[3 * (y * 8 + x)] = 200;
        }
        image
    }

    #[test]
    fn only_what_changes_is_stored() {
        assert_eq!(changed(&picture(&[]), &picture(&[(2, 1), (5, 4), (3, 4)])), [2, 1, 6, 5]);
        assert_eq!(changed(&picture(&[(7, 5)]), &picture(&[])), [7, 5, 8, 6]);
        assert_eq!(changed(&picture(&[]), &picture(&[])), [0, 0, 1, 1]);
    }

    #[test]
    fn a_reader_finds_the_same_pictures() {
        let frames = [picture(&[(1, 1)]), picture(&[(2, 1)]), picture(&[(2, 1)]), picture(&[(7, 5), (2, 1)])];
        let bytes = animation(&frames, 100).unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(&bytes)).read_info().unwrap();
        assert_eq!(reader.info().animation_control().unwrap().num_frames, 4);
        let mut shown = Image::black(8, 6);
        for frame in &frames {
            let mut part = vec![0; 3 * 8 * 6];
            let info = reader.next_frame(&mut part).unwrap();
            let place = *reader.info().frame_control().unwrap();
            part.truncate(info.buffer_size());
            let part = Image { width: info.width as usize, height: info.height as usize, rgb: part };
            shown.paste(&part, place.x_offset as usize, place.y_offset as usize);
            assert_eq!(&shown, frame);
        }
        assert!(animation(&[], 100).is_err());
    }
}
