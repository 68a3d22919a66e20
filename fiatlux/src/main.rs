//! The command `fiatlux`, with the built-in policies. With the feature `programs` also the other programs, by their names.

use std::process::ExitCode;

use fiatlux_policies::Policies;

fn main() -> ExitCode {
    #[cfg(feature = "programs")]
    if let Some(program) = std::env::args_os().next().as_deref().and_then(fiatlux::program_named) {
        return program();
    }
    fiatlux::run(Policies::default())
}
