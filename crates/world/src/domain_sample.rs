use crate::{HandFriction, Layout, Light, PropScale, StartOffset, Varied};

/// Everything that was drawn for an episode, or is nominal, except the noise of the sensors.
#[derive(Debug, Clone, PartialEq)]
pub struct DomainSample {
    /// Where everything stands in the room.
    pub layout: Layout,
    /// Sizes of the props.
    pub scale: PropScale,
    /// Friction of the hands; `None` for that in the robot's file.
    pub hand_friction: Option<HandFriction>,
    /// Light of the scene and tint of the room.
    pub light: Light,
    /// Offset of the robot from its nominal start.
    pub start: StartOffset,
    /// Values drawn from the ranges of the episode; empty without any.
    pub varied: Varied,
}
