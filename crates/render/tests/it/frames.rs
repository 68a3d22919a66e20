//! Frames show things where the pinhole formula says, the same each time, and complete.

use std::collections::BTreeMap;
use std::sync::Arc;

use fiatlux_render::{Camera, HEAD_PIXELS, Lighting, RenderError, Renderer, Visuals};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{Bulb, Row, Task, errand};
use fiatlux_world::{PropScale, Scene, SceneConfig, SceneKind, SceneSpec, ShapeOwner, StartOptions, start};
use nalgebra::{Isometry3, Point3, Vector3};

pub fn stage(task: Task, seed: u64) -> (Arc<Scene>, Row) {
    stage_scaled(task, seed, PropScale::default())
}

fn stage_scaled(task: Task, seed: u64, scale: PropScale) -> (Arc<Scene>, Row) {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let spec = SceneSpec { scale, ..SceneSpec::new(SceneKind::of(task), seed, robot.gains(GainSet::Fiatlux)) };
    let scene = Arc::new(Scene::build(&SceneConfig::default(), robot, spec).unwrap());
    let world = start(Arc::clone(&scene), task, 0, &StartOptions::default()).unwrap();
    let row = world.row().clone();
    (scene, row)
}

/// Pixels that show an owner: their mean position and number.
fn seen(renderer: &Renderer, size: [usize; 2], owner: ShapeOwner) -> ([f64; 2], usize) {
    let (mut sum, mut count) = ([0.0; 2], 0);
    for y in 0..size[1] {
        for x in 0..size[0] {
            if renderer.owner(x, y) == Some(owner) {
                sum[0] += x as f64 + 0.5;
                sum[1] += y as f64 + 0.5;
                count += 1;
            }
        }
    }
    (sum.map(|s| s / count as f64), count)
}

/// The pinhole formula, on its own: u = w/2 - f y/x, v = h/2 - f z/x.
fn pinhole(camera: &Camera, point: Vector3<f64>, [w, h]: [f64; 2]) -> [f64; 2] {
    let p = camera.world_from_camera.inverse() * Point3::from(point);
    let f = w / 2.0 / (camera.horizontal_fov / 2.0).tan();
    [w / 2.0 - f * p.y / p.x, h / 2.0 - f * p.z / p.x]
}

/// The outline of a bulb seen from afar is centred where its axis is; a crate's corners bound what shows it.
#[test]
fn landmarks_are_where_the_pinhole_formula_says() {
    let (scene, row) = stage(Task::S03, 0);
    let visuals = Visuals::new(&scene);
    let size = [320, 240];
    let mut renderer = Renderer::new(size[0], size[1]);
    let light = Lighting::default();

    // The fresh bulb on the bench, from above: its silhouette is a circle about its axis.
    let glass = (row.things[errand::FRESH_BULB].pose * Point3::new(0.0, 0.0, 0.155)).coords;
    for away in [[0.01, 0.0], [0.30, 0.2]] {
        let mut camera = Camera::look_at(glass + Vector3::new(0.0, 0.0, 1.5), glass, 0.2, 4.0 / 3.0);
        camera.world_from_camera = Isometry3::translation(0.0, 0.0, 0.0) * camera.world_from_camera;
        camera.world_from_camera.translation.x += away[0] * 0.2;
        camera.world_from_camera.translation.y += away[1] * 0.2;
        renderer.render(&visuals, &row, &camera, &light);
        let (center, count) = seen(&renderer, size, ShapeOwner::FRESH_BULB);
        assert!(count > 1000, "{count}");
        let expected = pinhole(&camera, glass, [320.0, 240.0]);
        assert!(
            (center[0] - expected[0]).abs() < 1.0 && (center[1] - expected[1]).abs() < 1.0,
            "{center:?} {expected:?}"
        );
    }

    // The crate from above: its rim's corners are the corners of what is seen.
    let center = scene.world_from(errand::CRATE).translation.vector;
    let camera = Camera::look_at(center + Vector3::new(0.02, -0.01, 2.0), center, 0.4, 4.0 / 3.0);
    renderer.render(&visuals, &row, &camera, &light);
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for y in 0..size[1] {
        for x in 0..size[0] {
            if renderer.owner(x, y) == Some(ShapeOwner::CRATE) {
                low = [low[0].min(x as f64), low[1].min(y as f64)];
                high = [high[0].max(x as f64 + 1.0), high[1].max(y as f64 + 1.0)];
            }
        }
    }
    let config = &scene.config.crate_;
    let corners = [[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]].map(|[sx, sy]| {
        let rim = Vector3::new(sx * config.outer_half[0], sy * config.outer_half[1], config.rim_height);
        pinhole(&camera, center + rim, [320.0, 240.0])
    });
    for i in 0..2 {
        let least = corners.iter().map(|c| c[i]).fold(f64::INFINITY, f64::min);
        let most = corners.iter().map(|c| c[i]).fold(f64::NEG_INFINITY, f64::max);
        assert!((low[i] - least).abs() < 1.0 && (high[i] - most).abs() < 1.0, "{low:?} {high:?} {corners:?}");
    }
}

/// A depth is the distance along the axis: looking straight down, to the floor.
#[test]
fn depth_is_the_distance_to_the_floor() {
    let (scene, row) = stage(Task::S02, 0);
    let crate_ = scene.world_from(errand::CRATE).translation.vector;
    let eye = crate_ + Vector3::new(0.0, 0.0, 3.0);
    let camera = Camera::look_at(eye, crate_, 0.6, 1.0);
    let mut renderer = Renderer::new(64, 64);
    renderer.render(&Visuals::new(&scene), &row, &camera, &Lighting::default());
    assert_eq!(renderer.owner(0, 0), Some(ShapeOwner::Floor));
    assert!((renderer.depth(0, 0).unwrap() - 3.0).abs() < 1e-4);
    assert!((renderer.depth(32, 32).unwrap() - (3.0 - scene.config.crate_.floor_height)).abs() < 1e-4);
}

#[test]
fn the_same_arguments_give_the_same_bytes() {
    let (scene, row) = stage(Task::S10, 1);
    let visuals = Visuals::new(&scene);
    let light = Lighting::default();
    let head = Camera::head(&scene.robot, &row).unwrap();
    let mut renderer = Renderer::new(HEAD_PIXELS, HEAD_PIXELS);
    let first = renderer.render(&visuals, &row, &head, &light).clone();
    // Another view between must leave nothing behind.
    let other = Camera::look_at(Vector3::new(3.0, 3.0, 2.0), Vector3::zeros(), 1.0, 1.0);
    assert_ne!(renderer.render(&visuals, &row, &other, &light), &first);
    assert_eq!(renderer.render(&visuals, &row, &head, &light), &first);
    let mut fresh = Renderer::new(HEAD_PIXELS, HEAD_PIXELS);
    assert_eq!(fresh.render(&Visuals::new(&scene), &row, &head, &light), &first);
}

/// Every prop and every link with a shape shows up in a picture that looks at it, in its own colour where it has one.
#[test]
fn nothing_is_missing() {
    let (scene, row) = stage(Task::S02, 0);
    let visuals = Visuals::new(&scene);
    let light = Lighting::default();
    let size = [160, 160];
    let mut renderer = Renderer::new(size[0], size[1]);
    let socket = (row.things[errand::FIXTURE].pose * Point3::new(0.0, 0.0, 0.04)).coords;
    let out = row.things[errand::FIXTURE].pose.rotation * Vector3::z();
    let spots: [(ShapeOwner, Vector3<f64>, Vector3<f64>); 6] = [
        (ShapeOwner::Bench, scene.world_from_bench.unwrap().translation.vector, Vector3::new(0.3, 1.5, 2.5)),
        (ShapeOwner::CRATE, scene.world_from(errand::CRATE).translation.vector, Vector3::new(0.5, 0.5, 1.5)),
        (ShapeOwner::FIXTURE, socket, out * 0.8 + Vector3::new(0.1, 0.2, 0.1)),
        (
            ShapeOwner::LADDER,
            row.things[errand::LADDER].pose.translation.vector + Vector3::z(),
            Vector3::new(1.5, 1.5, 1.5),
        ),
        (
            ShapeOwner::OLD_BULB,
            row.things[errand::OLD_BULB].pose.translation.vector,
            out * 0.8 + Vector3::new(0.1, 0.2, 0.1),
        ),
        (ShapeOwner::FRESH_BULB, row.things[errand::FRESH_BULB].pose.translation.vector, Vector3::new(0.1, 0.5, 0.6)),
    ];
    for (owner, target, from) in spots {
        let camera = Camera::look_at(target + from, target, 0.9, 1.0);
        let image = renderer.render(&visuals, &row, &camera, &light).clone();
        let (_, count) = seen(&renderer, size, owner);
        assert!(count > 60, "{owner:?}: {count} pixels");
        // Red, green and blue of its pixels, in the mean.
        let mut sum = [0.0; 3];
        for y in 0..size[1] {
            for x in 0..size[0] {
                if renderer.owner(x, y) == Some(owner) {
                    let pixel = image.pixel(x, y);
                    (0..3).for_each(|i| sum[i] += f64::from(pixel[i]) / count as f64);
                }
            }
        }
        match owner {
            ShapeOwner::CRATE => assert!(sum[0] > sum[1] && sum[1] > 2.0 * sum[2], "the crate is yellow: {sum:?}"),
            ShapeOwner::FRESH_BULB => assert!(sum[0] > 150.0, "the fresh bulb is bright: {sum:?}"),
            _ => assert!(sum.iter().any(|value| *value > 30.0), "{owner:?} is not black: {sum:?}"),
        }
    }

    // The robot from six sides.
    let mut found: BTreeMap<usize, usize> = BTreeMap::new();
    let middle = row.robot.pose.translation.vector;
    let size = [320, 320];
    let mut renderer = Renderer::new(size[0], size[1]);
    for from in
        [[2.0, 0.1, 0.1], [-2.0, 0.1, 0.1], [0.1, 2.0, 0.1], [0.1, -2.0, 0.1], [0.3, 0.3, 2.0], [0.5, 0.5, -2.0]]
    {
        let camera = Camera::look_at(middle + Vector3::from(from), middle, 0.8, 1.0);
        renderer.render(&visuals, &row, &camera, &light);
        for y in 0..size[1] {
            for x in 0..size[0] {
                if let Some(ShapeOwner::Robot(link)) = renderer.owner(x, y) {
                    *found.entry(link).or_default() += 1;
                }
            }
        }
    }
    for shape in scene.robot.shapes() {
        assert!(found.contains_key(&shape.link), "{} is not seen", scene.robot.links()[shape.link].name);
    }
}

/// Meshes are closed and turned outwards: what the far side of the robot hides is never seen through its near side.
#[test]
fn nothing_is_inside_out() {
    let (scene, row) = stage(Task::S02, 0);
    for visuals in [Visuals::new(&scene), Visuals::for_people(&scene, None)] {
        check_front(&scene, &row, &visuals);
    }
}

fn check_front(scene: &Scene, row: &Row, visuals: &Visuals) {
    let size = [200, 200];
    let mut renderer = Renderer::new(size[0], size[1]);
    let chest = row.robot.pose * Point3::new(0.0, 0.0, 0.25);
    let ahead = row.robot.pose.rotation * Vector3::x();
    let camera = Camera::look_at(chest.coords + ahead * 1.5, chest.coords, 0.1, 1.0);
    renderer.render(visuals, row, &camera, &Lighting::default());
    let [torso, logo] = ["torso_link", "logo_link"].map(|name| scene.robot.link_index(name).unwrap());
    for y in 50..150 {
        for x in 50..150 {
            assert!([Some(ShapeOwner::Robot(torso)), Some(ShapeOwner::Robot(logo))].contains(&renderer.owner(x, y)));
            assert!(renderer.depth(x, y).unwrap() < 1.5, "({x}, {y}) shows the back");
        }
    }
}

/// The head camera hangs where the published mount is: at standing 1.262 m high, 47.6 degrees downwards.
#[test]
fn the_head_camera_is_at_its_mount() {
    let (scene, mut row) = stage(Task::S02, 0);
    row.joint_position.copy_from_slice(scene.robot.q0());
    row.robot.pose = Isometry3::translation(0.0, 0.0, 0.788);
    let camera = Camera::head(&scene.robot, &row).unwrap();
    let at = camera.world_from_camera.translation.vector;
    assert!((at - Vector3::new(0.054, 0.0175, 1.262)).norm() < 2e-3, "{at}");
    let ahead = camera.world_from_camera.rotation * Vector3::x();
    assert!((ahead.z.asin().to_degrees() + 47.6).abs() < 0.1, "{ahead}");
    let [focal, _] = camera.focal(HEAD_PIXELS, HEAD_PIXELS);
    assert!((focal - 184.8).abs() < 0.1, "{focal}");
}

#[test]
fn a_row_that_is_no_posture_is_refused_and_drawn_without_its_robot() {
    let (scene, mut row) = stage(Task::S02, 0);
    row.joint_position[0] = f64::NAN;
    assert!(matches!(Camera::head(&scene.robot, &row), Err(RenderError::Posture(_))));
    let camera =
        Camera::look_at(row.robot.pose.translation.vector + Vector3::new(2.0, 1.0, 0.5), Vector3::zeros(), 1.0, 1.0);
    let mut renderer = Renderer::new(64, 64);
    renderer.render(&Visuals::new(&scene), &row, &camera, &Lighting::default());
    let robot = (0..64 * 64).filter(|i| matches!(renderer.owner(i % 64, i / 64), Some(ShapeOwner::Robot(_)))).count();
    assert_eq!(robot, 0);
}

/// Half the key light makes a darker picture; the room's tint colours the floor.
#[test]
fn light_and_tint_show() {
    let (scene, row) = stage(Task::S02, 0);
    let visuals = Visuals::new(&scene);
    let head = Camera::head(&scene.robot, &row).unwrap();
    let mut renderer = Renderer::new(64, 64);
    let mut mean = |light: &Lighting| {
        let image = renderer.render(&visuals, &row, &head, light);
        let mut sum = [0.0; 3];
        image.rgb().chunks_exact(3).for_each(|p| (0..3).for_each(|i| sum[i] += f64::from(p[i])));
        sum.map(|s| s / (64.0 * 64.0))
    };
    let nominal = mean(&Lighting::default());
    let dim = mean(&Lighting { key: 800.0, dome: 600.0, ..Lighting::default() });
    assert!((0..3).all(|i| dim[i] < 0.9 * nominal[i]), "{nominal:?} {dim:?}");
    let red = mean(&Lighting { room_tint: [1.0, 0.8, 0.8], ..Lighting::default() });
    assert!(red[1] < nominal[1] - 3.0 && (red[0] - nominal[0]).abs() < 1.0, "{nominal:?} {red:?}");
}

/// A seated fresh bulb lights the ladder below it in pictures for people. The robot's cameras keep the light of their version.
#[test]
fn a_burning_bulb_lights_what_is_near_for_people_alone() {
    let (scene, lit) = stage(Task::S12, 0);
    let mut dark = lit.clone();
    assert!(dark.attachments[Bulb::Fresh as usize].seated);
    dark.attachments[Bulb::Fresh as usize].seated = false;
    let ladder = lit.things[errand::LADDER].pose.translation.vector;
    let camera = Camera::look_at(ladder + Vector3::new(2.5, 1.5, 3.2), ladder + Vector3::z(), 0.8, 1.0);
    let mut renderer = Renderer::new(100, 100);
    let mut brightness = |visuals: &Visuals, row: &Row| {
        renderer.render(visuals, row, &camera, &Lighting::default());
        let pixels = (0..100 * 100).filter(|i| renderer.owner(i % 100, i / 100) == Some(ShapeOwner::LADDER));
        let bytes: Vec<usize> = pixels.map(|i| usize::from(renderer.image().rgb()[3 * i])).collect();
        assert!(bytes.len() > 200, "{}", bytes.len());
        bytes.iter().sum::<usize>() as f64 / bytes.len() as f64
    };
    let (people, sensors) = (Visuals::for_people(&scene, None), Visuals::new(&scene));
    assert!(brightness(&people, &lit) > brightness(&people, &dark) + 10.0);
    assert_eq!(brightness(&sensors, &lit), brightness(&sensors, &dark));
}

/// Props are seen in the size that they have: the ladder within the box of its projected ends, a bulb from above as a disc
/// whose area goes with the square of its size.
#[test]
fn scaled_props_are_seen_scaled() {
    let size = [320, 240];
    let mut renderer = Renderer::new(size[0], size[1]);
    let light = Lighting::default();
    let [x, y, z] = [1.05, 0.95, 1.1];
    let area = |renderer: &mut Renderer, fresh_bulb: f64| {
        let (scene, row) = stage_scaled(Task::S01, 0, PropScale { fresh_bulb, ladder: [x, y, z], socket: 0.9 });
        let glass = (row.things[errand::FRESH_BULB].pose * Point3::new(0.0, 0.0, 0.15224 * fresh_bulb)).coords;
        let above = Camera::look_at(glass + Vector3::new(0.0, 0.0, 1.5), glass, 0.2, 4.0 / 3.0);
        renderer.render(&Visuals::new(&scene), &row, &above, &light);
        seen(renderer, size, ShapeOwner::FRESH_BULB).1 as f64
    };
    let ratio = area(&mut renderer, 1.1) / area(&mut renderer, 0.9);
    let expected = (1.1_f64 / 0.9).powi(2);
    assert!((ratio / expected - 1.0).abs() < 0.02, "{ratio}, not {expected}");

    let scale = PropScale { ladder: [x, y, z], ..PropScale::default() };
    let (scene, row) = stage_scaled(Task::S01, 0, scale);
    let ladder = row.things[errand::LADDER].pose;
    let camera =
        Camera::look_at(ladder.translation.vector + Vector3::z() * 3.9, ladder.translation.vector, 0.7, 4.0 / 3.0);
    renderer.render(&Visuals::new(&scene), &row, &camera, &light);
    let radius = 0.016;
    let (foot_x, foot_y) = (0.304 * x - radius, 0.4895 * y - radius);
    let ends = [-1.0, 1.0].into_iter().flat_map(|side| {
        [
            Point3::new(side * foot_x, -foot_y, radius),
            Point3::new(side * foot_x, foot_y, radius),
            Point3::new(side * foot_x, 0.27 * y, 1.861 * z - radius),
        ]
    });
    let empty = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    let grow = |(low, high): ([f64; 2], [f64; 2]), [u, v]: [f64; 2], by: f64| {
        ([low[0].min(u - by), low[1].min(v - by)], [high[0].max(u + by), high[1].max(v + by)])
    };
    let focal = 160.0 / (camera.horizontal_fov / 2.0).tan();
    let expected = ends.fold(empty, |bounds, end| {
        let point = (ladder * end).coords;
        let depth = camera.world_from_camera.inverse_transform_point(&point.into()).x;
        grow(bounds, pinhole(&camera, point, [320.0, 240.0]), radius * focal / depth)
    });
    let pixels = (0..size[1]).flat_map(|v| (0..size[0]).map(move |u| (u, v)));
    let shown = pixels.filter(|&(u, v)| renderer.owner(u, v) == Some(ShapeOwner::LADDER));
    let found = shown.fold(empty, |bounds, (u, v)| grow(bounds, [u as f64 + 0.5, v as f64 + 0.5], 0.5));
    let off = |found: [f64; 2], expected: [f64; 2]| (0..2).map(|i| (found[i] - expected[i]).abs()).fold(0.0, f64::max);
    assert!(off(found.0, expected.0) < 2.0 && off(found.1, expected.1) < 2.0, "{found:?}, not {expected:?}");
}
