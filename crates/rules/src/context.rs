//! The view of a row that predicates get, and the criteria made of them.

use crate::geometry::Geometry;
use crate::parts::Bulb;
use crate::row::Row;
use crate::settle::PoseSpeed;
use crate::thresholds::Thresholds;

/// Inputs of a predicate besides the row.
#[derive(Debug, Clone, Copy)]
pub struct Context<'a> {
    /// Figures to compare with.
    pub thresholds: &'a Thresholds,
    /// Places and sizes in the scene that predicates measure against.
    pub geometry: &'a Geometry,
    /// Low-passed speeds of both bulbs, by [`Bulb`].
    pub bulb_speeds: [PoseSpeed; 2],
    /// Low-passed speeds of the bulbs in the frames of the palms, by [`Bulb`], then left and right, m/s.
    pub grip_speeds: [[f64; 2]; 2],
    /// Heights below which the bulbs count as dropped in this task, by [`Bulb`], m.
    pub drop_heights: [f64; 2],
}

impl<'a> Context<'a> {
    /// The context of a task, with bulbs that do not move. `fresh_drop_m` is the height below which the task's fresh bulb
    /// counts as dropped.
    pub(crate) fn at_rest(fresh_drop_m: f64, thresholds: &'a Thresholds, geometry: &'a Geometry) -> Self {
        let drop_heights = [thresholds.old_drop_m, fresh_drop_m];
        Self { thresholds, geometry, bulb_speeds: Default::default(), grip_speeds: Default::default(), drop_heights }
    }

    /// Low-passed speeds of a bulb.
    pub fn bulb_speed(&self, bulb: Bulb) -> PoseSpeed {
        self.bulb_speeds[bulb as usize]
    }

    /// Height below which a bulb counts as dropped in this task, m.
    pub fn drop_height(&self, bulb: Bulb) -> f64 {
        self.drop_heights[bulb as usize]
    }
}

/// A gate of this rulebook.
pub type Gate = fiatlux_judge::Gate<Criterion>;

/// A predicate of a row.
pub type Predicate = fn(&Row, &Context<'_>) -> bool;

/// One condition of a gate.
#[derive(Debug, Clone, Copy)]
pub struct Criterion {
    /// Name of the criterion in results, such as those of `results.json`.
    pub name: &'static str,
    /// Its predicate.
    pub holds: Predicate,
}
