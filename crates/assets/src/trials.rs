//! The trials: a list for the objects at hand, each a simulation of its own.

mod drop;
mod fit;
mod joint;
mod load;
mod settle;
mod socket;

use fiatlux_world::{Object, Role, SceneConfig};
use serde::Serialize;

use crate::error::TrialError;

/// A row of the paper's table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Check {
    /// Settles under gravity.
    BasicPhysics,
    /// A bulb falls onto a plate.
    BulbDrop,
    /// Insertion and extraction by force.
    BulbSocket,
    /// A ladder under a load and a push.
    LadderLoad,
    /// Ladder, bulb and socket in rooms.
    SceneFit,
    /// Each joint from limit to limit.
    JointMotion,
}

/// One trial and its outcome.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Trial {
    /// The row that it counts in.
    pub check: Check,
    /// Names of the objects.
    pub objects: Vec<String>,
    /// Its distinction from other trials of these objects.
    pub case: String,
    /// It passed.
    pub passed: bool,
    /// Measured values by name, with their units.
    pub measures: Vec<(String, f64)>,
    /// The failures; empty if it passed.
    pub reason: String,
}

/// Collects the bounds that a trial breaks.
#[derive(Debug, Default)]
struct Findings {
    measures: Vec<(String, f64)>,
    broken: Vec<String>,
}

impl Findings {
    fn measure(&mut self, name: &str, value: f64) {
        self.measures.push((name.into(), value));
    }

    /// Notes a value that must be within bounds; NaN is outside.
    fn within(&mut self, name: &str, value: f64, low: f64, high: f64) {
        self.measure(name, value);
        if !(low..=high).contains(&value) {
            self.broken.push(format!("{name} is {value:.4}, outside {low} to {high}"));
        }
    }

    fn require(&mut self, ok: bool, problem: &str) {
        if !ok {
            self.broken.push(problem.into());
        }
    }

    fn trial(self, check: Check, objects: &[&Object], case: String) -> Trial {
        let objects = objects.iter().map(|object| object.name.clone()).collect();
        let reason = self.broken.join("; ");
        Trial { check, objects, case, passed: reason.is_empty(), measures: self.measures, reason }
    }
}

/// Makes all trials of some objects in the published scene: each one settles, bulbs drop, plug into each fixture, ladders bear
/// loads, ladder, bulb and fixture go into rooms together, joints turn.
///
/// # Errors
/// [`TrialError`] for an object that the engine does not take.
pub fn trials(objects: &[Object]) -> Result<Vec<Trial>, TrialError> {
    let config = SceneConfig::default();
    let of = |role: Role| objects.iter().filter(move |object| object.role == role);
    let mut done = Vec::new();
    for object in objects {
        done.extend(settle::trials(&config, object)?);
    }
    for bulb in of(Role::Bulb) {
        done.extend(drop::trials(&config, bulb)?);
    }
    for (bulb, fixture) in of(Role::Bulb).flat_map(|bulb| of(Role::Fixture).map(move |fixture| (bulb, fixture))) {
        done.extend(socket::trials(&config, bulb, fixture)?);
    }
    for ladder in of(Role::Ladder) {
        done.extend(load::trials(&config, ladder)?);
    }
    for ((ladder, bulb), fixture) in of(Role::Ladder).zip(of(Role::Bulb)).zip(of(Role::Fixture)) {
        done.extend(fit::trials(&config, ladder, bulb, fixture)?);
    }
    for object in objects {
        done.extend(joint::trials(&config, object)?);
    }
    Ok(done)
}

#[cfg(test)]
mod tests;
