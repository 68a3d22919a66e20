//! Nearest points by parry's general convex query.

use parry3d_f64::math::{Mat3, Pose, Rotation, Vector};
use parry3d_f64::query::details::contact_support_map_support_map;
use parry3d_f64::shape::SupportMap;

use super::closed_form::{Placed, Point};
use crate::spatial::V3;

/// Margin from which two polyhedra that do not overlap are asked for their nearest points, too, m. Slower ones cannot get deep
/// into each other in a step.
const FAST_MARGIN: f64 = 0.01;

/// The nearest points of two fast polyhedra that do not overlap. Clipping along the best axis finds no point, or not the one
/// that will meet, where the faces lie past each other: thin boxes as fast as kicking feet would be 40 mm deep in each other
/// a step later.
pub(super) fn nearest(
    a: &Placed,
    a_from_b: &Pose,
    shape_a: &impl SupportMap,
    shape_b: &impl SupportMap,
    margin: f64,
    out: &mut impl FnMut(Point),
) {
    if margin > FAST_MARGIN
        && let Some(nearest) = contact_support_map_support_map(a_from_b, shape_a, shape_b, margin)
    {
        let world = |v: Vector| a.rotation * V3::new(v.x, v.y, v.z);
        let (on_a, normal) = (a.position + world(nearest.point1), world(nearest.normal1));
        out(Point { position: on_a + normal * (0.5 * nearest.dist), normal, distance: nearest.dist });
    }
}

pub(super) fn vector(v: &V3) -> Vector {
    Vector::new(v.x, v.y, v.z)
}

/// Pose of the second in the frame of the first.
pub(super) fn pose_between(a: &Placed, b: &Placed) -> Pose {
    let rotation = a.rotation.tr_mul(&b.rotation);
    let translation = a.rotation.tr_mul(&(b.position - a.position));
    let columns = Mat3::from_cols(
        vector(&rotation.column(0).into_owned()),
        vector(&rotation.column(1).into_owned()),
        vector(&rotation.column(2).into_owned()),
    );
    Pose { rotation: Rotation::from_mat3(&columns), translation: vector(&translation) }
}
