//! Takes what is sensed from messages, which carry f32.

use crate::{BODY, Sensed};

/// Terms of the standard observation, as messages carry them. [`Sensed`] says what they are.
#[derive(Debug, Clone, Copy)]
#[allow(missing_docs)]
pub struct SensedTerms<'a> {
    pub base_angular_velocity: &'a [f32],
    pub projected_gravity: &'a [f32],
    pub base_linear_velocity: &'a [f32],
    pub base_height: f32,
    pub joint_position: &'a [f32],
    pub joint_velocity: &'a [f32],
}

/// Converts terms for controllers, into memory that it keeps.
#[derive(Debug, Clone)]
pub struct Senses {
    /// Joint positions relative to the standing posture, rad.
    position: Vec<f64>,
    velocity: Vec<f64>,
}

impl Default for Senses {
    fn default() -> Self {
        let room = || Vec::with_capacity(BODY);
        Self { position: room(), velocity: room() }
    }
}

impl Senses {
    /// What legs, waist and arms sense. A term that is too short becomes NaN or stays short, so that the controller refuses it
    /// by its name.
    pub fn read(&mut self, terms: &SensedTerms<'_>) -> Sensed<'_> {
        let copy = |to: &mut Vec<f64>, from: &[f32]| {
            to.clear();
            to.extend(from.iter().take(BODY).map(|number| f64::from(*number)));
        };
        copy(&mut self.position, terms.joint_position);
        copy(&mut self.velocity, terms.joint_velocity);
        Sensed {
            base_angular_velocity: vector(terms.base_angular_velocity),
            projected_gravity: vector(terms.projected_gravity),
            base_linear_velocity: vector(terms.base_linear_velocity),
            base_height: f64::from(terms.base_height),
            joint_position: &self.position,
            joint_velocity: &self.velocity,
        }
    }
}

fn vector(term: &[f32]) -> [f64; 3] {
    [0, 1, 2].map(|axis| term.get(axis).map_or(f64::NAN, |&value| f64::from(value)))
}
