//! The native part of the Python package `fiatlux`: batches and episodes that write into NumPy arrays. The public interface
//! is in `fiatlux/*.py`; nothing here is meant for users.

mod assets;
mod bag;
mod batch;
mod build;
mod client;
mod climber;
mod episode;
mod evaluate;
mod fault;
mod kinematics;
mod numbers;
mod painter;
#[cfg(feature = "programs")]
mod program;
mod score;
mod settings;
mod state;
mod teacher;
mod watch;
mod wbc;

use fiatlux_rules::SeedOwner;
use pyo3::prelude::*;

use fault::FiatluxError;

#[pymodule(gil_used = true)]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("FiatluxError", module.py().get_type::<FiatluxError>())?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("MAX_WORLDS", fiatlux_batch::MAX_WORLDS)?;
    fiatlux_server::simulate_thin_bags();
    module.add("MAX_THREADS", fiatlux_batch::MAX_THREADS)?;
    module.add("MAX_STARTS", fiatlux_batch::MAX_STARTS)?;
    module.add("BODY_COMMAND", fiatlux_wbc::BodyCommand::NAMES)?;
    module.add("EXPERT_SENSORS", teacher::SENSORS.iter().map(|sensor| sensor.name()).collect::<Vec<_>>())?;
    module.add("STANDS_BELOW", fiatlux_wbc::BodyCommand::STANDS_BELOW)?;
    module.add("BODY_COMMAND_KEYS", fiatlux_wbc::BodyCommand::CHUNK_KEYS)?;
    let training = SeedOwner::Training.seeds();
    module.add("TRAINING_SEEDS", (*training.start(), training.end() + 1))?;
    module.add("BENCHMARK_VERSION", fiatlux_rules::BENCHMARK_VERSION)?;
    module.add_class::<bag::Bag>()?;
    module.add_class::<batch::Batch>()?;
    module.add_class::<batch::Snapshot>()?;
    module.add_class::<client::Client>()?;
    module.add_class::<climber::Climber>()?;
    module.add_class::<episode::Episode>()?;
    module.add_class::<kinematics::Kinematics>()?;
    module.add_class::<teacher::Expert>()?;
    module.add_class::<teacher::Experts>()?;
    module.add_class::<teacher::SessionExpert>()?;
    module.add_class::<wbc::WholeBody>()?;
    module.add_class::<wbc::WholeBodies>()?;
    module.add_function(wrap_pyfunction!(bag::is_leftover, module)?)?;
    module.add_function(wrap_pyfunction!(build::tasks, module)?)?;
    module.add_function(wrap_pyfunction!(build::task_of, module)?)?;
    module.add_function(wrap_pyfunction!(build::robots, module)?)?;
    module.add_function(wrap_pyfunction!(build::published_scene, module)?)?;
    module.add_function(wrap_pyfunction!(build::segments, module)?)?;
    module.add_function(wrap_pyfunction!(build::cameras, module)?)?;
    module.add_function(wrap_pyfunction!(build::sensors, module)?)?;
    module.add_function(wrap_pyfunction!(painter::camera_names, module)?)?;
    module.add_function(wrap_pyfunction!(build::body_sensors, module)?)?;
    module.add_function(wrap_pyfunction!(evaluate::evaluate_into, module)?)?;
    module.add_function(wrap_pyfunction!(evaluate::begin_run, module)?)?;
    module.add_function(wrap_pyfunction!(evaluate::grade_run, module)?)?;
    module.add_function(wrap_pyfunction!(evaluate::shards_left, module)?)?;
    module.add_function(wrap_pyfunction!(bag::write_thin, module)?)?;
    module.add_function(wrap_pyfunction!(evaluate::parse_seeds, module)?)?;
    module.add_function(wrap_pyfunction!(build::controller_contract, module)?)?;
    module.add_function(wrap_pyfunction!(build::climber_contract, module)?)?;
    module.add_function(wrap_pyfunction!(score::benchmark, module)?)?;
    module.add_function(wrap_pyfunction!(assets::asset_picture, module)?)?;
    module.add_function(wrap_pyfunction!(assets::asset_trials, module)?)?;
    module.add_function(wrap_pyfunction!(available_threads, module)?)?;
    module.add_function(wrap_pyfunction!(check_training, module)?)?;
    #[cfg(feature = "programs")]
    module.add_function(wrap_pyfunction!(program::run_program, module)?)?;
    Ok(())
}

/// Returns a seed that training may use, and refuses those for judging.
#[pyfunction]
fn check_training(seed: u64) -> PyResult<u64> {
    SeedOwner::check_training(seed).map_err(|error| fault::refused(&error))
}

/// Number of threads that this process may keep busy: by its affinity and by the quota of its control groups, as `docker run --cpus` sets
/// it, which Python's own count leaves out.
#[pyfunction]
fn available_threads() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from).min(fiatlux_batch::MAX_THREADS)
}
