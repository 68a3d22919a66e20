//! Names of what each pixel of the camera on the chest shows: things and links of the robot.

use super::chest_camera::MOUNT;
use super::segmentation::{label_message, label_terms, put_labels};
use crate::sensor::{Class, Entry, Needs};

pub(crate) const ENTRY: Entry = Entry {
    name: "chest_segmentation",
    class: Class::Optional,
    is_large: true,
    needs: Needs { camera: Some(MOUNT), labels: true, ..Needs::ROW },
    terms: |setup| label_terms("chest_segmentation", "chest_segmentation.labels", setup),
    compute: |view, devices, out| {
        put_labels(devices.geometry(view, MOUNT)?, out);
        Ok(())
    },
    encode: |view, devices, observation| {
        observation.chest_segmentation = Some(label_message(devices.geometry(view, MOUNT)?));
        Ok(())
    },
};
