//! Observations of messages as numbers, in the order and with the names that environments have.

use fiatlux_batch::Field;
use fiatlux_proto::v3::{self, Observation, ObservationTerm};
use fiatlux_rules::CONTROL_DT;

use crate::build;

/// A field as Python has it: name, shape, least and greatest value, and whether it is a picture.
type Described = (String, Vec<usize>, f32, f32, bool);

/// The terms of a sensor.
struct Sensed {
    parts: Vec<Part>,
    length: usize,
    /// Greatest age of its numbers, s, if they are not computed in every step.
    oldest: Option<f64>,
    /// The step of its numbers.
    taken_at: u64,
}

/// The place of a term in a field of the observation.
struct Part {
    field: String,
    offset: usize,
    length: usize,
    /// Its numbers are the bytes of a picture.
    is_picture: bool,
}

impl Part {
    /// Appends its numbers as environments have them: those of a picture as bytes, four to a word.
    fn put(&self, numbers: &[f64], words: &mut Vec<f32>) {
        if !self.is_picture {
            words.extend(numbers.iter().map(|number| *number as f32));
            return;
        }
        words.extend(numbers.chunks(size_of::<f32>()).map(|numbers| {
            let mut bytes = [0; size_of::<f32>()];
            bytes.iter_mut().zip(numbers).for_each(|(byte, number)| *byte = *number as u8);
            f32::from_ne_bytes(bytes)
        }));
    }
}

/// The numbers of the latest observation.
#[derive(Default)]
pub(crate) struct Numbers {
    sensors: Vec<Sensed>,
    /// A sensor that is not due keeps its last numbers; their age, s, comes after them. Pictures are bytes, four to a word.
    latest: Vec<f32>,
    fields: Vec<Described>,
}

impl Numbers {
    /// Zeros, for these terms of sensors with these rates.
    pub fn new(terms: &[ObservationTerm], rates: &[v3::Sensor]) -> Self {
        let (mut sensors, mut fields) = (Vec::new(), Vec::new());
        for terms in terms.chunk_by(|one, next| one.sensor == next.sensor) {
            let name = &terms[0].sensor;
            let oldest = rates.iter().find(|sensor| sensor.name == *name).and_then(oldest);
            let part = |term: &ObservationTerm| Part {
                field: term.field.clone(),
                offset: term.offset as usize,
                length: term.length(),
                is_picture: field(term).is_picture(),
            };
            fields.extend(terms.iter().map(|term| build::described(&field(term))));
            fields.extend(oldest.map(|oldest| build::described(&Field::of_age(name, oldest))));
            let length = terms.iter().map(|term| field(term).words()).sum();
            sensors.push(Sensed { parts: terms.iter().map(part).collect(), length, oldest, taken_at: 0 });
        }
        let count = sensors.iter().map(|sensor| sensor.length + usize::from(sensor.oldest.is_some())).sum();
        Self { sensors, latest: vec![0.0; count], fields }
    }

    /// The fields, in the order of the numbers.
    pub fn fields(&self) -> &[Described] {
        &self.fields
    }

    pub fn latest(&self) -> &[f32] {
        &self.latest
    }

    /// Takes over an observation.
    pub fn take(&mut self, observation: &Observation) {
        let mut rest = self.latest.as_mut_slice();
        for sensor in &mut self.sensors {
            let (mut found, mut is_due) = (Vec::new(), false);
            let mut field: (&str, Vec<f64>) = ("", Vec::new());
            for part in &sensor.parts {
                if field.0 != part.field {
                    field = (&part.field, observation.numbers(&part.field));
                }
                is_due |= !field.1.is_empty();
                match field.1.get(part.offset..part.offset + part.length) {
                    Some(numbers) => part.put(numbers, &mut found),
                    // A single number is not sent if it is zero.
                    None => part.put(&vec![0.0; part.length], &mut found),
                }
            }
            let (places, others) = rest.split_at_mut(sensor.length);
            rest = others;
            if is_due {
                places.copy_from_slice(&found);
                sensor.taken_at = observation.step;
            }
            if sensor.oldest.is_some() {
                let (age, others) = rest.split_at_mut(1);
                age[0] = (observation.step.saturating_sub(sensor.taken_at) as f64 * CONTROL_DT) as f32;
                rest = others;
            }
        }
    }
}

/// Greatest age of the numbers of a sensor, s, as environments have it; `None` if every observation has it.
fn oldest(sensor: &v3::Sensor) -> Option<f64> {
    let period = (1.0 / (CONTROL_DT * sensor.rate_hz)).round();
    match sensor.on_request {
        true => Some(f64::INFINITY),
        false => (sensor.rate_hz > 0.0 && period > 1.0).then_some((period - 1.0) * CONTROL_DT),
    }
}

/// A term as an environment's field.
fn field(term: &ObservationTerm) -> Field {
    let shape: Vec<usize> = term.shape.iter().map(|extent| *extent as usize).collect();
    Field::of_sensor(&term.sensor, &term.name, &shape, [term.low, term.high], term.noise, term.scale)
}
