//! Refused models, states and commands: each refusal names the part, the field and the rule.

use fiatlux_dynamics::*;
use nalgebra::{Isometry3, Matrix3, Vector3};

fn body() -> BodySpec {
    BodySpec {
        name: "arm".into(),
        parent: BodyId::WORLD,
        parent_from_body: Isometry3::identity(),
        joint: Joint::Hinge(Hinge {
            axis: Vector3::z_axis(),
            lower: -1.0,
            upper: 1.0,
            armature: 0.0,
            drive: Some(Drive { stiffness: 1.0, damping: 1.0, effort_limit: 1.0, speed_limit: f64::INFINITY }),
        }),
        mass: 1.0,
        com: Vector3::zeros(),
        inertia: Matrix3::identity(),
    }
}

fn shape() -> ShapeSpec {
    ShapeSpec {
        name: "ball".into(),
        body: BodyId(1),
        body_from_shape: Isometry3::identity(),
        geometry: Geometry::Sphere { radius: 0.1 },
        material: Material::new(1.0, 0),
        cull_group: 0,
        label: 0,
    }
}

fn hinge(edit: impl Fn(&mut Hinge)) -> BodySpec {
    let mut spec = body();
    if let Joint::Hinge(hinge) = &mut spec.joint {
        edit(hinge);
    }
    spec
}

fn refused<T: std::fmt::Debug>(result: Result<T, ModelError>, words: &[&str]) {
    let message = result.expect_err(&format!("{words:?} must be refused")).to_string();
    for word in words {
        assert!(message.contains(word), "'{message}' does not say '{word}'");
    }
}

#[test]
fn bodies() {
    let add = |spec: BodySpec| ModelBuilder::new().add_body(spec);
    refused(add(BodySpec { mass: -1.0, ..body() }), &["arm", "mass", "-1", "positive"]);
    refused(add(BodySpec { mass: f64::NAN, ..body() }), &["arm", "mass", "NaN"]);
    refused(add(BodySpec { com: Vector3::new(f64::INFINITY, 0.0, 0.0), ..body() }), &["arm", "com", "finite"]);
    refused(add(BodySpec { inertia: -Matrix3::identity(), ..body() }), &["inertia", "positive"]);
    let flat = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 3.0));
    refused(add(BodySpec { inertia: flat, ..body() }), &["inertia", "sum of the others"]);
    let skew = Matrix3::new(1.0, 0.5, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
    refused(add(BodySpec { inertia: skew, ..body() }), &["inertia", "symmetric"]);
    refused(add(BodySpec { parent: BodyId(7), ..body() }), &["arm", "parent 7", "add parents first"]);
    refused(add(hinge(|h| h.lower = 2.0)), &["arm", "lower", "below the upper limit"]);
    refused(add(hinge(|h| h.upper = f64::NAN)), &["arm", "lower"]);
    let nowhere = nalgebra::UnitVector3::new_unchecked(Vector3::new(f64::NAN, 0.0, 1.0));
    refused(add(hinge(|h| h.axis = nowhere)), &["arm", "axis", "finite"]);
    refused(add(hinge(|h| h.armature = -1.0)), &["arm", "armature", "negative"]);
    let drive = Drive { stiffness: 1.0, damping: 1.0, effort_limit: 1.0, speed_limit: f64::INFINITY };
    refused(add(hinge(|h| h.drive = Some(Drive { stiffness: -1.0, ..drive }))), &["arm", "stiffness"]);
    refused(add(hinge(|h| h.drive = Some(Drive { damping: f64::NAN, ..drive }))), &["arm", "damping"]);
    refused(add(hinge(|h| h.drive = Some(Drive { effort_limit: 0.0, ..drive }))), &["arm", "effort_limit"]);
}

#[test]
fn trees() {
    let mut builder = ModelBuilder::new();
    let arm = builder.add_body(body()).unwrap();
    refused(builder.add_body(body()), &["arm", "taken"]);
    let free = BodySpec { name: "free".into(), parent: arm, joint: Joint::Free, ..body() };
    refused(builder.add_body(free), &["free", "below the world"]);
    for number in 0..MAX_DOFS - 1 {
        builder.add_body(BodySpec { name: format!("link {number}"), ..body() }).unwrap();
    }
    refused(builder.add_body(BodySpec { name: "one more".into(), ..body() }), &["one more", "256"]);
    refused(ModelBuilder::new().build(), &["no body"]);
}

#[test]
fn shapes() {
    let add = |spec: ShapeSpec| {
        let mut builder = ModelBuilder::new();
        builder.add_body(body()).unwrap();
        builder.add_shape(spec)
    };
    refused(add(ShapeSpec { body: BodyId(9), ..shape() }), &["ball", "body does not exist"]);
    refused(add(ShapeSpec { geometry: Geometry::Sphere { radius: 0.0 }, ..shape() }), &["ball", "radius"]);
    refused(add(ShapeSpec { geometry: Geometry::HalfSpace, ..shape() }), &["half-space", "world"]);
    let flat = Geometry::Cuboid { half_extents: Vector3::new(0.1, -0.1, 0.1) };
    refused(add(ShapeSpec { geometry: flat, ..shape() }), &["half_extents", "-0.1"]);
    let rough = Material::new(-0.5, 0);
    refused(add(ShapeSpec { material: rough, ..shape() }), &["friction", "-0.5"]);
}

#[test]
fn hulls() {
    let corner = |k: usize| Vector3::new((k & 1) as f64, (k >> 1 & 1) as f64, (k >> 2 & 1) as f64);
    let cube: Vec<_> = (0..8).map(corner).collect();
    let new = |points: &[Vector3<f64>]| Hull::new("stone", points);
    assert!(new(&cube).is_ok());
    refused(new(&cube[..3]), &["stone", "vertices", "3 were given", "4 to 128"]);
    refused(new(&cube.repeat(17)), &["stone", "136 were given", "4 to 128"]);
    refused(new(&[cube[0], cube[1], cube[2], Vector3::new(0.0, f64::NAN, 1.0)]), &["stone", "vertices", "finite"]);
    for flat in [vec![cube[0]; 5], cube.iter().map(|p| p * 1e-5).collect(), cube.iter().map(|p| p * 1e9).collect()] {
        refused(new(&flat), &["stone", "between 1 mm and 1 km"]);
    }
    for height in [0.0, 1e-9, 1e-4] {
        let flat: Vec<_> = cube.iter().map(|p| Vector3::new(p.x, p.y, p.z * height)).collect();
        refused(new(&flat), &["stone", "nearly flat", "do not lie in a plane"]);
    }
    let line: Vec<_> = (0..6).map(|k| Vector3::new(f64::from(k), 2.0 * f64::from(k), 0.0)).collect();
    refused(new(&line), &["stone", "nearly flat"]);
}

#[test]
fn models() {
    let builder = || {
        let mut builder = ModelBuilder::new();
        builder.add_body(body()).unwrap();
        builder
    };
    let mut heavy = builder();
    heavy.set_gravity(Vector3::new(0.0, 0.0, f64::NAN));
    refused(heavy.build(), &["gravity", "finite"]);
    let mut unknown = builder();
    unknown.exclude(BodyId(1), BodyId(9));
    refused(unknown.build(), &["body 9", "does not exist"]);
    let mut mixed = builder();
    mixed.add_shape(shape()).unwrap();
    mixed.add_shape(ShapeSpec { name: "floor".into(), body: BodyId::WORLD, ..shape() }).unwrap();
    refused(mixed.build(), &["floor", "cull group 0", "'ball'"]);
}

#[test]
fn arrays() {
    refused(check_array("targets", &[0.0, f64::NAN], 2), &["targets[1]", "NaN", "finite"]);
    refused(check_array("targets", &[0.0], 2), &["targets", "1 numbers", "needs 2"]);
    let mut builder = ModelBuilder::new();
    builder.add_body(body()).unwrap();
    let model = builder.build().unwrap();
    refused(model.contacts_at(&[f64::INFINITY], 0.0), &["qpos[0]", "inf"]);
    refused(model.contacts_at(&[], 0.0), &["qpos", "needs 1"]);
}
