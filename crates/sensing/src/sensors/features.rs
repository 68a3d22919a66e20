//! ResNet-18 features of the head camera's image.

use fiatlux_features::FEATURES;
use fiatlux_proto::v3;
use fiatlux_render::HEAD_CAMERA;

use crate::Setup;
use crate::sensor::{Class, Entry, Needs, Term};

pub(crate) const ENTRY: Entry = Entry {
    name: "features",
    class: Class::Standard,
    is_large: true,
    needs: Needs { camera: Some(HEAD_CAMERA), network: true, ..Needs::ROW },
    terms,
    compute: |view, devices, out| {
        out.extend_singles(devices.recognise(view, HEAD_CAMERA)?.last());
        Ok(())
    },
    encode: |view, devices, observation| {
        let network = devices.recognise(view, HEAD_CAMERA)?;
        observation.features = Some(v3::Features { values: network.last().to_vec(), weights: network.label().into() });
        Ok(())
    },
};

fn terms(_: &Setup) -> Vec<Term> {
    let meaning = "ResNet-18 features of the head camera";
    vec![Term::new("camera_features", "features.values", &[FEATURES], "", meaning).within(0.0, f64::INFINITY)]
}
