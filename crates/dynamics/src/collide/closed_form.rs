//! Contact points between balls, capsules, boxes and half-spaces, in closed form.
//!
//! These pairs make up nearly all candidates, and closed forms cost a fraction of a general convex query; two boxes go to
//! parry (see the parent module), hulls to `polyhedra`. Everything here is a pure function of the two poses.

use nalgebra::Matrix3;

use crate::hull::Hull;
use crate::spatial::V3;

/// A shape's pose in the world; of the rotation, a capsule has only its axis (the third column) and a ball nothing.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Placed {
    pub rotation: Matrix3<f64>,
    pub position: V3,
}

/// A contact point before it knows its shapes: the normal points from the first shape to the second.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Point {
    pub position: V3,
    pub normal: V3,
    pub distance: f64,
}

impl Point {
    pub fn flipped(self) -> Self {
        Self { normal: -self.normal, ..self }
    }
}

/// Deepest points of a capsule on a box spread over what lies within this of the deepest one, m.
const FLAT_WITHIN: f64 = 5e-4;
/// Two capsules are parallel when the sine of the angle between them is below this.
const PARALLEL_SINE: f64 = 0.02;

/// Contact of two balls.
pub(crate) fn ball_ball(a: V3, radius_a: f64, b: V3, radius_b: f64, margin: f64, out: &mut impl FnMut(Point)) {
    let gap = b - a;
    let length_squared = gap.norm_squared();
    let reach = radius_a + radius_b + margin;
    if length_squared > reach * reach {
        return;
    }
    let length = length_squared.sqrt();
    // Concentric balls have no normal of their own; any will do.
    let normal = if length > 1e-12 { gap / length } else { V3::z() };
    let distance = length - radius_a - radius_b;
    out(Point { position: a + normal * (radius_a + 0.5 * distance), normal, distance });
}

/// Parameter in [-half, half] of the point of a segment nearest to `p`.
fn nearest_on_segment(centre: &V3, axis: &V3, half: f64, p: &V3) -> f64 {
    (p - centre).dot(axis).clamp(-half, half)
}

/// A ball (first) and a capsule.
pub(crate) fn ball_capsule(
    ball: V3,
    ball_radius: f64,
    capsule: &Placed,
    radius: f64,
    half: f64,
    margin: f64,
    out: &mut impl FnMut(Point),
) {
    let axis = capsule.rotation.column(2).into_owned();
    let t = nearest_on_segment(&capsule.position, &axis, half, &ball);
    ball_ball(ball, ball_radius, capsule.position + axis * t, radius, margin, out);
}

/// Two capsules: one point, or the two ends of the overlap when they are parallel.
pub(crate) fn capsule_capsule(
    (a, radius_a, half_a): (&Placed, f64, f64),
    (b, radius_b, half_b): (&Placed, f64, f64),
    margin: f64,
    out: &mut impl FnMut(Point),
) {
    let (axis_a, axis_b) = (a.rotation.column(2).into_owned(), b.rotation.column(2).into_owned());
    let between = b.position - a.position;
    let reach = half_a + half_b + radius_a + radius_b + margin;
    if between.norm_squared() > reach * reach {
        return;
    }
    let cosine = axis_a.dot(&axis_b);
    let (along_a, along_b) = (between.dot(&axis_a), between.dot(&axis_b));
    let sine_squared = 1.0 - cosine * cosine;
    if sine_squared > PARALLEL_SINE * PARALLEL_SINE {
        let s = ((along_a - cosine * along_b) / sine_squared).clamp(-half_a, half_a);
        let t = (s * cosine - along_b).clamp(-half_b, half_b);
        let s = (t * cosine + along_a).clamp(-half_a, half_a);
        ball_ball(a.position + axis_a * s, radius_a, b.position + axis_b * t, radius_b, margin, out);
        return;
    }
    // Overlap of b's segment with a's, in a's parameter.
    let (low, high) = (along_a - half_b, along_a + half_b);
    let (low, high) = (low.clamp(-half_a, half_a), high.clamp(-half_a, half_a));
    let mut at = |s: f64| {
        let p = a.position + axis_a * s;
        let t = nearest_on_segment(&b.position, &axis_b, half_b, &p);
        ball_ball(p, radius_a, b.position + axis_b * t, radius_b, margin, &mut *out);
    };
    at(low);
    if high > low {
        at(high);
    }
}

/// Signed distance of a point to a box about the origin, and the outward direction of its fastest growth.
pub(crate) fn box_distance(p: &V3, half: &V3) -> (f64, V3) {
    let excess = p.abs() - half;
    if excess.x <= 0.0 && excess.y <= 0.0 && excess.z <= 0.0 {
        return match excess.imax() {
            0 => (excess.x, V3::new(1.0_f64.copysign(p.x), 0.0, 0.0)),
            1 => (excess.y, V3::new(0.0, 1.0_f64.copysign(p.y), 0.0)),
            _ => (excess.z, V3::new(0.0, 0.0, 1.0_f64.copysign(p.z))),
        };
    }
    let outside = excess.sup(&V3::zeros());
    let distance = outside.norm();
    let direction = outside / distance;
    (distance, V3::new(direction.x.copysign(p.x), direction.y.copysign(p.y), direction.z.copysign(p.z)))
}

/// A convex body (first) by its signed distance in its own frame, and a ball.
pub(crate) fn convex_ball(
    convex: &Placed,
    signed_distance: impl Fn(&V3) -> (f64, V3),
    ball: V3,
    radius: f64,
    margin: f64,
    out: &mut impl FnMut(Point),
) {
    let local = convex.rotation.tr_mul(&(ball - convex.position));
    let (distance, normal) = signed_distance(&local);
    push_point(convex, ball, distance, &normal, radius, margin, out);
}

fn push_point(
    convex: &Placed,
    centre: V3,
    distance: f64,
    local_normal: &V3,
    radius: f64,
    margin: f64,
    out: &mut impl FnMut(Point),
) {
    let gap = distance - radius;
    if gap <= margin {
        let normal = convex.rotation * local_normal;
        out(Point { position: centre - normal * (radius + 0.5 * gap), normal, distance: gap });
    }
}

/// A convex body in its own frame, by its signed distance.
pub(crate) trait Convex {
    /// Signed distance of a point, and the outward direction of its fastest growth.
    fn distance(&self, p: &V3) -> (f64, V3);

    /// True if a point is at most this far away.
    #[inline(always)]
    fn is_within(&self, p: &V3, level: f64) -> bool {
        self.distance(p).0 <= level
    }

    /// True if the distance does not shrink along an axis.
    #[inline(always)]
    fn grows(&self, p: &V3, axis: &V3) -> bool {
        self.distance(p).1.dot(axis) >= 0.0
    }

    /// False only if a capsule at `centre` along `axis` is farther away than `reach` from its segment.
    #[inline(always)]
    fn may_reach(&self, centre: &V3, _axis: &V3, half_length: f64, reach: f64) -> bool {
        self.distance(centre).0 <= half_length + reach
    }
}

impl Convex for Hull {
    fn distance(&self, p: &V3) -> (f64, V3) {
        self.distance(p)
    }
}

/// Part of a number that rounding changes by less.
const ROUNDING: f64 = 1e-12;

/// A box about the origin. Comparisons do without root and division, unless rounding could decide them.
pub(crate) struct BoxAt<'a> {
    pub half: &'a V3,
}

impl Convex for BoxAt<'_> {
    #[inline(always)]
    fn distance(&self, p: &V3) -> (f64, V3) {
        box_distance(p, self.half)
    }

    #[inline(always)]
    fn is_within(&self, p: &V3, level: f64) -> bool {
        let square = (p.abs() - self.half).sup(&V3::zeros()).norm_squared();
        let limit = level * level;
        let is_clear = (square - limit).abs() > ROUNDING * limit;
        if is_clear & (level > 0.0) { square < limit } else { self.distance(p).0 <= level }
    }

    #[inline(always)]
    fn grows(&self, p: &V3, axis: &V3) -> bool {
        let outside = (p.abs() - self.half).sup(&V3::zeros());
        let [x, y, z] = [0, 1, 2].map(|k| outside[k].copysign(p[k]) * axis[k]);
        let slope = x + y + z;
        // A point inside has a slope of zero here.
        let is_clear = slope.abs() > ROUNDING * (x.abs() + y.abs() + z.abs());
        if is_clear { slope > 0.0 } else { self.distance(p).1.dot(axis) >= 0.0 }
    }

    #[inline(always)]
    fn may_reach(&self, centre: &V3, axis: &V3, half_length: f64, reach: f64) -> bool {
        let gap = centre.abs() - self.half - axis.abs() * half_length;
        let limit = reach + ROUNDING;
        (gap.x <= limit) & (gap.y <= limit) & (gap.z <= limit)
    }
}

/// A convex body (first) and a capsule: the ends of the stretch of the capsule that lies within [`FLAT_WITHIN`] of its deepest
/// point, or that point alone.
pub(crate) fn convex_capsule(
    convex: &Placed,
    body: &impl Convex,
    capsule: &Placed,
    radius: f64,
    half_length: f64,
    margin: f64,
    out: &mut impl FnMut(Point),
) {
    let centre = convex.rotation.tr_mul(&(capsule.position - convex.position));
    let axis = convex.rotation.tr_mul(&capsule.rotation.column(2));
    if !body.may_reach(&centre, &axis, half_length, radius + margin) {
        return;
    }
    let at = |t: f64| centre + axis * t;
    let grows = |t: f64| body.grows(&at(t), &axis);
    // The distance to a convex set is convex along a line, so its slope changes sign once.
    let deepest = if grows(-half_length) {
        -half_length
    } else if body.distance(&at(half_length)).1.dot(&axis) <= 0.0 {
        half_length
    } else {
        bisect(-half_length, half_length, grows)
    };
    let least = body.distance(&at(deepest)).0;
    if least - radius > margin {
        return;
    }
    let level = least + FLAT_WITHIN;
    let is_within = |t: f64| body.is_within(&at(t), level);
    let low = if is_within(-half_length) { -half_length } else { bisect(-half_length, deepest, is_within) };
    let high = if is_within(half_length) { half_length } else { bisect(deepest, half_length, |t| !is_within(t)) };
    let mut push = |t: f64| {
        let (distance, normal) = body.distance(&at(t));
        push_point(convex, capsule.position + capsule.rotation.column(2) * t, distance, &normal, radius, margin, out);
    };
    if high - low < 0.5 * radius {
        push(deepest);
    } else {
        push(low);
        push(high);
    }
}

/// Where a predicate turns from false (at `low`) to true (at `high`), to a 4096th of the interval.
#[inline(always)]
fn bisect(mut low: f64, mut high: f64, past: impl Fn(f64) -> bool) -> f64 {
    // Nobody foresees the way, so that bits are chosen by a mask, without a branch.
    let choose = |mask: u64, a: f64, b: f64| f64::from_bits(a.to_bits() & mask | b.to_bits() & !mask);
    for _ in 0..12 {
        let middle = 0.5 * (low + high);
        let mask = u64::from(past(middle)).wrapping_neg();
        high = choose(mask, middle, high);
        low = choose(mask, low, middle);
    }
    0.5 * (low + high)
}

/// A half-space (first) and a ball.
pub(crate) fn half_space_ball(plane: &Placed, ball: V3, radius: f64, margin: f64, out: &mut impl FnMut(Point)) {
    let normal = plane.rotation.column(2).into_owned();
    let distance = (ball - plane.position).dot(&normal) - radius;
    if distance <= margin {
        out(Point { position: ball - normal * (radius + 0.5 * distance), normal, distance });
    }
}

/// A half-space (first) and a capsule: its two ends.
pub(crate) fn half_space_capsule(
    plane: &Placed,
    capsule: &Placed,
    radius: f64,
    half: f64,
    margin: f64,
    out: &mut impl FnMut(Point),
) {
    let reach = capsule.rotation.column(2) * half;
    half_space_ball(plane, capsule.position - reach, radius, margin, out);
    half_space_ball(plane, capsule.position + reach, radius, margin, out);
}

/// A half-space (first) and a box: the corners of the box within the margin, four at most.
pub(crate) fn half_space_box(plane: &Placed, cuboid: &Placed, half: &V3, margin: f64, out: &mut impl FnMut(Point)) {
    let normal = plane.rotation.column(2).into_owned();
    let local_normal = cuboid.rotation.tr_mul(&normal);
    let centre = (cuboid.position - plane.position).dot(&normal);
    let steps = V3::new(local_normal.x * half.x, local_normal.y * half.y, local_normal.z * half.z);
    if centre - steps.abs().sum() > margin {
        return;
    }
    // The axis most along the normal tells the lower face; its four corners are the lowest four.
    let face = steps.iamax();
    for corner in 0..4 {
        let mut sign = V3::repeat(1.0);
        sign[face] = -1.0_f64.copysign(steps[face]);
        sign[(face + 1) % 3] = if corner & 1 == 0 { -1.0 } else { 1.0 };
        sign[(face + 2) % 3] = if corner & 2 == 0 { -1.0 } else { 1.0 };
        let distance = centre + sign.dot(&steps);
        if distance <= margin {
            let point = cuboid.position + cuboid.rotation * half.component_mul(&sign);
            out(Point { position: point - normal * (0.5 * distance), normal, distance });
        }
    }
}

#[cfg(test)]
mod tests;
