//! Finds the line of a value in a TOML text. Only used to word errors, so it parses the text again.

use toml::de::{DeTable, DeValue};

/// One step down into a document.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Step<'a> {
    Key(&'a str),
    Index(usize),
}

/// Line (from 1) of the byte at `offset`.
pub(crate) fn line_at(text: &str, offset: usize) -> usize {
    1 + text.bytes().take(offset).filter(|&b| b == b'\n').count()
}

/// Line of the value at `path`, or of the deepest part of `path` that exists.
pub(crate) fn line_of(text: &str, path: &[Step<'_>]) -> usize {
    let Ok(document) = DeTable::parse(text) else { return 1 };
    let Some((Step::Key(first), rest)) = path.split_first() else { return 1 };
    let Some((key, mut value)) = document.get_ref().get_key_value(*first) else { return 1 };
    let mut offset = key.span().start;
    for step in rest {
        let next = match (step, value.get_ref()) {
            (Step::Key(key), DeValue::Table(table)) => {
                table.get_key_value(*key).map(|(key, value)| (key.span().start, value))
            }
            (Step::Index(index), DeValue::Array(array)) => array.get(*index).map(|value| (value.span().start, value)),
            _ => None,
        };
        let Some((start, inner)) = next else { break };
        offset = start;
        value = inner;
    }
    line_at(text, offset)
}
