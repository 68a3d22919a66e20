//! The published flat vector, with the published scales.
//!
//! Other sensors' terms in the order and with the scales of the published `FIATLUX-Replace-v0` and `FIATLUX-Climb-v0` (`replace_env_cfg` and `climb_env_cfg`, group `policy`).

use fiatlux_proto::v3::FlatObservation;
use fiatlux_render::HEAD_CAMERA;
use fiatlux_rules::Task;

use super::{features, hand_contact, last_action, lidar, limb_contact, proprioception};
use crate::sensor::{Class, Entry, Needs, Term};
use crate::{Setup, Sight};

pub(crate) const ENTRY: Entry = Entry {
    name: "flat",
    class: Class::Standard,
    is_large: true,
    needs: Needs { scan: true, camera: Some(HEAD_CAMERA), network: true, ..Needs::ROW },
    terms,
    compute: |view, devices, out| {
        // The published LiDAR's ranges, whatever the session's own one sees.
        let sight = std::mem::replace(&mut devices.sight, Sight::Published);
        let computed = parts(view.task).iter().try_for_each(|(part, scale)| {
            out.set_scale(*scale);
            (part.compute)(view, devices, out)
        });
        devices.sight = sight;
        computed
    },
    encode: |view, devices, observation| {
        let values = ENTRY.numbers(view, devices)?;
        let weights = devices.recognise(view, HEAD_CAMERA)?.label().into();
        observation.flat = Some(FlatObservation { values, weights });
        Ok(())
    },
};

/// Scale of a force, 1/N, and of a range, 1/m.
const TENTH: f64 = 0.1;

const WITH_HANDS: [(&Entry, f64); 5] = [
    (&proprioception::ENTRY, 1.0),
    (&hand_contact::ENTRY, TENTH),
    (&features::ENTRY, 1.0),
    (&lidar::ENTRY, TENTH),
    (&last_action::ENTRY, 1.0),
];

/// Of `climb`, which handles no bulb.
const WITH_LIMBS: [(&Entry, f64); 5] = [
    (&proprioception::ENTRY, 1.0),
    (&limb_contact::ENTRY, TENTH),
    (&features::ENTRY, 1.0),
    (&lidar::ENTRY, TENTH),
    (&last_action::ENTRY, 1.0),
];

fn parts(task: Task) -> &'static [(&'static Entry, f64)] {
    if task == Task::Climb { &WITH_LIMBS } else { &WITH_HANDS }
}

fn terms(setup: &Setup) -> Vec<Term> {
    let of = |(part, scale): &(&Entry, f64)| {
        let scale = *scale;
        (part.terms)(setup).into_iter().map(move |term| Term { field: "flat.values", scale, ..term })
    };
    parts(setup.task).iter().flat_map(of).collect()
}
