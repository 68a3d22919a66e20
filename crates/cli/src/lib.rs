//! Shared by the programs on the command line: arguments and settings files, the log, results and progress, and the
//! signals that end a program.
#![allow(missing_docs)] // Used in this repository alone.
mod bag_form;
mod browser;
mod command_line;
mod in_full;
mod log;
mod parse;
mod print;
mod progress;
mod prometheus;
mod settings;
mod signal;
mod whole_file;

pub use bag_form::BagForm;
pub use browser::{Redirect, open_browser, open_browser_secretly};
pub use command_line::{command_line, set_command_line};
pub use in_full::in_full;
pub use log::{init_log, init_quiet_log, is_news};
pub use parse::{check_examples, check_whole_numbers, parse, whole};
pub use print::{failure, print, print_error, print_headed, print_painted, report, usage};
pub use progress::ProgressLine;
pub use prometheus::{PROMETHEUS_TEXT, metric_head};
pub use settings::{check_example, command_with_settings, parse_with_settings, parse_with_settings_from};
pub use signal::{INTERRUPTED, stop_on_signal, wait_for};
pub use whole_file::write_whole;
