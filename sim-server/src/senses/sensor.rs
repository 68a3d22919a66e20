//! Names of sensors, and sets of them.

use fiatlux_rules::Task;

/// What a session can sense. `proto/fiatlux/v3/observation.proto` describes each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sensor {
    /// The robot's own body.
    Proprioception,
    /// Force of the bulbs on the hands.
    HandContact,
    /// Force of the ladder on feet and palms.
    LimbContact,
    /// The last action.
    LastAction,
    /// Ranges to floor and ladder.
    Lidar,
    /// Image of the head camera.
    Camera,
    /// ResNet-18 features of that image.
    Features,
    /// The published vector.
    Flat,
    /// Exact poses and distances.
    Privileged,
    /// Gate and reward.
    Verdict,
}

impl Sensor {
    /// All, in the order in which sessions list them.
    pub const ALL: [Sensor; 10] = [
        Sensor::Proprioception,
        Sensor::HandContact,
        Sensor::LimbContact,
        Sensor::LastAction,
        Sensor::Lidar,
        Sensor::Camera,
        Sensor::Features,
        Sensor::Flat,
        Sensor::Privileged,
        Sensor::Verdict,
    ];

    /// Name in messages.
    pub fn name(self) -> &'static str {
        match self {
            Sensor::Proprioception => "proprioception",
            Sensor::HandContact => "hand_contact",
            Sensor::LimbContact => "limb_contact",
            Sensor::LastAction => "last_action",
            Sensor::Lidar => "lidar",
            Sensor::Camera => "camera",
            Sensor::Features => "features",
            Sensor::Flat => "flat",
            Sensor::Privileged => "privileged",
            Sensor::Verdict => "verdict",
        }
    }

    /// The sensor of that name.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|sensor| sensor.name() == name)
    }

    /// Names of all, for a message to a person.
    pub(crate) fn names() -> String {
        Self::ALL.map(Sensor::name).join(", ")
    }

    /// Large in a message: a bag has it only where the session asks for it.
    pub fn is_large(self) -> bool {
        Sensors::LARGE.contains(self)
    }
}

/// A set of sensors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Sensors(u16);

impl Sensors {
    /// None.
    pub const NONE: Self = Self(0);
    /// Those that are large in a message.
    pub const LARGE: Self = Self::of(&[Sensor::Lidar, Sensor::Camera, Sensor::Features, Sensor::Flat]);
    /// Those that need the head camera's image.
    pub const WITH_IMAGE: Self = Self::of(&[Sensor::Camera, Sensor::Features, Sensor::Flat]);
    /// Those that need the image's features.
    pub const WITH_FEATURES: Self = Self::of(&[Sensor::Features, Sensor::Flat]);
    /// Those that need a scan.
    pub const WITH_SCAN: Self = Self::of(&[Sensor::Lidar, Sensor::Flat]);

    /// A set of these.
    pub const fn of(sensors: &[Sensor]) -> Self {
        let (mut bits, mut index) = (0, 0);
        while index < sensors.len() {
            bits |= 1 << sensors[index] as u16;
            index += 1;
        }
        Self(bits)
    }

    /// What a session has that names none: the robot's own body, as the published vector of the task has it.
    pub fn of_body(task: Task) -> Self {
        let contact = if task == Task::Climb { Sensor::LimbContact } else { Sensor::HandContact };
        Self::of(&[Sensor::Proprioception, contact, Sensor::LastAction])
    }

    /// Whether it has a sensor.
    pub const fn contains(self, sensor: Sensor) -> bool {
        self.0 & 1 << sensor as u16 != 0
    }

    /// With another one.
    #[must_use]
    pub const fn with(self, sensor: Sensor) -> Self {
        Self(self.0 | 1 << sensor as u16)
    }

    /// Those of both.
    #[must_use]
    pub const fn and(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Those that the other set does not have.
    #[must_use]
    pub const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// Whether some sensor is in both.
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
        assert_eq!(set.and(Sensors::of(&[Sensor::Lidar])).iter().count(), 3);
        assert!(Sensors::of_body(Task::Climb).contains(Sensor::LimbContact));
    }

    #[test]
    fn names_read_back() {
        for sensor in Sensor::ALL {
            assert_eq!(Sensor::by_name(sensor.name()), Some(sensor));
        }
        assert_eq!(Sensor::by_name("smell"), None);
    }
}
