//! Tasks as messages.

use fiatlux_proto::v3::TaskInfo;
use fiatlux_rules::Task;

/// A task as policies are told of it, without the criteria of a protocol.
pub fn task_message(task: Task) -> TaskInfo {
    TaskInfo {
        task: task.short_id().into(),
        id: task.id().into(),
        name: task.name().into(),
        instruction: task.instruction().into(),
        horizon_steps: task.horizon_steps(),
        weight: task.weight(),
        criteria: Vec::new(),
    }
}
