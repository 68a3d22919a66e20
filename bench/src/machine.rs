//! The machine on which a benchmark ran.

use std::thread::available_parallelism;

/// Processor, cores and platform in one line.
pub(crate) fn machine() -> String {
    let cores = available_parallelism().map_or(1, std::num::NonZero::get);
    let (os, architecture) = (std::env::consts::OS, std::env::consts::ARCH);
    let processor = std::fs::read_to_string("/proc/cpuinfo").ok().and_then(|text| processor(&text));
    match processor {
        Some(name) => format!("{name}, {cores} cores, {os} {architecture}"),
        None => format!("{cores} cores, {os} {architecture}"),
    }
}

fn processor(cpuinfo: &str) -> Option<String> {
    let line = cpuinfo.lines().find(|line| line.starts_with("model name"))?;
    line.split_once(':').map(|(_, name)| name.trim().to_owned())
}
