//! MuJoCo's time for the same steps, measured by the oracle script.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use fiatlux_mjcf::{MjcfOptions, Names, OptionSet, to_mjcf};
use fiatlux_world::{PHYSICS_DT, SUBSTEPS};
use serde::Deserialize;

use super::{BenchError, Case, Folder};

/// MuJoCo's time per step, under the faster of two sets of options.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MujocoTime {
    pub mean_us: f64,
    /// `defaults` (Euler integrator, friction pyramids, the drives' damping passive in the joints) or `nearest` to ours
    /// (implicit integrator, friction cones, damping in the drives).
    pub options: &'static str,
    pub contacts: f64,
}

/// The script, and a temporary folder for the scenes that it reads.
#[derive(Debug)]
pub struct Oracle {
    script: PathBuf,
    folder: Folder,
}

#[derive(Deserialize)]
struct Output {
    cases: Vec<Timing>,
}

#[derive(Deserialize)]
struct Timing {
    defaults: Variant,
    ours: Variant,
}

#[derive(Deserialize)]
struct Variant {
    mean_us: f64,
    contacts: f64,
}

impl Oracle {
    /// Prepares to run that script.
    ///
    /// # Errors
    /// The script does not exist, or no temporary folder can be made.
    pub fn new(script: &Path) -> Result<Self, BenchError> {
        if !script.is_file() {
            return Err(BenchError::NoOracle(script.to_owned()));
        }
        Ok(Self { script: script.to_owned(), folder: Folder::new()? })
    }

    /// Times `repeats` runs of a case from its start state, stepped in C on one thread.
    ///
    /// # Errors
    /// Python, MuJoCo or the script is missing or fails.
    pub fn time(&self, case: &Case, repeats: usize) -> Result<MujocoTime, BenchError> {
        let scene = self.folder.path().join("scene.xml");
        let options = MjcfOptions {
            name: case.name.replace(' ', "-"),
            timestep: PHYSICS_DT,
            option_set: OptionSet::Nearest,
            names: Names::default(),
        };
        let write = |path: &Path, text: String| {
            fs::write(path, text)
                .map_err(|source| BenchError::Io { what: format!("write '{}'", path.display()), source })
        };
        write(&scene, to_mjcf(&case.model, &case.start, &case.targets[0], &options))?;
        let targets = self.folder.path().join("targets.json");
        write(&targets, serde_json::json!({"hold": SUBSTEPS, "targets": &case.targets}).to_string())?;
        let mut command = Command::new("python3");
        command.arg(&self.script).arg("timing").arg("--scene").arg(&scene).arg("--targets").arg(&targets);
        command.args(["--steps", &case.steps.to_string(), "--repeats", &repeats.to_string()]);
        let output = command
            .stderr(Stdio::inherit())
            .output()
            .map_err(|source| BenchError::Io { what: "start python3".into(), source })?;
        if !output.status.success() {
            return Err(BenchError::OracleFailed { case: case.name, status: output.status });
        }
        faster(&output.stdout).map_err(|source| BenchError::OracleOutput { case: case.name, source })
    }
}

fn faster(json: &[u8]) -> Result<MujocoTime, serde_json::Error> {
    use serde::de::Error;
    let output: Output = serde_json::from_slice(json)?;
    let [timing] = output.cases.as_slice() else {
        return Err(serde_json::Error::custom(format!("one case expected, {} found", output.cases.len())));
    };
    let (options, best) = if timing.defaults.mean_us <= timing.ours.mean_us {
        ("defaults", &timing.defaults)
    } else {
        ("nearest", &timing.ours)
    };
    Ok(MujocoTime { mean_us: best.mean_us, options, contacts: best.contacts })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_faster_options_count() {
        let output = |defaults: f64, ours: f64| {
            let variant = |us: f64| format!(r#"{{"mean_us": {us}, "min_us": 1.0, "contacts": {}}}"#, us / 4.0);
            let (defaults, ours) = (variant(defaults), variant(ours));
            format!(r#"{{"cases": [{{"name": "x", "defaults": {defaults}, "ours": {ours}}}]}}"#)
        };
        let read = |text: String| faster(text.as_bytes()).expect("valid output");
        assert_eq!(read(output(30.0, 40.0)), MujocoTime { mean_us: 30.0, options: "defaults", contacts: 7.5 });
        assert_eq!(read(output(40.0, 30.0)), MujocoTime { mean_us: 30.0, options: "nearest", contacts: 7.5 });
        assert!(faster(br#"{"cases": []}"#).is_err());
    }

    #[test]
    fn missing_script_is_refused_with_the_remedy() {
        let error = Oracle::new(Path::new("no/such/oracle.py")).expect_err("there is no such file").to_string();
        assert!(error.contains("no/such/oracle.py") && error.contains("--oracle"), "{error}");
    }
}
