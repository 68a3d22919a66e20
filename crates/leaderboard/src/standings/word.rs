//! Words of subtasks in stored summaries.

use fiatlux_rules::Task;
use serde::{Deserialize as _, Deserializer};

/// The id or the name of a subtask. Under this name it does not borrow from the text that it is read from.
pub(super) type Word = &'static str;

/// Reads the id or the name of a subtask.
pub(super) fn task_word<'de, D: Deserializer<'de>>(from: D) -> Result<Word, D::Error> {
    let text = String::deserialize(from)?;
    let words = Task::SUBTASKS.into_iter().flat_map(|task| [task.short_id(), task.name()]);
    let found = words.into_iter().find(|word| *word == text);
    found.ok_or_else(|| serde::de::Error::custom(format!("'{text}' is not a subtask")))
}
