//! Errors as exceptions of Python.

use std::sync::OnceLock;

use fiatlux_cli::in_full;
use pyo3::create_exception;
use pyo3::exceptions::{PyException, PyRuntimeError, PyValueError};
use pyo3::prelude::*;

create_exception!(
    fiatlux,
    FiatluxError,
    PyException,
    "The simulator refused a request. The message names the field and the remedy."
);

/// Turns an error with all its causes into the package's exception.
pub(crate) fn failed(error: &dyn std::error::Error) -> PyErr {
    FiatluxError::new_err(in_full(error))
}

/// The same as a `ValueError`, for a wrong argument.
pub(crate) fn refused(error: &dyn std::error::Error) -> PyErr {
    PyValueError::new_err(in_full(error))
}

/// The error for an array that is not contiguous.
pub(crate) fn not_contiguous(field: &str) -> PyErr {
    PyValueError::new_err(format!("{field} is not C-contiguous; give numpy.ascontiguousarray({field})"))
}

/// A panic is a bug in this package. It has printed its message, and becomes an exception that Python can catch.
pub(crate) fn guarded<T>(work: impl FnOnce() -> T) -> PyResult<T> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(work))
        .map_err(|_| PyRuntimeError::new_err("fiatlux has a fault, described on stderr; please report it"))
}

/// Borrows an object of a method that changes it: `own_mut!(slf, this)` makes `this` of `slf`.
macro_rules! own_mut {
    ($slf:ident, $this:ident) => {
        let mut held = $slf.try_borrow_mut().map_err(|_| $crate::fault::busy($slf))?;
        let $this = &mut *held;
    };
}

/// The same of a method that reads.
macro_rules! own {
    ($slf:ident, $this:ident) => {
        let held = $slf.try_borrow().map_err(|_| $crate::fault::busy($slf))?;
        let $this = &*held;
    };
}

pub(crate) use {own, own_mut};

/// The error for an object that another thread uses.
pub(crate) fn busy<T>(object: &Bound<'_, T>) -> PyErr {
    let name = object.as_any().get_type().name().map_or_else(|_| "object".to_owned(), |name| name.to_string());
    let remedy = "let one thread at a time call it (threading.Lock), or give each thread its own copy (copy.deepcopy)";
    PyRuntimeError::new_err(format!("another thread is in a call of this {name}; {remedy}"))
}

/// Refuses a forked child of the process that first used the network: it lacks Zenoh's threads, and would wait for ever.
pub(crate) fn check_process() -> PyResult<()> {
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
