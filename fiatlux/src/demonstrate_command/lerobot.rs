//! Makes the LeRobot data set, by the Python package: LeRobot's own writer has no other language.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, bail};
use fiatlux_runs::Demonstration;

/// Of what a data set was made, next to it.
const NOTE: &str = "lerobot.txt";

/// A Python that can make data sets, and the folder of ours.
pub(super) struct LeRobot {
    python: PathBuf,
    target: PathBuf,
    note: PathBuf,
}

impl LeRobot {
    /// Finds out whether this Python has what is needed.
    ///
    /// # Errors
    /// It does not run or lacks a package; the data set's folder is in the way.
    pub fn find(python: Option<&Path>, out: &Path) -> anyhow::Result<Self> {
        let python = python.unwrap_or(Path::new("python3")).to_path_buf();
        let found = Self { python, target: out.join("lerobot"), note: out.join(NOTE) };
        let asked = Command::new(&found.python).args(["-m", "fiatlux.lerobot", "--check"]).output();
        let name = found.python.display();
        let remedy = "install the Fiatlux wheel with its extra lerobot (docs/python/wheels.md) and name its Python with \
                      --python; or leave --lerobot out, and make the data set later with \
                      `python -m fiatlux.lerobot OUT/bags --out SET`";
        match asked {
            Err(error) => bail!("--lerobot: cannot run {name}: {error}; {remedy}"),
            Ok(asked) if !asked.status.success() => {
                let said = String::from_utf8_lossy(&asked.stderr);
                bail!("--lerobot: {name}: {}; {remedy}", said.trim().lines().last().unwrap_or("it says nothing"))
            }
            Ok(_) => {}
        }
        if found.target.exists() && !found.note.exists() {
            bail!("--lerobot: {} is in the way; move it elsewhere", found.target.display());
        }
        Ok(found)
    }

    /// Makes the data set of these bags, and returns its folder. One of the same bags is kept; one of others is replaced when the new
    /// one is whole.
    ///
    /// # Errors
    /// Python fails; a file cannot be written.
    pub fn export(&self, bags: &Path, kept: &[Demonstration]) -> anyhow::Result<PathBuf> {
        let names = kept.iter().filter_map(|kept| kept.bag.file_name()).map(|name| name.to_string_lossy().into_owned());
        let note = names.collect::<Vec<_>>().join("\n") + "\n";
        if self.target.exists() && fs::read_to_string(&self.note).is_ok_and(|earlier| earlier == note) {
            return Ok(self.target.clone());
        }
        let next = self.target.with_file_name("lerobot_next");
        let mut python = Command::new(&self.python);
        python.args(["-m", "fiatlux.lerobot"]).arg(bags).arg("--out").arg(&next);
        // Results of this program alone go to stdout.
        let done = python.stdout(Stdio::null()).status();
        let done = done.with_context(|| format!("--lerobot: cannot run {}", self.python.display()))?;
        if !done.success() {
            bail!("--lerobot: the export failed ({done}); the bags are whole, and the same command goes on with it");
        }
        let replace = || {
            fs::write(&self.note, "")?;
            if self.target.exists() {
                fs::remove_dir_all(&self.target)?;
            }
            fs::rename(&next, &self.target)?;
            fs::write(&self.note, &note)
        };
        replace().with_context(|| format!("--lerobot: cannot put the data set in {}", self.target.display()))?;
        Ok(self.target.clone())
    }
}
