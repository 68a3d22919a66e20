//! Pictures of an object on its own.

use std::sync::Arc;

use fiatlux_render::{Image, ObjectPart, Texture, object_picture};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_world::{Scene, SceneConfig, SceneSpec, World};

const SIZE: [usize; 2] = [64, 48];

/// A box of these half sizes, m, on the floor.
fn block(half: [f32; 3], colour: [f32; 3]) -> ObjectPart {
    let corner = |i: usize| {
        let side = |axis: usize| if i >> axis & 1 == 1 { 1.0 } else { -1.0 };
        [half[0] * side(0), half[1] * side(1), half[2] * (1.0 + side(2))]
    };
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = faces.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
    ObjectPart { positions: (0..8).map(corner).collect(), triangles, colour, texture: None }
}

fn picture(parts: &[ObjectPart]) -> Image {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let spec = SceneSpec::floor(robot.gains(GainSet::default()));
    let scene = Arc::new(Scene::build(&SceneConfig::default(), robot, spec).unwrap());
    let world = World::new(Arc::clone(&scene));
    object_picture(&scene, world.row(), parts, SIZE)
}

/// Red, green and blue of a pixel.
fn pixel(image: &Image, x: usize, y: usize) -> [u8; 3] {
    let at = 3 * (y * SIZE[0] + x);
    [0, 1, 2].map(|channel| image.rgb()[at + channel])
}

#[test]
fn an_object_has_its_colour_and_fills_the_picture_at_any_size() {
    let [large, small] = [0.5, 0.005].map(|half| picture(&[block([half; 3], [0.6, 0.1, 0.05])]));
    let [red, green, blue] = pixel(&large, 32, 24);
    assert!(red > 2 * green && green > blue, "{red} {green} {blue}");
    let differing = large.rgb().iter().zip(small.rgb()).filter(|(a, b)| a.abs_diff(**b) > 3).count();
    assert!(differing < 30, "{differing} bytes differ between a cube of 1 m and one of 1 cm");
}

/// The floor's colour comes from nothing else than the object's own shadow: the robot of the scene is not there.
#[test]
fn nothing_but_the_object_is_seen() {
    let image = picture(&[block([0.5, 0.5, 0.001], [0.2; 3])]);
    let [corner, other] = [pixel(&image, 1, 46), pixel(&image, 62, 46)];
    assert!(corner.iter().zip(other).all(|(a, b)| a.abs_diff(b) < 12), "{corner:?} {other:?}");
}

/// One half of the image is blue, and the coordinates say which half a face shows.
#[test]
fn a_texture_is_where_its_coordinates_say() {
    let image = Texture { size: [2, 1], rgb: vec![200, 20, 20, 20, 20, 200] };
    let textured = |u: f32| {
        let mut part = block([0.5; 3], [1.0; 3]);
        part.texture = Some((vec![[u, 0.5]; 8], image.clone()));
        pixel(&picture(&[part]), 32, 24)
    };
    let ([red, _, blue], [other_red, _, other_blue]) = (textured(0.25), textured(1.75));
    assert!(red > 2 * blue && other_blue > 2 * other_red, "{red} {blue}, {other_red} {other_blue}");
}
