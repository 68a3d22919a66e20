//! A bulb that lies free in the crate is disposed, however it fell in.

use std::f64::consts::PI;

use fiatlux_rules::predicates::{dropped, in_crate};
use fiatlux_rules::{AttachmentRow, BodyRow, Judge, JudgeOptions, Protocol, Row, Task, Thresholds};
use nalgebra::{Translation3, UnitQuaternion};

use super::*;
use crate::props::{bulb, bulb_body, crate_};
use crate::{Random, Stream};

/// Bulbs, each let go at a place and in a turn of its own; the physics has 3 s to bring it to rest.
const BULBS: u64 = 1000;
const SECONDS: f64 = 3.0;

/// A turn that is uniform over all turns (Shoemake).
fn any_turn(random: &mut Random) -> UnitQuaternion<f64> {
    let [u, v, w] = [0; 3].map(|_| random.uniform(0.0, 1.0));
    let (a, b) = ((1.0_f64 - u).sqrt(), u.sqrt());
    let [(sv, cv), (sw, cw)] = [v, w].map(|part| (libm::sin(2.0 * PI * part), libm::cos(2.0 * PI * part)));
    UnitQuaternion::new_normalize(nalgebra::Quaternion::new(b * cw, a * sv, a * cv, b * sw))
}

/// The crate, and a bulb alone.
fn model(config: &SceneConfig) -> (Model, BodyId) {
    let mut builder = ModelBuilder::new();
    let owner = ShapeOwner::Floor;
    let (at, surfaces) = (Isometry3::identity(), &config.surfaces);
    add_parts(&mut builder, crate_(&config.crate_, surfaces), "crate_", BodyId::WORLD, &at, owner, 0).unwrap();
    let body = builder.add_body(bulb_body(&config.bulb, "bulb", at)).unwrap();
    add_parts(&mut builder, bulb(&config.bulb, surfaces), "bulb_", body, &at, owner, 1).unwrap();
    (builder.build().unwrap(), body)
}

/// Reach of a body at a pose along a direction, by its shapes, m.
fn reach(model: &Model, body: BodyId, pose: &Isometry3<f64>, direction: &Vector3<f64>) -> f64 {
    let shapes = model.shapes().iter().filter(|shape| shape.body == body).map(|shape| {
        let at = pose * shape.body_from_shape;
        let local = at.inverse_transform_vector(direction);
        at.translation.vector.dot(direction) + shape.geometry.support(&local).dot(&local)
    });
    shapes.fold(f64::NEG_INFINITY, f64::max)
}

#[test]
fn a_bulb_that_lies_free_in_the_crate_is_disposed() {
    let scene = scene_of(SceneKind::FreeLadder, 0);
    let config = &scene.config;
    let (model, body) = model(config);
    let judge =
        Judge::new(Protocol::Published, Task::S06, Thresholds::default(), scene.geometry(), JudgeOptions::default());
    let cx = judge.context();
    let mut dynamics = Dynamics::new(&model);
    let (half, rim) = (config.crate_.interior_half, config.crate_.rim_height);
    let mut row = Row::zeros(scene.robot_layout());
    row.things = vec![BodyRow::at_rest(Isometry3::identity()); manifest().things.len()];
    row.attachments = vec![AttachmentRow::FREE; 2];
    let (mut inside, mut at_walls) = (0, 0);
    for number in 0..BULBS {
        let mut random = Random::of_term(Stream::Trial, "dropped", 0, number);
        // Its middle over the crate's interior, all of it above the rim or between the walls.
        let com = Vector3::z() * config.bulb.com_z;
        let place = loop {
            let middle = Vector3::new(
                random.uniform(-1.0, 1.0) * (half[0] - 0.04),
                random.uniform(-1.0, 1.0) * (half[1] - 0.04),
                random.uniform(0.10, 0.30),
            );
            let turn = any_turn(&mut random);
            let place = Isometry3::from_parts(Translation3::from(middle - turn * com), turn);
            let reach = |direction: Vector3<f64>| reach(&model, body, &place, &direction);
            let sides = [(Vector3::x(), half[0]), (Vector3::y(), half[1])];
            let is_between = sides.into_iter().all(|(side, half)| reach(side) < half && reach(-side) < half);
            if -reach(-Vector3::z()) > if is_between { config.crate_.floor_height } else { rim } {
                break place;
            }
        };
        let mut state = model.reference_state();
        state.set_pose(&model, body, &place);
        let (mut was_inside, mut leans) = (false, false);
        for step in 0..(SECONDS / crate::PHYSICS_DT) as u32 {
            dynamics.step(&model, &mut state, &Input::default(), crate::PHYSICS_DT);
            if !(step + 1).is_multiple_of(crate::SUBSTEPS as u32) {
                continue;
            }
            dynamics.update(&model, &state);
            let pose = dynamics.world_from_body(body);
            row.things[errand::OLD_BULB].pose = pose;
            // Below the rim and over the floor, by its shapes: nothing else can hold it there but floor and walls.
            let reach = |direction: Vector3<f64>| reach(&model, body, &pose, &direction);
            let center = (pose * nalgebra::Point3::from(com)).coords;
            let is_inside = reach(Vector3::z()) < rim - 1e-4 && center.x.abs() < half[0] && center.y.abs() < half[1];
            assert!(!is_inside || !dropped(&row, &cx, Bulb::Old), "bulb {number}, step {step}: {pose}");
            was_inside = is_inside;
            leans = [Vector3::x(), -Vector3::x()].into_iter().any(|side| reach(side) > half[0] - 1e-3);
        }
        assert!(
            !was_inside || in_crate(&row, &cx, Bulb::Old),
            "bulb {number} rests at {}",
            row.things[errand::OLD_BULB].pose
        );
        inside += u32::from(was_inside);
        at_walls += u32::from(was_inside && leans);
    }
    // Most fall in, and many lie against a wall, where the outline is what matters.
    assert!(inside > 900, "{inside} of {BULBS} came to rest inside");
    assert!(at_walls > 50, "{at_walls} against a wall");
}
