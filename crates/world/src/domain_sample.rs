use crate::{HandFriction, Layout, Light, PropScale, StartOffset};

/// What was drawn for an episode, or is nominal. The noise of the sensors is not kept.
#[derive(Debug, Clone, PartialEq)]
pub struct DomainSample {
    /// Where everything stands in the room.
    pub layout: Layout,
    /// Sizes of the props.
    pub scale: PropScale,
    /// Friction of the hands; none for the robot file's own.
    pub hand_friction: Option<HandFriction>,
    /// Light of the scene and tint of the room.
    pub light: Light,
    /// How far off its nominal start the robot is.
    pub start: StartOffset,
}
