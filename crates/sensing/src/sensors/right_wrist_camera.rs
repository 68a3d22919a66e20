//! Image of the camera beside the right wrist, which looks along the palm at fingers and thumb.

use super::camera::{image_terms, message};
use crate::sensor::{Class, Entry, Needs};

/// Its name in `cameras.toml` of the robots.
const MOUNT: &str = "right_wrist_camera";

pub(crate) const ENTRY: Entry = Entry {
    name: "right_wrist_camera",
    class: Class::Optional,
    is_large: true,
    needs: Needs { camera: Some(MOUNT), ..Needs::ROW },
    terms: |setup| image_terms("right_wrist_camera", "right_wrist_camera.rgb", setup),
    compute: |view, devices, out| devices.draw(view, MOUNT, out),
    encode: |view, devices, observation| {
        observation.right_wrist_camera = Some(message(devices.picture(view, MOUNT)?));
        Ok(())
    },
};
