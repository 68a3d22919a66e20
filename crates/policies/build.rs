//! Lists the parameters of `src/hands/`: `(name, text)`. `TASK.toml` is for the benchmark's robot, `TASK.ROBOT.toml` for another one.

use std::fmt::Write;
use std::path::Path;
use std::{env, fs};

fn main() {
    println!("cargo::rerun-if-changed=src/hands");
    let folder = Path::new(&env::var_os("CARGO_MANIFEST_DIR").expect("cargo names the folder")).join("src/hands");
    let entries = fs::read_dir(&folder).expect("the folder src/hands/").map(|entry| entry.expect("a file").path());
    let mut files: Vec<_> = entries.filter(|path| path.extension().is_some_and(|kind| kind == "toml")).collect();
    files.sort();
    let mut list = format!("const PARAMETERS: [(&str, &str); {}] = [", files.len());
    for path in files {
        let name = path.file_stem().expect("a name").to_string_lossy();
        write!(list, "({name:?}, include_str!({path:?})),").expect("a string");
    }
    list.push_str("];\n");
    let out = Path::new(&env::var_os("OUT_DIR").expect("cargo names the folder")).join("parameters.rs");
    fs::write(out, list).expect("the list");
}
