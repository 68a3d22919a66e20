//! The reasons why an episode is not scored.

use fiatlux_proto::plain;
use fiatlux_rules::Row;
use serde::Serialize;
use serde_json::Value;

/// Maximum length of a value in a message, characters.
const MAX_SHOWN: usize = 80;

/// The reason why an episode is listed, but not scored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Flaw {
    Aborted,
    Unended,
    /// Rows are missing, or do not reach the end.
    Gap(String),
    /// Its result has no digest of a header.
    Unbound,
    /// The result was made under another header.
    Header {
        header: String,
        result: String,
    },
    /// The digest chain starts from another episode than the header describes.
    Identity {
        /// Start of the chain, computed from task, seeds, drives, thresholds and the rest of the header.
        found: String,
        /// The `digest_context` that the header claims.
        said: String,
    },
    /// The request in the header asks for another episode than the rest of the header describes.
    Request(Difference),
    /// No server plays its request, for this reason.
    Unplayable(String),
    /// The signature does not belong to the result.
    Signature,
    Altered {
        rows: String,
        result: String,
    },
    Result(Difference),
    /// A row lacks a number, or has an impossible one.
    Row {
        step: u64,
        problem: String,
    },
    /// The sum of squared actions is not finite.
    NotFinite,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference {
    /// Path of the field, with dots between its parts.
    pub field: String,
    /// Its value by the rows, or in a second run.
    pub found: String,
    /// Its value in the bag.
    pub recorded: String,
}

impl std::fmt::Display for Flaw {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let short = |digest: &str| digest.chars().take(12).collect::<String>();
        match self {
            Flaw::Aborted => f.write_str("the episode was stopped before its end"),
            Flaw::Unended => f.write_str("the recording has no result"),
            Flaw::Gap(what) => f.write_str(what),
            Flaw::Unbound => f.write_str(
                "its result has no header_digest, so nothing shows that its header was not changed; grade it with the scorer \
                 of its own version, or record the episode again",
            ),
            Flaw::Header { header, result } => {
                let (header, result) = (short(header), short(result));
                write!(f, "the bag's header was changed: it has digest {header}, its result says {result}")
            }
            Flaw::Identity { found, said } => {
                let (found, said) = (short(found), short(said));
                write!(
                    f,
                    "the bag's header was changed: its task, seeds, drives, thresholds and ends make digest_context {found}, \
                     it says {said}"
                )
            }
            Flaw::Request(Difference { field, found, recorded }) => write!(
                f,
                "the bag's header contradicts itself: {field} is {found} by the request in it, and {recorded} in the header"
            ),
            Flaw::Unplayable(reason) => write!(f, "no server plays the request in the header: {reason}"),
            Flaw::Signature => f.write_str(
                "its signature does not fit its result: one of the two was changed, or the signature is of another bag",
            ),
            Flaw::Altered { rows, result } => {
                let (rows, result) = (short(rows), short(result));
                write!(f, "the bag's numbers were changed: its rows have digest {rows}, its result says {result}")
            }
            Flaw::Result(Difference { field, found, recorded }) => {
                write!(f, "the bag's result was changed: {field} is {found} by its rows, its result says {recorded}")
            }
            Flaw::Row { step, problem } => write!(f, "row {step} cannot be judged: {problem}"),
            Flaw::NotFinite => f.write_str("its control effort is not finite"),
        }
    }
}

/// Sums over rows that no judge computes.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct RowSums {
    pub unconverged: u64,
    pub steps_outside_box: u64,
    pub reward: f64,
}

impl RowSums {
    pub fn push(&mut self, row: &Row) {
        self.unconverged += u64::from(row.unconverged);
        // The action of row 0 is the staged posture.
        let outside_box = row.step > 0 && row.action.iter().any(|number| number.abs() > 1.0);
        self.steps_outside_box += u64::from(outside_box);
    }
}

/// The first field in which two messages differ, under its name in the protocol.
pub fn first_difference<M: Serialize + PartialEq>(found: &M, recorded: &M) -> Option<Difference> {
    if found == recorded {
        return None;
    }
    let value = |message| serde_json::to_value(message).unwrap_or_default();
    differing("", &value(found), &value(recorded))
}

fn differing(path: &str, found: &Value, recorded: &Value) -> Option<Difference> {
    let below = |name: &str| if path.is_empty() { name.to_owned() } else { format!("{path}.{name}") };
    match (found, recorded) {
        (Value::Object(a), Value::Object(b)) => {
            let names = a.keys().chain(b.keys().filter(|name| !a.contains_key(*name)));
            let get = |map: &serde_json::Map<String, Value>, name| map.get(name).cloned().unwrap_or_default();
            names.into_iter().find_map(|name| differing(&below(name), &get(a, name), &get(b, name)))
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            let pairs = a.iter().zip(b).enumerate();
            pairs.into_iter().find_map(|(index, (a, b))| differing(&format!("{path}[{index}]"), a, b))
        }
        (Value::Array(a), Value::Array(b)) if a.iter().chain(b).any(Value::is_object) => {
            let (field, found, recorded) = (format!("number of {path}"), a.len().to_string(), b.len().to_string());
            Some(Difference { field, found, recorded })
        }
        _ if found == recorded => None,
        _ => Some(Difference { field: path.to_owned(), found: shown(found), recorded: shown(recorded) }),
    }
}

fn shown(value: &Value) -> String {
    let text = match value {
        Value::Null => "nothing".to_owned(),
        Value::String(text) if !text.is_empty() => plain(text).into_owned(),
        other => other.to_string(),
    };
    if text.chars().count() <= MAX_SHOWN { text } else { text.chars().take(MAX_SHOWN).collect::<String>() + "..." }
}
