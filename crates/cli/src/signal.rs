//! Ends a program on Ctrl-C or SIGTERM.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use tokio::signal::unix::{SignalKind, signal};

/// Exit code of a program that an interrupt ended before its work was done, as in shells.
pub const INTERRUPTED: u8 = 130;

/// A flag that Ctrl-C or SIGTERM sets, so that the program can end cleanly. A second signal ends it at once.
pub fn stop_on_signal() -> std::io::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build()?;
    let (mut interrupt, mut terminate) = {
        let _guard = runtime.enter();
        (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?)
    };
    std::thread::Builder::new().name("signals".into()).spawn(move || {
        runtime.block_on(async move {
            for times in 1.. {
                tokio::select! {
                    _ = interrupt.recv() => {}
                    _ = terminate.recv() => {}
                }
                if times > 1 {
                    std::process::exit(INTERRUPTED.into());
                }
                flag.store(true, Ordering::Relaxed);
            }
        });
    })?;
    Ok(stop)
}

/// Blocks until the flag of [`stop_on_signal`] is set.
pub fn wait_for(stop: &AtomicBool) {
    while !stop.load(Ordering::Relaxed) {
        std::thread::sleep(Duration::from_millis(20));
    }
}
