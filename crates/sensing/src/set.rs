//! Sets of sensors.

use fiatlux_rules::Task;

use crate::Sensor;
use crate::sensor::Needs;

/// A set of sensors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Sensors(u32);

const _: () = assert!(Sensor::ALL.len() <= u32::BITS as usize);

/// The sensors for which a condition on their entry holds.
macro_rules! sensors_with {
    (|$sensor:ident, $needs:ident| $condition:expr) => {{
        let (mut set, mut index) = (Sensors::NONE, 0);
        while index < Sensor::ALL.len() {
            let $sensor = Sensor::ALL[index];
            let $needs: &Needs = &$sensor.entry().needs;
            if $condition {
                set = set.with($sensor);
            }
            index += 1;
        }
        set
    }};
}

impl Sensors {
    /// The set without any sensor.
    pub const NONE: Self = Self(0);
    /// Those that are large in a message.
    pub const LARGE: Self = sensors_with!(|sensor, _needs| sensor.is_large());
    /// Those that need a camera's image.
    pub const WITH_IMAGE: Self = sensors_with!(|_sensor, needs| needs.camera.is_some());
    /// Those that need the features of the head camera's image.
    pub const WITH_FEATURES: Self = sensors_with!(|_sensor, needs| needs.network);
    /// Those whose numbers are labels of [`segment_names`](crate::segment_names).
    pub const WITH_LABELS: Self = sensors_with!(|_sensor, needs| needs.labels);
    /// Those that need a scan.
    pub const WITH_SCAN: Self = sensors_with!(|_sensor, needs| needs.scan);

    /// A set of these.
    pub const fn of(sensors: &[Sensor]) -> Self {
        let (mut set, mut index) = (Self::NONE, 0);
        while index < sensors.len() {
            set = set.with(sensors[index]);
            index += 1;
        }
        set
    }

    /// Sensors of a session that names none: the robot's own body, as the published vector of the task has it, and the contact of
    /// the limbs where the task is to climb.
    pub fn of_body(task: Task) -> Self {
        let contact: &[Sensor] = match task {
            Task::Climb => &[Sensor::LimbContact],
            Task::S02 | Task::S04 | Task::S10 | Task::S12 => &[Sensor::HandContact, Sensor::LimbContact],
            _ => &[Sensor::HandContact],
        };
        Self::of(&[Sensor::Proprioception, Sensor::LastAction]).union(Self::of(contact))
    }

    /// True if it has a sensor.
    pub const fn contains(self, sensor: Sensor) -> bool {
        self.0 & 1 << sensor as u32 != 0
    }

    /// This set with another sensor.
    #[must_use]
    pub const fn with(self, sensor: Sensor) -> Self {
        Self(self.0 | 1 << sensor as u32)
    }

    /// The sensors that are in either set.
    #[must_use]
    pub const fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Those that the other set does not have.
    #[must_use]
    pub const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// True if some sensor is in both.
    pub const fn meets(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }

    /// In the order of [`Sensor::ALL`].
    pub fn iter(self) -> impl Iterator<Item = Sensor> {
        Sensor::ALL.into_iter().filter(move |sensor| self.contains(*sensor))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets() {
        let set = Sensors::of(&[Sensor::Verdict, Sensor::Camera]);
        assert_eq!(set.iter().collect::<Vec<_>>(), [Sensor::Camera, Sensor::Verdict]);
        assert!(set.meets(Sensors::WITH_IMAGE) && !set.meets(Sensors::WITH_SCAN));
        assert_eq!(set.without(Sensors::LARGE), Sensors::NONE.with(Sensor::Verdict));
        assert_eq!(set.union(Sensors::of(&[Sensor::Lidar])).iter().count(), 3);
        let limbs = Task::ALL.into_iter().filter(|task| Sensors::of_body(*task).contains(Sensor::LimbContact));
        assert_eq!(limbs.collect::<Vec<_>>(), [Task::S02, Task::S04, Task::S10, Task::S12, Task::Climb]);
    }

    #[test]
    fn names_read_back() {
        for sensor in Sensor::ALL {
            assert_eq!(Sensor::by_name(sensor.name()), Some(sensor));
        }
        assert_eq!(Sensor::by_name("smell"), None);
    }
}
