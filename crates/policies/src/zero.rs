//! The policy `zero`.

use fiatlux_proto::v3::{Observation, SessionInfo};

use fiatlux_client::{Command, Policy, PolicyError};

use crate::entry::Entry;

/// As a program makes it.
pub(crate) const ENTRY: Entry = Entry {
    name: "zero",
    does: "all actions 0: every joint goes to its angle of the standing posture, on which the robot soon falls",
    make: |_| Ok(Box::new(Zero::default())),
};

/// All actions 0: every joint moves to its angle in the standing posture.
#[derive(Debug, Default)]
pub struct Zero {
    joints: usize,
}

impl Policy for Zero {
    fn name(&self) -> String {
        "zero".into()
    }

    fn reset(&mut self, info: &SessionInfo, _first: &Observation) -> Result<(), PolicyError> {
        self.joints = info.joints.len();
        Ok(())
    }

    fn act(&mut self, _observation: &Observation) -> Result<Command, PolicyError> {
        Ok(Command::Action(vec![0.0; self.joints]))
    }
}
