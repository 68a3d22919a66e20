//! Contact points of pairs of shapes.

use std::sync::Arc;

use fiatlux_dynamics::{BodyId, BodySpec, Geometry, Hull, Joint, Material, ModelBuilder, ShapeSpec};
use nalgebra::{Isometry3, Matrix3, Quaternion, UnitQuaternion, Vector3};
use serde::Deserialize;

use super::fixture;

#[derive(Deserialize)]
struct ContactsFixture {
    margin: f64,
    pairs: Vec<ContactPair>,
}

#[derive(Deserialize)]
struct ContactPair {
    a: ContactShape,
    b: ContactShape,
    distance: Option<f64>,
    normal: Option<Vec<f64>>,
    direct_distance: Option<f64>,
}

#[derive(Deserialize)]
struct ContactShape {
    kind: String,
    size: Vec<f64>,
    pos: Vec<f64>,
    quat: Vec<f64>,
}

impl ContactShape {
    fn geometry(&self) -> Geometry {
        match self.kind.as_str() {
            "plane" => Geometry::HalfSpace,
            "sphere" => Geometry::Sphere { radius: self.size[0] },
            "capsule" => Geometry::Capsule { radius: self.size[0], half_length: self.size[1] },
            "box" => Geometry::Cuboid { half_extents: Vector3::from_column_slice(&self.size[..3]) },
            "mesh" => {
                let vertices: Vec<_> = self.size.chunks_exact(3).map(Vector3::from_column_slice).collect();
                Geometry::Hull(Arc::new(Hull::new("mesh", &vertices).unwrap()))
            }
            other => panic!("unknown kind {other}"),
        }
    }

    fn pose(&self) -> Isometry3<f64> {
        let q = &self.quat;
        let rotation = UnitQuaternion::new_normalize(Quaternion::new(q[0], q[1], q[2], q[3]));
        Isometry3::from_parts(Vector3::from_column_slice(&self.pos).into(), rotation)
    }
}

#[test]
fn contact_points_are_those_of_mujoco() {
    let fixture: ContactsFixture = fixture("contacts");
    let (mut compared, mut hulls) = (0, 0);
    for (number, pair) in fixture.pairs.iter().enumerate() {
        let mut builder = ModelBuilder::new();
        for (name, shape) in [("a", &pair.a), ("b", &pair.b)] {
            let fixed = shape.geometry() == Geometry::HalfSpace;
            let body = if fixed {
                BodyId::WORLD
            } else {
                let spec = BodySpec {
                    name: name.into(),
                    parent: BodyId::WORLD,
                    parent_from_body: shape.pose(),
                    joint: Joint::Free,
                    mass: 1.0,
                    com: Vector3::zeros(),
                    inertia: Matrix3::identity(),
                };
                builder.add_body(spec).unwrap()
            };
            let spec = ShapeSpec {
                name: name.into(),
                body,
                body_from_shape: if fixed { shape.pose() } else { Isometry3::identity() },
                geometry: shape.geometry(),
                material: Material::new(1.0, 0),
                cull_group: u16::from(name == "b"),
                label: 0,
            };
            builder.add_shape(spec).unwrap();
        }
        let model = builder.build().unwrap();
        let found = model.contacts_at(&model.reference_state().qpos, fixture.margin).unwrap();
        let deepest = found.iter().min_by(|a, b| a.distance.total_cmp(&b.distance));
        let (Some(theirs), Some(direct), Some(normal)) = (pair.distance, pair.direct_distance, &pair.normal) else {
            continue;
        };
        // Where MuJoCo's two routines disagree, or polyhedra are apart (a separating axis is not a distance), none judges.
        let polyhedra = [&pair.a, &pair.b].iter().all(|shape| ["box", "mesh"].contains(&shape.kind.as_str()));
        // Of hulls its contacts are found step by step: 7e-6 m off the least overlap, one normal is 5 degrees off its axis.
        let agreement = if pair.b.kind == "mesh" { 1e-6 } else { 1e-5 };
        if (theirs - direct).abs() > agreement || theirs > 0.9 * fixture.margin || polyhedra && theirs > 0.0 {
            continue;
        }
        let ours = deepest.unwrap_or_else(|| panic!("pair {number}: MuJoCo sees {theirs}, we see nothing"));
        compared += 1;
        hulls += usize::from(pair.b.kind == "mesh");
        assert!((ours.distance - theirs).abs() < 6e-4, "pair {number}: {} against {theirs}", ours.distance);
        let aligned = ours.normal.dot(&Vector3::from_column_slice(normal));
        // The ends of a capsule's flat stretch lie up to half a millimetre above its deepest point, where an edge turns the normal.
        let turned = pair.a.kind == "capsule" && pair.b.kind == "mesh";
        assert!(
            aligned > if turned { 0.99 } else { 0.999 },
            "pair {number} ({} {}): normals differ: {aligned}",
            pair.a.kind,
            pair.b.kind
        );
    }
    println!("{compared} of {} pairs compared, {hulls} with hulls", fixture.pairs.len());
    assert!(compared > 100 && hulls > 40);
}
