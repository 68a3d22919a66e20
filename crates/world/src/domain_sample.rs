use crate::{HandFriction, Layout, Light, PropScale, StartOffset};

/// What was drawn for an episode, or is nominal. The noise of the sensors is not kept.
#[derive(Debug, Clone, PartialEq)]
pub struct DomainSample {
    /// The room.
    pub layout: Layout,
    /// Sizes of the props.
    pub scale: PropScale,
    /// Friction of the hands; none for the robot file's own.
    pub hand_friction: Option<HandFriction>,
    /// Light and tint.
    pub light: Light,
    /// How far off its nominal start the robot is.
    pub start: StartOffset,
}
