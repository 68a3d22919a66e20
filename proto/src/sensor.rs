//! Sensors by name.

use crate::v3::Sensor;

/// That sensor in every observation.
impl From<&str> for Sensor {
    fn from(name: &str) -> Self {
        Self { name: name.into(), ..Self::default() }
    }
}
