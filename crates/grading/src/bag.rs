//! Reads one bag and passes it to the grader.

use std::path::Path;

use fiatlux_access::PublicKey;
use fiatlux_bag::{Bag, BagError, Completeness, Patience};
use fiatlux_cli::in_full;
use fiatlux_rules::{Relay, Task};
use fiatlux_wire::{layout_of, read_row};

use crate::GradeOptions;
use crate::assemble::BagContent;
use crate::episode::Grader;
use crate::results::Fault;

/// Grades a bag by the published thresholds; returns the key of the server that signed it, if any. Of a thin bag it checks all but the
/// rows, which a second run shows.
///
/// # Errors
/// The reason why the bag would not be scored: it cannot be read, is cut, or contradicts itself.
pub fn check_bag(path: &Path) -> Result<Option<PublicKey>, String> {
    let bag = Bag::open(path).map_err(|error| in_full(&error))?;
    if bag.is_thin() {
        if let Completeness::Cut { reason, .. } = bag.completeness() {
            return Err(reason.clone());
        }
        if is_replay(&bag) {
            return Err(REPLAY.into());
        }
        bag.check().map_err(|error| in_full(&error))?;
        let grader = Grader::new(bag.header(), &[], false).map_err(|error| in_full(&error))?;
        let actions = bag.actions().try_fold(0, |count: u64, action| action.map(|_| count + 1));
        let actions = actions.map_err(|error| in_full(&error))?;
        return grader.finish_without_rows(bag.result(), actions).map_err(|flaw| flaw.to_string());
    }
    let content = read(path, &GradeOptions::default(), None).map_err(|ungraded| match ungraded {
        Ungraded::Excluded(_, reason) => reason,
        Ungraded::Machine(error) => in_full(&error),
    })?;
    let flaw = content.graded.flaw.as_ref();
    match content.damage.map(|(_, why)| why).or_else(|| flaw.map(ToString::to_string)) {
        Some(reason) => Err(reason),
        None => Ok(content.graded.signer),
    }
}

const REPLAY: &str = "it records a replay, which serves comparison only and is never scored";

fn is_replay(bag: &Bag) -> bool {
    bag.header().request.as_ref().is_some_and(|request| request.replay)
}

/// The reason for which a bag has no grade.
pub(crate) enum Ungraded {
    Excluded(Fault, String),
    /// The machine failed, see [`BagError::is_of_machine`]: the bag may be as good as any.
    Machine(BagError),
}

/// For each action of a relay's bag the subtask that it belongs to; one that held for want of another belongs to the same. Damaged actions
/// and those behind them are left out: whatever reads the whole bag finds them.
///
/// # Errors
/// [`Ungraded::Machine`].
fn of_relay(bag: &Bag) -> Result<Vec<Option<Task>>, Ungraded> {
    let (mut tasks, mut last) = (Vec::new(), None);
    if Relay::of(&bag.header().policy).is_none() {
        return Ok(tasks);
    }
    for record in bag.actions() {
        match record {
            Ok(record) => {
                if let Some(chunk) = record.action.and_then(|action| action.chunk) {
                    last = Relay::task_of(&chunk.phase);
                }
                tasks.push(last);
            }
            Err(error) if error.is_of_machine() => return Err(Ungraded::Machine(error)),
            Err(_) => break,
        }
    }
    Ok(tasks)
}

/// Grades a bag up to its end, or to the first record that cannot be read.
pub(crate) fn read(path: &Path, options: &GradeOptions, patience: Option<Patience>) -> Result<BagContent, Ungraded> {
    // The message must not depend on the folder from which the bag was graded.
    let folder = path.parent().map(|folder| folder.join("").display().to_string()).filter(|folder| !folder.is_empty());
    let in_full = |error: &dyn std::error::Error| match &folder {
        Some(folder) => in_full(error).replace(folder, ""),
        None => in_full(error),
    };
    let unreadable = |error: &dyn std::error::Error| Ungraded::Excluded(Fault::Unreadable, in_full(error));
    let damaged = |error: BagError| match error {
        error if error.is_of_machine() => Err(Ungraded::Machine(error)),
        BagError::Slow { .. } | BagError::Unable { .. } => Ok((Fault::Unreadable, in_full(&error))),
        _ => Ok((Fault::Altered, in_full(&error))),
    };
    let bag = Bag::open(path).map_err(|error| match error.is_of_machine() {
        true => Ungraded::Machine(error),
        false => unreadable(&error),
    })?;
    let bag = bag.with_patience(patience);
    let header = bag.header();
    if is_replay(&bag) {
        return Err(Ungraded::Excluded(Fault::Unreadable, REPLAY.into()));
    }
    let mut grader =
        Grader::new(header, &options.set, options.published_counting).map_err(|error| unreadable(&error))?;
    let layout = layout_of(header).map_err(|error| unreadable(&error))?;
    let mut damage = match bag.completeness() {
        Completeness::Whole => None,
        Completeness::Cut { reason, .. } => Some((Fault::Cut, reason.clone())),
    };
    let mut played = of_relay(&bag)?.into_iter();
    let mut states = bag.states();
    let mut step = 0;
    while let Some(state) = states.next() {
        let state = match state {
            Ok(state) => state,
            Err(error) => {
                let found = damaged(error)?;
                damage.get_or_insert(found);
                break;
            }
        };
        let row = read_row(&state, layout);
        states.reuse(state);
        match row {
            Ok(row) => {
                // The last row has no action: it still belongs to the subtask before.
                if let Some(task) = played.next() {
                    grader.play(task);
                }
                grader.push(&row);
            }
            Err(error) => {
                grader.refuse(step, &error);
                break;
            }
        }
        step += 1;
    }
    if damage.is_none() {
        damage = bag.check_rest(&states.into_read()).err().map(damaged).transpose()?;
    }
    Ok(BagContent { header: header.clone(), damage, graded: grader.finish(bag.result()) })
}
