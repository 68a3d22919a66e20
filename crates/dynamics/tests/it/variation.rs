//! A varied world moves exactly as one whose model was built with the varied numbers, and an unvaried one as before.

use fiatlux_dynamics::*;
use nalgebra::{Isometry3, Matrix3, Vector3};

const DT: f64 = 0.005;
const STEPS: usize = 300;
const TORSO: BodyId = BodyId(1);
const LEG: BodyId = BodyId(2);
const FLOOR: ShapeId = ShapeId(0);
const FOOT: ShapeId = ShapeId(1);

/// A torso that slides, tips and swings its driven leg on the floor, with what a variation may change applied to its specs.
fn model(variation: &Variation) -> Model {
    let mut builder = ModelBuilder::new();
    let body = |id: BodyId, name: &str, parent, z: f64, joint, mass: f64| {
        let varied = variation.bodies.iter().rfind(|(body, _)| *body == id).map_or_else(Default::default, |(_, v)| *v);
        let inertia = Matrix3::from_diagonal(&Vector3::new(0.03, 0.02, 0.025)) * mass;
        BodySpec {
            name: name.into(),
            parent,
            parent_from_body: Isometry3::translation(0.0, 0.0, z),
            joint,
            mass: mass * varied.mass,
            com: Vector3::new(0.01, 0.02, -0.1) + varied.com_offset,
            inertia: inertia * varied.mass,
        }
    };
    variation.gravity.into_iter().for_each(|gravity| builder.set_gravity(gravity));
    builder.add_body(body(TORSO, "torso", BodyId::WORLD, 0.62, Joint::Free, 3.0)).unwrap();
    let gains = variation.drives.iter().rfind(|(body, _)| *body == LEG).map_or_else(Default::default, |(_, v)| *v);
    let hip = Hinge {
        axis: Vector3::y_axis(),
        lower: -0.4,
        upper: 0.7,
        armature: 0.01,
        drive: Some(Drive {
            stiffness: 60.0 * gains.stiffness,
            damping: 2.0 * gains.damping,
            effort_limit: 20.0 * gains.effort_limit,
            speed_limit: f64::INFINITY,
        }),
    };
    builder.add_body(body(LEG, "leg", TORSO, -0.2, Joint::Hinge(hip), 1.0)).unwrap();
    let shapes = [
        (FLOOR, "floor", BodyId::WORLD, 0.0, Geometry::HalfSpace, 0.6),
        (FOOT, "foot", LEG, -0.35, Geometry::Cuboid { half_extents: Vector3::new(0.1, 0.05, 0.03) }, 0.3),
        (ShapeId(2), "trunk", TORSO, 0.0, Geometry::Capsule { radius: 0.1, half_length: 0.1 }, 0.4),
    ];
    for (id, name, body, z, geometry, nominal) in shapes {
        let friction = variation.frictions.iter().rfind(|(shape, _)| *shape == id).map_or(nominal, |(_, mu)| *mu);
        let body_from_shape = Isometry3::translation(0.0, 0.0, z);
        let material = Material::new(friction, i32::from(id == FOOT));
        let cull_group = body.0 as u16;
        let spec = ShapeSpec { name: name.into(), body, body_from_shape, geometry, material, cull_group, label: 0 };
        assert_eq!(builder.add_shape(spec).unwrap(), id);
    }
    builder.build().unwrap()
}

/// Steps from one start, with a swinging target and a push.
fn motion(model: &Model, dynamics: &mut Dynamics) -> Vec<(State, Vec<Contact>, f64, Vector3<f64>)> {
    let mut state = model.reference_state();
    state.qvel[0] = 1.0;
    let push = Wrench { force: Vector3::new(2.0, 1.0, 0.0), torque: Vector3::new(0.0, 0.0, 0.1) };
    (0..STEPS)
        .map(|step| {
            let targets = [if step % 100 < 50 { 0.8 } else { -0.5 }];
            let input = Input { targets: &targets, wrenches: &[(TORSO, push)], locked: &[] };
            assert!(dynamics.step(model, &mut state, &input, DT).converged);
            let (contacts, effort) = (dynamics.contacts().to_vec(), dynamics.efforts()[0]);
            dynamics.update(model, &state);
            (state.clone(), contacts, effort, dynamics.com_velocity(model, TORSO))
        })
        .collect()
}

fn varied(model: &Model, variation: &Variation) -> Dynamics {
    let mut dynamics = Dynamics::new(model);
    dynamics.set_variation(model, variation).unwrap();
    dynamics
}

fn body(mass: f64, com_offset: Vector3<f64>) -> BodyVariation {
    BodyVariation { mass, com_offset }
}

#[test]
fn a_variation_of_ones_and_none_at_all_change_no_bit() {
    let nominal = model(&Variation::default());
    let expected = motion(&nominal, &mut Dynamics::new(&nominal));
    assert!(expected.iter().any(|(_, contacts, ..)| contacts.iter().any(|c| c.force.norm() > 1.0)), "it must touch");
    let ones = Variation {
        bodies: vec![(TORSO, BodyVariation::default()), (LEG, BodyVariation::default())],
        drives: vec![(LEG, DriveVariation::default())],
        frictions: vec![(FOOT, 0.3)],
        gravity: None,
    };
    assert_eq!(motion(&nominal, &mut varied(&nominal, &ones)), expected);
    assert_eq!(motion(&nominal, &mut varied(&nominal, &Variation::default())), expected);

    let mut back = varied(&nominal, &Variation { bodies: vec![(LEG, body(3.0, Vector3::zeros()))], ..ones });
    assert_ne!(motion(&nominal, &mut back), expected);
    back.set_variation(&nominal, &Variation::default()).unwrap();
    assert_eq!(motion(&nominal, &mut back), expected);
}

#[test]
fn a_varied_world_moves_as_a_model_built_that_way() {
    let shift = Vector3::new(0.02, -0.01, 0.03);
    let gains = |stiffness, damping, effort_limit| (LEG, DriveVariation { stiffness, damping, effort_limit });
    let masses =
        vec![(TORSO, body(1.3, Vector3::zeros())), (LEG, body(0.1, Vector3::zeros())), (LEG, body(0.7, shift))];
    let drives = vec![gains(1.4, 0.6, 0.2)];
    let frictions = vec![(FLOOR, 1.1), (FOOT, 0.05)];
    let none = Variation::default();
    let cases = [
        Variation { bodies: masses.clone(), ..none.clone() },
        Variation { drives: drives.clone(), ..none.clone() },
        Variation { drives: vec![gains(0.0, 0.0, 1.0)], ..none.clone() },
        Variation { frictions: frictions.clone(), ..none.clone() },
        Variation { gravity: Some(Vector3::new(0.0, 0.0, -5.0)), ..none.clone() },
        Variation { bodies: masses, drives, frictions, gravity: None },
    ];
    let nominal = model(&none);
    let unvaried = motion(&nominal, &mut Dynamics::new(&nominal));
    for case in cases {
        let built = model(&case);
        let (mut world, mut reference) = (varied(&nominal, &case), Dynamics::new(&built));
        let found = motion(&nominal, &mut world);
        assert_eq!(found, motion(&built, &mut reference), "{case:?}");
        assert_ne!(found, unvaried, "{case:?} must matter");
        let state = &found[STEPS - 1].0;
        let equation = |model: &Model, case: &Variation| {
            let mut mechanics = Mechanics::new(model);
            mechanics.vary(&case.prepare(model).unwrap());
            mechanics.update_equation(model, state);
            let mut matrix = vec![0.0; model.nv() * model.nv()];
            mechanics.mass_matrix(model, &mut matrix);
            (matrix, mechanics.bias_force().to_vec())
        };
        assert_eq!(equation(&nominal, &case), equation(&built, &none));
    }
}

#[test]
fn a_variation_that_no_world_can_have_is_refused_and_changes_nothing() {
    let nominal = model(&Variation::default());
    let refused = |variation: Variation, words: &[&str]| {
        let mut dynamics = Dynamics::new(&nominal);
        let message = dynamics.set_variation(&nominal, &variation).expect_err("must be refused").to_string();
        for word in words {
            assert!(message.contains(word), "'{message}' does not say '{word}'");
        }
        assert!(dynamics.has_variation(&PreparedVariation::default()));
    };
    let bodies = |id, mass, x| Variation {
        bodies: vec![(LEG, body(2.0, Vector3::zeros())), (id, body(mass, Vector3::x() * x))],
        ..Variation::default()
    };
    for mass in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e308, 1e-320] {
        refused(bodies(TORSO, mass, 0.0), &["'torso'", "mass", "positive"]);
    }
    refused(bodies(TORSO, 1e-307, 0.0), &["'torso'", "inertia"]);
    refused(bodies(TORSO, 1.0, f64::NAN), &["'torso'", "com", "finite"]);
    refused(bodies(BodyId::WORLD, 1.0, 0.0), &["'world'", "mass"]);
    refused(bodies(BodyId(9), 1.0, 0.0), &["body 9"]);
    let drives = |id, stiffness, damping, effort_limit| Variation {
        drives: vec![(id, DriveVariation { stiffness, damping, effort_limit })],
        ..Variation::default()
    };
    for bad in [-1.0, f64::NAN, f64::INFINITY, 1e308] {
        refused(drives(LEG, bad, 1.0, 1.0), &["'leg'", "stiffness", "not negative"]);
        refused(drives(LEG, 1.0, bad, 1.0), &["'leg'", "damping", "not negative"]);
        refused(drives(LEG, 1.0, 1.0, bad), &["'leg'", "effort_limit", "positive"]);
    }
    refused(drives(LEG, 1.0, 1.0, 0.0), &["'leg'", "effort_limit"]);
    refused(drives(TORSO, 1.0, 1.0, 1.0), &["'torso'", "no drive"]);
    for friction in [-0.1, f64::NAN, f64::INFINITY] {
        let frictions = vec![(FOOT, friction)];
        refused(Variation { frictions, ..Variation::default() }, &["'foot'", "friction", "not negative"]);
    }
    refused(Variation { frictions: vec![(ShapeId(5), 0.5)], ..Variation::default() }, &["shape 5"]);
}
