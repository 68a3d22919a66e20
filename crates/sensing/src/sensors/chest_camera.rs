//! The image of a camera on the chest: treads ahead, hands and feet on the ladder.

use super::camera::{image_terms, message};
use crate::sensor::{Entry, Needs};

/// Its name in the robot's file.
const MOUNT: &str = "chest_camera";

pub(crate) const ENTRY: Entry = Entry {
    name: "chest_camera",
    is_large: true,
    needs: Needs { camera: Some(MOUNT), ..Needs::ROW },
    terms: |setup| image_terms("chest_camera", "chest_camera.rgb", setup),
    compute: |view, devices, out| {
        out.extend_bytes(devices.picture(view, MOUNT)?.rgb());
        Ok(())
    },
    encode: |view, devices, observation| {
        observation.chest_camera = Some(message(devices.picture(view, MOUNT)?));
        Ok(())
    },
};
