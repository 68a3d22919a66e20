//! Writes the numbers of the scene as constants: a module for each section, a constant for each number or list of numbers. It reads what
//! it needs of TOML by itself: another build of a parser would come first in every build.

use std::fmt::Write;
use std::path::Path;
use std::{env, fs};

/// Targets of the hand's joints by name, the one section below another that is read.
const GRIP: &str = "start.carry.grip";

fn main() {
    let file =
        Path::new(&env::var_os("CARGO_MANIFEST_DIR").expect("cargo names the folder")).join("../world/scene.toml");
    println!("cargo::rerun-if-changed={}", file.display());
    let scene = fs::read_to_string(file).expect("the scene");
    let (mut modules, mut section, mut entry) = (String::new(), String::new(), String::new());
    let mut grip = Vec::new();
    for line in scene.lines().map(|line| line.split('#').next().unwrap_or_default().trim()) {
        entry.push_str(line);
        if entry.matches('[').count() > entry.matches(']').count() {
            continue;
        }
        let entry = std::mem::take(&mut entry);
        match entry.split_once('=') {
            None if !entry.is_empty() => entry.trim_matches(['[', ']']).clone_into(&mut section),
            Some((name, value)) if section == GRIP => grip.push(format!("({:?}, {})", name.trim(), value.trim())),
            Some((name, value)) if !section.contains('.') => {
                if let Some(kind) = kind(value.trim()) {
                    let (name, value) = (name.trim(), value.trim());
                    let module = if section == "crate" { "crate_" } else { &section };
                    let shouted = name.to_uppercase();
                    writeln!(modules, "pub mod {module} {{ pub const {shouted}: {kind} = {value}; }}")
                        .expect("a string");
                }
            }
            _ => {}
        }
    }
    let out = Path::new(&env::var_os("OUT_DIR").expect("cargo names the folder")).join("numbers.rs");
    let grip = format!(
        "/// The grasp of a bulb.\npub mod grasp {{\n    /// `[{GRIP}]`.\n    pub const GRIP: [(&str, f64); {}] = [{}];\n}}\n",
        grip.len(),
        grip.join(", ")
    );
    fs::write(out, joined(&modules) + &grip).expect("the numbers");
}

/// One module for each name, its constants documented by their names in the scene.
fn joined(modules: &str) -> String {
    let mut text = String::new();
    let mut last = "";
    for line in modules.lines() {
        let (module, constant) = line.split_once(" { ").expect("a constant");
        if module != last {
            let section = module.trim_start_matches("pub mod ").trim_end_matches('_');
            write!(text, "{}/// `[{section}]`.\n{module} {{\n", if last.is_empty() { "" } else { "}\n" })
                .expect("a string");
            last = module;
        }
        let constant = constant.trim_end_matches(" }");
        let name = constant.trim_start_matches("pub const ").split(':').next().unwrap_or_default().to_lowercase();
        writeln!(text, "    /// `{name}`.\n    {constant}").expect("a string");
    }
    text + "}\n"
}

/// The type of a number, or of a list whose entries have one type; `None` for anything else.
fn kind(value: &str) -> Option<String> {
    let Some(entries) = value.strip_prefix('[').and_then(|value| value.strip_suffix(']')) else {
        let is_float = value.contains('.') && value.parse::<f64>().is_ok();
        return if is_float { Some("f64".into()) } else { value.parse::<u32>().ok().map(|_| "u32".into()) };
    };
    let (mut depth, mut parts) = (0, vec![String::new()]);
    for letter in entries.chars() {
        depth += i32::from(letter == '[') - i32::from(letter == ']');
        match letter {
            ',' if depth == 0 => parts.push(String::new()),
            letter => parts.last_mut()?.push(letter),
        }
    }
    let kinds: Option<Vec<String>> =
        parts.iter().map(|part| part.trim()).filter(|part| !part.is_empty()).map(kind).collect();
    let kinds = kinds?;
    let first = kinds.first()?;
    kinds.iter().all(|kind| kind == first).then(|| format!("[{first}; {}]", kinds.len()))
}
