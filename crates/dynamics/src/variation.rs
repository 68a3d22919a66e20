//! Deviations of one world from the model that it shares with others, for training on varied bodies, drives and surfaces.

use std::sync::Arc;

use nalgebra::Vector3;

use crate::check::{check_finite, check_friction, check_value};
use crate::error::ModelError;
use crate::inverse_weights::inverse_weights;
use crate::model::Model;
use crate::parameters::{Parameters, new_id};
use crate::spec::{BodyId, ShapeId};

/// Differences of one world from its model, for [`Dynamics::set_variation`](crate::Dynamics::set_variation). What is not
/// listed stays nominal; of two entries for one part the later one holds.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Variation {
    /// Mass properties, by body.
    pub bodies: Vec<(BodyId, BodyVariation)>,
    /// Drives, by the body that each moves.
    pub drives: Vec<(BodyId, DriveVariation)>,
    /// Coefficient of friction in place of the shape's own, at least 0. The priority of its material stays.
    pub frictions: Vec<(ShapeId, f64)>,
    /// Gravity in place of the model's, world, m/s^2.
    pub gravity: Option<Vector3<f64>>,
}

/// A body's mass properties relative to the nominal ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodyVariation {
    /// Factor of mass and inertia, above 0: the shape stays and the density changes.
    pub mass: f64,
    /// Shift of the centre of mass in the body's frame, m. The inertia about it stays.
    pub com_offset: Vector3<f64>,
}

/// A drive's gains as factors of the nominal ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriveVariation {
    /// Factor of the stiffness, at least 0.
    pub stiffness: f64,
    /// Factor of the damping, at least 0.
    pub damping: f64,
    /// Factor of the effort limit, above 0.
    pub effort_limit: f64,
}

/// A variation worked out for one model, for many worlds to share and to take turns with
/// ([`Dynamics::vary`](crate::Dynamics::vary)). The default changes nothing.
#[derive(Debug, Clone, Default)]
pub struct PreparedVariation(pub(crate) Option<Arc<Parameters>>);

impl Default for BodyVariation {
    fn default() -> Self {
        Self { mass: 1.0, com_offset: Vector3::zeros() }
    }
}

impl Default for DriveVariation {
    fn default() -> Self {
        Self { stiffness: 1.0, damping: 1.0, effort_limit: 1.0 }
    }
}

impl Variation {
    /// True if it changes nothing.
    fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Works it out for a model. That takes about as long as building the model's constants.
    ///
    /// # Errors
    /// A body, shape or drive that the model lacks, or a number that is not finite or out of range.
    pub fn prepare(&self, model: &Model) -> Result<PreparedVariation, ModelError> {
        let parameters = if self.is_empty() { None } else { Some(Arc::new(self.parameters(model)?)) };
        Ok(PreparedVariation(parameters))
    }

    /// The parameters of a world of that model.
    fn parameters(&self, model: &Model) -> Result<Parameters, ModelError> {
        let (nominal, mut varied) = (&model.nominal, model.nominal.clone());
        for &(id, variation) in &self.bodies {
            let name = &model.bodies.get(id.0).ok_or_else(|| missing("body", id.0))?.spec.name;
            if id == BodyId::WORLD {
                return Err(structure("body", name, "the world has no mass; vary a body that moves"));
            }
            let (from, to) = (&nominal.bodies[id.0], &mut varied.bodies[id.0]);
            to.mass = scaled(name, "mass variation", from.mass, variation.mass, f64::MIN_POSITIVE)?;
            to.inertia = from.inertia * variation.mass;
            to.com = from.com + variation.com_offset;
            check_finite("body", name, "varied inertia", to.inertia.as_slice())?;
            let moment = to.inertia.diagonal().min();
            check_value(
                "body",
                name,
                "varied inertia",
                moment,
                moment >= f64::MIN_POSITIVE,
                "every moment must be positive",
            )?;
            check_finite("body", name, "com_offset", variation.com_offset.as_slice())?;
            check_finite("body", name, "varied com", to.com.as_slice())?;
        }
        for &(id, variation) in &self.drives {
            let name = &model.bodies.get(id.0).ok_or_else(|| missing("body", id.0))?.spec.name;
            let Some(index) = nominal.drives.iter().position(|(body, _)| *body == id) else {
                return Err(structure("body", name, "it has no drive; vary a drive that the model has"));
            };
            let (from, to) = (&nominal.drives[index].1, &mut varied.drives[index].1);
            to.stiffness = scaled(name, "stiffness variation", from.stiffness, variation.stiffness, 0.0)?;
            to.damping = scaled(name, "damping variation", from.damping, variation.damping, 0.0)?;
            let (limit, factor) = (from.effort_limit, variation.effort_limit);
            to.effort_limit = scaled(name, "effort_limit variation", limit, factor, f64::MIN_POSITIVE)?;
        }
        for &(id, friction) in &self.frictions {
            let name = &model.shapes.get(id.0).ok_or_else(|| missing("shape", id.0))?.name;
            check_friction(name, friction)?;
            varied.materials[id.0].friction = friction;
        }
        if let Some(gravity) = self.gravity {
            check_finite("model", "world", "varied gravity", gravity.as_slice())?;
            varied.gravity = gravity;
        }
        varied.id = new_id();
        varied.inverse_weights = inverse_weights(model, &varied);
        Ok(varied)
    }
}

/// `value` times a factor. Both the factor and the product are at least `least`; an infinite value stays infinite.
fn scaled(name: &str, field: &'static str, value: f64, factor: f64, least: f64) -> Result<f64, ModelError> {
    let product = value * factor;
    let ok = factor.is_finite() && factor >= least && product >= least && product.is_finite() == value.is_finite();
    let rule = if least > 0.0 {
        "the factor must be positive and finite, and so must its product with the nominal value"
    } else {
        "the factor must be finite and not negative, and its product with the nominal value finite"
    };
    check_value("body", name, field, factor, ok, rule)?;
    Ok(product)
}

fn structure(part: &'static str, name: &str, reason: &str) -> ModelError {
    ModelError::Structure { part, name: name.into(), reason: reason.into() }
}

fn missing(part: &'static str, index: usize) -> ModelError {
    structure(part, &format!("{part} {index}"), "the model that is varied does not have it")
}
