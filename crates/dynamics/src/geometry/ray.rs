//! A ray against a box or a capsule. A ball is a capsule of no length.

use nalgebra::Vector3;

/// Where the ray has entered all three slabs, unless it has left one by then.
pub(super) fn cuboid(eye: &Vector3<f64>, along: &Vector3<f64>, half: &Vector3<f64>) -> Option<f64> {
    let (mut enter, mut leave) = (0.0_f64, f64::INFINITY);
    for axis in 0..3 {
        // Infinite along a face, which the comparisons bear.
        let inverse = 1.0 / along[axis];
        let (a, b) = ((-half[axis] - eye[axis]) * inverse, (half[axis] - eye[axis]) * inverse);
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    (enter <= leave).then_some(enter)
}

/// Where the ray first enters the tube between the caps' centres or one of the two balls. From inside, no entry lies
/// ahead that is not inside as well, so that case is told apart first.
pub(super) fn capsule(eye: &Vector3<f64>, along: &Vector3<f64>, radius: f64, half_length: f64) -> Option<f64> {
    let square = radius * radius;
    let beside = Vector3::new(eye.x, eye.y, eye.z - eye.z.clamp(-half_length, half_length));
    if beside.norm_squared() <= square {
        return Some(0.0);
    }
    let tube = {
        let (a, b) = (along.x * along.x + along.y * along.y, eye.x * along.x + eye.y * along.y);
        let c = eye.x * eye.x + eye.y * eye.y - square;
        first_root(a, b, c).filter(|distance| (eye.z + distance * along.z).abs() <= half_length)
    };
    if tube.is_some() {
        return tube;
    }
    let ball = |z: f64| {
        let from = Vector3::new(eye.x, eye.y, eye.z - z);
        first_root(1.0, from.dot(along), from.norm_squared() - square)
    };
    match (ball(-half_length), ball(half_length)) {
        (Some(a), Some(b)) => Some(a.min(b)),
        (a, b) => a.or(b),
    }
}

/// The smaller root of a x^2 + 2 b x + c, where it is not negative.
fn first_root(a: f64, b: f64, c: f64) -> Option<f64> {
    let discriminant = b * b - a * c;
    (a > 0.0 && discriminant >= 0.0 && b < 0.0 && c >= 0.0).then(|| (-b - libm::sqrt(discriminant)) / a)
}
