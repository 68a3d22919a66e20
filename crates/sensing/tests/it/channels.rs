//! Depth and segmentation show what the camera's picture shows.

use fiatlux_render::{Camera, HEAD_CAMERA, Lighting, Renderer, Visuals};
use fiatlux_rules::{Task, errand};
use fiatlux_sensing::{Sensor, Sensors, segment_names};
use fiatlux_world::{CameraVariation, ShapeOwner};
use nalgebra::Point3;

use crate::common::{Rig, start_row};

const CHANNELS: [(Sensor, Sensor, Sensor, &str); 2] = [
    (Sensor::Camera, Sensor::Depth, Sensor::Segmentation, HEAD_CAMERA),
    (Sensor::ChestCamera, Sensor::ChestDepth, Sensor::ChestSegmentation, "chest_camera"),
];
const SIZE: [usize; 2] = [64, 32];

/// Names by label. A byte names every link of every robot.
#[test]
fn labels_have_names() {
    for name in ["g1_inspire", "g1_dex3", "g1_bare"] {
        let robot = fiatlux_robot::Robot::by_name(name).unwrap();
        let names = segment_names(&robot);
        assert!(names.len() < 256, "{name}: {}", names.len());
        assert_eq!(&names[..3], ["floor", "room", "bench"]);
        assert_eq!(names[ShapeOwner::CRATE.label() as usize], "crate");
        let link = robot.link_index("torso_link").unwrap();
        assert_eq!(names[ShapeOwner::Robot(link).label() as usize], "torso_link");
    }
}

/// A point of the floor lies in the floor's plane.
#[test]
fn depth_is_the_distance_of_what_is_labelled() {
    let (scene, row) = start_row(Task::S08);
    for (_, depth, labels, mount) in CHANNELS {
        let mut rig = Rig::new(&scene, &row, Task::S08, Sensors::of(&[depth, labels]), None);
        let [depths, labels] = [depth, labels].map(|sensor| rig.compute(sensor, &row));
        let camera = Camera::mounted(&scene.robot, mount, &row).unwrap().fitted(SIZE[0], SIZE[1]);
        let [fx, fy] = camera.focal(SIZE[0], SIZE[1]);
        let floor = (ShapeOwner::Floor.label() + 1) as f32;
        let mut seen = 0;
        for (at, depth) in depths.iter().enumerate().filter(|(at, _)| labels[*at] == floor) {
            let [u, v] = [at % SIZE[0], at / SIZE[0]].map(|pixel| pixel as f64 + 0.5);
            let x = f64::from(*depth);
            let point = Point3::new(x, x * (SIZE[0] as f64 / 2.0 - u) / fx, x * (SIZE[1] as f64 / 2.0 - v) / fy);
            let height = (camera.world_from_camera * point).z;
            assert!(height.abs() < 1e-3, "{mount}: pixel {at} of the floor is at {height} m");
            seen += 1;
        }
        assert!(seen > 50, "{mount}: {seen} pixels of the floor");
    }
}

/// The crate of S06, in front of the robot, is labelled where the camera projects it.
#[test]
fn labels_are_where_things_are() {
    let (scene, row) = start_row(Task::S06);
    for (_, _, labels, mount) in CHANNELS {
        let mut rig = Rig::new(&scene, &row, Task::S06, Sensors::of(&[labels]), None);
        let label = (ShapeOwner::CRATE.label() + 1) as f32;
        let numbers = rig.compute(labels, &row);
        let mine: Vec<usize> = (0..numbers.len()).filter(|at| numbers[*at] == label).collect();
        let mean =
            |axis: &dyn Fn(usize) -> usize| mine.iter().map(|at| axis(*at) as f64).sum::<f64>() / mine.len() as f64;
        let middle = [mean(&|at| at % SIZE[0]), mean(&|at| at / SIZE[0])];
        let camera = Camera::mounted(&scene.robot, mount, &row).unwrap().fitted(SIZE[0], SIZE[1]);
        let place = camera.project(&row.things[errand::CRATE].pose.translation.vector, SIZE[0], SIZE[1]).unwrap();
        let off = (middle[0] - place[0]).hypot(middle[1] - place[1]);
        assert!(mine.len() > 20 && off < 12.0, "{mount}: {} pixels, {off} from the crate", mine.len());
    }
}

/// A channel is the same alone and together with a picture, in any order, and so is the picture.
#[test]
fn channels_and_pictures_do_not_touch_each_other() {
    let (scene, row) = start_row(Task::S06);
    for (picture, depth, labels, _) in CHANNELS {
        let alone = |sensor| Rig::new(&scene, &row, Task::S06, Sensors::of(&[sensor]), None).compute(sensor, &row);
        let all = [picture, depth, labels];
        for order in [[0, 1, 2], [1, 0, 2], [2, 1, 0]] {
            let mut rig = Rig::new(&scene, &row, Task::S06, Sensors::of(&all), None);
            for index in order {
                assert_eq!(rig.compute(all[index], &row), alone(all[index]), "{:?} in {order:?}", all[index]);
            }
        }
        assert!(alone(depth).iter().any(|depth| *depth > 0.0));
    }
}

/// Every pixel with a label has a distance, and the other way round; a later row is seen afresh.
#[test]
fn a_pixel_has_both_or_neither() {
    let (scene, row) = start_row(Task::S02);
    let both = Sensors::of(&[Sensor::Depth, Sensor::Segmentation]);
    let mut rig = Rig::new(&scene, &row, Task::S02, both, None);
    let [depths, labels] = [Sensor::Depth, Sensor::Segmentation].map(|sensor| rig.compute(sensor, &row));
    assert!(depths.iter().zip(&labels).all(|(depth, label)| (*depth > 0.0) == (*label > 0.0)));
    let mut later = row.clone();
    later.step += 1;
    later.robot.pose.translation.vector.x += 0.5;
    assert_ne!(rig.compute(Sensor::Depth, &later), depths);
}

/// The second look is that of pictures for people, and the first one is as before after it.
#[test]
fn the_second_look_is_that_for_people() {
    let (scene, row) = start_row(Task::S08);
    let mut rig = Rig::new(&scene, &row, Task::S08, Sensors::of(&[Sensor::Camera]), None);
    let mut seen = |look: f64| {
        let varied = [("camera.look".to_owned(), look)].into();
        rig.suite.vary_cameras(CameraVariation::of(&varied, 3, 0));
        rig.suite.restart(None, Lighting::default());
        rig.observe(Sensors::of(&[Sensor::Camera]), &row).camera.unwrap().rgb
    };
    let [first, second, again] = [1.0, 2.0, 1.0].map(&mut seen);
    let camera = Camera::head(&scene.robot, &row).unwrap().fitted(SIZE[0], SIZE[1]);
    let drawn = |visuals: Visuals| {
        Renderer::new(SIZE[0], SIZE[1]).render(&visuals, &row, &camera, &Lighting::default()).rgb().to_vec()
    };
    assert_eq!(first, drawn(Visuals::new(&scene)));
    assert_eq!(second, drawn(Visuals::for_people(&scene, None)));
    assert_eq!(again, first);
    assert_ne!(second, first);
}
