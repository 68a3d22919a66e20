//! The cameras at the wrists see what the hands do.

use fiatlux_render::{Camera, Lighting, Renderer, Visuals};
use fiatlux_rules::Task;
use fiatlux_sensing::{Sensor, Sensors};
use fiatlux_world::ShapeOwner;

use crate::common::{Rig, start_row};

const SIZE: usize = 128;

/// Each sees fingers of its own hand and none of the other one's; the bulb in the right hand is in the picture of the right one alone.
#[test]
fn each_sees_its_own_hand_and_the_bulb_in_it() {
    for (task, bulb) in [(Task::S11, ShapeOwner::FRESH_BULB), (Task::S04, ShapeOwner::OLD_BULB)] {
        let (scene, row) = start_row(task);
        let links = scene.robot.links();
        for (side, prefix, other) in [("left", "L_", "R_"), ("right", "R_", "L_")] {
            let mut renderer = Renderer::new(SIZE, SIZE);
            let camera = Camera::mounted(&scene.robot, &format!("{side}_wrist_camera"), &row).unwrap();
            let picture = renderer.render(&Visuals::new(&scene), &row, &camera, &Lighting::default());
            if let Some(folder) = std::env::var_os("FIATLUX_PICTURES") {
                let path = std::path::Path::new(&folder).join(format!("{side}_wrist_{task}.png"));
                std::fs::write(path, picture.to_png().unwrap()).unwrap();
            }
            let owners: Vec<_> = (0..SIZE * SIZE).filter_map(|at| renderer.owner(at % SIZE, at / SIZE)).collect();
            let share = |is: &dyn Fn(ShapeOwner) -> bool| {
                owners.iter().filter(|owner| is(**owner)).count() as f64 / (SIZE * SIZE) as f64
            };
            let fingers = |prefix: &str| {
                share(&|owner| matches!(owner, ShapeOwner::Robot(link) if links[link].name.starts_with(prefix)))
            };
            let own = fingers(prefix);
            assert!((0.03..0.6).contains(&own), "{task} {side}: {own} of the picture shows its fingers");
            assert_eq!(fingers(other), 0.0, "{task} {side}");
            let bulb = share(&|owner| owner == bulb);
            assert_eq!(bulb > 0.05, side == "right", "{task} {side}: {bulb} of the picture shows the bulb");
        }
    }
}

#[test]
fn each_has_its_own_picture() {
    let (scene, row) = start_row(Task::S11);
    let sensors = Sensors::of(&[Sensor::LeftWristCamera, Sensor::RightWristCamera, Sensor::Camera]);
    let seen = Rig::new(&scene, &row, Task::S11, sensors, None).observe(sensors, &row);
    let pictures = [seen.left_wrist_camera, seen.right_wrist_camera, seen.camera].map(Option::unwrap);
    assert!(pictures[0] != pictures[1] && pictures[1] != pictures[2] && pictures[0] != pictures[2]);
}
