//! Runs long work on a thread of its own, so that Ctrl-C works in Python.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::{Duration, Instant};

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;

/// Time between two checks for Ctrl-C.
const PERIOD: Duration = Duration::from_millis(50);
/// Time to wait for work that was asked to stop. A query without an answer may take longer, and ends by itself.
const STOPPING_TIME: Duration = Duration::from_secs(10);

/// Progress that the work reports.
pub(crate) type OnProgress<'a, P> = &'a dyn Fn(P);

enum Event<T, P> {
    Progress(P),
    Done(T),
}

/// Does the work without the interpreter's lock. Ctrl-C stops it, and so does an exception of `on_progress`, which is called
/// in this thread.
pub(crate) fn watch<T: Send + 'static, P: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(&Arc<AtomicBool>, OnProgress<'_, P>) -> T + Send + 'static,
    mut on_progress: impl FnMut(Python<'_>, P) -> PyResult<()>,
) -> PyResult<T> {
    let stop = Arc::new(AtomicBool::new(false));
    let (sender, mut events) = mpsc::channel();
    let theirs = Arc::clone(&stop);
    let thread = std::thread::Builder::new().name("fiatlux".into()).spawn(move || {
        // After a second Ctrl-C nobody is listening.
        let done = work(&theirs, &|progress| drop(sender.send(Event::Progress(progress))));
        let _ = sender.send(Event::Done(done));
    });
    thread?;
    let mut stopping: Option<(PyErr, Instant)> = None;
    loop {
        let waiting = &mut events;
        let event = py.detach(move || waiting.recv_timeout(PERIOD));
        let looked = match event {
            Ok(Event::Done(done)) => {
                return stopping.map_or(Ok(done), |(error, _)| Err(error));
            }
            Ok(Event::Progress(progress)) if stopping.is_none() => on_progress(py, progress),
            Ok(Event::Progress(_)) | Err(RecvTimeoutError::Timeout) => Ok(()),
            Err(RecvTimeoutError::Disconnected) => {
                return Err(PyRuntimeError::new_err("fiatlux has a fault, described on stderr; please report it"));
            }
        };
        if let Err(error) = looked.and_then(|()| py.check_signals()) {
            stop.store(true, Ordering::Relaxed);
            if stopping.is_some() {
                return Err(error);
            }
            stopping = Some((error, Instant::now()));
        }
        if let Some((error, since)) = stopping.take() {
            if since.elapsed() > STOPPING_TIME {
                return Err(error);
            }
            stopping = Some((error, since));
        }
    }
}
