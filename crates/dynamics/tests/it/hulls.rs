//! Convex hulls against boxes and closed forms.

use std::sync::Arc;

use fiatlux_dynamics::*;
use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};

const DT: f64 = 0.005;
const HALF: Vector3<f64> = Vector3::new(0.1, 0.07, 0.05);

fn corners(half: &Vector3<f64>) -> Vec<Vector3<f64>> {
    let sign = |k: usize, axis: usize| if k >> axis & 1 == 0 { -1.0 } else { 1.0 };
    (0..8).map(|k| half.component_mul(&Vector3::new(sign(k, 0), sign(k, 1), sign(k, 2)))).collect()
}

fn hull(points: &[Vector3<f64>]) -> Geometry {
    Geometry::Hull(Arc::new(Hull::new("hull", points).unwrap()))
}

fn add_shape(builder: &mut ModelBuilder, body: BodyId, geometry: Geometry, pose: Isometry3<f64>, friction: f64) {
    let spec = ShapeSpec {
        name: format!("shape {}", body.0),
        body,
        body_from_shape: pose,
        geometry,
        material: Material::new(friction, 0),
        cull_group: body.0 as u16,
        label: 0,
    };
    builder.add_shape(spec).unwrap();
}

fn add_body(builder: &mut ModelBuilder, name: &str, geometry: Geometry, friction: f64) -> BodyId {
    let (solid, density) = (geometry.solid(), 500.0);
    let body = builder.add_body(BodySpec {
        name: name.into(),
        parent: BodyId::WORLD,
        parent_from_body: Isometry3::identity(),
        joint: Joint::Free,
        mass: density * solid.volume,
        com: solid.center,
        inertia: density * solid.inertia,
    });
    let body = body.unwrap();
    add_shape(builder, body, geometry, Isometry3::identity(), friction);
    body
}

/// A body above a floor: a half-space, or a slab whose top is at z = 0, tilted about y.
fn above(floor: Geometry, body: Geometry, slope: f64, friction: f64, pose: Isometry3<f64>) -> (Model, State) {
    let mut builder = ModelBuilder::new();
    let body = add_body(&mut builder, "body", body, friction);
    let tilt = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), slope);
    let depth = if floor == Geometry::HalfSpace { 0.0 } else { SLAB.z };
    let world_from_floor = tilt * Isometry3::translation(0.0, 0.0, -depth);
    add_shape(&mut builder, BodyId::WORLD, floor, world_from_floor, friction);
    let model = builder.build().unwrap();
    let mut state = model.reference_state();
    state.set_pose(&model, body, &(tilt * pose));
    (model, state)
}

const SLAB: Vector3<f64> = Vector3::new(2.0, 1.0, 0.1);

/// Positions at the end of each step.
fn path(model: &Model, state: &mut State, steps: usize) -> Vec<Vec<f64>> {
    let mut dynamics = Dynamics::new(model);
    let mut step = |_| {
        assert!(dynamics.step(model, state, &Input::default(), DT).converged);
        state.qpos.clone()
    };
    (0..steps).map(&mut step).collect()
}

fn largest_difference(a: &[Vec<f64>], b: &[Vec<f64>]) -> f64 {
    let pairs = a.iter().flatten().zip(b.iter().flatten());
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// A hull of a box's corners moves like the box, on a plane and on slabs of both kinds, falling flat, sliding and coming to
/// rest. The two differ only in points that carry no load.
#[test]
fn a_hull_of_a_box_moves_like_the_box() {
    let boxed = |half: Vector3<f64>| Geometry::Cuboid { half_extents: half };
    for (slope, friction) in [(0.0, 0.6), (0.3, 0.2), (0.3, 0.6)] {
        let pose = Isometry3::translation(0.0, 0.0, HALF.z + 0.02);
        let run = |floor: Geometry, body: Geometry| {
            let (model, mut state) = above(floor, body, slope, friction, pose);
            let path = path(&model, &mut state, 200);
            assert!(state.qvel.iter().all(|v| v.is_finite()));
            path
        };
        let expected = run(Geometry::HalfSpace, boxed(HALF));
        let slid = (expected[199][0] - expected[20][0]).hypot(expected[199][2] - expected[20][2]);
        assert_eq!(slid > 0.1, slope > 0.0 && friction < 0.3, "{slope} {friction}: {slid}");
        let on_plane = largest_difference(&expected, &run(Geometry::HalfSpace, hull(&corners(&HALF))));
        assert!(on_plane < 1e-6, "{slope} {friction}: {on_plane} m on a plane");
        let slabs = [
            (boxed(SLAB), hull(&corners(&HALF))),
            (hull(&corners(&SLAB)), boxed(HALF)),
            (hull(&corners(&SLAB)), hull(&corners(&HALF))),
        ];
        let expected = run(boxed(SLAB), boxed(HALF));
        for (which, (slab, body)) in slabs.into_iter().enumerate() {
            let on_slab = largest_difference(&expected, &run(slab, body));
            assert!(on_slab < 1e-5, "{slope} {friction}, slab {which}: {on_slab} m");
        }
    }
}

/// Whatever way they fall, boxes and their hulls end flat and at rest, on the plane and on each other.
#[test]
fn a_hull_that_tumbles_comes_to_rest_on_a_face() {
    let wedge =
        [[-0.1, -0.1, 0.0], [0.1, -0.1, 0.0], [-0.1, 0.1, 0.0], [0.1, 0.1, 0.0], [-0.1, 0.0, 0.12], [0.1, 0.0, 0.12]];
    let wedge = hull(&wedge.map(Vector3::from));
    for (case, body) in [hull(&corners(&HALF)), wedge].into_iter().enumerate() {
        for floor in [Geometry::HalfSpace, hull(&corners(&SLAB)), Geometry::Cuboid { half_extents: SLAB }] {
            let turn = UnitQuaternion::from_euler_angles(0.7, 0.4, 0.2);
            let pose = Isometry3::from_parts(Vector3::new(0.0, 0.0, 0.3).into(), turn);
            let (model, mut state) = above(floor, body.clone(), 0.0, 0.6, pose);
            let path = path(&model, &mut state, 600);
            let speed = state.qvel.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
            assert!(speed < 1e-4, "case {case}: {speed}");
            let drift = largest_difference(&path[500..], &vec![path[500].clone(); 100]);
            assert!(drift < 1e-4, "case {case}: it crept {drift} m in 0.5 s");
            let contacts = model.contacts_at(&state.qpos, 1e-3).unwrap();
            assert!((3..=4).contains(&contacts.len()), "case {case}: {contacts:?}");
            assert!(contacts.iter().all(|contact| contact.distance.abs() < 5e-4), "case {case}: {contacts:?}");
        }
    }
}

#[test]
fn a_tetrahedron_rests_on_its_base() {
    let points = [[0.1, 0.0, 0.0], [-0.05, 0.08, 0.0], [-0.05, -0.08, 0.0], [0.0, 0.0, 0.15]].map(Vector3::from);
    let pose = Isometry3::translation(0.0, 0.0, 0.01);
    let (model, mut state) = above(Geometry::HalfSpace, hull(&points), 0.0, 0.5, pose);
    let mut dynamics = Dynamics::new(&model);
    for _ in 0..200 {
        dynamics.step(&model, &mut state, &Input::default(), DT);
    }
    let tilt = state.qpos[4].hypot(state.qpos[5]);
    assert!(state.qpos[2].abs() < 1e-4 && tilt < 1e-4, "{:?}", state.qpos);
    let force: f64 = dynamics.contacts().iter().map(|contact| contact.force.z.abs()).sum();
    let weight = model.bodies()[1].spec.mass * DEFAULT_GRAVITY;
    assert!((force / weight - 1.0).abs() < 1e-4, "{force} N, not {weight} N");
    assert_eq!(dynamics.contacts().len(), 3, "one point at each corner of the base");
}

/// Two bars that cross meet at one point between their upper and lower edges.
#[test]
fn crossed_edges_meet_at_a_point() {
    let bar = hull(&corners(&Vector3::new(0.2, 0.02, 0.02)));
    let mut builder = ModelBuilder::new();
    let bodies = ["low", "high"].map(|name| add_body(&mut builder, name, bar.clone(), 0.5));
    let model = builder.build().unwrap();
    let mut state = model.reference_state();
    // An edge up, an edge down, a quarter turn between the bars.
    let eighth = std::f64::consts::FRAC_PI_4;
    let ridge = UnitQuaternion::from_euler_angles(eighth, 0.0, 0.0);
    let quarter = UnitQuaternion::from_euler_angles(0.0, 0.0, 2.0 * eighth);
    let height = 2.0 * 0.02 * 2.0_f64.sqrt();
    state.set_pose(&model, bodies[0], &Isometry3::from_parts(Vector3::zeros().into(), ridge));
    let place = Vector3::new(0.03, 0.05, height - 1e-3);
    state.set_pose(&model, bodies[1], &Isometry3::from_parts(place.into(), quarter * ridge));
    let contacts = model.contacts_at(&state.qpos, 2e-3).unwrap();
    assert_eq!(contacts.len(), 1, "{contacts:?}");
    let contact = &contacts[0];
    assert!((contact.normal - Vector3::z()).norm() < 1e-9 && (contact.distance + 1e-3).abs() < 1e-9, "{contact:?}");
    assert!((contact.position - Vector3::new(0.03, 0.0, height / 2.0 - 5e-4)).norm() < 1e-9, "{contact:?}");
}

#[test]
fn mass_and_rays_are_those_of_the_box() {
    let (turn, offset) = (Rotation3::from_euler_angles(0.3, -0.8, 1.1), Vector3::new(0.4, -0.2, 0.7));
    let points: Vec<_> = corners(&HALF).iter().map(|corner| turn * corner + offset).collect();
    let (boxed, moved) = (Geometry::Cuboid { half_extents: HALF }, hull(&points));
    let (expected, found) = (boxed.solid(), moved.solid());
    assert!((found.volume / expected.volume - 1.0).abs() < 1e-12);
    assert!((found.center - offset).norm() < 1e-12);
    let turned: Matrix3<f64> = turn.matrix() * expected.inertia * turn.matrix().transpose();
    assert!((found.inertia - turned).amax() < 1e-12 * turned.amax(), "{}", found.inertia);
    let (mut hits, mut misses) = (0, 0);
    for k in 0..500 {
        let angle = f64::from(k) * 0.7;
        let origin = Vector3::new(angle.cos(), angle.sin(), (angle * 0.3).sin()) * (0.06 + 0.001 * f64::from(k));
        let aim = Vector3::new((angle * 1.7).sin() * 0.15, (angle * 2.3).sin() * 0.15, (angle * 3.1).sin() * 0.15);
        let direction = (aim - origin).normalize();
        let expected = boxed.cast_ray(&origin, &direction);
        let found = moved.cast_ray(&(turn * origin + offset), &(turn * direction));
        match (expected, found) {
            (Some(expected), Some(found)) => {
                assert!((expected - found).abs() < 1e-9, "ray {k}: {found} m, not {expected} m");
                hits += 1;
            }
            (None, None) => misses += 1,
            other => panic!("ray {k}: {other:?}"),
        }
    }
    assert!(hits > 100 && misses > 50, "{hits} hits, {misses} misses");
}

/// Triangles close around the volume, and points inside of the hull are left out.
#[test]
fn the_surface_is_closed() {
    let mut points = corners(&HALF);
    points.extend([Vector3::zeros(), Vector3::new(0.02, 0.03, -0.01), Vector3::new(0.0, 0.0, 0.05)]);
    let hull = Hull::new("crate", &points).unwrap();
    assert_eq!(hull.vertices().len(), 8);
    assert_eq!(hull.triangles().count(), 12);
    let vertex = |k: usize| hull.vertices()[k];
    let six_volumes: f64 = hull.triangles().map(|[a, b, c]| vertex(a).dot(&vertex(b).cross(&vertex(c)))).sum();
    assert!((six_volumes / 6.0 / (8.0 * HALF.x * HALF.y * HALF.z) - 1.0).abs() < 1e-12);
}
