//! The native part of the Python package `fiatlux`: batches and episodes that write into NumPy arrays. The public interface
//! is in `fiatlux/*.py`; nothing here is meant for users.

mod bag;
mod batch;
mod build;
mod client;
mod episode;
mod evaluate;
mod score;
mod settings;
mod watch;
mod wbc;

use std::sync::OnceLock;

use fiatlux_cli::in_full;
use pyo3::create_exception;
use pyo3::exceptions::{PyException, PyRuntimeError, PyValueError};
use pyo3::prelude::*;

create_exception!(
    _native,
    FiatluxError,
    PyException,
    "The simulator refused a request. The message names the field and the remedy."
);

/// Turns an error with all its causes into the package's exception.
fn failed(error: &dyn std::error::Error) -> PyErr {
    FiatluxError::new_err(in_full(error))
}

/// The same as a `ValueError`, for a wrong argument.
fn refused(error: &dyn std::error::Error) -> PyErr {
    PyValueError::new_err(in_full(error))
}

/// The error for an array that is not contiguous.
fn not_contiguous(field: &str) -> PyErr {
    PyValueError::new_err(format!("{field} is not C-contiguous; give numpy.ascontiguousarray({field})"))
}

/// A panic is a bug in this package. It has printed its message, and becomes an exception that Python can catch.
fn guarded<T>(work: impl FnOnce() -> T) -> PyResult<T> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(work))
        .map_err(|_| PyRuntimeError::new_err("fiatlux has a fault, described on stderr; please report it"))
}

/// Refuses a forked child of the process that first used the network: it lacks Zenoh's threads, and would wait for ever.
fn check_process() -> PyResult<()> {
    static FIRST: OnceLock<u32> = OnceLock::new();
    let parent = *FIRST.get_or_init(std::process::id);
    if parent == std::process::id() {
        return Ok(());
    }
    Err(FiatluxError::new_err(format!(
        "process {parent} used the network before it forked this one, which lacks its threads; start processes with `spawn`, or \
         make the first Client in the child"
    )))
}

#[pymodule(gil_used = true)]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("FiatluxError", module.py().get_type::<FiatluxError>())?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("MAX_WORLDS", fiatlux_batch::MAX_WORLDS)?;
    module.add("MAX_THREADS", fiatlux_batch::MAX_THREADS)?;
    module.add("MAX_STARTS", fiatlux_batch::MAX_STARTS)?;
    module.add("BENCHMARK_VERSION", fiatlux_rules::BENCHMARK_VERSION)?;
    module.add_class::<bag::Bag>()?;
    module.add_class::<batch::Batch>()?;
    module.add_class::<batch::Snapshot>()?;
    module.add_class::<client::Client>()?;
    module.add_class::<episode::Episode>()?;
    module.add_class::<wbc::WholeBody>()?;
    module.add_function(wrap_pyfunction!(build::tasks, module)?)?;
    module.add_function(wrap_pyfunction!(build::sensors, module)?)?;
    module.add_function(wrap_pyfunction!(evaluate::evaluate_into, module)?)?;
    module.add_function(wrap_pyfunction!(build::controller_contract, module)?)?;
    module.add_function(wrap_pyfunction!(score::benchmark, module)?)?;
    Ok(())
}
