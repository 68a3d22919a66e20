//! The hidden command `fiatlux manual`: completions for shells and pages for `man`, of every program.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::{Args, CommandFactory};
use clap_complete::{Shell, generate_to};

/// Options of `fiatlux manual`.
#[derive(Debug, Args)]
pub struct ManualArgs {
    /// Folder to write into: completions/, and man/man1/ as MANPATH has it.
    #[arg(value_name = "DIR")]
    out: PathBuf,
}

/// Writes the files.
pub fn run(args: &ManualArgs) -> anyhow::Result<()> {
    write(&args.out).with_context(|| format!("cannot write into {}", args.out.display()))
}

fn write(out: &Path) -> std::io::Result<()> {
    let [completions, pages] = [out.join("completions"), out.join("man/man1")];
    fs::create_dir_all(&completions)?;
    fs::create_dir_all(&pages)?;
    let commands = [
        crate::Cli::command(),
        sim_server::command(),
        sim_server::recorder::command(),
        policy_client::command(),
        scorer::command(),
    ];
    for mut command in commands {
        let name = command.get_name().to_owned();
        for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
            generate_to(shell, &mut command, &name, &completions)?;
        }
        clap_mangen::generate_to(command, &pages)?;
    }
    Ok(())
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// Guards that each command of each program has its page, that a page has each of its flags, and that the shells know the commands.
    #[test]
    fn every_command_has_its_page() {
        let out = std::env::temp_dir().join(format!("fiatlux-manual-{}", std::process::id()));
        write(&out).unwrap();
        let read = |file: String| fs::read_to_string(out.join(&file)).unwrap_or_else(|error| panic!("{file}: {error}"));
        for (page, flags) in [
            ("fiatlux", &["fiatlux\\-evaluate(1)", "fiatlux\\-keys(1)"][..]),
            ("fiatlux-evaluate", &["\\-\\-policy", "\\-\\-seeds", "\\-\\-robot"]),
            ("sim-server", &["\\-\\-settings", "\\-\\-record"]),
            ("recorder", &["\\-\\-settings", "\\-\\-out"]),
            ("policy-client-run", &["\\-\\-sensors"]),
            ("scorer-admin-token", &["\\-\\-days"]),
        ] {
            let text = read(format!("man/man1/{page}.1"));
            flags.iter().for_each(|flag| assert!(text.contains(flag), "{page} without {flag}"));
        }
        for program in ["fiatlux", "sim-server", "recorder", "policy-client", "scorer"] {
            for file in [format!("{program}.bash"), format!("_{program}"), format!("{program}.fish")] {
                assert!(read(format!("completions/{file}")).contains("--help"), "{file}");
            }
        }
        assert!(read("completions/fiatlux.bash".into()).contains("evaluate"));
        assert!(!out.join("man/man1/fiatlux-manual.1").exists(), "it is for those who package the programs");
        fs::remove_dir_all(out).unwrap();
    }
}
