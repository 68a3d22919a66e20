//! All sensors.

use crate::sensor::{Class, Cost, Entry, Term};
use crate::{Setup, sensors};

/// Makes the list of sensors from the entry in each one's file.
macro_rules! sensors {
    ($($(#[$doc:meta])* $sensor:ident: $module:ident, $does:literal,)*) => {
        /// Sensors that a session can have: one for each file of `sensors/`. `proto/fiatlux/v3/observation.proto` has the field
        /// of each.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum Sensor {
            $($(#[$doc])* $sensor,)*
        }

        impl Sensor {
            /// All, in the order in which sessions list them: the benchmark's, then all others by name.
            pub const ALL: [Sensor; [$(stringify!($sensor)),*].len()] = [$(Sensor::$sensor),*];

            /// One line that says what it senses.
            pub const fn does(self) -> &'static str {
                match self {
                    $(Sensor::$sensor => $does,)*
                }
            }

            pub(crate) const fn entry(self) -> &'static Entry {
                match self {
                    $(Sensor::$sensor => &sensors::$module::ENTRY,)*
                }
            }
        }
    };
}

include!(concat!(env!("OUT_DIR"), "/variants.rs"));

/// Guards those who read requests without the simulator: they know the same sensors.
const _: () = {
    let known = &fiatlux_wire::SENSORS;
    assert!(known.len() == Sensor::ALL.len(), "list the sensor in SENSORS of crates/wire/src/known.rs");
    let mut index = 0;
    while index < known.len() {
        let (name, is_large) = (Sensor::ALL[index].name().as_bytes(), Sensor::ALL[index].is_large());
        let listed = known[index].name.as_bytes();
        let mut byte = 0;
        while byte < name.len() && byte < listed.len() && name[byte] == listed[byte] {
            byte += 1;
        }
        let is_same = byte == name.len() && byte == listed.len() && is_large == known[index].is_large;
        assert!(is_same, "SENSORS of crates/wire/src/known.rs has other sensors, another order or other sizes");
        index += 1;
    }
};

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

    /// Class of runs that have it.
    pub const fn class(self) -> Class {
        self.entry().class
    }

    /// Large in a message: a bag has it only where the session asks for it.
    pub const fn is_large(self) -> bool {
        self.entry().is_large
    }

    /// Cost of computing it.
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

    /// Count of its numbers.
    pub fn length(self, setup: &Setup) -> usize {
        (self.entry().terms)(setup).iter().map(Term::length).sum()
    }
}
