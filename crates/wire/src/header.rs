//! What a bag's header says of the rows that follow it.

use fiatlux_proto::v3::EpisodeHeader;
use fiatlux_rules::RobotLayout;

use crate::WireError;

/// The sizes of an episode's rows.
///
/// # Errors
/// [`WireError::Value`] for a header without joints, or with an odd number of hand bodies.
pub fn layout_of(header: &EpisodeHeader) -> Result<RobotLayout, WireError> {
    let (joints, bodies) = (header.joint_names.len(), header.hand_bodies.len());
    if joints == 0 {
        return Err(WireError::Missing { field: "joint_names" });
    }
    if !bodies.is_multiple_of(2) {
        let problem = format!("has {bodies} names; both hands have the same number of bodies");
        return Err(WireError::Value { field: "hand_bodies", problem });
    }
    Ok(RobotLayout { joints, hand_bodies_per_side: bodies / 2 })
}
