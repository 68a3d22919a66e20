//! Checks a request for a session as far as no simulator is needed. A server refuses what fails here, and a grader does not
//! score a bag of it: no server can have played it.
//!
//! The server checks the rest, numbers that only the simulator knows: ranges and sizes of props. In a ranking they have one value, so
//! a grader compares them with that.

use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{self, Mode, OpenRequest, Refusal};
use fiatlux_proto::{did_you_mean, is_unseen, limits};
use fiatlux_rules::{CONTROL_DT, Cause, Causes, Protocol, Task, ThresholdError, Thresholds, UnknownProtocol, Variant};

use crate::known::{GAINS, KnownSensor, ROBOTS, SENSORS, known_gains, known_robot, known_sensor};

/// Side of the camera's image where a request leaves it out, pixels.
pub const IMAGE_SIDE: u32 = 256;
/// Sides of images that features are computed from are a multiple of this, pixels.
pub const FEATURE_SIDE_STEP: u32 = 32;
/// Sensors that need the features of the camera's image.
pub const SENSORS_WITH_FEATURES: [&str; 2] = ["features", "flat"];
/// Longest delay of actions that a session may request, ms.
pub const MAX_ACTION_DELAY_MS: u32 = 100;
/// Longest name or version of a policy, bytes.
pub const MAX_NAME: usize = 128;
/// Time for which a whole-body command stays in force without a new action, ms: by default, and at most.
pub const COMMAND_TIMEOUT_MS: u32 = 500;
const MAX_COMMAND_TIMEOUT_MS: u32 = 10_000;
/// Observations a second of simulated time.
const STEP_HZ: f64 = 1.0 / CONTROL_DT;
/// Default rate at which a bag records a sensor, Hz.
const RECORD_HZ: f64 = 10.0;

/// The values of a request, read.
#[derive(Debug, Clone, PartialEq)]
pub struct RequestedSession {
    pub task: Task,
    pub real_time: bool,
    /// Full name of the robot.
    pub robot: &'static str,
    pub gains: &'static str,
    /// As they are listed; empty for the task's own.
    pub sensors: Vec<RequestedSensor>,
    /// Width and height of the camera's image, pixels.
    pub image_size: [usize; 2],
    pub protocol: Protocol,
    /// `None` for the task's own.
    pub end_on: Option<Causes>,
    pub thresholds: Thresholds,
    pub reward: Variant,
    /// Control steps from an action's arrival to the step in which it acts.
    pub action_delay: usize,
    /// Time for which a whole-body command stays in force without a new action, s; 0 in lockstep.
    pub command_timeout_s: f64,
}

/// A sensor of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RequestedSensor {
    pub name: &'static str,
    pub use_: SensorUse,
    /// It sees more than the published one.
    pub see_room: bool,
    /// Steps from one record in the bag to the next, if it is large and recorded.
    pub record_period: Option<u64>,
}

/// When the policy gets a sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SensorUse {
    /// In observations, with this many steps between them.
    Every(u64),
    /// Only when the policy looks.
    Look,
    /// Not at all: only the bag has it.
    BagOnly,
}

/// Reads a request.
///
/// # Errors
/// A refusal that names the first field that no server accepts, its value and what is allowed.
pub fn check_request(request: &OpenRequest) -> Result<RequestedSession, Refusal> {
    check_text("policy", &request.policy, 0, MAX_NAME)?;
    let unknown = |field: &str, error: String| Refusal::new(Code::Unknown, field, error);
    let real_time = match Mode::try_from(request.mode) {
        Ok(Mode::Unspecified | Mode::Lockstep) => false,
        Ok(Mode::RealTime) => true,
        Err(_) => {
            let message = format!("mode {} does not exist; use MODE_LOCKSTEP or MODE_REAL_TIME", request.mode);
            return Err(unknown("mode", message));
        }
    };
    let task = request.task.parse::<Task>().map_err(|error| unknown("task", error.to_string()))?;
    let sensors = requested_sensors(&request.sensors)?;
    check_weights(request)?;
    let end_on = end_on(&request.end_on)?;
    check_take(request, end_on)?;
    Ok(RequestedSession {
        task,
        real_time,
        robot: robot(&request.robot)?,
        gains: gains(&request.gains)?,
        sensors,
        image_size: image_size(request)?,
        protocol: protocol(&request.episode_protocol)?,
        end_on,
        thresholds: thresholds(request)?,
        reward: reward(&request.reward)?,
        action_delay: action_delay(request.action_delay_ms)?,
        command_timeout_s: if real_time { command_timeout_s(request.command_timeout_ms)? } else { 0.0 },
    })
}

/// Refuses a mistyped name of a sensor, a robot or a set of gains, before anything is made for the request.
///
/// # Errors
/// A refusal with the nearest name, or of sensors that contradict each other.
pub fn check_names(request: &OpenRequest) -> Result<(), Refusal> {
    requested_sensors(&request.sensors)?;
    robot(&request.robot)?;
    gains(&request.gains)?;
    Ok(())
}

/// Refuses a text that others will read, where it is too short, too long, or could change how their screens show it.
///
/// # Errors
/// A refusal that names the field.
pub fn check_text(field: &str, text: &str, least: usize, most: usize) -> Result<(), Refusal> {
    if (least..=most).contains(&text.len()) && !text.contains(is_unseen) {
        return Ok(());
    }
    let message = format!("write {least} to {most} bytes of plain text, in one line and without control characters");
    Err(Refusal::new(Code::Value, field, message))
}

/// Reads the sensors of a request.
///
/// # Errors
/// A refusal of a sensor that does not exist or is listed twice, and of rates or flags that contradict each other.
pub fn requested_sensors(sensors: &[v3::Sensor]) -> Result<Vec<RequestedSensor>, Refusal> {
    let read = |(index, asked): (usize, &v3::Sensor)| {
        let Some(KnownSensor { name, is_large }) = known_sensor(&asked.name) else {
            let known = SENSORS.map(|sensor| sensor.name).join(", ");
            let near = did_you_mean(&asked.name, SENSORS.map(|sensor| sensor.name));
            let message = format!("sensor '{}' does not exist; ask for some of {known}{near}", asked.name);
            return Err(Refusal::new(Code::Unknown, "sensors", message));
        };
        if sensors[..index].iter().any(|other| other.name == name) {
            let message = format!("sensor '{name}' is listed twice; list it once, with one rate");
            return Err(Refusal::new(Code::Value, "sensors", message));
        }
        let (use_, record_period) = sensor_use(asked)?;
        if asked.recorded && !is_large {
            let message =
                format!("sensor '{name}' is small: the bag has it as often as observations do; leave recorded out");
            return Err(Refusal::new(Code::Value, "sensors", message));
        }
        Ok(RequestedSensor { name, use_, see_room: asked.see_room, record_period })
    };
    sensors.iter().enumerate().map(read).collect()
}

fn robot(name: &str) -> Result<&'static str, Refusal> {
    known_robot(name).ok_or_else(|| {
        let known: Vec<String> = ROBOTS.iter().map(|(robot, _)| format!("'{robot}'")).collect();
        let (known, near) = (known.join(", "), did_you_mean(name, ROBOTS.iter().map(|(robot, _)| *robot)));
        Refusal::new(Code::Unknown, "robot", format!("robot '{name}' is unknown; use one of {known}{near}"))
    })
}

fn gains(name: &str) -> Result<&'static str, Refusal> {
    known_gains(name).ok_or_else(|| {
        let near = did_you_mean(name, GAINS);
        let message = format!("'{name}' is not a known set of gains; use one of {}{near}", GAINS.join(", "));
        Refusal::new(Code::Unknown, "gains", message)
    })
}

/// When a sensor is given to the policy, and the steps from one record in the bag to the next, if it is recorded.
fn sensor_use(asked: &v3::Sensor) -> Result<(SensorUse, Option<u64>), Refusal> {
    let name = &asked.name;
    let wrong = |message: String| Err(Refusal::new(Code::Value, "sensors", message));
    let rated = asked.rate_hz != 0.0;
    if u8::from(asked.on_request) + u8::from(asked.bag_only) + u8::from(rated) > 1 {
        return wrong(format!("sensor '{name}' has more than one of rate_hz, on_request and bag_only; choose one"));
    }
    if asked.see_room && name != "lidar" {
        return wrong(format!("sensor '{name}' has see_room, which only lidar takes; leave it out"));
    }
    if !asked.recorded && (asked.record_hz != 0.0 || asked.bag_only) {
        return wrong(format!(
            "sensor '{name}' is not recorded but has record_hz or bag_only; set recorded, or leave them out"
        ));
    }
    let use_ = match (asked.on_request, asked.bag_only) {
        (true, _) => SensorUse::Look,
        (_, true) => SensorUse::BagOnly,
        _ => SensorUse::Every(period(name, "rate_hz", asked.rate_hz, STEP_HZ)?),
    };
    let record_period = asked.recorded.then(|| period(name, "record_hz", asked.record_hz, RECORD_HZ)).transpose()?;
    Ok((use_, record_period))
}

/// Number of steps between two readings at a rate in Hz.
fn period(name: &str, field: &str, hz: f64, otherwise: f64) -> Result<u64, Refusal> {
    /// About once an episode.
    const MIN_HZ: f64 = 0.01;
    /// For rates without an exact decimal form.
    const TOLERANCE: f64 = 1e-3;
    let hz = if hz == 0.0 { otherwise } else { hz };
    if (MIN_HZ..=STEP_HZ).contains(&hz) {
        let steps = (STEP_HZ / hz).round();
        if (STEP_HZ / steps - hz).abs() <= TOLERANCE * hz {
            return Ok(steps as u64);
        }
        let faster = STEP_HZ / (STEP_HZ / hz).floor();
        let slower = STEP_HZ / (STEP_HZ / hz).ceil();
        let message = format!(
            "{field} of sensor '{name}' is {hz}; it must be {STEP_HZ} divided by a whole number: \
             the nearest ones are {slower:.4} and {faster:.4}"
        );
        return Err(Refusal::new(Code::Value, "sensors", message));
    }
    let message = format!("{field} of sensor '{name}' is {hz}; it must be from {MIN_HZ} to {STEP_HZ} Hz");
    Err(Refusal::new(Code::Value, "sensors", message))
}

fn has_features(request: &OpenRequest) -> bool {
    request.sensors.iter().any(|sensor| SENSORS_WITH_FEATURES.contains(&sensor.name.as_str()))
}

fn check_weights(request: &OpenRequest) -> Result<(), Refusal> {
    if !request.weights.is_empty() && !has_features(request) {
        let message = "weights are named, but no sensor needs them; ask for features or flat, or leave them out";
        return Err(Refusal::new(Code::Value, "weights", message));
    }
    Ok(())
}

fn image_size(request: &OpenRequest) -> Result<[usize; 2], Refusal> {
    let [least, most] = limits::IMAGE_SIDES;
    let with_features = has_features(request);
    let side = |field: &str, side: u32| {
        let side = if side == 0 { IMAGE_SIDE } else { side };
        if !(least..=most).contains(&side) {
            let message = format!("{field} is {side} pixels; it must be from {least} to {most}");
            return Err(Refusal::new(Code::Value, field, message));
        }
        if with_features && !side.is_multiple_of(FEATURE_SIDE_STEP) {
            let message = format!("{field} is {side} pixels; features need a multiple of {FEATURE_SIDE_STEP}");
            return Err(Refusal::new(Code::Value, field, message));
        }
        Ok(side as usize)
    };
    Ok([side("image_width", request.image_width)?, side("image_height", request.image_height)?])
}

/// The name of a reward, as headers have it.
pub fn reward_name(reward: Variant) -> &'static str {
    match reward {
        Variant::Benchmark => "benchmark",
        Variant::Training => "training",
    }
}

fn reward(name: &str) -> Result<Variant, Refusal> {
    let known = [Variant::Benchmark, Variant::Training];
    let found = known.into_iter().find(|reward| name == reward_name(*reward) || name.is_empty());
    found.ok_or_else(|| {
        let message = format!("'{name}' is not a known reward; use one of {}", known.map(reward_name).join(", "));
        Refusal::new(Code::Unknown, "reward", message)
    })
}

/// Length of a control step, ms.
fn step_ms() -> u32 {
    (CONTROL_DT * 1e3).round() as u32
}

fn command_timeout_s(ms: u32) -> Result<f64, Refusal> {
    let ms = if ms == 0 { COMMAND_TIMEOUT_MS } else { ms };
    if ms > MAX_COMMAND_TIMEOUT_MS || !ms.is_multiple_of(step_ms()) {
        let message = format!(
            "commands would expire after {ms} ms; it must be a multiple of {} ms, the length of a control step, and at most \
             {MAX_COMMAND_TIMEOUT_MS} ms",
            step_ms()
        );
        return Err(Refusal::new(Code::Value, "command_timeout_ms", message));
    }
    Ok(f64::from(ms) / 1e3)
}

/// Converts a delay in ms to control steps.
fn action_delay(ms: u32) -> Result<usize, Refusal> {
    let step_ms = step_ms();
    if ms > MAX_ACTION_DELAY_MS || !ms.is_multiple_of(step_ms) {
        let message = format!(
            "a delay of {ms} ms; it must be a multiple of {step_ms} ms, the length of a control step, and at most \
             {MAX_ACTION_DELAY_MS} ms"
        );
        return Err(Refusal::new(Code::Value, "action_delay_ms", message));
    }
    Ok((ms / step_ms) as usize)
}

fn protocol(name: &str) -> Result<Protocol, Refusal> {
    if name.is_empty() {
        return Ok(Protocol::default());
    }
    name.parse().map_err(|error: UnknownProtocol| Refusal::new(Code::Unknown, "episode_protocol", error.to_string()))
}

fn end_on(names: &[String]) -> Result<Option<Causes>, Refusal> {
    if names.is_empty() {
        return Ok(None);
    }
    let parsed: Result<Causes, _> = names.iter().map(|name| name.parse::<Cause>()).collect();
    parsed.map(Some).map_err(|error| Refusal::new(Code::Unknown, "end_on", error.to_string()))
}

/// Refuses a take that something besides success would end.
fn check_take(request: &OpenRequest, end_on: Option<Causes>) -> Result<(), Refusal> {
    // What is no longer physical ends every episode, and stands in headers too.
    let ends = end_on.map(|causes| causes.without(Cause::Diverged));
    if request.take && ends != Some(Causes::of(&[Cause::Success])) {
        let message = "a take goes on past mistakes and time-out: set end_on to success alone";
        return Err(Refusal::new(Code::Value, "end_on", message));
    }
    Ok(())
}

fn thresholds(request: &OpenRequest) -> Result<Thresholds, Refusal> {
    let mut thresholds = Thresholds::default();
    for (key, value) in &request.thresholds {
        thresholds.set(&format!("{key}={value}")).map_err(|error| {
            let code = match error {
                ThresholdError::Key { .. } => Code::Unknown,
                _ => Code::Value,
            };
            Refusal::new(code, "thresholds", error.to_string())
        })?;
    }
    Ok(thresholds)
}
