//! Converts Python arguments to our types.

use std::collections::BTreeMap;

use fiatlux_batch::{Disturbances, Field, Pushes, Ranges, Spec, Wrenches};
use fiatlux_robot::Robot;
use fiatlux_rules::{ACTION_DELAY, CAMERA, NOISE, NamedRange, PRESETS, Task};
use fiatlux_sensing::{Sensor, Sensors};
use fiatlux_world::{EpisodeRanges, SceneConfig};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::fault::refused;

/// The tasks: short id, environment id, name, instruction, horizon.
#[pyfunction]
pub(crate) fn tasks() -> Vec<(&'static str, &'static str, &'static str, &'static str, u64)> {
    let tasks = Task::ALL.into_iter();
    tasks.map(|task| (task.short_id(), task.id(), task.name(), task.instruction(), task.horizon_steps())).collect()
}

/// Short id of a task that is named in any of its forms, such as `s5`.
#[pyfunction]
pub(crate) fn task_of(name: &str) -> PyResult<&'static str> {
    task(name).map(Task::short_id)
}

/// Numbers of the published room by section, as JSON.
#[pyfunction]
pub(crate) fn published_scene() -> PyResult<String> {
    serde_json::to_string(&SceneConfig::default()).map_err(|error| refused(&error))
}

/// Names of all robots, the benchmark's first.
#[pyfunction]
pub(crate) fn robots() -> Vec<&'static str> {
    Robot::NAMES.into()
}

/// Names of what segmentation shows, in the order of its labels from 1 on.
#[pyfunction]
pub(crate) fn segments(robot: &str) -> PyResult<Vec<String>> {
    let robot = Robot::by_name(robot).map_err(|error| refused(&error))?;
    Ok(fiatlux_sensing::segment_names(&robot))
}

/// A camera: its sensor, its link, its pose there, its focal lengths and principal point in pixels, and the nearest distance, m.
type DescribedCamera = (String, String, Vec<f64>, [f64; 4], f64);

/// The robot's cameras for images of that size.
#[pyfunction]
pub(crate) fn cameras(robot: &str, width: usize, height: usize) -> PyResult<Vec<DescribedCamera>> {
    let robot = Robot::by_name(robot).map_err(|error| refused(&error))?;
    let described = |camera: fiatlux_proto::v3::Camera| {
        let pose = camera.pose.unwrap_or_default();
        let lens = [camera.fx, camera.fy, camera.cx, camera.cy];
        (camera.sensor, camera.link, [pose.position, pose.quaternion].concat(), lens, camera.near)
    };
    let sensors = Sensors::of(&Sensor::ALL);
    let cameras = fiatlux_sensing::camera_messages(sensors, &robot, [width, height]);
    Ok(cameras.into_iter().map(described).collect())
}

/// Names of all sensors.
#[pyfunction]
pub(crate) fn sensors() -> Vec<&'static str> {
    Sensor::ALL.map(Sensor::name).into()
}

/// Names of a task's sensors where none are named.
#[pyfunction]
pub(crate) fn body_sensors(name: &str) -> PyResult<Vec<&'static str>> {
    Ok(Sensors::of_body(task(name)?).iter().map(Sensor::name).collect())
}

/// The contract of a controller trained with this version, as JSON.
#[pyfunction]
pub(crate) fn controller_contract(
    frames: usize,
    hidden: Vec<usize>,
    seed: u64,
    samples: u64,
    minutes: f64,
    hardware: String,
) -> PyResult<String> {
    let training = fiatlux_wbc::Training { seed, samples, minutes, hardware };
    let contract = fiatlux_wbc::Contract::of_this_version(frames, &hidden, training);
    Ok(contract.map_err(|error| refused(&error))?.to_json())
}

/// The contract of a climbing policy trained with this version, as JSON.
#[pyfunction]
pub(crate) fn climber_contract(
    hidden: Vec<usize>,
    until: f64,
    seed: u64,
    samples: u64,
    minutes: f64,
    hardware: String,
) -> PyResult<String> {
    let contract = fiatlux_climb::Contract::of_this_version(&hidden, until, [seed, samples], minutes, hardware);
    Ok(contract.map_err(|error| refused(&error))?.to_json())
}

pub(crate) fn task(name: &str) -> PyResult<Task> {
    name.parse().map_err(|error: fiatlux_rules::UnknownTask| refused(&error))
}

/// A field of an observation: name, shape, least and greatest value, and whether it is a picture.
pub(crate) fn described(field: &Field) -> (String, Vec<usize>, f32, f32, bool) {
    (field.name.clone(), field.shape.clone(), field.range[0], field.range[1], field.is_picture())
}

/// A spec in Python's own types.
pub(crate) fn describe<'py>(py: Python<'py>, spec: &Spec) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("actions", spec.actions.clone())?;
    dict.set_item("action_range", spec.action_range.clone())?;
    dict.set_item("horizon_steps", spec.horizon_steps)?;
    dict.set_item("observation", spec.observation.iter().map(described).collect::<Vec<_>>())?;
    dict.set_item("rewards", spec.rewards.clone())?;
    dict.set_item("reward_weights", spec.reward_weights.clone())?;
    Ok(dict)
}

/// Removes a known key from a dictionary of settings.
fn take<'py, T: FromPyObjectOwned<'py>>(settings: &Bound<'py, PyDict>, key: &str) -> PyResult<Option<T>> {
    let Some(value) = settings.get_item(key)? else { return Ok(None) };
    settings.del_item(key)?;
    match value.extract() {
        Ok(value) => Ok(Some(value)),
        Err(_) => Err(PyValueError::new_err(format!("{key} is {value}; give {}", wanted(key)))),
    }
}

/// The values that a key of ranges or disturbances takes, in words.
fn wanted(key: &str) -> &'static str {
    match key {
        "com_shift_m" => "a number, m: the largest shift",
        "linear" => "a number, m/s: the largest push",
        "angular" => "a number, rad/s",
        "force_n" => "a number, N",
        "torque_nm" => "a number, N m",
        "light" => "True or False",
        "link" => "the name of a link",
        "preset" => "the name of one",
        "friction" => "a dictionary of (least, most) for each surface",
        "thing_mass" => "a dictionary of (least, most) for each thing",
        "pushes" | "wrenches" => "a dictionary",
        "camera" => "a dictionary of (least, most), such as {\"exposure\": (-1, 1)}",
        "action_delay" => "(least, most), whole ms",
        _ => "(least, most)",
    }
}

fn nothing_left(field: &str, settings: &Bound<'_, PyDict>, known: &str) -> PyResult<()> {
    match settings.keys().iter().next() {
        Some(key) => Err(PyValueError::new_err(format!("{field} has no '{key}'; known keys are {known}"))),
        None => Ok(()),
    }
}

/// Delay of actions, ms, and factor of the noise.
pub(crate) type TaskRanges = (Option<[u32; 2]>, Option<[f64; 2]>);

/// The ranges that a task draws from, not a bank: the delay of actions, ms, and the factor of the noise.
pub(crate) fn task_ranges(settings: Option<&Bound<'_, PyDict>>) -> PyResult<TaskRanges> {
    let Some(settings) = settings else { return Ok((None, None)) };
    let settings = settings.copy()?;
    let preset = preset(&settings)?;
    let of = |name: &str| preset.iter().find(|(known, _)| *known == name).map(|(_, range)| *range);
    let delay = of(ACTION_DELAY).map(|range| range.map(|ms| ms as u32));
    Ok((take(&settings, "action_delay")?.or(delay), take(&settings, "noise")?.or(of(NOISE))))
}

/// The ranges of what varies in pictures.
pub(crate) fn camera_ranges(settings: Option<&Bound<'_, PyDict>>) -> PyResult<EpisodeRanges> {
    let given: Option<BTreeMap<String, [f64; 2]>> = match settings {
        Some(settings) => take(&settings.copy()?, "camera")?,
        None => None,
    };
    let named = given.unwrap_or_default().into_iter().map(|(name, range)| (format!("{CAMERA}{name}"), range));
    EpisodeRanges::new(named).map_err(|error| PyValueError::new_err(format!("ranges: {error}")))
}

/// The ranges of a preset that a dictionary names; none without one.
fn preset(settings: &Bound<'_, PyDict>) -> PyResult<&'static [NamedRange]> {
    let Some(name) = take::<String>(settings, "preset")? else { return Ok(&[]) };
    let known = PRESETS.map(|(name, _)| name).join(", ");
    fiatlux_rules::preset(&name)
        .ok_or_else(|| PyValueError::new_err(format!("ranges: preset is '{name}'; known ones are {known}")))
}

/// Reads the ranges of what varies between worlds from a dictionary.
pub(crate) fn ranges(settings: Option<&Bound<'_, PyDict>>) -> PyResult<Option<Ranges>> {
    let Some(settings) = settings else { return Ok(None) };
    let settings = settings.copy()?;
    let nominal = Ranges::NOMINAL.with(preset(&settings)?);
    let _: TaskRanges = (take(&settings, "action_delay")?, take(&settings, "noise")?);
    let _: Option<BTreeMap<String, [f64; 2]>> = take(&settings, "camera")?;
    let ranges = Ranges {
        hand_friction: take(&settings, "hand_friction")?.or(nominal.hand_friction),
        floor_friction: take(&settings, "floor_friction")?.or(nominal.floor_friction),
        robot_mass: take(&settings, "robot_mass")?.unwrap_or(nominal.robot_mass),
        gains: take(&settings, "gains")?.unwrap_or(nominal.gains),
        mass: take(&settings, "mass")?.unwrap_or(nominal.mass),
        com_shift_m: take(&settings, "com_shift_m")?.unwrap_or(nominal.com_shift_m),
        stiffness: take(&settings, "stiffness")?.unwrap_or(nominal.stiffness),
        damping: take(&settings, "damping")?.unwrap_or(nominal.damping),
        effort_limit: take(&settings, "effort_limit")?.unwrap_or(nominal.effort_limit),
        friction: merged(nominal.friction, take(&settings, "friction")?),
        thing_mass: merged(nominal.thing_mass, take(&settings, "thing_mass")?),
        light: take(&settings, "light")?.unwrap_or_default(),
        gravity: take(&settings, "gravity")?.or(nominal.gravity),
    };
    let known = "gravity, noise, action_delay, floor_friction, hand_friction, robot_mass, gains, friction, thing_mass, camera, \
                 preset, and of each body or drive mass, com_shift_m, stiffness, damping, effort_limit, and light";
    nothing_left("ranges", &settings, known)?;
    Ok(Some(ranges))
}

/// A preset's ranges by name, and those that override them.
fn merged(
    mut preset: BTreeMap<String, [f64; 2]>,
    given: Option<BTreeMap<String, [f64; 2]>>,
) -> BTreeMap<String, [f64; 2]> {
    preset.extend(given.unwrap_or_default());
    preset
}

/// Reads the disturbances from a dictionary.
pub(crate) fn disturbances(robot: &Robot, settings: Option<&Bound<'_, PyDict>>) -> PyResult<Disturbances> {
    let Some(settings) = settings else { return Ok(Disturbances::default()) };
    let settings = settings.copy()?;
    let pushes: Option<Bound<'_, PyDict>> = take(&settings, "pushes")?;
    let wrenches: Option<Bound<'_, PyDict>> = take(&settings, "wrenches")?;
    nothing_left("disturbances", &settings, "pushes, wrenches")?;
    let pushes = pushes.map(|pushes| {
        let pushes = pushes.copy()?;
        let made = Pushes {
            interval_s: take(&pushes, "interval_s")?.unwrap_or([3.0, 8.0]),
            linear: take(&pushes, "linear")?.unwrap_or(0.5),
            angular: take(&pushes, "angular")?.unwrap_or(0.0),
        };
        nothing_left("pushes", &pushes, "interval_s, linear, angular")?;
        PyResult::Ok(made)
    });
    let wrenches = wrenches.map(|wrenches| {
        let wrenches = wrenches.copy()?;
        let name: String = take(&wrenches, "link")?.unwrap_or_else(|| "torso_link".into());
        let link = robot.link_index(&name);
        let made = Wrenches {
            link: link.ok_or_else(|| PyValueError::new_err(format!("wrenches.link: the robot has no '{name}'")))?,
            interval_s: take(&wrenches, "interval_s")?.unwrap_or([3.0, 8.0]),
            duration_s: take(&wrenches, "duration_s")?.unwrap_or([0.1, 0.5]),
            force_n: take(&wrenches, "force_n")?.unwrap_or(20.0),
            torque_nm: take(&wrenches, "torque_nm")?.unwrap_or(0.0),
        };
        nothing_left("wrenches", &wrenches, "link, interval_s, duration_s, force_n, torque_nm")?;
        PyResult::Ok(made)
    });
    Ok(Disturbances { pushes: pushes.transpose()?, wrenches: wrenches.transpose()? })
}
