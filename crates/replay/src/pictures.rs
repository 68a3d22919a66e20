//! The head camera's pictures, if the session recorded them.

use fiatlux_bag::Bag;
use fiatlux_proto::foxglove::CompressedImage;
use fiatlux_rules::CONTROL_DT;

use crate::text::short;

/// Maximum size of all pictures, bytes; beyond it every second one is dropped, and so on.
const MAX_BYTES: usize = 24 << 20;

/// The format that recorders write, which a page shows.
const FORMAT: &str = "png";

/// The pictures of a bag up to the first that cannot be read, by rising control steps.
pub(crate) fn pictures(bag: &Bag, notes: &mut Vec<String>) -> Vec<(u32, Vec<u8>)> {
    let mut found: Vec<(u32, Vec<u8>)> = Vec::new();
    if !bag.header().sensors.iter().any(|sensor| sensor.recorded && sensor.name == "camera") {
        return found;
    }
    if bag.is_thin() {
        notes.push("The camera's pictures of a thin bag are left out; scorer fill draws them again.".into());
        return found;
    }
    let (mut size, mut stride) = (0, 1);
    for (index, image) in bag.images().enumerate() {
        let image = match image {
            Ok(image) => image,
            Err(error) => {
                notes.push(format!("Pictures cannot be read to the end: {}.", short(&error.to_string())));
                break;
            }
        };
        let rises = |step: &u32| found.last().is_none_or(|(last, _)| last < step);
        let Some(step) = step_of(&image).filter(rises) else { continue };
        if index % stride != 0 || image.format != FORMAT {
            continue;
        }
        size += image.data.len();
        found.push((step, image.data));
        while size > MAX_BYTES && found.len() > 1 {
            stride *= 2;
            let mut is_kept = false;
            found.retain(|_| {
                is_kept = !is_kept;
                is_kept
            });
            size = found.iter().map(|(_, data)| data.len()).sum();
        }
    }
    found
}

/// The control step of a picture; `None` if its time is not one of an episode.
fn step_of(image: &CompressedImage) -> Option<u32> {
    let time = image.timestamp.as_ref()?;
    let step = ((time.seconds as f64 + f64::from(time.nanos) * 1e-9) / CONTROL_DT).round();
    (0.0..=f64::from(u32::MAX)).contains(&step).then_some(step as u32)
}

/// The pictures as the page reads them, little-endian: for each its step and its length (u32), then its bytes.
pub(crate) fn bytes_of(pictures: &[(u32, Vec<u8>)]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for (step, data) in pictures {
        bytes.extend(step.to_le_bytes());
        bytes.extend((data.len() as u32).to_le_bytes());
        bytes.extend(data);
    }
    bytes
}
