//! The programs of the service inside the package's library, for the commands that a wheel installs. They share its simulator,
//! renderer and transport, so the wheel has each of them once.

use std::ffi::OsString;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;

use fiatlux_policies::Policies;
use pyo3::prelude::*;

/// Exit code of a Rust program that panicked.
const PANICKED: i32 = 101;

/// Runs the program of this name, `fiatlux` for any other name, and ends the process with its exit code. It does not return, and the
/// interpreter is not finalised, since threads of a carrier may still run. Signals should be at their defaults.
#[pyfunction]
pub(crate) fn run_program(py: Python<'_>, name: OsString, arguments: Vec<OsString>) {
    let program = fiatlux::program_named(&name);
    fiatlux_cli::set_command_line(std::iter::once(name).chain(arguments).collect());
    let run = || program.map_or_else(|| fiatlux::run(Policies::default()), |program| program());
    let ended = py.detach(|| catch_unwind(AssertUnwindSafe(run)));
    // Flushes stdout, too.
    std::process::exit(ended.map_or(PANICKED, number))
}

/// The number of an exit code, which its type keeps to itself.
fn number(code: ExitCode) -> i32 {
    (0..=u8::MAX).find(|&number| ExitCode::from(number) == code).map_or(PANICKED, i32::from)
}
