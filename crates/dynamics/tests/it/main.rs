//! The engine against closed forms and a peer, and what it refuses.
#![allow(clippy::unwrap_used, missing_docs)]

mod closed_forms;
mod contact_points;
mod coupling;
mod dense;
mod distances;
mod heap;
mod hulls;
mod mechanics;
mod refused;
mod rest;
mod rolling;
mod variation;

use fiatlux_dynamics::{Mechanics, Model, State};

/// Mass matrix of a state, row-major.
fn mass_matrix(model: &Model, state: &State) -> Vec<f64> {
    let (mut mechanics, mut matrix) = (Mechanics::new(model), vec![0.0; model.nv() * model.nv()]);
    mechanics.update_equation(model, state);
    mechanics.mass_matrix(model, &mut matrix);
    matrix
}
