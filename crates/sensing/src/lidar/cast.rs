//! A ray against a box, a ball or a capsule.

use fiatlux_dynamics::Geometry;
use nalgebra::{Isometry3, Matrix3, Vector3};

/// A shape of a prop, in the prop's frame.
#[derive(Debug, Clone)]
pub(super) struct Target {
    prop_from_shape: Isometry3<f64>,
    form: Form,
    /// Half extents of its bounding box, in its own frame, m.
    half: Vector3<f64>,
}

#[derive(Debug, Clone, Copy)]
enum Form {
    Box,
    /// Along z; a ball where its half length is 0.
    Capsule {
        radius: f64,
        half_length: f64,
    },
}

impl Target {
    /// `None` for what has no bounds.
    pub fn new(geometry: &Geometry, prop_from_shape: Isometry3<f64>) -> Option<Self> {
        let capsule = |radius: f64, half_length: f64| {
            (Form::Capsule { radius, half_length }, Vector3::new(radius, radius, radius + half_length))
        };
        let (form, half) = match *geometry {
            Geometry::Cuboid { half_extents } => (Form::Box, half_extents),
            Geometry::Capsule { radius, half_length } => capsule(radius, half_length),
            Geometry::Sphere { radius } => capsule(radius, 0.0),
            Geometry::HalfSpace => return None,
        };
        Some(Self { prop_from_shape, form, half })
    }

    /// In the frame of a sensor.
    pub fn place(&self, sensor_from_prop: &Isometry3<f64>) -> Placed {
        let sensor_from_shape = sensor_from_prop * self.prop_from_shape;
        let center = sensor_from_shape.translation.vector;
        let axes = sensor_from_shape.rotation.to_rotation_matrix().into_inner();
        Placed { form: self.form, half: self.half, center, axes, eye: -axes.tr_mul(&center) }
    }
}

/// A shape in the frame of a sensor, whose rays start at the origin.
#[derive(Debug)]
pub(super) struct Placed {
    form: Form,
    half: Vector3<f64>,
    pub center: Vector3<f64>,
    /// The shape's axes as columns.
    axes: Matrix3<f64>,
    /// The sensor in the shape's frame.
    eye: Vector3<f64>,
}

impl Placed {
    /// A distance that the shape surely keeps from the sensor, m.
    pub fn gap(&self) -> f64 {
        self.center.norm() - self.half.norm()
    }

    /// Corners of the bounding box.
    pub fn corners(&self) -> [Vector3<f64>; 8] {
        std::array::from_fn(|corner| {
            let sign = |axis: usize| if corner >> axis & 1 == 0 { -1.0 } else { 1.0 };
            let local = Vector3::new(sign(0) * self.half.x, sign(1) * self.half.y, sign(2) * self.half.z);
            self.center + self.axes * local
        })
    }

    /// Distance along a unit vector, m; 0 from inside.
    pub fn cast(&self, direction: &Vector3<f64>) -> Option<f64> {
        let along = self.axes.tr_mul(direction);
        match self.form {
            Form::Box => cast_box(&self.eye, &along, &self.half),
            Form::Capsule { radius, half_length } => cast_capsule(&self.eye, &along, radius, half_length),
        }
    }
}

/// Where the ray has entered all three slabs, unless it has left one by then.
fn cast_box(eye: &Vector3<f64>, along: &Vector3<f64>, half: &Vector3<f64>) -> Option<f64> {
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
fn cast_capsule(eye: &Vector3<f64>, along: &Vector3<f64>, radius: f64, half_length: f64) -> Option<f64> {
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
