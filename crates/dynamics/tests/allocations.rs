//! A step allocates nothing, in a varied world with contacts and drives or in a heap of 32 bodies.
#![allow(clippy::unwrap_used, missing_docs)]

use std::sync::Arc;

use fiatlux_dynamics::*;
use nalgebra::{Isometry3, Matrix3, Vector3};

#[test]
fn a_step_allocates_nothing() {
    a_varied_world();
    a_heap();
}

fn a_varied_world() {
    let mut builder = ModelBuilder::new();
    let body = |name: &str, parent, joint| BodySpec {
        name: name.into(),
        parent,
        parent_from_body: Isometry3::translation(0.0, 0.0, 0.12),
        joint,
        mass: 2.0,
        com: Vector3::zeros(),
        inertia: Matrix3::identity() * 0.01,
    };
    let base = builder.add_body(body("base", BodyId::WORLD, Joint::Free)).unwrap();
    let drive = Some(Drive { stiffness: 50.0, damping: 1.0, effort_limit: 10.0, speed_limit: f64::INFINITY });
    let hinge = Hinge { axis: Vector3::y_axis(), lower: -1.0, upper: 1.0, armature: 0.01, drive };
    let follower = Hinge { drive: None, ..hinge.clone() };
    let arm = builder.add_body(body("arm", base, Joint::Hinge(hinge))).unwrap();
    let hand = builder.add_body(body("hand", arm, Joint::Hinge(follower))).unwrap();
    builder.couple(Coupling { follower: hand, leader: arm, ratio: 0.5, offset: 0.0 }).unwrap();
    for (body, geometry) in
        [(BodyId::WORLD, Geometry::HalfSpace), (base, Geometry::Cuboid { half_extents: Vector3::repeat(0.1) })]
    {
        let (name, body_from_shape) = (format!("shape {}", body.0), Isometry3::identity());
        let (material, cull_group) = (Material::new(0.5, 0), body.0 as u16);
        builder.add_shape(ShapeSpec { name, body, body_from_shape, geometry, material, cull_group, label: 0 }).unwrap();
    }
    // A hull falls on the box and down from it.
    let corner = |k: usize| Vector3::new((k & 1) as f64, (k >> 1 & 1) as f64, (k >> 2 & 1) as f64) * 0.05;
    let stone = Hull::new("stone", &(0..8).map(corner).collect::<Vec<_>>()).unwrap();
    let mut spec = body("stone", BodyId::WORLD, Joint::Free);
    spec.parent_from_body = Isometry3::translation(0.07, 0.0, 0.23);
    let stone = (builder.add_body(spec).unwrap(), Geometry::Hull(Arc::new(stone)));
    let shape = ShapeSpec {
        name: "stone".into(),
        body: stone.0,
        body_from_shape: Isometry3::identity(),
        geometry: stone.1,
        material: Material::new(0.2, 0),
        cull_group: 7,
        label: 0,
    };
    builder.add_shape(shape).unwrap();
    let model = builder.build().unwrap();
    let variation = Variation {
        bodies: vec![(base, BodyVariation { mass: 1.2, com_offset: Vector3::new(0.01, 0.0, 0.0) })],
        drives: vec![(arm, DriveVariation { stiffness: 0.8, damping: 1.1, effort_limit: 0.5 })],
        frictions: vec![(ShapeId(1), 0.9)],
        gravity: None,
    };
    let start = || {
        let (mut dynamics, mut state) = (Dynamics::new(&model), model.reference_state());
        dynamics.set_variation(&model, &variation).unwrap();
        state.set_pose(&model, stone.0, &Isometry3::translation(0.07, 0.0, 0.23));
        (dynamics, state)
    };
    let (mut most_contacts, mut stone_rested) = (0, false);
    let allocations = fiatlux_allocations::count(start, |(dynamics, state)| {
        for _ in 0..200 {
            dynamics.step(&model, state, &Input { targets: &[0.9], ..Input::default() }, 0.005);
            most_contacts = most_contacts.max(dynamics.contacts().len());
            let on_box =
                dynamics.contacts().iter().any(|c| c.force != Vector3::zeros() && c.shape_a.0 == 1 && c.shape_b.0 == 2);
            stone_rested |= on_box;
        }
    });
    assert!(stone_rested, "the stone must touch the box");
    assert!(most_contacts >= 4, "the base must rest on the floor: {most_contacts} contacts");
    assert_eq!(allocations, 0);
}

fn a_heap() {
    let mut builder = ModelBuilder::new();
    let shape = |builder: &mut ModelBuilder, body: BodyId, geometry| {
        let (name, body_from_shape) = (format!("shape {}", body.0), Isometry3::identity());
        let (material, cull_group) = (Material::new(0.5, 0), body.0 as u16);
        builder.add_shape(ShapeSpec { name, body, body_from_shape, geometry, material, cull_group, label: 0 }).unwrap();
    };
    shape(&mut builder, BodyId::WORLD, Geometry::HalfSpace);
    for k in 0..32 {
        let spec = BodySpec {
            name: format!("box {k}"),
            parent: BodyId::WORLD,
            parent_from_body: Isometry3::translation(
                0.02 * f64::from(k % 3),
                0.015 * f64::from(k % 2),
                0.06 + 0.11 * f64::from(k),
            ),
            joint: Joint::Free,
            mass: 1.0,
            com: Vector3::zeros(),
            inertia: Matrix3::identity() * 0.002,
        };
        let body = builder.add_body(spec).unwrap();
        shape(&mut builder, body, Geometry::Cuboid { half_extents: Vector3::new(0.06, 0.05, 0.05) });
    }
    let model = builder.build().unwrap();
    let start = || {
        let (dynamics, mut state) = (Dynamics::new(&model), model.reference_state());
        for k in 0..32 {
            let pose = model.bodies()[k + 1].spec.parent_from_body;
            state.set_pose(&model, BodyId(k + 1), &pose);
        }
        (dynamics, state)
    };
    let mut most_contacts = 0;
    let allocations = fiatlux_allocations::count(start, |(dynamics, state)| {
        for _ in 0..100 {
            dynamics.step(&model, state, &Input::default(), 0.005);
            most_contacts = most_contacts.max(dynamics.contacts().len());
        }
    });
    assert!(most_contacts >= 128, "the boxes must touch: {most_contacts} contacts");
    assert_eq!(allocations, 0);
}
