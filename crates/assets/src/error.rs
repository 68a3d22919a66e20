use fiatlux_dynamics::ModelError;
use fiatlux_world::SceneError;
use thiserror::Error;

/// Why a trial cannot be made.
#[derive(Debug, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum TrialError {
    #[error("the engine refuses the object")]
    Model(#[from] ModelError),
    #[error("no scene can be built")]
    Scene(#[from] SceneError),
    #[error("cannot load the robot")]
    Robot(#[from] fiatlux_robot::RobotError),
    #[error("object '{object}': joint '{joint}' is prismatic, and the engine has hinges alone; try it in MuJoCo")]
    Joint { object: String, joint: String },
}
