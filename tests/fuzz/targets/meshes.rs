//! Meshes of the robot's links, as a user's folder has them: STL, binary or ASCII, and Wavefront OBJ.
#![no_main]

use std::path::PathBuf;
use std::sync::LazyLock;

use fiatlux_fuzz::{folder, seeds_wanted, write_seeds};
use fiatlux_render::RobotMeshes;
use fiatlux_robot::Robot;
use libfuzzer_sys::fuzz_target;

static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| folder("meshes"));
static ROBOT: LazyLock<Robot> = LazyLock::new(|| Robot::benchmark().expect("the robot"));

const OBJ: &str = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 2 3\nf 1/1 2/2 4/4\nf -4 -2 -1\n";
const ASCII: &str = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 0.1 0 0\nvertex 0 0.1 0\nendloop\nendfacet\nendsolid a\n";

/// A binary STL file of one triangle.
fn binary() -> Vec<u8> {
    let mut bytes = vec![0; 80];
    bytes.extend(1_u32.to_le_bytes());
    let numbers = [0.0_f32, 0.0, 1.0, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.1, 0.0];
    bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
    bytes.extend([0; 2]);
    bytes
}

// The first byte of an input is the format: odd for OBJ.
fuzz_target!(init: if let Some((folder, _)) = seeds_wanted() {
    let seed = |format: u8, bytes: &[u8]| [&[format], bytes].concat();
    let seeds = [("obj", seed(1, OBJ.as_bytes())), ("ascii", seed(0, ASCII.as_bytes())), ("binary", seed(0, &binary()))];
    write_seeds(&folder, seeds.map(|(name, bytes)| (name.to_owned(), bytes)));
}, |data: &[u8]| {
    let Some((format, bytes)) = data.split_first() else { return };
    let name = if format % 2 == 1 { "left_knee_link.obj" } else { "left_knee_link.STL" };
    let path = FOLDER.join(name);
    std::fs::write(&path, bytes).expect("a file");
    let _ = RobotMeshes::open(&*FOLDER, &ROBOT);
    std::fs::remove_file(path).expect("a file");
});
