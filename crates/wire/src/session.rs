//! The terms of a session that follow from its task and scene.

use fiatlux_proto::v3::{SessionInfo, TaskInfo};
use fiatlux_rules::{CONTROL_DT, Task};
use fiatlux_world::{ACTION_LIMIT, ACTION_SCALE, Scene};

use crate::{footprint_messages, hand_body_names, joint_messages};

/// The terms of a session that policies read, where no server describes one: task, joints, hands, what stands in the room, and the
/// meaning of actions.
pub fn session_terms(task: Task, scene: &Scene) -> SessionInfo {
    SessionInfo {
        task: Some(TaskInfo { task: task.short_id().into(), ..TaskInfo::default() }),
        robot: scene.robot.name().into(),
        joints: joint_messages(&scene.robot, &scene.spec.gains),
        footprints: footprint_messages(scene),
        hand_bodies: hand_body_names(&scene.robot),
        control_dt: CONTROL_DT,
        action_scale: ACTION_SCALE,
        action_limit: ACTION_LIMIT,
        ..SessionInfo::default()
    }
}
