//! The policy `hold`.

use fiatlux_proto::v3::{Observation, SessionInfo};

use fiatlux_client::{Command, Policy, PolicyError};

use crate::entry::Entry;

/// As a program makes it.
pub(crate) const ENTRY: Entry =
    Entry { name: "hold", does: "keeps the posture of the start", make: |_| Ok(Box::new(Hold::default())) };

/// Keeps the staged posture: repeats the last action of observation 0.
#[derive(Debug, Default)]
pub struct Hold {
    posture: Vec<f64>,
}

impl Policy for Hold {
    fn name(&self) -> String {
        "hold".into()
    }

    fn reset(&mut self, _info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        if first.last_action.is_empty() {
            return Err(PolicyError::Sensor { policy: "hold", sensor: "last_action" });
        }
        self.posture = first.last_action.iter().map(|&angle| f64::from(angle)).collect();
        Ok(())
    }

    fn act(&mut self, _observation: &Observation) -> Result<Command, PolicyError> {
        Ok(Command::Action(self.posture.clone()))
    }
}
