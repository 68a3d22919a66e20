//! The other programs of the service, by the names under which they are started.

use std::ffi::OsStr;
use std::path::Path;
use std::process::ExitCode;

/// The program that goes by this name, which may be a path; none for `fiatlux` itself and for any other name, such as that of a copy.
pub fn program_named(started_as: &OsStr) -> Option<fn() -> ExitCode> {
    match Path::new(started_as).file_name()?.to_str()? {
        "sim-server" => Some(sim_server::run),
        "recorder" => Some(sim_server::recorder::run),
        "policy-client" => Some(policy_client::run),
        "scorer" => Some(scorer::run),
        _ => None,
    }
}
