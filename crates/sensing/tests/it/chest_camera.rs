//! The chest camera sees what a policy on the ladder wants.

use fiatlux_render::{Camera, Lighting, Renderer, Visuals};
use fiatlux_rules::Task;
use fiatlux_sensing::{Sensor, Sensors};
use fiatlux_world::ShapeOwner;

use crate::common::{Rig, start_row};

/// In the starts on the floor before the ladder and on the ladder, treads are in the picture, and nothing of the torso
/// that carries it; with a bulb in the hand the hand is.
#[test]
fn treads_and_hands_are_in_the_picture() {
    for (task, sees_ladder, sees_hand) in
        [(Task::S02, true, false), (Task::S11, true, true), (Task::Climb, true, false)]
    {
        let (scene, row) = start_row(task);
        let mut renderer = Renderer::new(128, 128);
        let camera = Camera::mounted(&scene.robot, "chest_camera", &row).unwrap();
        renderer.render(&Visuals::new(&scene), &row, &camera, &Lighting::default());
        if let Some(folder) = std::env::var_os("FIATLUX_PICTURES") {
            let mut large = Renderer::new(512, 512);
            let picture = large.render(&Visuals::new(&scene), &row, &camera, &Lighting::default()).to_png().unwrap();
            std::fs::write(std::path::Path::new(&folder).join(format!("chest_{task}.png")), picture).unwrap();
        }
        let owners = (0..128 * 128).filter_map(|pixel| renderer.owner(pixel % 128, pixel / 128)).collect::<Vec<_>>();
        let share =
            |is: &dyn Fn(ShapeOwner) -> bool| owners.iter().filter(|owner| is(**owner)).count() as f64 / 16384.0;
        let torso = scene.robot.link_index("torso_link").unwrap();
        let hands = scene.robot.hand_links();
        assert_eq!(share(&|owner| owner == ShapeOwner::Robot(torso)), 0.0, "{task}");
        assert_eq!(share(&|owner| owner == ShapeOwner::LADDER) > 0.05, sees_ladder, "{task}");
        let hand = share(&|owner| matches!(owner, ShapeOwner::Robot(link) if hands.contains(&link)));
        assert!(hand > 0.01 || !sees_hand, "{task}: {hand}");
    }
}

/// Off unless a session asks for it, alone or together with the head camera, each with its own picture.
#[test]
fn two_cameras_have_their_own_pictures() {
    let (scene, row) = start_row(Task::S11);
    let both = Sensors::of(&[Sensor::Camera, Sensor::ChestCamera]);
    assert!(!Sensors::of_body(Task::Climb).contains(Sensor::ChestCamera));
    let rig = |sensors| Rig::new(&scene, &row, Task::S11, sensors, None);
    let seen = rig(both).observe(both, &row);
    let [head, chest] = [Sensor::Camera, Sensor::ChestCamera].map(|sensor| {
        let alone = Sensors::of(&[sensor]);
        rig(alone).observe(alone, &row)
    });
    assert!(head.camera.is_some() && head.camera != chest.chest_camera);
    assert_eq!((seen.camera, seen.chest_camera), (head.camera, chest.chest_camera));
}
