use fiatlux_dynamics::ModelError;
use fiatlux_world::SceneError;
use thiserror::Error;

/// Why a trial cannot be made.
#[derive(Debug, Error)]
pub enum TrialError {
    /// The engine refuses the object.
    #[error("the engine refuses the object")]
    Model(#[from] ModelError),
    /// The object makes no scene.
    #[error("no scene can be built")]
    Scene(#[from] SceneError),
    /// The robot's file.
    #[error("cannot load the robot")]
    Robot(#[from] fiatlux_robot::RobotError),
    /// A joint that the engine does not have.
    #[error("object '{object}': joint '{joint}' is prismatic, and the engine has hinges alone; try it in MuJoCo")]
    Joint {
        /// The object.
        object: String,
        /// The joint.
        joint: String,
    },
}
