//! Shapes of a scene by what they belong to.

use fiatlux_dynamics::ShapeSpec;
use fiatlux_world::{Scene, ShapeOwner};

use crate::mesh::Frame;

/// The shapes of an owner.
pub(super) fn shapes(scene: &Scene, owner: ShapeOwner) -> impl Iterator<Item = &ShapeSpec> {
    scene.model.shapes().iter().filter(move |shape| ShapeOwner::from_label(shape.label) == owner)
}

/// Where the shapes of a thing are given: with the thing, or in the world if it cannot move.
pub(super) fn frame_of(scene: &Scene, thing: usize) -> Frame {
    if scene.body(thing).is_some() { Frame::Thing(thing) } else { Frame::World }
}
