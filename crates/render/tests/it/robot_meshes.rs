//! A folder of meshes shows in the picture, has a label that is its content's, and is refused where it is not a
//! robot's.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use fiatlux_render::{Camera, Lighting, MeshError, Renderer, RobotMeshes, Visuals};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{Row, Task};
use fiatlux_world::{Scene, SceneConfig, SceneKind, SceneSpec, ShapeOwner, StartOptions, start};
use nalgebra::{Point3, Vector3};

type Corners = [[f32; 3]; 3];

/// A folder that is gone at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("fiatlux-meshes-{name}-{}", std::process::id()));
        drop(std::fs::remove_dir_all(&path));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn with(self, name: &str, bytes: impl AsRef<[u8]>) -> Self {
        std::fs::write(self.0.join(name), bytes).unwrap();
        self
    }

    fn open(&self) -> Result<RobotMeshes, MeshError> {
        RobotMeshes::open(&self.0, &Robot::benchmark().unwrap())
    }

    /// Message of the refusal.
    fn refused(&self) -> String {
        self.open().unwrap_err().to_string()
    }
}

impl AsRef<Path> for Folder {
    fn as_ref(&self) -> &Path {
        &self.0
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        drop(std::fs::remove_dir_all(&self.0));
    }
}

/// A box about the origin, each face towards the outside.
fn cuboid([x, y, z]: [f32; 3]) -> Vec<Corners> {
    let mut triangles = Vec::new();
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            let corner = |u: f32, v: f32| {
                let mut p = [0.0; 3];
                (p[axis], p[(axis + 1) % 3], p[(axis + 2) % 3]) = (side, u, v * side);
                [p[0] * x, p[1] * y, p[2] * z]
            };
            let quad = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
            triangles.extend([[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]);
        }
    }
    triangles
}

/// A binary STL file by the format's description, not by the crate that reads it.
fn binary(head: &str, triangles: &[Corners]) -> Vec<u8> {
    let mut bytes = head.as_bytes().to_vec();
    bytes.resize(80, b' ');
    bytes.extend((triangles.len() as u32).to_le_bytes());
    for triangle in triangles {
        bytes.extend([0; 12]);
        triangle.iter().flatten().for_each(|value| bytes.extend(value.to_le_bytes()));
        bytes.extend([0; 2]);
    }
    bytes
}

fn ascii(head: &str, triangles: &[Corners]) -> String {
    let mut text = format!("{head}\n");
    for triangle in triangles {
        text += "  facet normal 0 0 0\n    outer loop\n";
        triangle.iter().for_each(|[x, y, z]| writeln!(text, "      vertex {x} {y} {z:e}").unwrap());
        text += "    endloop\n  endfacet\n";
    }
    text + "endsolid\n"
}

/// Eight vertices and six faces of four corners.
fn obj([x, y, z]: [f32; 3]) -> String {
    let mut text = String::from("# a box\nmtllib missing.mtl\n");
    for i in 0..8 {
        let sign = |bit: i32| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
        writeln!(text, "v {} {} {}", x * sign(0), y * sign(1), z * sign(2)).unwrap();
    }
    text + "vn 0 0 1\nf 1/1/1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf -8 -4 -2 -6\nf 2//1 4//1 8//1 6//1\n"
}

fn stage() -> (Arc<Scene>, Row) {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let spec = SceneSpec::new(SceneKind::of(Task::S02), 0, robot.gains(GainSet::Fiatlux));
    let scene = Arc::new(Scene::build(&SceneConfig::default(), robot, spec).unwrap());
    let world = start(Arc::clone(&scene), Task::S02, 0, &StartOptions::default()).unwrap();
    let row = world.row().clone();
    (scene, row)
}

/// A box in place of the torso has the outline that the pinhole formula gives it: in every format, turned either way, and
/// from its inside where a side is missing.
#[test]
fn a_mesh_is_where_its_link_is() {
    let (scene, mut row) = stage();
    row.joint_position.fill(0.0);
    let torso = scene.robot.link_index("torso_link").unwrap();
    let half = [0.3_f32, 0.25, 0.25];
    let pose = scene.robot.forward_kinematics(&row.joint_position, &row.robot.pose).unwrap()[torso];
    // From behind, where no arm is before the box.
    let eye = pose * Point3::new(-3.0, 0.0, 0.0);
    let camera = Camera::look_at(eye.coords, pose.translation.vector, 0.4, 1.0);
    let inside_out: Vec<Corners> = cuboid(half).into_iter().map(|[a, b, c]| [a, c, b]).collect();
    let (without_near_side, mut without_far_side) = (cuboid(half).split_off(2), cuboid(half));
    without_far_side.drain(2..4);
    let files: [(&str, Vec<u8>); 8] = [
        ("torso_link.STL", binary("a box", &cuboid(half))),
        ("torso_link_rev_1_0.STL", binary("solid by some programs", &cuboid(half))),
        ("torso_link.stl", ascii("solid a box", &cuboid(half)).into()),
        ("torso_link.stl", ascii("solid", &cuboid(half)).into()),
        ("torso_link.obj", obj(half).into()),
        ("torso_link.stl", binary("", &inside_out)),
        ("torso_link.stl", binary("", &without_far_side)),
        ("torso_link.stl", binary("", &without_near_side)),
    ];
    // Half the angle of view over the picture's half side.
    let side = |half: f64, away: f64| 2.0 * half * 100.0 / (0.2_f64).tan() / away;
    for (index, (name, bytes)) in files.iter().enumerate() {
        let meshes = Folder::new("place").with(name, bytes).open().unwrap();
        assert_eq!(meshes.links().collect::<Vec<_>>(), [torso], "{name}");
        for mut renderer in [Renderer::new(200, 200), Renderer::supersampled(200, 200, 3)] {
            let mut look = |visuals: &Visuals| {
                renderer.render(visuals, &row, &camera, &Lighting::default());
                let pixels = (0..200 * 200).map(|i| (i % 200, i / 200));
                let count = pixels.filter(|&(x, y)| renderer.owner(x, y) == Some(ShapeOwner::Robot(torso))).count();
                (count as f64, renderer.depth(100, 100).unwrap())
            };
            let (found, depth) = look(&Visuals::with_robot(&scene, Some(&meshes)));
            let away = if index == 7 { 3.3 } else { 2.7 };
            assert!((depth - away).abs() < 1e-3, "{name} {index}: {depth} m, not {away} m");
            // Through the missing side other links are seen.
            if index == 7 {
                continue;
            }
            let expected = side(0.25, 2.7).powi(2);
            assert!((found / expected - 1.0).abs() < 0.03, "{name} {index}: {found} pixels, not {expected}");
            assert!(look(&Visuals::new(&scene)).0 < 0.7 * found);
        }
    }
}

/// Of a link's files the latest revision counts, Unitree's names of the hands are known, and a hand's base has its palm.
#[test]
fn names_find_their_links() {
    let robot = Robot::benchmark().unwrap();
    let small = binary("", &cuboid([0.01; 3]));
    let names =
        ["torso_link.STL", "torso_link_rev_1_0.STL", "torso_link_23dof_rev_1_0.STL", "Link14_R.STL", "Link99_R.STL"];
    let folder = names.iter().fold(Folder::new("names"), |folder, name| folder.with(name, &small));
    let folder = folder.with("L_hand_base_link.STL", &small).with("README.md", "").with("knee.STL", &small);
    std::fs::create_dir(folder.0.join("left_knee_link.STL")).unwrap();
    let meshes = folder.open().unwrap();
    let found: Vec<_> = meshes.links().map(|link| robot.links()[link].name.as_str()).collect();
    assert_eq!(found, ["torso_link", "left_hand_base_link", "R_thumb_distal"]);
    // The earlier revision is not even read.
    let label = meshes.label().to_owned();
    assert_eq!(folder.with("torso_link.STL", "broken").open().unwrap().label(), label);

    let (scene, row) = stage();
    let meshes = Folder::new("palm").with("L_hand_base_link.STL", &small).open().unwrap();
    let at = |name: &str| scene.robot.link_index(name).unwrap();
    let poses = scene.robot.forward_kinematics(&row.joint_position, &row.robot.pose).unwrap();
    let palm = poses[at("left_palm")].translation.vector;
    let seen = |visuals: &Visuals| {
        [Vector3::x(), -Vector3::x(), Vector3::y(), -Vector3::y(), Vector3::z(), -Vector3::z()].iter().any(|from| {
            let camera = Camera::look_at(palm + from * 0.5, palm, 0.4, 1.0);
            let mut renderer = Renderer::new(64, 64);
            renderer.render(visuals, &row, &camera, &Lighting::default());
            (0..64 * 64).any(|i| renderer.owner(i % 64, i / 64) == Some(ShapeOwner::Robot(at("left_palm"))))
        })
    };
    assert!(seen(&Visuals::new(&scene)) && !seen(&Visuals::with_robot(&scene, Some(&meshes))));
}

/// The label is one of names and bytes, in whatever order they came into the folder.
#[test]
fn a_label_is_its_files() {
    let [one, two] = [[0.1; 3], [0.1, 0.1, 0.2]].map(|half| binary("", &cuboid(half)));
    let label = |folder: &Folder| folder.open().unwrap().label().to_owned();
    let first = Folder::new("label-a").with("pelvis.STL", &one).with("head_link.STL", &two);
    let again = Folder::new("label-b").with("head_link.STL", &two).with("pelvis.STL", &one).with("notes.txt", "x");
    assert_eq!(label(&first), label(&again));
    let hex = label(&first).strip_prefix("meshes:").unwrap().to_owned();
    assert!(hex.len() == 64 && hex.bytes().all(|byte| byte.is_ascii_hexdigit()), "{hex}");
    let mut other = one.clone();
    // In the head, which nothing is drawn from.
    other[0] ^= 1;
    let changed = Folder::new("label-c").with("pelvis.STL", &other).with("head_link.STL", &two);
    let swapped = Folder::new("label-d").with("pelvis.STL", &two).with("head_link.STL", &one);
    assert_ne!(label(&changed), label(&first));
    assert_ne!(label(&swapped), label(&first));
}

#[test]
fn a_folder_without_meshes_of_the_robot_is_refused() {
    let empty = Folder::new("empty");
    let message = empty.refused();
    assert!(message.contains("pelvis.stl") && message.contains("g1_inspire"), "{message}");
    assert!(empty.with("g1.stl", binary("", &cuboid([0.1; 3]))).refused().contains("pelvis.stl"));
    let missing = RobotMeshes::open("/nowhere/at/all", &Robot::benchmark().unwrap()).unwrap_err();
    assert!(matches!(missing, MeshError::Folder { .. }), "{missing}");
    let small = binary("", &cuboid([0.1; 3]));
    let twice = Folder::new("twice").with("pelvis.stl", &small).with("pelvis.obj", obj([0.1; 3]));
    let message = twice.refused();
    assert!(message.contains("pelvis.obj and pelvis.stl") && message.contains("leave one"), "{message}");
    assert!(twice.with("pelvis_rev_2_0.stl", &small).open().is_ok());
}

/// Whatever a file holds, it is refused with its name and a remedy.
#[test]
fn hostile_files_are_refused() {
    let cube = cuboid([0.1; 3]);
    let whole = binary("", &cube);
    let mut huge = whole.clone();
    huge[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
    let mut not_a_number = cube.clone();
    not_a_number[3][1][2] = f32::NAN;
    let mut infinite = cube.clone();
    infinite[3][1][2] = f32::INFINITY;
    let many = vec![[[0.0; 3], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]]; 500_001];
    let far = cuboid([0.1; 3]).into_iter().map(|t| t.map(|[x, y, z]| [x + 3.0, y, z])).collect::<Vec<_>>();
    let cases: [(&str, Vec<u8>, &str); 22] = [
        ("pelvis.stl", Vec::new(), "too short"),
        ("pelvis.stl", whole[..whole.len() - 1].into(), "cut off"),
        ("pelvis.stl", whole[..83].into(), "too short"),
        ("pelvis.stl", huge, "4294967295 triangles"),
        ("pelvis.stl", binary("", &many), "decimate"),
        ("pelvis.stl", binary("", &[]), "no triangle"),
        ("pelvis.stl", binary("", &[[[0.1; 3]; 3]]), "export"),
        ("pelvis.stl", binary("", &[[[0.1, 0.0, 0.0], [0.2, 0.0, 0.0], [0.3, 0.0, 0.0]]]), "with an area"),
        ("pelvis.stl", binary("", &not_a_number), "is not finite"),
        ("pelvis.stl", binary("", &infinite), "is not finite"),
        ("pelvis.stl", binary("", &cuboid([100.0, 50.0, 80.0])), "scale it by 0.001"),
        ("pelvis.stl", binary("", &cuboid([1e-6; 3])), "in metres"),
        ("pelvis.stl", binary("", &far), "in the link's frame"),
        (
            "pelvis.stl",
            "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 12 and some more words to fill".into(),
            "no STL",
        ),
        ("pelvis.stl", "solid x\nfacet normal 0 0 NaN\n".into(), "not a whole STL"),
        ("pelvis.stl", ascii("solid", &cube).replace("endsolid", "").into(), "not a whole STL"),
        ("pelvis.stl", format!("solid x\nfacet normal {}\n", "1 ".repeat(10_000)).into(), "line of more than"),
        ("pelvis.obj", "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 4\n".into(), "line 4"),
        ("pelvis.obj", "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 0 3\n".into(), "line 4"),
        ("pelvis.obj", format!("v 0 0 0\nf 1 1 {}\nf 1 1 -2\n", i64::MIN).into(), "line 2"),
        ("pelvis.obj", "v 0 0\n".into(), "line 1"),
        ("pelvis.obj", vec![0xff, 0xfe, 0, 0], "not text"),
    ];
    for (name, bytes, words) in cases {
        let message = Folder::new("hostile").with(name, &bytes).refused();
        assert!(message.contains(words) && message.contains(name), "{words}: {message}");
    }
    // Every way to cut a text and a binary file.
    let text = ascii("solid a box", &cube);
    for (bytes, step) in [(whole.as_slice(), 7), (text.as_bytes(), 13)] {
        for length in (0..bytes.len() - 12).step_by(step) {
            Folder::new("cut").with("pelvis.stl", &bytes[..length]).open().unwrap_err();
        }
    }
    let large = Folder::new("large");
    std::fs::File::create(large.0.join("pelvis.stl")).unwrap().set_len((64 << 20) + 1).unwrap();
    assert!(large.refused().contains("more than 64 MiB"));
}
