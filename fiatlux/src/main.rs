//! The command `fiatlux`, with the built-in policies.

use std::process::ExitCode;

use fiatlux_policies::Policies;

fn main() -> ExitCode {
    fiatlux::run(Policies::default())
}
