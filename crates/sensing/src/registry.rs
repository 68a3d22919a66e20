//! All sensors.

use crate::Setup;
use crate::sensor::{Cost, Entry, Term};
use crate::sensors::{
    camera, chest_camera, features, flat, hand_contact, last_action, lidar, limb_contact, privileged, proprioception,
    verdict,
};

/// Makes the list of sensors from the entry in each one's file.
macro_rules! sensors {
    ($($(#[$doc:meta])* $sensor:ident: $entry:expr,)*) => {
        /// What a session can sense. `proto/fiatlux/v3/observation.proto` has the field of each.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum Sensor {
            $($(#[$doc])* $sensor,)*
        }

        impl Sensor {
            /// All, in the order in which sessions list them.
            pub const ALL: [Sensor; [$(stringify!($sensor)),*].len()] = [$(Sensor::$sensor),*];

            pub(crate) const fn entry(self) -> &'static Entry {
                match self {
                    $(Sensor::$sensor => &$entry,)*
                }
            }
        }
    };
}

sensors! {
    /// The robot's own body.
    Proprioception: proprioception::ENTRY,
    /// Force of the bulbs on the hands.
    HandContact: hand_contact::ENTRY,
    /// Force of the ladder on feet and palms.
    LimbContact: limb_contact::ENTRY,
    /// The action that led to the observation; at first the staged posture in action units.
    LastAction: last_action::ENTRY,
    /// Ranges to floor and ladder, and to the room where a session asks for it.
    Lidar: lidar::ENTRY,
    /// Image of the head camera.
    Camera: camera::ENTRY,
    /// ResNet-18 features of that image.
    Features: features::ENTRY,
    /// The published flat vector, with the published scales.
    Flat: flat::ENTRY,
    /// Exact poses and distances.
    Privileged: privileged::ENTRY,
    /// Criteria of the gate, its progress, and the reward of the step.
    Verdict: verdict::ENTRY,
    /// Image of the camera on the chest, which looks down at treads and hands.
    ChestCamera: chest_camera::ENTRY,
}

impl Sensor {
    /// Name in messages, such as `proprioception`.
    pub const fn name(self) -> &'static str {
        self.entry().name
    }

    /// The sensor of that name.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|sensor| sensor.name() == name)
    }

    /// Names of all, for a message to a person.
    pub fn names() -> String {
        Self::ALL.map(Sensor::name).join(", ")
    }

    /// Large in a message: a bag has it only where the session asks for it.
    pub const fn is_large(self) -> bool {
        self.entry().is_large
    }

    /// How much work it is.
    pub const fn cost(self) -> Cost {
        let needs = &self.entry().needs;
        if needs.network {
            Cost::Network
        } else if needs.camera.is_some() {
            Cost::Image
        } else if needs.scan {
            Cost::Scan
        } else {
            Cost::Body
        }
    }

    /// The camera of the robot's file whose image it needs.
    pub const fn camera(self) -> Option<&'static str> {
        self.entry().needs.camera
    }

    /// Its terms in their order.
    pub fn terms(self, setup: &Setup) -> Vec<Term> {
        let mut terms = (self.entry().terms)(setup);
        for index in 1..terms.len() {
            let before = &terms[index - 1];
            if before.field == terms[index].field {
                terms[index].offset = before.offset + before.length();
            }
        }
        terms
    }

    /// How many numbers it has.
    pub fn length(self, setup: &Setup) -> usize {
        (self.entry().terms)(setup).iter().map(Term::length).sum()
    }
}
