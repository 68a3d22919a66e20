//! A ladder, a bulb and a socket in rooms of the benchmark, at three sizes: geometry alone.

use std::sync::Arc;

use fiatlux_dynamics::{BodyId, ShapeId, ShapeSpec};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_world::{Object, Scene, SceneConfig, SceneKind, SceneSpec};
use nalgebra::{Isometry3, Point3, Vector3};

use super::{Check, Findings, Trial, load};
use crate::error::TrialError;
use crate::rig::{Base, Rig, Setup};

const SCALES: [f64; 3] = [0.9, 1.0, 1.1];
const SEEDS: [u64; 3] = [0, 1, 2];
/// Least gap between the ladder and what stands around it, m.
const CLEARANCE: f64 = 0.01;
/// Largest overlap of the seated bulb with the socket, and of the socket with the room, m.
const OVERLAP: [f64; 2] = [1e-3, 5e-3];
/// Heights of the seat above the surface that the robot stands on, m: what the robot can reach.
const REACH: [f64; 2] = [0.7, 1.3];

pub(super) fn trials(
    config: &SceneConfig,
    ladder: &Object,
    bulb: &Object,
    fixture: &Object,
) -> Result<Vec<Trial>, TrialError> {
    let robot = Arc::new(Robot::benchmark()?);
    let mut done = Vec::new();
    for seed in SEEDS {
        let spec = SceneSpec::new(SceneKind::CoupledLadder, seed, robot.gains(GainSet::default()));
        let scene = Scene::build(config, Arc::clone(&robot), spec)?;
        for scale in SCALES {
            let seat = Vector3::z() * config.bulb.seat_z;
            let stop = seat + Vector3::z() * config.fixture.stop_height;
            let objects =
                [scaled(ladder, scale, Vector3::zeros()), scaled(bulb, scale, seat), scaled(fixture, scale, stop)];
            done.push(one(&scene, seed, scale, &objects)?);
        }
    }
    Ok(done)
}

fn one(scene: &Scene, seed: u64, scale: f64, [ladder, bulb, fixture]: &[Object; 3]) -> Result<Trial, TrialError> {
    let config = &scene.config;
    let mut setup = Setup::new(config)?;
    let stays = |shape: &&ShapeSpec| {
        shape.body == BodyId::WORLD && shape.name != "room_floor" && !shape.name.starts_with("fixture_")
    };
    for shape in scene.model.shapes().iter().filter(stays) {
        let name = format!("scene_{}", shape.name);
        setup.add_shape(BodyId::WORLD, &name, shape.body_from_shape, shape.geometry.clone(), shape.material)?;
    }
    let world_from_fixture = scene.layout.world_from_fixture;
    let world_from_ladder = scene.layout.ladder.world_from_place(0.0);
    setup.add_object(ladder, "ladder_", world_from_ladder, Base::Free, None)?;
    let seated = world_from_fixture * Isometry3::translation(0.0, 0.0, config.fixture.stop_height);
    setup.add_object(bulb, "bulb_", seated, Base::Free, None)?;
    setup.add_object(fixture, "fixture_", world_from_fixture, Base::Fixed, None)?;
    let rig = setup.build()?;

    let mut findings = Findings::default();
    let around = gap(&rig, "ladder_", "scene_").min(gap(&rig, "ladder_", "fixture_"));
    findings.within("ladder_gap_m", around, CLEARANCE, f64::INFINITY);
    findings.within("ladder_to_bulb_m", gap(&rig, "ladder_", "bulb_"), CLEARANCE, f64::INFINITY);
    findings.within("bulb_to_socket_m", gap(&rig, "bulb_", "fixture_"), -OVERLAP[0], f64::INFINITY);
    findings.within("socket_to_room_m", gap(&rig, "fixture_", "scene_"), -OVERLAP[1], f64::INFINITY);
    let seat = world_from_fixture * Point3::new(0.0, 0.0, config.bulb.seat_z);
    let stand = load::surface(ladder).map_or(f64::NAN, |[_, high]| high.z);
    findings.within("seat_above_surface_m", seat.z - stand, REACH[0], REACH[1]);
    Ok(findings.trial(Check::SceneFit, &[ladder, bulb, fixture], format!("seed {seed}, scale {scale}")))
}

/// Smallest signed distance between the shapes of two owners, m; at most 1 m is looked for.
fn gap(rig: &Rig, a: &str, b: &str) -> f64 {
    let of = |prefix: &str| -> Vec<ShapeId> {
        let shapes = rig.model.shapes().iter().enumerate();
        shapes.filter(|(_, shape)| shape.name.starts_with(prefix)).map(|(index, _)| ShapeId(index)).collect()
    };
    let others = of(b);
    let pairs: Vec<(ShapeId, ShapeId)> = of(a).into_iter().flat_map(|a| others.iter().map(move |b| (a, *b))).collect();
    let mut mechanics = fiatlux_dynamics::Mechanics::new(&rig.model);
    mechanics.update(&rig.model, &rig.state);
    mechanics.gaps(&rig.model).nearest_pair(&pairs, 1.0).map_or(1.0, |(_, nearest)| nearest.distance)
}

/// An object times a factor about a point of its frame. Its mass stays.
fn scaled(object: &Object, factor: f64, about: Vector3<f64>) -> Object {
    let mut object = object.clone();
    let moved = |point: &mut [f64; 3]| *point = (about + (Vector3::from(*point) - about) * factor).into();
    for link in &mut object.links {
        moved(&mut link.com);
        link.inertia.iter_mut().for_each(|moment| *moment *= factor * factor);
        link.pieces.iter_mut().flatten().for_each(moved);
        if let Some(joint) = &mut link.joint {
            moved(&mut joint.anchor);
        }
    }
    object
}
