//! Depth of the camera on the chest: the distance of each pixel along its axis.

use super::chest_camera::MOUNT;
use super::depth::{depth_message, depth_terms, put_depths};
use crate::sensor::{Class, Entry, Needs};

pub(crate) const ENTRY: Entry = Entry {
    name: "chest_depth",
    class: Class::Optional,
    is_large: true,
    needs: Needs { camera: Some(MOUNT), ..Needs::ROW },
    terms: |setup| depth_terms("chest_depth", "chest_depth.metres", setup),
    compute: |view, devices, out| {
        put_depths(devices.geometry(view, MOUNT)?, out);
        Ok(())
    },
    encode: |view, devices, observation| {
        observation.chest_depth = Some(depth_message(devices.geometry(view, MOUNT)?));
        Ok(())
    },
};
