//! Image of the head camera.

use fiatlux_proto::v3;
use fiatlux_render::{HEAD_CAMERA, Image};

use crate::Setup;
use crate::sensor::{Class, Entry, Needs, Term};

pub(crate) const ENTRY: Entry = Entry {
    name: "camera",
    class: Class::Standard,
    is_large: true,
    needs: Needs { camera: Some(HEAD_CAMERA), ..Needs::ROW },
    terms: |setup| image_terms("camera", "camera.rgb", setup),
    compute: |view, devices, out| devices.draw(view, HEAD_CAMERA, out),
    encode: |view, devices, observation| {
        observation.camera = Some(message(devices.picture(view, HEAD_CAMERA)?));
        Ok(())
    },
};

pub(crate) fn image_terms(name: &'static str, field: &'static str, setup: &Setup) -> Vec<Term> {
    let [width, height] = setup.image_size;
    let meaning = "red, green and blue of each pixel, rows from the top";
    vec![Term::new(name, field, &[height, width, 3], "", meaning).within(0.0, 255.0)]
}

pub(crate) fn message(image: &Image) -> v3::Image {
    v3::Image { width: image.width() as u32, height: image.height() as u32, rgb: image.rgb().to_vec() }
}
