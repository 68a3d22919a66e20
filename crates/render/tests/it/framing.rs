//! The framing of pictures for people.

use fiatlux_render::framing::{Aim, FOLLOW_ELEVATION, Focus, Spot, best_bearing, hidden};
use fiatlux_render::{Lighting, Renderer, Visuals};
use fiatlux_rules::Task;
use fiatlux_world::ShapeOwner;

use crate::frames::stage;

/// Vertical field of view of `fiatlux render`, rad, and the size of the pictures, pixels.
const FOV: f64 = 0.6;
const SIZE: [usize; 2] = [384, 216];

/// By default the robot fills at least half of the picture's height, all of it is in the picture, and almost nothing is in front of
/// it: a rail of the ladder, at most. What its task is about is seen, too.
#[test]
fn the_robot_is_at_half_the_height_and_nothing_hides_it() {
    let mut unseen = Vec::new();
    for task in Task::ALL {
        for seed in 0..2 {
            let (scene, row) = stage(task, seed);
            let (visuals, light) = (Visuals::for_people(&scene, None), Lighting::default());
            let (focus, lens) = (Focus::of(Some(task)), [FOV, SIZE[0] as f64 / SIZE[1] as f64]);
            let bearing = best_bearing(&visuals, &light, std::slice::from_ref(&row), focus, lens);
            let aim = Aim::from(bearing, FOLLOW_ELEVATION, lens[0], lens[1]);
            let camera = aim.camera(aim.fit_spot(&Spot::of(&row), focus));
            let mut renderer = Renderer::for_people(SIZE[0], SIZE[1]);
            renderer.measure(&visuals, &row, &camera);
            let is_robot =
                |y: &usize| (0..SIZE[0]).any(|x| matches!(renderer.owner(x, *y), Some(ShapeOwner::Robot(_))));
            let rows: Vec<usize> = (0..SIZE[1]).filter(is_robot).collect();
            let [top, bottom] = [rows[0], rows[rows.len() - 1]];
            let height = (bottom - top) as f64 / SIZE[1] as f64;
            let hidden = hidden(&visuals, &row, &camera, &renderer);
            let about = match focus {
                Focus::Crate => vec![ShapeOwner::CRATE],
                Focus::Bench => vec![ShapeOwner::Bench, ShapeOwner::FRESH_BULB],
                Focus::Ladder => vec![ShapeOwner::LADDER],
            };
            let pixels = (0..SIZE[0] * SIZE[1]).map(|at| renderer.owner(at % SIZE[0], at / SIZE[0]));
            let about = pixels.filter(|owner| owner.is_some_and(|owner| about.contains(&owner))).count();
            unseen.extend((about < 100).then_some((task, seed)));
            println!("{task} {seed}: {height:.2} of the height, {hidden:.2} hidden, {about} pixels of its task");
            assert!((0.47..0.86).contains(&height), "{task} {seed}: {height}");
            assert!(top > 0 && bottom < SIZE[1] - 1, "{task} {seed}: rows {top} to {bottom}");
            assert!(hidden < 0.12, "{task} {seed}: {hidden} is hidden");
        }
    } // A crate at the other end of the room.
    assert!(unseen.len() <= 1, "{unseen:?} do not show what they are about");
}
