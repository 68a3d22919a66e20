//! The sensors that a session asks for, and how often.

use fiatlux_proto::v1;
use fiatlux_proto::v1::refusal::Code;
use fiatlux_proto::v1::{OpenRequest, Refusal};
use fiatlux_rules::{CONTROL_DT, Task};

use super::refusal;
use crate::senses::{Sensor, Sensors};

/// Observations a second.
const STEP_HZ: f64 = 1.0 / CONTROL_DT;
/// How often a bag has what its session asks for without a rate, Hz.
const RECORD_HZ: f64 = 10.0;

/// One sensor of a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Choice {
    sensor: Sensor,
    /// Steps from one observation that has it to the next; none where only a look gives it.
    period: Option<u64>,
    /// Steps from one record to the next, where it is large and in the bag.
    record_period: Option<u64>,
}

/// The sensors of a session.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::server) struct SensorPlan(Vec<Choice>);

impl SensorPlan {
    /// All of them.
    pub fn all(&self) -> Sensors {
        self.0.iter().fold(Sensors::NONE, |set, choice| set.with(choice.sensor))
    }

    /// Those that the observation of a step has.
    pub fn due(&self, step: u64) -> Sensors {
        self.at(step, |choice| choice.period)
    }

    /// Those that the bag has of a step: of the large ones those whose turn it is, of the others what is due.
    pub fn recorded(&self, step: u64) -> Sensors {
        self.due(step).without(Sensors::LARGE).and(self.at(step, |choice| choice.record_period))
    }

    fn at(&self, step: u64, period: impl Fn(&Choice) -> Option<u64>) -> Sensors {
        let due = |choice: &&Choice| period(choice).is_some_and(|period| step.is_multiple_of(period));
        self.0.iter().filter(due).fold(Sensors::NONE, |set, choice| set.with(choice.sensor))
    }

    /// As a client is told.
    pub fn messages(&self) -> Vec<v1::Sensor> {
        let hz = |period: u64| STEP_HZ / period as f64;
        let message = |choice: &Choice| v1::Sensor {
            name: choice.sensor.name().into(),
            rate_hz: choice.period.map_or(0.0, hz),
            on_request: choice.period.is_none(),
            recorded: choice.record_period.is_some(),
            record_hz: choice.record_period.map_or(0.0, hz),
        };
        self.0.iter().map(message).collect()
    }
}

/// Reads and checks the sensors of a request.
pub(super) fn read(request: &OpenRequest, task: Task) -> Result<SensorPlan, Refusal> {
    let mut choices: Vec<Choice> = Vec::new();
    for asked in &request.sensors {
        let name = &asked.name;
        let Some(sensor) = Sensor::by_name(name) else {
            let message = format!("sensor '{name}' does not exist; ask for some of {}", Sensor::names());
            return Err(refusal(Code::Unknown, "sensors", message));
        };
        let wrong = |message: String| Err(refusal(Code::Value, "sensors", message));
        if choices.iter().any(|choice| choice.sensor == sensor) {
            return wrong(format!("sensor '{name}' is listed twice; list it once, with one rate"));
        }
        if asked.on_request && asked.rate_hz != 0.0 {
            return wrong(format!("sensor '{name}' has a rate and is on request; choose one of the two"));
        }
        if !asked.recorded && asked.record_hz != 0.0 {
            return wrong(format!("sensor '{name}' has record_hz but is not recorded; set recorded, or leave it out"));
        }
        let period = if asked.on_request { None } else { Some(period(name, "rate_hz", asked.rate_hz, STEP_HZ)?) };
        let record_period = (asked.recorded && sensor.is_large())
            .then(|| self::period(name, "record_hz", asked.record_hz, RECORD_HZ))
            .transpose()?;
        choices.push(Choice { sensor, period, record_period });
    }
    if choices.is_empty() {
        let choice = |sensor| Choice { sensor, period: Some(1), record_period: None };
        choices = Sensors::of_body(task).iter().map(choice).collect();
    }
    choices.sort_by_key(|choice| choice.sensor as u16);
    Ok(SensorPlan(choices))
}

/// Steps from one time to the next at a rate in Hz.
fn period(name: &str, field: &str, hz: f64, otherwise: f64) -> Result<u64, Refusal> {
    /// A rate once an episode or so.
    const LEAST_HZ: f64 = 0.01;
    let hz = if hz == 0.0 { otherwise } else { hz };
    if (LEAST_HZ..=STEP_HZ).contains(&hz) {
        let steps = (STEP_HZ / hz).round();
        if (STEP_HZ / steps - hz).abs() <= 1e-6 * hz {
            return Ok(steps as u64);
        }
        let faster = STEP_HZ / (STEP_HZ / hz).floor();
        let slower = STEP_HZ / (STEP_HZ / hz).ceil();
        let message = format!(
            "{field} of sensor '{name}' is {hz}; it must be {STEP_HZ} divided by a whole number: \
             the nearest ones are {slower:.4} and {faster:.4}"
        );
        return Err(refusal(Code::Value, "sensors", message));
    }
    let message = format!("{field} of sensor '{name}' is {hz}; it must be within {LEAST_HZ} and {STEP_HZ}, in Hz");
    Err(refusal(Code::Value, "sensors", message))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sensor(name: &str) -> v1::Sensor {
        v1::Sensor { name: name.into(), ..v1::Sensor::default() }
    }

    fn plan(sensors: Vec<v1::Sensor>) -> Result<SensorPlan, Refusal> {
        read(&OpenRequest { sensors, ..OpenRequest::default() }, Task::S05)
    }

    #[test]
    fn rates_say_when_a_sensor_is_due() {
        let camera = v1::Sensor { rate_hz: 1.25, recorded: true, ..sensor("camera") };
        let lidar = v1::Sensor { on_request: true, recorded: true, record_hz: 25.0, ..sensor("lidar") };
        let plan = plan(vec![camera, sensor("proprioception"), lidar]).expect("valid");
        let body = Sensors::of(&[Sensor::Proprioception]);
        assert_eq!(plan.due(0), body.with(Sensor::Camera));
        assert_eq!((plan.due(39), plan.due(40)), (body, body.with(Sensor::Camera)));
        assert_eq!(plan.recorded(0), body.with(Sensor::Camera).with(Sensor::Lidar));
        assert_eq!(plan.recorded(1), body);
        assert_eq!(plan.recorded(5), body.with(Sensor::Camera), "10 Hz");
        assert_eq!(plan.recorded(6), body.with(Sensor::Lidar));
        let told = plan.messages();
        assert_eq!(
            told.iter().map(|sensor| sensor.name.as_str()).collect::<Vec<_>>(),
            ["proprioception", "lidar", "camera"]
        );
        assert_eq!((told[2].rate_hz, told[2].record_hz), (1.25, 10.0));
    }

    /// Each refusal names the sensor and the remedy.
    #[test]
    fn refusals() {
        let with =
            |rate_hz, record_hz| v1::Sensor { rate_hz, record_hz, recorded: record_hz != 0.0, ..sensor("lidar") };
        let cases = [
            (vec![sensor("smell")], "'smell' does not exist; ask for some of proprioception"),
            (vec![sensor("lidar"), sensor("lidar")], "listed twice"),
            (vec![with(30.0, 0.0)], "the nearest ones are 25.0000 and 50.0000"),
            (vec![with(51.0, 0.0)], "within 0.01 and 50"),
            (vec![with(-1.0, 0.0)], "rate_hz of sensor 'lidar' is -1"),
            (vec![with(f64::NAN, 0.0)], "within"),
            (vec![with(f64::INFINITY, 0.0)], "within"),
            (vec![with(0.0, 20.0)], "record_hz of sensor 'lidar' is 20"),
            (vec![v1::Sensor { on_request: true, ..with(10.0, 0.0) }], "choose one of the two"),
            (vec![v1::Sensor { record_hz: 5.0, ..sensor("lidar") }], "not recorded"),
        ];
        for (sensors, message) in cases {
            let refusal = plan(sensors).expect_err(message);
            assert_eq!(refusal.field, "sensors");
            assert!(refusal.message.contains(message), "{refusal:?}");
        }
    }
}
