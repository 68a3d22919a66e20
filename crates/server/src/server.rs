//! Sessions for policies.
//!
//! [`Server`] offers them on a carrier, in one process with its clients or on the network. A session itself is a
//! state machine without I/O (`fiatlux_session::ServerSession`) over a simulation (`host`); a fixed pool of workers
//! runs it (`pool`, `actor`), and the carrier's callbacks only check messages and put them into inboxes (`listen`). A failure
//! in a session stays in it.

mod actor;
mod counts;
mod credentials;
mod gate;
mod host;
mod info;
mod links;
mod listen;
mod networks;
mod open;
mod opens;
mod places;
mod plan;
mod pool;
mod record;
mod run_requests;
mod runs;
mod scenes;
mod sessions;
mod shell;
mod simulate;
mod state;

use std::sync::{Mutex, MutexGuard, PoisonError};

pub use counts::Counts;
pub use runs::{RecordError, SharedSeeds};
pub use shell::{RecordsTo, Server, ServerError, ServerOptions};
pub use simulate::simulate_thin_bags;

/// Locks a mutex even if another thread panicked with it: what it guards is then closed, not shared.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// An episode of a request, and the header that a bag of it would have.
#[cfg(test)]
pub(crate) fn recorded_header(
    request: &fiatlux_proto::v3::OpenRequest,
    config: &fiatlux_world::SceneConfig,
    robot: std::sync::Arc<fiatlux_robot::Robot>,
    episode: u64,
) -> (fiatlux_proto::v3::EpisodeHeader, fiatlux_world::Episode) {
    use fiatlux_proto::Message;
    let request = fiatlux_proto::v3::OpenRequest { protocol: Some(fiatlux_proto::PROTOCOL), ..request.clone() };
    let plan = plan::read(&request.encode_to_vec()).expect("a valid request");
    let spec = plan.episode(episode);
    let gains = robot.gains(plan.gains);
    let scene = fiatlux_world::Scene::build(config, robot, spec.scene(gains)).expect("a scene");
    let episode = fiatlux_world::Episode::start(std::sync::Arc::new(scene), &spec).expect("it starts");
    (info::header("lab", "1", &plan, info::Labels::default(), &episode), episode)
}
