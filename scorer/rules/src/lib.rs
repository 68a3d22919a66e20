//! The rulebook: subtasks, gates, rewards, weights and scores as pure functions of recorded state.
mod row;

pub use row::{AttachmentRow, BodyRow, Bulb, HAND_BODIES, HAND_BODIES_PER_SIDE, JOINTS, LIMBS, Limb, Row};
