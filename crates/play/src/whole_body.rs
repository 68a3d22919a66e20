//! The whole-body controller, for policies that command it in place of legs and waist.

use std::sync::{Arc, LazyLock};

use fiatlux_proto::v3;
use fiatlux_wbc::{ARMS, Arms, BODY, BodyCommand, Controller, Joint, MOVED, Network, Proprioception, WbcError};
use fiatlux_world::{ACTION_SCALE, Scene};

/// The shipped network, read when it is first asked for.
static NETWORK: LazyLock<Result<Arc<Network>, WbcError>> = LazyLock::new(|| Network::shipped().map(Arc::new));

/// Least and greatest of each number of a command, in the order of `SessionInfo.whole_body_range`; nothing where the controller
/// was not trained for the scene's robot and drives.
pub fn whole_body_range(scene: &Scene) -> Vec<f64> {
    let fits = |network: &&Arc<Network>| network.contract().fits_joints(&joints(scene)).is_ok();
    let Some(network) = NETWORK.as_ref().ok().filter(fits) else { return Vec::new() };
    let [walking, standing] = [true, false].map(|walks| network.contract().command_ranges(walks));
    // The controller itself keeps a robot that walks within the narrower range of heights.
    walking
        .iter()
        .zip(standing)
        .flat_map(|(walking, standing)| [walking[0].min(standing[0]), walking[1].max(standing[1])])
        .collect()
}

fn joints(scene: &Scene) -> Vec<Joint> {
    Joint::all(&scene.robot, &scene.spec.gains).collect()
}

/// The controller while it is commanded.
#[derive(Debug, Clone)]
pub(crate) struct WholeBody {
    controller: Controller,
    arms: Arms,
    sensed: Proprioception,
    /// Of all joints, rad. Those of arms and hands are as they are wanted.
    targets: Vec<f64>,
    /// The policy has named targets: angles at which the arms shall rest. Earlier ones are played as they are.
    is_named: bool,
}

impl WholeBody {
    /// Takes over from an action, in action units.
    ///
    /// # Errors
    /// [`WbcError`]: the controller does not fit the scene.
    pub fn take_over(scene: &Scene, action: &[f64]) -> Result<Self, WbcError> {
        let (network, joints) = (NETWORK.as_ref().map_err(|error| WbcError::Arms(error.to_string()))?, joints(scene));
        network.contract().fits_joints(&joints)?;
        let targets = scene.robot.q0().iter().zip(action).map(|(q0, action)| q0 + ACTION_SCALE * action).collect();
        Ok(Self {
            controller: Controller::new(Arc::clone(network)),
            arms: Arms::new(&joints)?,
            sensed: Proprioception::default(),
            targets,
            is_named: false,
        })
    }

    /// Targets of all joints that follow a command, rad. `named` has targets of all joints, or none.
    ///
    /// # Errors
    /// [`WbcError`]: what is sensed is not finite.
    pub fn step(
        &mut self,
        seen: &v3::Proprioception,
        command: &BodyCommand,
        named: &[f64],
    ) -> Result<Vec<f64>, WbcError> {
        let sensed = self.sensed.read(seen);
        if named.len() == self.targets.len() {
            self.targets[MOVED..].copy_from_slice(&named[MOVED..]);
            self.is_named = true;
        }
        self.controller.step(&sensed, command, &mut self.targets)?;
        let mut targets = self.targets.clone();
        if self.is_named {
            let mut angles = [0.0; ARMS];
            angles.copy_from_slice(&targets[MOVED..BODY]);
            targets[MOVED..BODY].copy_from_slice(&self.arms.targets(&sensed, &angles)?);
        }
        Ok(targets)
    }
}
