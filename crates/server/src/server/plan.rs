//! Checks a client's request to open a session, field by field.

mod sensors;

use fiatlux_cli::in_full;
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{Mode, OpenRequest, Refusal, RunTicket, Version};
use fiatlux_proto::{PROTOCOL, is_compatible};
#[cfg(test)]
use fiatlux_proto::{decode, limits};
use fiatlux_robot::{GainSet, Robot, RobotError};
use fiatlux_rules::{Causes, Protocol, Task, Thresholds, Variant};

use fiatlux_world::{EpisodeRanges, EpisodeSpec, PropScale, Randomization, RangeError, Scene};

use fiatlux_sensing::{Sensor, Setup};
use fiatlux_wire as wire;
pub(super) use sensors::SensorPlan;

pub(super) use fiatlux_wire::{MAX_NAME, check_text};

/// A session as it was requested.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Plan {
    /// The request as it arrived.
    pub request: OpenRequest,
    pub task: Task,
    pub seed: u64,
    pub real_time: bool,
    pub sensors: SensorPlan,
    /// Width and height of the camera's image, pixels.
    pub image_size: [usize; 2],
    pub gains: GainSet,
    pub robot: &'static str,
    pub randomize: Randomization,
    pub scale: PropScale,
    pub ranges: EpisodeRanges,
    pub recorded: bool,
    pub protocol: Protocol,
    pub end_on: Option<Causes>,
    pub thresholds: Thresholds,
    pub reward: Variant,
    /// Control steps from an action's arrival to the step in which it acts, where episodes draw no delay.
    pub action_delay: usize,
    /// Time for which a whole-body command stays in force without a new action, s; 0 in lockstep.
    pub command_timeout_s: f64,
    /// The run whose episode it plays; `None` if a client opened the session by itself.
    pub ticket: Option<RunTicket>,
}

impl Plan {
    pub fn mode(&self) -> Mode {
        if self.real_time { Mode::RealTime } else { Mode::Lockstep }
    }

    /// True if the client must not learn the seed before the run is over.
    pub fn is_hosted(&self) -> bool {
        self.ticket.as_ref().is_some_and(|ticket| ticket.hosted)
    }

    /// True if the client must not learn the room from the session's description: its seed is hosted, and no sensor shows
    /// exact poses of what is in the room.
    pub fn hides_room(&self) -> bool {
        self.is_hosted() && !self.sensors.sensed().contains(Sensor::Privileged)
    }

    /// A refusal of a scene or a start. The obstacle may reveal the room, so for a hosted room only the log has it.
    pub fn does_not_start(&self, field: &str, error: &dyn std::error::Error) -> Refusal {
        if self.is_hosted() {
            tracing::warn!(error = in_full(error), "an episode with a hosted seed does not start");
            let message = "the episode does not start in its room, which is secret; open the run's next one";
            return Refusal::new(Code::Start, "", message);
        }
        Refusal::new(Code::Start, field, in_full(error))
    }

    /// The properties that the shapes of its terms depend on.
    pub fn setup(&self, scene: &Scene) -> Setup {
        Setup { protocol: self.protocol, image_size: self.image_size, ..Setup::new(scene, self.task) }
    }

    /// An episode of the session.
    pub fn episode(&self, index: u64) -> EpisodeSpec {
        EpisodeSpec {
            randomize: self.randomize,
            scale: self.scale,
            ranges: self.ranges.clone(),
            thresholds: self.thresholds.clone(),
            protocol: self.protocol,
            end_on: self.end_on,
            variant: self.reward,
            ..EpisodeSpec::new(self.task, self.seed, index)
        }
    }

    pub fn reward_name(&self) -> &'static str {
        wire::reward_name(self.reward)
    }
}

/// Decodes and checks a request.
#[cfg(test)]
pub(super) fn read(bytes: &[u8]) -> Result<Plan, Refusal> {
    let request: OpenRequest = decode(bytes, limits::MAX_CLIENT_MESSAGE).map_err(|error| Refusal::from(&error))?;
    check(&request)
}

pub(super) fn check(request: &OpenRequest) -> Result<Plan, Refusal> {
    check_version(request.protocol.as_ref())?;
    // A grader makes the same checks: what is refused here is scored nowhere.
    let asked = wire::check_request(request)?;
    let randomize = wire::randomization(&request.randomization.unwrap_or_default());
    Ok(Plan {
        request: request.clone(),
        task: asked.task,
        seed: request.seed,
        real_time: asked.real_time,
        image_size: asked.image_size,
        sensors: sensors::plan(&asked.sensors, asked.task),
        gains: asked
            .gains
            .parse()
            .map_err(|error: RobotError| Refusal::new(Code::Unknown, "gains", in_full(&error)))?,
        robot: Robot::known(asked.robot).map_err(|error| Refusal::new(Code::Unknown, "robot", in_full(&error)))?,
        randomize,
        scale: prop_scale(request, &randomize)?,
        ranges: ranges(request, &randomize)?,
        recorded: request.recorded,
        protocol: asked.protocol,
        end_on: asked.end_on,
        thresholds: asked.thresholds,
        reward: asked.reward,
        action_delay: asked.action_delay,
        command_timeout_s: asked.command_timeout_s,
        ticket: None,
    })
}

/// Refuses a client of another major version.
pub(super) fn check_version(version: Option<&Version>) -> Result<(), Refusal> {
    let Some(version) = version else {
        let message = format!("the request names no version; this server speaks {PROTOCOL}; name that one");
        return Err(Refusal::new(Code::Version, "protocol", message));
    };
    if !is_compatible(version) {
        let message = format!(
            "the client speaks {version}, but this server speaks {PROTOCOL}; use a client of major version {}",
            PROTOCOL.major
        );
        return Err(Refusal::new(Code::Version, "protocol", message));
    }
    Ok(())
}

fn prop_scale(request: &OpenRequest, randomize: &Randomization) -> Result<PropScale, Refusal> {
    let wrong = |message: String| Err(Refusal::new(Code::Value, "prop_scale", message));
    let scale = wire::prop_scale(&request.prop_scale.unwrap_or_default());
    if randomize.prop_scale && scale != PropScale::default() {
        return wrong("sizes are both given and random; choose one of the two".into());
    }
    scale.check().map(|()| scale).or_else(|error| wrong(error.to_string()))
}

fn ranges(request: &OpenRequest, randomize: &Randomization) -> Result<EpisodeRanges, Refusal> {
    let refuse = |code, message: String| Refusal::new(code, "ranges", message);
    let ranges = wire::episode_ranges(request).map_err(|error| match error {
        RangeError::Name { .. } => refuse(Code::Unknown, error.to_string()),
        RangeError::Value { .. } => refuse(Code::Value, error.to_string()),
    })?;
    let twice = [
        ("noise", !randomize.sensors, "noise has a range, but the sensors are exact; choose one of the two"),
        (
            "action_delay",
            request.action_delay_ms > 0,
            "action_delay has a range, and action_delay_ms is set; choose one of the two",
        ),
    ];
    match twice.into_iter().find(|(name, is_set, _)| *is_set && ranges.get(name).is_some()) {
        Some((_, _, message)) => Err(refuse(Code::Value, message.into())),
        None => Ok(ranges),
    }
}

#[cfg(test)]
mod tests {
    use fiatlux_proto::Message;
    use fiatlux_proto::v3;
    use fiatlux_rules::Cause;
    use fiatlux_sensing::{Sensor, Sensors};

    use super::*;

    fn named(names: &[&str]) -> Vec<v3::Sensor> {
        names.iter().map(|name| v3::Sensor { name: (*name).into(), ..v3::Sensor::default() }).collect()
    }

    fn ranging(name: &str, least: f64, most: f64) -> OpenRequest {
        OpenRequest { ranges: [(name.to_owned(), v3::Range { least, most })].into(), ..request() }
    }

    fn request() -> OpenRequest {
        OpenRequest { protocol: Some(PROTOCOL), task: "S05".into(), ..OpenRequest::default() }
    }

    #[test]
    fn what_is_left_out_has_its_default() {
        let plan = read(&request().encode_to_vec()).expect("valid");
        assert_eq!((plan.task, plan.real_time, plan.gains), (Task::S05, false, GainSet::Fiatlux));
        assert_eq!(plan.sensors.all(), Sensors::of_body(Task::S05));
        assert_eq!((plan.image_size, plan.reward), ([256, 256], Variant::Benchmark));
        assert_eq!((plan.end_on, plan.thresholds), (None, Thresholds::default()));
        assert_eq!((plan.protocol, plan.action_delay), (Protocol::Strict, 0));
    }

    #[test]
    fn what_is_asked_for_is_taken() {
        let asked = OpenRequest {
            sensors: named(&["last_action", "camera"]),
            image_width: 480,
            image_height: 270,
            reward: "training".into(),
            episode_protocol: "published".into(),
            gains: "sonic".into(),
            robot: "g1_inspire".into(),
            end_on: vec!["fall".into(), "time-out".into()],
            thresholds: [("fragility_n".into(), 30.0), ("grip_bodies".into(), 3.0)].into(),
            mode: Mode::RealTime.into(),
            action_delay_ms: 60,
            command_timeout_ms: 1000,
            ..request()
        };
        let plan = read(&asked.encode_to_vec()).expect("valid");
        assert_eq!(plan.sensors.all(), Sensors::of(&[Sensor::Camera, Sensor::LastAction]));
        assert_eq!((plan.image_size, plan.reward), ([480, 270], Variant::Training));
        assert_eq!((plan.gains, plan.real_time, plan.protocol), (GainSet::Sonic, true, Protocol::Published));
        assert_eq!((plan.action_delay, plan.command_timeout_s), (3, 1.0));
        assert_eq!(plan.end_on, Some(Causes::of(&[Cause::Fall, Cause::TimeOut])));
        assert_eq!((plan.thresholds.fragility_n, plan.thresholds.grip_bodies), (30.0, 3));
    }

    /// Guards that the checks which graders share know the robots, the gains, and the images that a server computes features from.
    #[test]
    fn shared_checks_know_the_simulators_names() {
        assert!(wire::ROBOTS.iter().map(|(name, _)| *name).eq(Robot::NAMES), "crates/robot/robots/names.in");
        for (name, hand) in wire::ROBOTS {
            assert_eq!([Robot::known(name).ok(), Robot::known(hand).ok()], [Some(*name); 2]);
        }
        assert_eq!(wire::GAINS, GainSet::ALL.map(GainSet::name));
        let with_features: Vec<&str> = Sensors::WITH_FEATURES.iter().map(Sensor::name).collect();
        let mut shared = wire::SENSORS_WITH_FEATURES.to_vec();
        shared.sort_by_key(|name| Sensor::by_name(name).map(|sensor| sensor as u16));
        assert_eq!(with_features, shared);
        assert_eq!(wire::FEATURE_SIDE_STEP as usize, fiatlux_features::SIDE_STEP);
        assert_eq!(wire::IMAGE_SIDE as usize, fiatlux_render::HEAD_PIXELS);
    }

    /// Guards that a take can be opened again from its header, which names what ends every episode.
    #[test]
    fn a_take_ends_on_success_alone() {
        for ends in [vec!["success".into()], vec!["success".into(), "diverged".into()]] {
            let take = OpenRequest { take: true, end_on: ends, ..request() };
            assert!(read(&take.encode_to_vec()).is_ok_and(|plan| plan.request.take));
        }
    }

    /// Each refusal names the field and the remedy.
    #[test]
    fn refusals() {
        let list = |name: &str| vec![name.to_owned()];
        let flat = || named(&["flat"]);
        let expires = |ms| OpenRequest { mode: Mode::RealTime.into(), command_timeout_ms: ms, ..request() };
        let cases = [
            (OpenRequest { protocol: None, ..request() }, Code::Version, "protocol", "speaks 3."),
            (
                OpenRequest { protocol: Some(Version { major: 2, minor: 3 }), ..request() },
                Code::Version,
                "protocol",
                "the client speaks 2.3, but this server speaks 3.",
            ),
            (
                OpenRequest { policy: "a\x1b[2J".into(), ..request() },
                Code::Value,
                "policy",
                "without control characters",
            ),
            (OpenRequest { policy: "a\nequal: b".into(), ..request() }, Code::Value, "policy", "in one line"),
            (OpenRequest { policy: "a\u{202e}b".into(), ..request() }, Code::Value, "policy", "plain text"),
            (OpenRequest { policy: "a".repeat(129), ..request() }, Code::Value, "policy", "0 to 128 bytes"),
            (OpenRequest { task: "S99".into(), ..request() }, Code::Unknown, "task", "known ones are S01"),
            (OpenRequest { mode: 7, ..request() }, Code::Unknown, "mode", "MODE_LOCKSTEP"),
            (OpenRequest { sensors: named(&["smell"]), ..request() }, Code::Unknown, "sensors", "does not exist"),
            (OpenRequest { image_width: 15, ..request() }, Code::Value, "image_width", "from 16 to 640"),
            (OpenRequest { image_height: 641, ..request() }, Code::Value, "image_height", "from 16 to 640"),
            (
                OpenRequest { sensors: flat(), image_height: 250, ..request() },
                Code::Value,
                "image_height",
                "multiple of 32",
            ),
            (OpenRequest { weights: "a".into(), ..request() }, Code::Value, "weights", "ask for features or flat"),
            (
                OpenRequest {
                    prop_scale: Some(v3::PropScale { ladder_z: 1.3, ..v3::PropScale::default() }),
                    ..request()
                },
                Code::Value,
                "prop_scale",
                "ladder_z is 1.3",
            ),
            (
                OpenRequest {
                    prop_scale: Some(v3::PropScale { socket: f64::NAN, ..v3::PropScale::default() }),
                    ..request()
                },
                Code::Value,
                "prop_scale",
                "socket",
            ),
            (
                OpenRequest {
                    prop_scale: Some(v3::PropScale { socket: 1.1, ..v3::PropScale::default() }),
                    randomization: Some(v3::Randomization { prop_scale: true, ..v3::Randomization::default() }),
                    ..request()
                },
                Code::Value,
                "prop_scale",
                "choose one of the two",
            ),
            (ranging("wind", 1.0, 2.0), Code::Unknown, "ranges", "'wind' has no range"),
            (ranging("gravity", 2.0, 1.0), Code::Value, "ranges", "gravity is from 2 to 1"),
            (
                OpenRequest {
                    randomization: Some(v3::Randomization { exact_sensors: true, ..v3::Randomization::default() }),
                    ..ranging("noise", 0.5, 2.0)
                },
                Code::Value,
                "ranges",
                "the sensors are exact",
            ),
            (
                OpenRequest { action_delay_ms: 20, ..ranging("action_delay", 0.0, 40.0) },
                Code::Value,
                "ranges",
                "choose one of the two",
            ),
            (OpenRequest { action_delay_ms: 30, ..request() }, Code::Value, "action_delay_ms", "a multiple of 20 ms"),
            (OpenRequest { action_delay_ms: 120, ..request() }, Code::Value, "action_delay_ms", "at most 100 ms"),
            (expires(510), Code::Value, "command_timeout_ms", "a multiple of 20 ms"),
            (expires(10_020), Code::Value, "command_timeout_ms", "at most 10000 ms"),
            (OpenRequest { reward: "more".into(), ..request() }, Code::Unknown, "reward", "benchmark, training"),
            (OpenRequest { gains: "soft".into(), ..request() }, Code::Unknown, "gains", "fiatlux, sonic"),
            (
                OpenRequest { robot: "claw".into(), ..request() },
                Code::Unknown,
                "robot",
                "use one of 'g1_inspire', 'g1_bare', 'g1_dex3', 'g1_inspire6'",
            ),
            (
                OpenRequest { episode_protocol: "lenient".into(), ..request() },
                Code::Unknown,
                "episode_protocol",
                "known ones are published, strict",
            ),
            (OpenRequest { take: true, ..request() }, Code::Value, "end_on", "success alone"),
            (
                OpenRequest { take: true, end_on: list("fall"), ..request() },
                Code::Value,
                "end_on",
                "past mistakes and time-out",
            ),
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
