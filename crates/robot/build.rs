//! Lists the robots of `robots/`: `(name, hand, text)` by name, the first of them the benchmark's, which the file `benchmark` names.

use std::fmt::Write;
use std::path::Path;
use std::{env, fs};

fn main() {
    println!("cargo::rerun-if-changed=robots");
    let folder = Path::new(&env::var_os("CARGO_MANIFEST_DIR").expect("cargo names the folder")).join("robots");
    let entries = fs::read_dir(&folder).expect("the folder robots/").map(|entry| entry.expect("a file").path());
    let mut files: Vec<_> = entries.filter(|path| path.extension().is_some_and(|kind| kind == "toml")).collect();
    let benchmark = fs::read_to_string(folder.join("benchmark")).expect("the name of the benchmark's robot");
    let is_other = |path: &Path| path.file_stem().is_none_or(|name| name != benchmark.trim());
    files.sort_by_key(|path| (is_other(path), path.clone()));
    let mut list = format!("pub(crate) const ROBOTS: [(&str, &str, &str); {}] = [", files.len());
    for path in files {
        let name = path.file_stem().expect("a name").to_string_lossy();
        let text = fs::read_to_string(&path).expect("the robot's file");
        let hand = text.lines().find_map(|line| line.strip_prefix("hand = ")).expect("a line `hand = \"...\"`");
        write!(list, "({name:?}, {hand}, include_str!({path:?})),").expect("a string");
    }
    list.push_str("];\n");
    let out = Path::new(&env::var_os("OUT_DIR").expect("cargo names the folder")).join("robots.rs");
    fs::write(out, list).expect("the list");
}
