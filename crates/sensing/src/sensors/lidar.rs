//! Ranges to floor and ladder, and to the room where a session asks for it.

use crate::sensor::{Class, Entry, Needs, Term};
use crate::{LIDAR_COLUMNS, LIDAR_RANGE, LIDAR_ROWS, Setup};

pub(crate) const ENTRY: Entry = Entry {
    name: "lidar",
    class: Class::Standard,
    is_large: true,
    needs: Needs { scan: true, ..Needs::ROW },
    terms,
    compute: |view, devices, out| {
        out.extend_singles(devices.scan(view, devices.sight)?.ranges());
        Ok(())
    },
    encode: |view, devices, observation| {
        observation.lidar = devices.scan(view, devices.sight)?.ranges().to_vec();
        Ok(())
    },
};

pub(crate) fn terms(_: &Setup) -> Vec<Term> {
    let meaning = "range by elevation, then azimuth: entry 180 row + column; 10 m where nothing is hit";
    vec![Term::new("lidar", "lidar", &[LIDAR_ROWS, LIDAR_COLUMNS], "m", meaning).within(0.0, LIDAR_RANGE)]
}
