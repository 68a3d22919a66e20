//! Looks for people alone: the robot's cameras keep those of their version.

use fiatlux_render::{Camera, Lighting, Renderer, Visuals};
use fiatlux_rules::{Row, Task, errand};
use fiatlux_world::{Scene, ShapeOwner};
use nalgebra::{Point3, Vector3};

use crate::frames::stage;

const SIZE: usize = 120;

/// Red of the pixels that show an owner, in a picture for people and in one for a sensor.
fn both(scene: &Scene, row: &Row, camera: &Camera, owner: Option<ShapeOwner>) -> [Vec<f64>; 2] {
    [Visuals::for_people(scene, None), Visuals::new(scene)].map(|visuals| {
        let mut renderer = Renderer::supersampled(SIZE, SIZE, 2);
        renderer.render(&visuals, row, camera, &Lighting::default());
        let pixels = (0..SIZE * SIZE).filter(|at| renderer.owner(at % SIZE, at / SIZE) == owner);
        pixels.map(|at| f64::from(renderer.image().rgb()[3 * at])).collect()
    })
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn deviation(values: &[f64]) -> f64 {
    let mean = mean(values);
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
}

/// From the middle of the room, looking north, a sensor sees out of it.
#[test]
fn the_room_is_closed_for_people() {
    let (scene, row) = stage(Task::S07, 0);
    let eye = Vector3::new(0.0, 1.0, 3.0);
    let camera = Camera::look_at(eye, eye + Vector3::new(0.0, 3.0, 0.4), 0.8, 1.0);
    let [people, sensors] = both(&scene, &row, &camera, None);
    assert!(people.is_empty(), "{} pixels look out", people.len());
    assert!(sensors.len() > SIZE * SIZE / 4, "{}", sensors.len());
    // And from outside it hides nothing.
    let outside = Vector3::new(0.0, 7.0, 1.5);
    let camera = Camera::look_at(outside, Vector3::new(0.0, 0.0, 1.5), 0.5, 1.0);
    let mut renderer = Renderer::new(SIZE, SIZE);
    renderer.measure(&Visuals::for_people(&scene, None), &row, &camera);
    assert!(renderer.depth(SIZE / 2, SIZE / 2).unwrap() > 4.0, "{:?}", renderer.depth(SIZE / 2, SIZE / 2));
}

/// A lamp has a shade about its socket; one that looks sideways has an arm and a rod up to the ceiling.
#[test]
fn the_lamp_has_a_shade_and_hangs_on_something() {
    for seed in 0..6 {
        let (scene, row) = stage(Task::S07, seed);
        let lamp = row.things[errand::FIXTURE].pose;
        let (at, out) = (lamp.translation.vector, lamp.rotation * Vector3::z());
        let across = out.cross(&Vector3::new(0.3, 0.5, 0.1)).normalize();
        let camera = Camera::look_at(at + 1.2 * out + 0.4 * across, at, 0.6, 1.0);
        let [people, sensors] = both(&scene, &row, &camera, Some(ShapeOwner::FIXTURE));
        assert!(people.len() as f64 > 1.6 * sensors.len() as f64, "{seed}: {} and {}", people.len(), sensors.len());
        // What it hangs on, half way up to the ceiling.
        let up = Vector3::new(at.x, at.y, 3.2);
        let rod = |from: [f64; 2]| {
            let camera = Camera::look_at(up + Vector3::new(from[0], from[1], 0.0), up, 0.5, 1.0);
            both(&scene, &row, &camera, Some(ShapeOwner::FIXTURE))[0].len()
        };
        let most = [[1.2, 0.1], [-1.2, 0.1], [0.1, 1.2], [0.1, -1.2]].map(rod).into_iter().max();
        assert!(most > Some(SIZE), "{seed}: {most:?} pixels of a rod");
    }
}

/// Floor, walls and bench are not of one colour: within a tile, a block, a plank.
#[test]
fn floor_walls_and_bench_have_a_texture() {
    let (scene, row) = stage(Task::S07, 0);
    let bench = scene.world_from_bench.unwrap();
    let top = (bench * Point3::new(-0.8, 0.0, 1.0)).coords;
    let tile = Vector3::new(-3.2, 2.8, 0.0);
    let wall = Vector3::new(scene.config.room.wall_x[1], 0.5, 2.5);
    for (what, owner, at, from) in [
        ("floor", ShapeOwner::Floor, tile, Vector3::new(0.02, 0.0, 1.0)),
        ("wall", ShapeOwner::Room, wall, Vector3::new(-1.0, 0.0, 0.02)),
        ("bench", ShapeOwner::Bench, top, Vector3::new(0.02, 0.0, 1.0)),
    ] {
        let camera = Camera::look_at(at + from, at, 0.35, 1.0);
        let [people, sensors] = both(&scene, &row, &camera, Some(owner)).map(|pixels| deviation(&pixels));
        assert!(people > sensors + 0.9, "{what}: {people} for people, {sensors} for sensors");
    }
}

/// Beside a sole the floor is darker than a sensor sees it; with the robot lifted by 5 cm it is not.
#[test]
fn feet_have_a_shadow_where_they_touch() {
    let (scene, row) = stage(Task::S07, 0);
    let mut lifted = row.clone();
    lifted.robot.pose.translation.z += 0.05;
    let links = scene.robot.forward_kinematics(&row.joint_position, &row.robot.pose).unwrap();
    let ankle = links[scene.robot.feet()[0]].translation.vector;
    let camera = Camera::look_at(ankle + Vector3::new(0.0, 0.0, 3.0), ankle, 0.14, 1.0);
    let darker = |row: &Row| {
        let [people, sensors] = both(&scene, row, &camera, Some(ShapeOwner::Floor)).map(|pixels| mean(&pixels));
        sensors - people
    };
    let (standing, lifted) = (darker(&row), darker(&lifted));
    assert!(standing > lifted + 2.0, "{standing} and {lifted}");
}

/// Rails of aluminium show lights and darks of the room, where a sensor sees an even grey.
#[test]
fn aluminium_shines() {
    let (scene, row) = stage(Task::S02, 0);
    let ladder = row.things[errand::LADDER].pose.translation.vector + Vector3::z();
    let camera = Camera::look_at(ladder + Vector3::new(1.5, 1.2, 0.2), ladder, 0.6, 1.0);
    let [people, sensors] = both(&scene, &row, &camera, Some(ShapeOwner::LADDER)).map(|pixels| deviation(&pixels));
    assert!(people > 1.2 * sensors, "{people} and {sensors}");
}
