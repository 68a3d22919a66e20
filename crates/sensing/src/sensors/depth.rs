//! Depth of the head camera: the distance of each pixel along its axis.

use fiatlux_proto::v3;
use fiatlux_render::{HEAD_CAMERA, Renderer};

use crate::Setup;
use crate::out::Out;
use crate::sensor::{Class, Entry, Needs, Term};

pub(crate) const ENTRY: Entry = Entry {
    name: "depth",
    class: Class::Optional,
    is_large: true,
    needs: Needs { camera: Some(HEAD_CAMERA), ..Needs::ROW },
    terms: |setup| depth_terms("depth", "depth.metres", setup),
    compute: |view, devices, out| {
        put_depths(devices.geometry(view, HEAD_CAMERA)?, out);
        Ok(())
    },
    encode: |view, devices, observation| {
        observation.depth = Some(depth_message(devices.geometry(view, HEAD_CAMERA)?));
        Ok(())
    },
};

pub(crate) fn depth_terms(name: &'static str, field: &'static str, setup: &Setup) -> Vec<Term> {
    let [width, height] = setup.image_size;
    let meaning = "distance of each pixel along the camera's axis, rows from the top; 0 where nothing is seen";
    vec![Term::new(name, field, &[height, width], "m", meaning).within(0.0, f64::INFINITY)]
}

/// Distances of all pixels, m.
fn depths(eye: &Renderer) -> impl Iterator<Item = f64> + '_ {
    let [width, height] = eye.size();
    (0..height).flat_map(move |y| (0..width).map(move |x| eye.depth(x, y).unwrap_or(0.0)))
}

pub(crate) fn put_depths(eye: &Renderer, out: &mut Out<'_>) {
    depths(eye).for_each(|depth| out.put(depth));
}

pub(crate) fn depth_message(eye: &Renderer) -> v3::DepthImage {
    let [width, height] = eye.size();
    v3::DepthImage {
        width: width as u32,
        height: height as u32,
        metres: depths(eye).map(|depth| depth as f32).collect(),
    }
}
