//! Names of what each pixel of the head camera shows: things and links of the robot.

use fiatlux_proto::v3;
use fiatlux_render::{HEAD_CAMERA, Renderer};
use fiatlux_world::ShapeOwner;

use crate::Setup;
use crate::out::Out;
use crate::sensor::{Class, Entry, Needs, Term};

pub(crate) const ENTRY: Entry = Entry {
    name: "segmentation",
    class: Class::Optional,
    is_large: true,
    needs: Needs { camera: Some(HEAD_CAMERA), labels: true, ..Needs::ROW },
    terms: |setup| label_terms("segmentation", "segmentation.labels", setup),
    compute: |view, devices, out| {
        put_labels(devices.geometry(view, HEAD_CAMERA)?, out);
        Ok(())
    },
    encode: |view, devices, observation| {
        observation.segmentation = Some(label_message(devices.geometry(view, HEAD_CAMERA)?));
        Ok(())
    },
};

pub(crate) fn label_terms(name: &'static str, field: &'static str, setup: &Setup) -> Vec<Term> {
    let [width, height] = setup.image_size;
    let meaning = "label of each pixel, rows from the top: 0 where nothing is seen, otherwise the place of its name \
                   among the segments, plus 1";
    vec![Term::new(name, field, &[height, width], "", meaning).within(0.0, 255.0)]
}

/// Labels of all pixels. A robot has at most as many links as a byte can name, which a test holds.
fn labels(eye: &Renderer) -> impl Iterator<Item = u8> + '_ {
    let [width, height] = eye.size();
    let label = |owner: ShapeOwner| u8::try_from(owner.label() + 1).unwrap_or(u8::MAX);
    (0..height).flat_map(move |y| (0..width).map(move |x| eye.owner(x, y).map_or(0, label)))
}

pub(crate) fn put_labels(eye: &Renderer, out: &mut Out<'_>) {
    labels(eye).for_each(|label| out.put(f64::from(label)));
}

pub(crate) fn label_message(eye: &Renderer) -> v3::LabelImage {
    let [width, height] = eye.size();
    v3::LabelImage { width: width as u32, height: height as u32, labels: labels(eye).collect() }
}
