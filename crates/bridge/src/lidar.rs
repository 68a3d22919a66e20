//! The LiDAR's scan as a few numbers of a state.

use fiatlux_robot::lidar::{COLUMNS, RANGE};

/// The nearest range of a scan in each of `count` equal sectors, m, from behind by the left; [`RANGE`] where nothing is
/// hit. `count` divides the columns. `python/fiatlux/_inputs.py` does the same in training.
pub(crate) fn sectors(scan: &[f32], count: usize) -> Vec<f32> {
    let mut nearest = vec![RANGE as f32; count];
    for row in scan.chunks(COLUMNS) {
        for (column, range) in row.iter().enumerate() {
            let sector = &mut nearest[column * count / COLUMNS];
            *sector = sector.min(*range);
        }
    }
    nearest
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use fiatlux_robot::lidar::RAYS;

    use super::*;

    /// The scan and its sectors are also those of `python/tests/test_train_lerobot.py`: both must agree.
    #[test]
    fn sectors_are_those_that_a_policy_is_trained_on() {
        let shared: serde_json::Value = serde_json::from_str(include_str!("../tests/lidar_sectors.json")).unwrap();
        let number = |value: &serde_json::Value| value.as_f64().unwrap();
        let mut scan = vec![RANGE as f32; RAYS];
        for hit in shared["hits"].as_array().unwrap() {
            let [row, column, range] = [0, 1, 2].map(|index| number(&hit[index]));
            scan[row as usize * COLUMNS + column as usize] = range as f32;
        }
        let cases = shared["sectors"].as_object().unwrap();
        assert_eq!(cases.len(), 4);
        for (count, expected) in cases {
            let expected: Vec<f32> = expected.as_array().unwrap().iter().map(|range| number(range) as f32).collect();
            assert_eq!(sectors(&scan, count.parse().unwrap()), expected, "{count}");
        }
    }
}
