//! Image of the camera on the chest, which looks down at treads and hands.

use super::camera::{image_terms, message};
use crate::sensor::{Class, Entry, Needs};

/// Its name in the robot's file.
pub(super) const MOUNT: &str = "chest_camera";

pub(crate) const ENTRY: Entry = Entry {
    name: "chest_camera",
    class: Class::Standard,
    is_large: true,
    needs: Needs { camera: Some(MOUNT), ..Needs::ROW },
    terms: |setup| image_terms("chest_camera", "chest_camera.rgb", setup),
    compute: |view, devices, out| devices.draw(view, MOUNT, out),
    encode: |view, devices, observation| {
        observation.chest_camera = Some(message(devices.picture(view, MOUNT)?));
        Ok(())
    },
};
