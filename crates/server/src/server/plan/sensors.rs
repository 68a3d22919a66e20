//! The sensors that a session asks for, and how often.

use fiatlux_proto::v3;
use fiatlux_rules::{CONTROL_DT, Task};
use fiatlux_wire::{RequestedSensor, SensorUse as Use};

use fiatlux_sensing::{Sensor, Sensors, Sight};

/// Observations a second of simulated time.
const STEP_HZ: f64 = 1.0 / CONTROL_DT;
/// One sensor of a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Choice {
    sensor: Sensor,
    use_: Use,
    /// It sees more than the published one.
    see_room: bool,
    /// Steps from one record to the next, if it is large and recorded.
    record_period: Option<u64>,
}

/// The sensors of a session.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::server) struct SensorPlan(Vec<Choice>);

impl SensorPlan {
    /// All sensors, for the policy or for the bag alone.
    pub fn all(&self) -> Sensors {
        self.of(|_| true)
    }

    /// Sensors that the policy may look at.
    pub fn sensed(&self) -> Sensors {
        self.of(|choice| choice.use_ != Use::BagOnly)
    }

    pub fn due(&self, step: u64) -> Sensors {
        self.of(|choice| matches!(choice.use_, Use::Every(period) if step.is_multiple_of(period)))
    }

    /// Sensors that the bag has of a step: large ones at their own rate, others whenever they are due.
    pub fn recorded(&self, step: u64) -> Sensors {
        let is_due = |choice: &Choice| choice.record_period.is_some_and(|period| step.is_multiple_of(period));
        self.due(step).without(Sensors::LARGE).union(self.of(is_due))
    }

    pub fn sight(&self) -> Sight {
        if self.0.iter().any(|choice| choice.see_room) { Sight::Room } else { Sight::Published }
    }

    fn of(&self, is_in: impl Fn(&Choice) -> bool) -> Sensors {
        self.0.iter().filter(|choice| is_in(choice)).fold(Sensors::NONE, |set, choice| set.with(choice.sensor))
    }

    /// The sensors as the client is told about them.
    pub fn messages(&self) -> Vec<v3::Sensor> {
        let hz = |period: u64| STEP_HZ / period as f64;
        let message = |choice: &Choice| v3::Sensor {
            name: choice.sensor.name().into(),
            rate_hz: if let Use::Every(period) = choice.use_ { hz(period) } else { 0.0 },
            on_request: choice.use_ == Use::Look,
            recorded: choice.record_period.is_some(),
            record_hz: choice.record_period.map_or(0.0, hz),
            bag_only: choice.use_ == Use::BagOnly,
            see_room: choice.see_room,
        };
        self.0.iter().map(message).collect()
    }
}

/// The sensors of a request; the task's own where the policy is given none of them.
pub(super) fn plan(asked: &[RequestedSensor], task: Task) -> SensorPlan {
    let choice = |asked: &RequestedSensor| {
        let sensor = Sensor::by_name(asked.name).expect("the build compares the names");
        Choice { sensor, use_: asked.use_, see_room: asked.see_room, record_period: asked.record_period }
    };
    let mut choices: Vec<Choice> = asked.iter().map(choice).collect();
    if choices.iter().all(|choice| choice.use_ == Use::BagOnly) {
        let choice = |sensor| Choice { sensor, use_: Use::Every(1), see_room: false, record_period: None };
        choices.extend(Sensors::of_body(task).iter().map(choice));
    }
    choices.sort_by_key(|choice| choice.sensor as u16);
    SensorPlan(choices)
}

#[cfg(test)]
mod tests {
    use fiatlux_proto::v3::Refusal;
    use fiatlux_wire::requested_sensors;

    use super::*;

    fn sensor(name: &str) -> v3::Sensor {
        v3::Sensor { name: name.into(), ..v3::Sensor::default() }
    }

    fn plan(sensors: Vec<v3::Sensor>) -> Result<SensorPlan, Refusal> {
        requested_sensors(&sensors).map(|asked| super::plan(&asked, Task::S05))
    }

    #[test]
    fn rates_say_when_a_sensor_is_due() {
        let camera = v3::Sensor { rate_hz: 1.25, recorded: true, ..sensor("camera") };
        let lidar = v3::Sensor { on_request: true, recorded: true, record_hz: 25.0, ..sensor("lidar") };
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

    /// A sensor for the bag alone takes nothing from the policy, which may not look at it.
    #[test]
    fn recording_changes_nothing_for_the_policy() {
        let camera = v3::Sensor { bag_only: true, recorded: true, ..sensor("camera") };
        let plan = plan(vec![camera]).expect("valid");
        let body = Sensors::of_body(Task::S05);
        assert_eq!((plan.due(0), plan.sensed()), (body, body));
        assert_eq!((plan.recorded(0), plan.recorded(1)), (body.with(Sensor::Camera), body));
    }

    #[test]
    fn proposed_rates_are_taken() {
        for steps in 1..=60 {
            let rate_hz: f64 = format!("{:.4}", STEP_HZ / f64::from(steps)).parse().expect("a number");
            let plan = plan(vec![v3::Sensor { rate_hz, ..sensor("lidar") }]).expect("valid");
            assert!(plan.due(u64::from(2 * steps as u32)).contains(Sensor::Lidar));
        }
    }

    /// Each refusal names the sensor and the remedy.
    #[test]
    fn refusals() {
        let with =
            |rate_hz, record_hz| v3::Sensor { rate_hz, record_hz, recorded: record_hz != 0.0, ..sensor("lidar") };
        let cases = [
            (vec![sensor("smell")], "'smell' does not exist; ask for some of proprioception"),
            (vec![sensor("camra")], "; did you mean 'camera'?"),
            (vec![sensor("lidar"), sensor("lidar")], "listed twice"),
            (vec![with(30.0, 0.0)], "the nearest ones are 25.0000 and 50.0000"),
            (vec![with(51.0, 0.0)], "from 0.01 to 50"),
            (vec![with(-1.0, 0.0)], "rate_hz of sensor 'lidar' is -1"),
            (vec![with(f64::NAN, 0.0)], "is NaN; it must be from 0.01 to 50 Hz"),
            (vec![with(f64::INFINITY, 0.0)], "is inf; it must be from 0.01 to 50 Hz"),
            (vec![with(0.0, 20.0)], "record_hz of sensor 'lidar' is 20"),
            (vec![v3::Sensor { on_request: true, ..with(10.0, 0.0) }], "choose one"),
            (vec![v3::Sensor { on_request: true, bag_only: true, ..sensor("lidar") }], "choose one"),
            (vec![v3::Sensor { record_hz: 5.0, ..sensor("lidar") }], "not recorded"),
            (vec![v3::Sensor { bag_only: true, ..sensor("lidar") }], "not recorded"),
            (vec![v3::Sensor { recorded: true, ..sensor("verdict") }], "is small"),
            (vec![v3::Sensor { see_room: true, ..sensor("camera") }], "only lidar takes"),
        ];
        for (sensors, message) in cases {
            let refusal = plan(sensors).expect_err(message);
            assert_eq!(refusal.field, "sensors");
            assert!(refusal.message.contains(message), "{refusal:?}");
        }
    }
}
