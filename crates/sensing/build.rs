//! Lists the sensors of `src/sensors/`: their modules for `sensors.rs`, and their variants for `registry.rs`.

use std::fmt::Write;
use std::path::Path;
use std::{env, fs};

/// The benchmark's sensors, in the order in which sessions list them. All others follow by name.
const BENCHMARK: [&str; 11] = [
    "proprioception",
    "hand_contact",
    "limb_contact",
    "last_action",
    "lidar",
    "camera",
    "features",
    "flat",
    "privileged",
    "verdict",
    "chest_camera",
];

fn main() {
    println!("cargo::rerun-if-changed=src/sensors");
    let folder = Path::new(&env::var_os("CARGO_MANIFEST_DIR").expect("cargo names the folder")).join("src/sensors");
    let entries = fs::read_dir(&folder).expect("the folder src/sensors/").map(|entry| entry.expect("a file").path());
    let files = entries.filter(|path| path.extension().is_some_and(|kind| kind == "rs"));
    let name = |path: &Path| path.file_stem().expect("a name").to_string_lossy().into_owned();
    let mut sensors: Vec<_> = files.map(|path| (name(&path), path)).collect();
    let place = |name: &str| BENCHMARK.iter().position(|sensor| *sensor == name).unwrap_or(BENCHMARK.len());
    sensors.sort_by_cached_key(|(name, _)| (place(name), name.clone()));
    let (mut modules, mut variants) = (String::new(), "sensors! {\n".to_owned());
    for (name, path) in sensors {
        let text = fs::read_to_string(&path).expect("the sensor's file");
        let doc =
            text.lines().next().and_then(|line| line.strip_prefix("//!")).expect("the file begins with its `//!`");
        let words = name.split('_').map(|word| word[..1].to_uppercase() + &word[1..]);
        writeln!(modules, "#[path = {path:?}]\npub(crate) mod {name};").expect("a string");
        writeln!(variants, "#[doc = {doc:?}]\n{}: {name}, {:?},", words.collect::<String>(), doc.trim())
            .expect("a string");
    }
    variants.push_str("}\n");
    let out = env::var_os("OUT_DIR").expect("cargo names the folder");
    fs::write(Path::new(&out).join("modules.rs"), modules).expect("the list of modules");
    fs::write(Path::new(&out).join("variants.rs"), variants).expect("the list of variants");
}
