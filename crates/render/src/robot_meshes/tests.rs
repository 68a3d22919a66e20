//! Our own shapes, written as files and read again, are the same robot.
#![allow(clippy::unwrap_used)]

use fiatlux_robot::GainSet;
use fiatlux_rules::Task;
use fiatlux_world::{Scene, SceneConfig, SceneKind, SceneSpec, StartOptions, start};
use nalgebra::Vector3;

use super::*;
use crate::look::Look;
use crate::visuals::robot::links;
use crate::{Camera, HEAD_PIXELS, Lighting, Renderer, Visuals};

/// A binary STL file of each link that has a look of its own.
fn export(robot: &Robot, folder: &Path) {
    for (link, mesh) in robot.links().iter().zip(links(robot, None, Detail::Fine, Look::One)) {
        let corner = |i: u32| stl_io::Vertex::new(mesh.positions[i as usize]);
        let triangle = |triangle: &crate::mesh::Triangle| stl_io::Triangle {
            normal: stl_io::Normal::new([0.0; 3]),
            vertices: triangle.vertices.map(corner),
        };
        let triangles: Vec<_> = mesh.triangles.iter().map(triangle).collect();
        if !triangles.is_empty() {
            let mut file = std::fs::File::create(folder.join(format!("{}.STL", link.name))).unwrap();
            stl_io::write_stl(&mut file, triangles.iter()).unwrap();
        }
    }
}

#[test]
fn our_own_shapes_come_back() {
    let folder = std::env::temp_dir().join(format!("fiatlux-own-meshes-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let robot = Arc::new(Robot::benchmark().unwrap());
    export(&robot, &folder);
    let meshes = RobotMeshes::open(&folder, &robot).unwrap();
    let drawn = robot.links().len()
        - links(&robot, None, Detail::Fine, Look::One).iter().filter(|m| m.triangles.is_empty()).count();
    assert_eq!(meshes.links().count(), drawn);

    let spec = SceneSpec::new(SceneKind::of(Task::S08), 0, robot.gains(GainSet::Fiatlux));
    let scene = Arc::new(Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec).unwrap());
    let world = start(Arc::clone(&scene), Task::S08, 0, &StartOptions::default()).unwrap();
    let middle = world.row().robot.pose.translation.vector;
    let beside = Camera::look_at(middle + Vector3::new(1.5, 2.0, 0.5), middle, 0.7, 1.0);
    let head = Camera::head(&robot, world.row()).unwrap();
    let visuals = [None, Some(&meshes)].map(|own| Visuals::with_robot(&scene, own).finely(&scene, own));
    // Of the coarse one the outline is a little off.
    let cases =
        [(Renderer::supersampled(300, 300, 2), beside, 0.999), (Renderer::new(HEAD_PIXELS, HEAD_PIXELS), head, 0.985)];
    for (mut renderer, camera, least) in cases {
        let size = [renderer.image().width(), renderer.image().height()];
        let [ours, theirs] = visuals.each_ref().map(|visuals| {
            renderer.render(visuals, world.row(), &camera, &Lighting::default());
            let pixels = (0..size[0] * size[1]).map(|i| (i % size[0], i / size[0]));
            pixels.map(|(x, y)| renderer.owner(x, y)).collect::<Vec<_>>()
        });
        let is_robot = |owner: &Option<ShapeOwner>| matches!(owner, Some(ShapeOwner::Robot(_)));
        assert!(ours.iter().filter(|owner| is_robot(owner)).count() > 3000);
        let same = ours.iter().zip(&theirs).filter(|(a, b)| a == b).count() as f64 / ours.len() as f64;
        assert!(same > least, "{same} of the pixels show the same");
    }
    std::fs::remove_dir_all(folder).unwrap();
}

/// Cells that grow to the budget, a heap that vanishes at any size, and a surface that is small enough already.
#[test]
fn coarse_surfaces_keep_to_their_budget() {
    let ball = {
        let mut mesh = Mesh::new(Frame::World, ShapeOwner::Room, Detail::Fine);
        mesh.egg(&nalgebra::Isometry3::identity(), Vector3::zeros(), Vector3::repeat(0.1), 120, Paint::Shell);
        mesh.triangles.iter().map(|t| t.vertices.map(|i| mesh.positions[i as usize])).collect::<Vec<_>>()
    };
    let drawn = |surface: &Surface| {
        let mut mesh = Mesh::new(Frame::World, ShapeOwner::Room, Detail::Fine);
        surface.add_to(&mut mesh, Paint::Shell);
        mesh.finished()
    };
    let coarse = Surface::new(&ball).decimated(600).unwrap();
    let mesh = drawn(&coarse);
    assert!((300..=600).contains(&mesh.triangles.len()), "{}", mesh.triangles.len());
    assert!((mesh.radius - 0.1 * 3.0_f64.sqrt()).abs() < 0.01, "{}", mesh.radius);

    // Faces over one another: all of them are in one cell of any grid that is coarse enough.
    let heap: Vec<_> = (0..5000_u16)
        .map(|i| {
            let [x, y] = [i % 70, i / 70].map(|k| 2e-4 + f32::from(k) * 1e-5);
            [[x, y, 1e-3], [x + 1.5e-3, y, 1e-3], [x, y + 1.5e-3, 1e-3]]
        })
        .collect();
    // A closed surface is drawn from outside, one with a rim from both sides.
    let heap = Surface::new(&heap).decimated(600).unwrap();
    assert_eq!((drawn(&heap).triangles.len(), drawn(&heap).casters().len()), (1200, 600));
    assert!(coarse.decimated(600).is_none());
}
