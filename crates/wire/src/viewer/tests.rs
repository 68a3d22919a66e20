use std::collections::BTreeSet;
use std::sync::Arc;

use fiatlux_proto::Message;
use fiatlux_robot::GainSet;
use fiatlux_rules::{Task, errand};
use fiatlux_world::{SceneConfig, SceneKind, SceneSpec, StartOptions, start};

use super::*;

fn build(task: Task) -> (Arc<Scene>, Row) {
    let robot = Arc::new(Robot::benchmark().expect("the robot"));
    let gains = robot.gains(GainSet::default());
    let spec = SceneSpec::new(SceneKind::of(task), 3, gains);
    let scene = Arc::new(Scene::build(&SceneConfig::default(), robot, spec).expect("a scene"));
    let world = start(Arc::clone(&scene), task, 0, &StartOptions::default()).expect("a start");
    let row = world.row().clone();
    (scene, row)
}

fn isometry(translation: Option<Vector>, rotation: Option<Quaternion>) -> Isometry3<f64> {
    let (t, r) = (translation.expect("a translation"), rotation.expect("a rotation"));
    let rotation = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(r.w, r.x, r.y, r.z));
    Isometry3::from_parts(Translation3::new(t.x, t.y, t.z), rotation)
}

fn in_world(frames: &FrameTransforms) -> BTreeMap<String, Isometry3<f64>> {
    let mut poses = BTreeMap::from([(WORLD.to_owned(), Isometry3::identity())]);
    for frame in &frames.transforms {
        let parent_from_child = isometry(frame.translation, frame.rotation);
        poses.insert(frame.child_frame_id.clone(), poses[&frame.parent_frame_id] * parent_from_child);
    }
    poses
}

fn tasks() -> impl Iterator<Item = (Arc<Scene>, Row)> {
    ["S01", "S12", "climb"].into_iter().map(|task| build(task.parse().expect("a task")))
}

#[test]
fn frames_as_bytes_are_those_of_the_messages() {
    for (scene, mut row) in tasks() {
        let frames = Frames::new(&scene.robot);
        for step in [0, 7, 50, 6000] {
            row.step = step;
            row.joint_position.iter_mut().for_each(|angle| *angle += 0.1);
            row.robot.pose.translation.vector.y = [0.0, -0.0, 1.5][step as usize % 3];
            assert_eq!(frames.encode(&row), frames.transforms(&row).encode_to_vec(), "{step}");
        }
    }
}

#[test]
fn frames_are_where_the_links_are() {
    for (scene, row) in tasks() {
        let frames = Frames::new(&scene.robot).transforms(&row);
        let poses = in_world(&frames);
        let expected = scene.robot.forward_kinematics(&row.joint_position, &row.robot.pose).expect("kinematics");
        let links = scene.robot.links().iter().map(|link| link.name.as_str()).zip(expected);
        let props = [
            ("ladder", row.things[errand::LADDER].pose),
            ("old_bulb", row.things[errand::OLD_BULB].pose),
            ("fixture", row.things[errand::FIXTURE].pose),
        ];
        for (name, pose) in links.chain(props) {
            let difference = poses[name].inv_mul(&pose);
            assert!(difference.translation.vector.norm() < 1e-5, "{name}: {difference}");
            assert!(difference.rotation.angle() < 1e-5, "{name}: {difference}");
        }
    }
}

#[test]
fn every_entity_has_a_frame() {
    for (scene, row) in tasks() {
        let frames = Frames::new(&scene.robot).transforms(&row);
        let mut names: BTreeSet<&str> = frames.transforms.iter().map(|frame| frame.child_frame_id.as_str()).collect();
        assert_eq!(names.len(), frames.transforms.len(), "a frame has one parent");
        names.insert(WORLD);
        let update = scene_update(&scene);
        let ids: BTreeSet<&str> = update.entities.iter().map(|entity| entity.id.as_str()).collect();
        assert_eq!(ids.len(), update.entities.len(), "an id stands once");
        assert!(ids.is_superset(&["pelvis", "floor", "ladder", "old_bulb", "fresh_bulb", "fixture"].into()));
        for entity in &update.entities {
            assert!(names.contains(entity.frame_id.as_str()), "{} in {}", entity.id, entity.frame_id);
        }
    }
}

#[test]
fn boxes_are_drawn_where_the_model_has_them() {
    for (scene, row) in tasks() {
        let frames = Frames::new(&scene.robot).transforms(&row);
        let poses = in_world(&frames);
        let update = scene_update(&scene);
        let drawn: Vec<Isometry3<f64>> = (update.entities.iter())
            .flat_map(|entity| entity.cubes.iter().map(|cube| (&entity.frame_id, cube.pose.expect("a pose"))))
            .map(|(frame, pose)| poses[frame] * isometry(pose.position, pose.orientation))
            .collect();
        for (index, shape) in scene.model.shapes().iter().enumerate() {
            let world_from_body = match scene.owner(ShapeId(index)) {
                ShapeOwner::Room | ShapeOwner::Robot(_) => continue,
                ShapeOwner::LADDER if scene.body(errand::LADDER).is_some() => row.things[errand::LADDER].pose,
                ShapeOwner::OLD_BULB => row.things[errand::OLD_BULB].pose,
                ShapeOwner::FRESH_BULB => row.things[errand::FRESH_BULB].pose,
                _ => Isometry3::identity(),
            };
            if let Geometry::Cuboid { .. } = shape.geometry {
                let pose = world_from_body * shape.body_from_shape;
                let distance = |other: &Isometry3<f64>| {
                    (pose.translation.vector - other.translation.vector).norm()
                        + pose.rotation.angle_to(&other.rotation)
                };
                let nearest = drawn.iter().map(distance).fold(f64::INFINITY, f64::min);
                assert!(nearest < 1e-5, "{} is drawn {nearest} away", shape.name);
            }
        }
    }
}

#[test]
fn a_hull_is_drawn_by_its_triangles() {
    let corners = [[0.1, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.3], [0.0, 0.0, 0.0]].map(Vector3::from);
    let hull = fiatlux_dynamics::Hull::new("stone", &corners).expect("a solid");
    let mut entity = entity("stone", WORLD);
    draw(&mut entity, &Isometry3::translation(0.0, 0.0, 1.0), &Geometry::Hull(Arc::new(hull)), TREAD);
    let [drawn] = &entity.triangles[..] else { panic!("{entity:?}") };
    assert_eq!((drawn.points.len(), drawn.indices.len()), (4, 12));
    assert!(drawn.indices.iter().all(|index| *index < 4));
    assert_eq!(drawn.pose.as_ref().and_then(|pose| pose.position).map(|position| position.z), Some(1.0));
}
