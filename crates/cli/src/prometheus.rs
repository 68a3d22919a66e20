//! The text format of Prometheus.

use std::fmt::Write as _;

/// Content type of a page in this format.
pub const PROMETHEUS_TEXT: &str = "text/plain; version=0.0.4";

/// Writes what stands before the values of a metric: `fiatlux_NAME`, of a kind such as `gauge`, with its help.
pub fn metric_head(out: &mut String, name: &str, kind: &str, help: &str) {
    let _ = write!(out, "# HELP fiatlux_{name} {help}\n# TYPE fiatlux_{name} {kind}\n");
}
