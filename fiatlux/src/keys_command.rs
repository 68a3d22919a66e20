//! The command `fiatlux keys`.

use std::fmt::Display;
use std::path::PathBuf;

use crate::keys::{Authentication, CreatedKeys, KeysOptions, make};
use clap::{Args, ValueEnum};
use fiatlux_cli::whole;

/// Text below the options of `keys`.
pub const EXAMPLES: &str = "Examples:
  fiatlux keys --out keys                              for programs on this machine
  fiatlux keys --out keys --host 192.168.1.7           for a router that others reach at this address
  fiatlux keys --out keys --host lab --auth password   without encryption, on a network whose wires nobody else reads
docs/access.md explains who can do what, and how keys are rotated and withdrawn.";

/// Options of `fiatlux keys`.
#[derive(Debug, Args)]
pub struct KeysArgs {
    /// Folder to create; it must not exist, or be empty. Nothing is ever overwritten.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Name or address of the router's machine, for its certificate; may be repeated, with the one that others connect
    /// to first [default: this machine only]
    #[arg(long, value_name = "NAME_OR_IP")]
    host: Vec<String>,
    /// Port that the router listens on.
    #[arg(long, default_value_t = 7447, value_parser = whole::<u16>(1..=65_535))]
    port: u16,
    /// Name of the server, as in sim-server --name. For several servers that share these files name all of them, such as
    /// lab,lab-2,lab-3, or a group: lab,lab-*
    #[arg(long, default_value = "local", value_delimiter = ',')]
    name: Vec<String>,
    /// The router's way to authenticate programs.
    #[arg(long, value_enum, default_value_t = Auth::Mtls)]
    auth: Auth,
    /// Validity of the certificates, days.
    #[arg(long, default_value_t = 365, value_parser = whole::<u16>(1..=3650))]
    days: u16,
    /// Number of sessions that the policy's token allows at once.
    #[arg(long, default_value_t = 64, value_parser = whole::<u32>(1..=65_536))]
    sessions: u32,
    /// Print JSON instead of text.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Auth {
    /// Certificates: QUIC with mutual TLS.
    Mtls,
    /// User and password over TCP, without encryption.
    Password,
}

/// Runs the command `fiatlux keys`.
pub fn keys(args: KeysArgs) -> anyhow::Result<()> {
    let options = KeysOptions {
        out: args.out,
        hosts: args.host,
        port: args.port,
        servers: args.name,
        authentication: match args.auth {
            Auth::Mtls => Authentication::Certificates,
            Auth::Password => Authentication::Passwords,
        },
        days: args.days,
        sessions: args.sessions,
    };
    let made = make(&options)?;
    let report = Report { folder: options.out, made };
    if args.json {
        fiatlux_cli::print(serde_json::to_string_pretty(&report)? + "\n")?;
    } else {
        fiatlux_cli::print(report.to_string())?;
    }
    Ok(())
}

#[derive(serde::Serialize)]
struct Report {
    folder: PathBuf,
    #[serde(flatten)]
    made: CreatedKeys,
}

impl Display for Report {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "Created for each machine (files with a * are secret: only their owner may read them):")?;
        for file in &self.made.files {
            let mark = if file.secret { "*" } else { " " };
            writeln!(f, "  {mark} {:<28} {}", file.path.display().to_string(), file.purpose)?;
        }
        if let Some(day) = &self.made.valid_until {
            writeln!(f, "The certificates are valid until {day}; make a new folder before.")?;
        }
        writeln!(f, "\nStart, each on its machine:")?;
        self.made.commands.iter().try_for_each(|command| writeln!(f, "  {command}"))
    }
}
