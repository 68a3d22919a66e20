//! Observations of messages as numbers, in the order and with the names that environments have.

use fiatlux_batch::Field;
use fiatlux_proto::v3::{Observation, ObservationTerm};

use crate::build;

/// The place of a term in a field of the observation.
struct Part {
    sensor: String,
    field: String,
    offset: usize,
    length: usize,
}

/// The numbers of the latest observation.
#[derive(Default)]
pub(crate) struct Numbers {
    terms: Vec<Part>,
    /// A term that is not due keeps its last numbers.
    latest: Vec<f32>,
}

impl Numbers {
    /// Zeros, for these terms.
    pub fn new<'a>(terms: impl Iterator<Item = &'a ObservationTerm>) -> Self {
        let part = |term: &ObservationTerm| Part {
            sensor: term.sensor.clone(),
            field: term.field.clone(),
            offset: term.offset as usize,
            length: term.length(),
        };
        let terms: Vec<_> = terms.map(part).collect();
        let latest = vec![0.0; terms.iter().map(|term| term.length).sum()];
        Self { terms, latest }
    }

    pub fn latest(&self) -> &[f32] {
        &self.latest
    }

    /// Takes over an observation.
    pub fn take(&mut self, observation: &Observation) {
        let mut rest = self.latest.as_mut_slice();
        for sensor in self.terms.chunk_by(|one, next| one.sensor == next.sensor) {
            let (mut found, mut is_due) = (Vec::new(), false);
            let mut field: (&str, Vec<f64>) = ("", Vec::new());
            for part in sensor {
                if field.0 != part.field {
                    field = (&part.field, observation.numbers(&part.field));
                }
                is_due |= !field.1.is_empty();
                match field.1.get(part.offset..part.offset + part.length) {
                    Some(numbers) => found.extend(numbers.iter().map(|number| *number as f32)),
                    // A single number is not sent if it is zero.
                    None => found.resize(found.len() + part.length, 0.0),
                }
            }
            let (places, others) = rest.split_at_mut(found.len());
            rest = others;
            if is_due {
                places.copy_from_slice(&found);
            }
        }
    }
}

/// A term as an environment's field.
pub(crate) fn described(term: &ObservationTerm) -> (String, Vec<usize>, f32, f32, bool) {
    let shape: Vec<usize> = term.shape.iter().map(|extent| *extent as usize).collect();
    build::described(&Field::of_sensor(&term.sensor, &term.name, &shape, [term.low, term.high], term.noise, term.scale))
}
