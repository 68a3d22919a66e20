//! What a client asks for when it opens a session, checked field by field.

use fiatlux_proto::v1::refusal::Code;
use fiatlux_proto::v1::{Mode, OpenRequest, Refusal};
use fiatlux_proto::{DecodeError, PROTOCOL, decode, is_compatible, limits};
use fiatlux_robot::{GainSet, HandKind};
use fiatlux_rules::{Cause, Causes, Task, Thresholds};

/// Sensor names, in the order in which sessions list them.
pub(super) const SENSORS: [&str; 3] = ["proprioception", "hand_contact", "last_action"];
/// Sensors of the benchmark that this server does not have.
const LATER_SENSORS: [&str; 4] = ["camera", "lidar", "features", "privileged"];
/// Names of the gains.
pub(super) const GAINS: [&str; 2] = ["fiatlux", "sonic"];

/// Which terms observations have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Sensors {
    pub proprioception: bool,
    pub hand_contact: bool,
    pub last_action: bool,
}

impl Sensors {
    pub fn names(self) -> Vec<String> {
        let asked = [self.proprioception, self.hand_contact, self.last_action];
        SENSORS.iter().zip(asked).filter(|(_, asked)| *asked).map(|(name, _)| (*name).to_owned()).collect()
    }
}

/// A session as it was asked for.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Plan {
    pub policy: String,
    pub task: Task,
    pub seed: u64,
    pub real_time: bool,
    pub sensors: Sensors,
    pub gains: GainSet,
    pub hands: HandKind,
    pub no_noise: bool,
    pub recorded: bool,
    pub end_on: Option<Causes>,
    pub thresholds: Thresholds,
}

impl Plan {
    pub fn mode(&self) -> Mode {
        if self.real_time { Mode::RealTime } else { Mode::Lockstep }
    }
}

pub(super) fn refusal(code: Code, field: &str, message: impl Into<String>) -> Refusal {
    Refusal { code: code.into(), message: message.into(), field: field.into() }
}

/// What cannot be read.
pub(super) fn malformed(error: &DecodeError) -> Refusal {
    refusal(Code::Malformed, "", error.to_string())
}

/// Reads and checks a request.
pub(super) fn read(bytes: &[u8]) -> Result<Plan, Refusal> {
    let request: OpenRequest = decode(bytes, limits::MAX_CLIENT_MESSAGE).map_err(|error| malformed(&error))?;
    check(&request)
}

fn check(request: &OpenRequest) -> Result<Plan, Refusal> {
    let Some(version) = &request.protocol else {
        let message = format!("the request names no version; this server speaks {PROTOCOL}; name that one");
        return Err(refusal(Code::Version, "protocol", message));
    };
    if !is_compatible(version) {
        let message = format!(
            "the client speaks {version}, this server {PROTOCOL}; use a client of major version {}",
            PROTOCOL.major
        );
        return Err(refusal(Code::Version, "protocol", message));
    }
    let unknown = |field: &str, error: String| refusal(Code::Unknown, field, error);
    let real_time = match Mode::try_from(request.mode) {
        Ok(Mode::Unspecified | Mode::Lockstep) => false,
        Ok(Mode::RealTime) => true,
        Err(_) => {
            let message = format!("there is no mode {}; use MODE_LOCKSTEP or MODE_REAL_TIME", request.mode);
            return Err(unknown("mode", message));
        }
    };
    Ok(Plan {
        policy: request.policy.clone(),
        task: request.task.parse::<Task>().map_err(|error| unknown("task", error.to_string()))?,
        seed: request.seed,
        real_time,
        sensors: sensors(&request.sensors)?,
        gains: gains(&request.gains)?,
        hands: hands(&request.hands)?,
        no_noise: request.no_noise,
        recorded: request.recorded,
        end_on: end_on(&request.end_on)?,
        thresholds: thresholds(request)?,
    })
}

fn sensors(names: &[String]) -> Result<Sensors, Refusal> {
    let all = names.is_empty();
    let mut sensors = Sensors { proprioception: all, hand_contact: all, last_action: all };
    for name in names {
        match name.as_str() {
            "proprioception" => sensors.proprioception = true,
            "hand_contact" => sensors.hand_contact = true,
            "last_action" => sensors.last_action = true,
            other => {
                let later = LATER_SENSORS.contains(&other);
                let what = if later { "is not supported yet" } else { "does not exist" };
                let message = format!("sensor '{other}' {what}; ask for some of {}", SENSORS.join(", "));
                return Err(refusal(Code::Unknown, "sensors", message));
            }
        }
    }
    Ok(sensors)
}

fn gains(name: &str) -> Result<GainSet, Refusal> {
    if name.is_empty() {
        return Ok(GainSet::default());
    }
    let unknown = |_| {
        let message = format!("there are no gains '{name}'; use one of {}", GAINS.join(", "));
        refusal(Code::Unknown, "gains", message)
    };
    name.parse().map_err(unknown)
}

fn hands(name: &str) -> Result<HandKind, Refusal> {
    if name.is_empty() {
        return Ok(HandKind::Inspire);
    }
    let unknown = |_| {
        let what = if name.eq_ignore_ascii_case("dex3") { "are not supported yet" } else { "do not exist" };
        refusal(Code::Unknown, "hands", format!("hands '{name}' {what}; use 'inspire'"))
    };
    name.parse().map_err(unknown)
}

fn end_on(names: &[String]) -> Result<Option<Causes>, Refusal> {
    if names.is_empty() {
        return Ok(None);
    }
    let parsed: Result<Causes, _> = names.iter().map(|name| name.parse::<Cause>()).collect();
    parsed.map(Some).map_err(|error| refusal(Code::Unknown, "end_on", error.to_string()))
}

fn thresholds(request: &OpenRequest) -> Result<Thresholds, Refusal> {
    let mut thresholds = Thresholds::default();
    for (key, value) in &request.thresholds {
        thresholds.set(&format!("{key}={value}")).map_err(|error| {
            let code = match error {
                fiatlux_rules::ThresholdError::Key { .. } => Code::Unknown,
                _ => Code::Value,
            };
            refusal(code, "thresholds", error.to_string())
        })?;
    }
    Ok(thresholds)
}

#[cfg(test)]
mod tests {
    use fiatlux_proto::Message;
    use fiatlux_proto::v1::Version;

    use super::*;

    fn request() -> OpenRequest {
        OpenRequest { protocol: Some(PROTOCOL), task: "S05".into(), ..OpenRequest::default() }
    }

    #[test]
    fn what_is_left_out_has_its_default() {
        let plan = read(&request().encode_to_vec()).expect("valid");
        assert_eq!((plan.task, plan.real_time, plan.gains), (Task::S05, false, GainSet::Fiatlux));
        assert_eq!(plan.sensors.names(), SENSORS);
        assert_eq!((plan.end_on, plan.thresholds), (None, Thresholds::default()));
    }

    #[test]
    fn what_is_asked_for_is_taken() {
        let asked = OpenRequest {
            sensors: vec!["last_action".into(), "proprioception".into()],
            gains: "sonic".into(),
            hands: "inspire".into(),
            end_on: vec!["fall".into(), "time-out".into()],
            thresholds: [("fragility_n".into(), 30.0), ("grip_bodies".into(), 3.0)].into(),
            mode: Mode::RealTime.into(),
            ..request()
        };
        let plan = read(&asked.encode_to_vec()).expect("valid");
        assert_eq!(plan.sensors.names(), ["proprioception", "last_action"]);
        assert_eq!((plan.gains, plan.real_time), (GainSet::Sonic, true));
        assert_eq!(plan.end_on, Some(Causes::of(&[Cause::Fall, Cause::TimeOut])));
        assert_eq!((plan.thresholds.fragility_n, plan.thresholds.grip_bodies), (30.0, 3));
    }

    /// Each refusal names the field and the remedy.
    #[test]
    fn refusals() {
        let list = |name: &str| vec![name.to_owned()];
        let cases: [(OpenRequest, Code, &str, &str); 13] = [
            (OpenRequest { protocol: None, ..request() }, Code::Version, "protocol", "speaks 1.0"),
            (
                OpenRequest { protocol: Some(Version { major: 2, minor: 3 }), ..request() },
                Code::Version,
                "protocol",
                "the client speaks 2.3, this server 1.0",
            ),
            (OpenRequest { task: "S99".into(), ..request() }, Code::Unknown, "task", "known ones are S01"),
            (OpenRequest { mode: 7, ..request() }, Code::Unknown, "mode", "MODE_LOCKSTEP"),
            (OpenRequest { sensors: list("camera"), ..request() }, Code::Unknown, "sensors", "not supported yet"),
            (OpenRequest { sensors: list("smell"), ..request() }, Code::Unknown, "sensors", "does not exist"),
            (OpenRequest { gains: "soft".into(), ..request() }, Code::Unknown, "gains", "fiatlux, sonic"),
            (OpenRequest { hands: "dex3".into(), ..request() }, Code::Unknown, "hands", "not supported yet"),
            (OpenRequest { hands: "claw".into(), ..request() }, Code::Unknown, "hands", "use 'inspire'"),
            (OpenRequest { end_on: list("falls"), ..request() }, Code::Unknown, "end_on", "known ones are success"),
            (
                OpenRequest { thresholds: [("fragility".into(), 1.0)].into(), ..request() },
                Code::Unknown,
                "thresholds",
                "known ones are",
            ),
            (
                OpenRequest { thresholds: [("fragility_n".into(), f64::NAN)].into(), ..request() },
                Code::Value,
                "thresholds",
                "finite",
            ),
            (
                OpenRequest { thresholds: [("grip_bodies".into(), 1.5)].into(), ..request() },
                Code::Value,
                "thresholds",
                "whole number",
            ),
        ];
        for (request, code, field, message) in cases {
            let refusal = read(&request.encode_to_vec()).expect_err(message);
            assert_eq!((refusal.code(), refusal.field.as_str()), (code, field), "{refusal:?}");
            assert!(refusal.message.contains(message), "{refusal:?}");
        }
        assert_eq!(read(&[0xff; 9]).expect_err("garbage").code(), Code::Malformed);
    }
}
