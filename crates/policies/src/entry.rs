//! An entry of the registry of policies.

use fiatlux_client::{Policy, PolicyError};

/// A policy that a program can make by name.
#[derive(Debug, Clone, Copy)]
pub struct Entry {
    /// Its name, with what follows it: `zero`, `gear:DIR`, or `walk[:FILE]` where that may be left out.
    pub name: &'static str,
    /// One line of help for the command line.
    pub does: &'static str,
    /// Makes one from what follows the colon of the name, which is empty where nothing does.
    pub make: fn(&str) -> Result<Box<dyn Policy>, PolicyError>,
}

impl Entry {
    /// Its name without what follows it.
    pub(crate) fn word(&self) -> &'static str {
        self.name.split([':', '[']).next().unwrap_or(self.name)
    }

    /// True if this may follow its name. A colon with nothing behind it is a slip.
    pub(crate) fn takes(&self, argument: Option<&str>) -> bool {
        match argument {
            None => self.name.contains('[') || !self.name.contains(':'),
            Some(argument) => !argument.is_empty() && self.name.contains(':'),
        }
    }
}
