//! Pictures of the robot's cameras, where the session recorded them.

use fiatlux_bag::{Bag, BagError};
use fiatlux_proto::foxglove::CompressedImage;
use fiatlux_proto::v3::{DepthImage, Image as Rgb, LabelImage, Observation};
use fiatlux_render::Image;
use fiatlux_rules::CONTROL_DT;
use serde::Serialize;

use crate::text::short;

/// Maximum size of all pictures, bytes; beyond it every second one of each sensor is dropped, and so on.
const MAX_BYTES: usize = 24 << 20;

/// The format that recorders write, which a page shows.
const FORMAT: &str = "png";

/// Distances that are drawn white and black, m.
const NEAR: f32 = 0.15;
const FAR: f32 = 6.0;

/// The sensor whose pictures have a topic of their own.
const HEAD: &str = "camera";

/// Draws what a sensor recorded in an observation; `None` where that is nothing, or nothing that can be drawn.
type Drawn = fn(&mut Observation) -> Option<Image>;

const SENSORS: [(&str, Drawn); 7] = [
    ("chest_camera", |seen| colours(seen.chest_camera.take()?)),
    ("left_wrist_camera", |seen| colours(seen.left_wrist_camera.take()?)),
    ("right_wrist_camera", |seen| colours(seen.right_wrist_camera.take()?)),
    ("depth", |seen| distances(&seen.depth.take()?)),
    ("chest_depth", |seen| distances(&seen.chest_depth.take()?)),
    ("segmentation", |seen| labels(&seen.segmentation.take()?)),
    ("chest_segmentation", |seen| labels(&seen.chest_segmentation.take()?)),
];

fn colours(image: Rgb) -> Option<Image> {
    Image::of_rgb(image.width as usize, image.height as usize, image.rgb)
}

/// Near is bright, by the logarithm of the distance; where nothing is seen it is black.
fn distances(image: &DepthImage) -> Option<Image> {
    let grey = |metres: &f32| match *metres > 0.0 {
        true => (255.0 * (FAR / metres).ln() / (FAR / NEAR).ln()).clamp(20.0, 255.0) as u8,
        false => 0,
    };
    let rgb = image.metres.iter().flat_map(|metres| [grey(metres); 3]).collect();
    Image::of_rgb(image.width as usize, image.height as usize, rgb)
}

/// Each label has a colour; nothing is black.
fn labels(image: &LabelImage) -> Option<Image> {
    let rgb = image.labels.iter().flat_map(|label| colour(*label)).collect();
    Image::of_rgb(image.width as usize, image.height as usize, rgb)
}

/// Hues a golden angle apart, so that neighbours in the list differ.
fn colour(label: u8) -> [u8; 3] {
    if label == 0 {
        return [0; 3];
    }
    let hue = 6.0 * (f32::from(label) * 0.618_034).fract();
    let light = if label.is_multiple_of(2) { 235.0 } else { 170.0 };
    [0.0_f32, 2.0, 4.0].map(|shift| {
        let away = ((hue - shift + 9.0) % 6.0 - 3.0).abs();
        (light * (0.25 + 0.75 * (2.0 - away).clamp(0.0, 1.0))) as u8
    })
}

/// The pictures of one sensor by rising control steps, as PNG.
struct Seen {
    sensor: &'static str,
    pictures: Vec<(u32, Vec<u8>)>,
    /// Number of those that were offered.
    offered: usize,
}

/// Pictures of a sensor, in the order of [`crate::Replay::pictures`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SensorPictures {
    pub sensor: &'static str,
    pub count: usize,
}

/// The pictures of all sensors, which take a limited number of bytes.
pub(crate) struct Pictures {
    seen: Vec<Seen>,
    size: usize,
    /// One of so many is kept.
    stride: usize,
}

impl Pictures {
    /// Those of a bag, up to the first that cannot be read.
    pub(crate) fn of(bag: &Bag, notes: &mut Vec<String>) -> Self {
        let mut pictures = Self { seen: Vec::new(), size: 0, stride: 1 };
        let is_recorded = |name: &str| bag.header().sensors.iter().any(|sensor| sensor.recorded && sensor.name == name);
        let others: Vec<_> = SENSORS.into_iter().filter(|(name, _)| is_recorded(name)).collect();
        if !is_recorded(HEAD) && others.is_empty() {
            return pictures;
        }
        if bag.is_thin() {
            notes.push("Pictures of a thin bag are left out; scorer fill draws them again.".into());
            return pictures;
        }
        if let Err(error) = pictures.read(bag, is_recorded(HEAD), &others) {
            notes.push(format!("Pictures cannot be read to the end: {}.", short(&error.to_string())));
        }
        pictures.seen.retain(|seen| !seen.pictures.is_empty());
        pictures
    }

    fn read(&mut self, bag: &Bag, has_head: bool, others: &[(&'static str, Drawn)]) -> Result<(), BagError> {
        if has_head {
            self.seen.push(Seen { sensor: HEAD, pictures: Vec::new(), offered: 0 });
            for image in bag.images() {
                let image = image?;
                if let Some(step) = step_of(&image) {
                    self.offer(0, step, || (image.format == FORMAT).then_some(image.data));
                }
            }
        }
        if others.is_empty() {
            return Ok(());
        }
        let first = self.seen.len();
        self.seen.extend(others.iter().map(|(sensor, _)| Seen { sensor, pictures: Vec::new(), offered: 0 }));
        for observation in bag.observations() {
            let mut observation = observation?;
            let Ok(step) = u32::try_from(observation.step) else { continue };
            for (place, (_, draw)) in others.iter().enumerate() {
                if let Some(image) = draw(&mut observation) {
                    self.offer(first + place, step, || image.to_png_fast().ok());
                }
            }
        }
        Ok(())
    }

    /// Keeps a picture, if it is that of a later step than the last one and its turn has come.
    fn offer(&mut self, place: usize, step: u32, png: impl FnOnce() -> Option<Vec<u8>>) {
        let seen = &mut self.seen[place];
        if seen.pictures.last().is_some_and(|(last, _)| *last >= step) {
            return;
        }
        seen.offered += 1;
        if !(seen.offered - 1).is_multiple_of(self.stride) {
            return;
        }
        let Some(png) = png() else { return };
        self.size += png.len();
        seen.pictures.push((step, png));
        while self.size > MAX_BYTES && self.seen.iter().any(|seen| seen.pictures.len() > 1) {
            self.stride *= 2;
            for seen in &mut self.seen {
                let mut is_kept = false;
                seen.pictures.retain(|_| {
                    is_kept = !is_kept;
                    is_kept
                });
            }
            self.size = self.seen.iter().flat_map(|seen| &seen.pictures).map(|(_, png)| png.len()).sum();
        }
    }

    pub(crate) fn sensors(&self) -> Vec<SensorPictures> {
        self.seen.iter().map(|seen| SensorPictures { sensor: seen.sensor, count: seen.pictures.len() }).collect()
    }

    /// As the page reads them, little-endian: for each its step and its length (u32), then its bytes.
    pub(crate) fn bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        for (step, png) in self.seen.iter().flat_map(|seen| &seen.pictures) {
            bytes.extend(step.to_le_bytes());
            bytes.extend((png.len() as u32).to_le_bytes());
            bytes.extend(png);
        }
        bytes
    }
}

/// The control step of a picture; `None` if its time is not one of an episode.
fn step_of(image: &CompressedImage) -> Option<u32> {
    let time = image.timestamp.as_ref()?;
    let step = ((time.seconds as f64 + f64::from(time.nanos) * 1e-9) / CONTROL_DT).round();
    (0.0..=f64::from(u32::MAX)).contains(&step).then_some(step as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Guards that the page leaves no camera out.
    #[test]
    fn every_sensor_with_pictures_is_shown() {
        let large = fiatlux_wire::SENSORS.iter().filter(|sensor| sensor.is_large).map(|sensor| sensor.name);
        // These hold numbers, not pictures.
        let mut expected: Vec<_> = large.filter(|name| !["lidar", "features", "flat"].contains(name)).collect();
        let mut shown: Vec<_> = SENSORS.iter().map(|(name, _)| *name).chain([HEAD]).collect();
        expected.sort_unstable();
        shown.sort_unstable();
        assert_eq!(shown, expected);
    }
}
