//! Checks, without a simulation, that the request in a header fits the rest of it.

use fiatlux_proto::plain;
use fiatlux_proto::v3::{EpisodeHeader, Mode, OpenRequest, PropScale, Range};
use fiatlux_rules::{Cause, Causes, Protocol, Task, Thresholds};
use fiatlux_wire::{COMMAND_TIMEOUT_MS, IMAGE_SIDE, check_request, known_robot};

use crate::flaw::{Difference, first_difference};

/// Value in a header for gains that a request leaves out.
const GAINS: &str = "fiatlux";
const REWARD: &str = "benchmark";

/// The first field of a header that differs from its request, by the request and in the header; `None` if all agree, or
/// if the header has no request.
pub(crate) fn contradiction(header: &EpisodeHeader) -> Option<Difference> {
    let request = header.request.as_ref()?;
    first_difference(&asked(request, header), header)
}

/// The reason why no server plays the request in a header; `None` if one may, or if the header has no request.
pub(crate) fn unplayable(header: &EpisodeHeader) -> Option<String> {
    let refusal = check_request(header.request.as_ref()?).err()?;
    Some(format!("{}: {}", refusal.field, plain(&refusal.message)))
}

/// A header with the fields that its request asks for; the rest is as recorded, as are the delay of actions and the
/// weights, which are only in the request.
fn asked(request: &OpenRequest, header: &EpisodeHeader) -> EpisodeHeader {
    let or = |text: &str, default: &str| if text.is_empty() { default.to_owned() } else { text.to_ascii_lowercase() };
    let side = |side| if side == 0 { IMAGE_SIDE } else { side };
    // An unreadable value stays as it is, and then differs.
    let task = request.task.parse().map_or(request.task.clone(), |task: Task| task.short_id().into());
    let protocol = request.episode_protocol.parse().map_or("", Protocol::name);
    let randomization = request.randomization.unwrap_or_default();
    let mut thresholds = Thresholds::default();
    let are_known = request.thresholds.iter().all(|(key, value)| thresholds.set(&format!("{key}={value}")).is_ok());
    let thresholds = match are_known {
        true => thresholds.entries().map(|(key, value)| (key.into(), value)).collect(),
        false => request.thresholds.clone(),
    };
    let mut asked = EpisodeHeader {
        policy: request.policy.clone(),
        task,
        seed: request.seed,
        mode: if request.mode == 0 { Mode::Lockstep.into() } else { request.mode },
        gains: or(&request.gains, GAINS),
        // A robot may be named by its hands.
        robot: known_robot(&request.robot).map_or_else(|| request.robot.clone(), str::to_owned),
        episode_protocol: or(protocol, Protocol::default().name()),
        reward: or(&request.reward, REWARD),
        randomization: Some(randomization),
        thresholds,
        command_timeout_s: command_timeout_s(request, header),
        image_width: side(request.image_width),
        image_height: side(request.image_height),
        end_on_overridden: !request.end_on.is_empty(),
        ..header.clone()
    };
    if !request.end_on.is_empty() {
        let causes: Result<Causes, _> = request.end_on.iter().map(|name| name.parse::<Cause>()).collect();
        // What is no longer physical ends every episode.
        let causes = causes.map(|causes| causes.union(Causes::of(&[Cause::Diverged])));
        asked.end_on = causes.map_or(Vec::new(), |causes| causes.iter().map(|cause| cause.name().into()).collect());
    }
    if let Some(sample) = asked.domain_sample.as_mut().filter(|_| !randomization.prop_scale) {
        sample.prop_scale = Some(prop_scale(&request.prop_scale.unwrap_or_default()));
    }
    if let Some(sample) = asked.domain_sample.as_mut() {
        let drawn = |name: &String, range: &Range| {
            let recorded = sample.varied.get(name).copied().unwrap_or(range.least);
            // What is not a number is below none.
            if range.least <= recorded && recorded <= range.most { recorded } else { range.least }
        };
        sample.varied = request.ranges.iter().map(|(name, range)| (name.clone(), drawn(name, range))).collect();
    }
    let names = |header: &EpisodeHeader| header.sensors.iter().map(|sensor| sensor.name.clone()).collect::<Vec<_>>();
    if request.sensors.iter().any(|sensor| !sensor.bag_only) {
        // Their order and their rates are the server's choice.
        asked.sensors.retain(|sensor| request.sensors.iter().any(|asked| asked.name == sensor.name));
        let known = names(&asked);
        asked.sensors.extend(request.sensors.iter().filter(|sensor| !known.contains(&sensor.name)).cloned());
    }
    asked
}

/// Time after which commands expire, s. In lockstep none does, and bags of before protocol 3.7 do not say.
fn command_timeout_s(request: &OpenRequest, header: &EpisodeHeader) -> f64 {
    match request.command_timeout_ms {
        _ if header.mode() != Mode::RealTime || header.command_timeout_s == 0.0 => 0.0,
        0 => f64::from(COMMAND_TIMEOUT_MS) / 1e3,
        ms => f64::from(ms) / 1e3,
    }
}

/// Sizes, from a request in which 0 means 1.
fn prop_scale(asked: &PropScale) -> PropScale {
    let factor = |factor: f64| if factor == 0.0 { 1.0 } else { factor };
    PropScale {
        ladder_x: factor(asked.ladder_x),
        ladder_y: factor(asked.ladder_y),
        ladder_z: factor(asked.ladder_z),
        socket: factor(asked.socket),
        fresh_bulb: factor(asked.fresh_bulb),
    }
}

#[cfg(test)]
mod tests {
    use fiatlux_proto::v3::{DomainSample, Randomization, Sensor};
    use fiatlux_rules::pins;

    use super::*;

    fn sensor(name: &str, rate_hz: f64) -> Sensor {
        Sensor { name: name.into(), rate_hz, ..Sensor::default() }
    }

    /// A header as a server makes it of this request.
    fn header(request: OpenRequest) -> EpisodeHeader {
        EpisodeHeader {
            policy: "stand".into(),
            task: "S05".into(),
            seed: 7,
            mode: Mode::Lockstep.into(),
            gains: "fiatlux".into(),
            robot: pins::RANKED_ROBOTS[0].into(),
            episode_protocol: "strict".into(),
            reward: "benchmark".into(),
            randomization: Some(Randomization::default()),
            thresholds: Thresholds::default().entries().map(|(key, value)| (key.into(), value)).collect(),
            image_width: 256,
            image_height: 256,
            sensors: vec![sensor("last_action", 50.0), sensor("camera", 10.0)],
            domain_sample: Some(DomainSample {
                prop_scale: Some(prop_scale(&PropScale::default())),
                ..DomainSample::default()
            }),
            request: Some(request),
            ..EpisodeHeader::default()
        }
    }

    fn request() -> OpenRequest {
        OpenRequest {
            policy: "stand".into(),
            task: "S05".into(),
            seed: 7,
            sensors: vec![sensor("camera", 10.0), sensor("last_action", 0.0)],
            ..OpenRequest::default()
        }
    }

    /// Guards that a bag is not scored whose request no server would have played.
    #[test]
    fn what_no_server_plays_is_named() {
        let said = |request: OpenRequest| unplayable(&header(request)).unwrap_or_default();
        assert_eq!(said(request()), "");
        assert_eq!(unplayable(&EpisodeHeader { request: None, ..header(request()) }), None);
        let cases = [
            (OpenRequest { image_width: 7, ..request() }, "image_width: image_width is 7 pixels"),
            (OpenRequest { action_delay_ms: 7, ..request() }, "action_delay_ms: "),
            (
                OpenRequest { mode: Mode::RealTime.into(), command_timeout_ms: 7, ..request() },
                "command_timeout_ms: commands would expire after 7 ms",
            ),
            (OpenRequest { mode: 9, ..request() }, "mode: "),
            (OpenRequest { task: "no task".into(), ..request() }, "task: "),
            (OpenRequest { policy: "a\u{1b}[2K".into(), ..request() }, "policy: "),
            (OpenRequest { policy: "p".repeat(129), ..request() }, "policy: "),
            (OpenRequest { take: true, ..request() }, "end_on: "),
            (OpenRequest { end_on: vec!["rain".into()], ..request() }, "end_on: "),
            (OpenRequest { reward: "mine".into(), ..request() }, "reward: "),
            (OpenRequest { episode_protocol: "mine".into(), ..request() }, "episode_protocol: "),
            (OpenRequest { weights: "mine".into(), ..request() }, "weights: "),
            (OpenRequest { thresholds: [("nothing".into(), 30.0)].into(), ..request() }, "thresholds: "),
            (OpenRequest { robot: "claw".into(), ..request() }, "robot: robot 'claw' is unknown"),
            (OpenRequest { robot: "G1_INSPIRE".into(), ..request() }, "robot: "),
            (OpenRequest { gains: "soft".into(), ..request() }, "gains: 'soft' is not a known set of gains"),
            (OpenRequest { gains: "Fiatlux".into(), ..request() }, "gains: "),
            (
                OpenRequest { sensors: vec![sensor("smell", 0.0)], ..request() },
                "sensors: sensor 'smell' does not exist",
            ),
            (
                OpenRequest { sensors: vec![Sensor { recorded: true, ..sensor("verdict", 0.0) }], ..request() },
                "sensors: sensor 'verdict' is small",
            ),
            (OpenRequest { sensors: vec![sensor("camera", 7.7)], ..request() }, "sensors: "),
            (OpenRequest { sensors: vec![sensor("camera", 1.0), sensor("camera", 2.0)], ..request() }, "sensors: "),
            (OpenRequest { image_height: 100, sensors: vec![sensor("features", 1.0)], ..request() }, "image_height: "),
        ];
        for (request, beginning) in cases {
            let reason = said(request.clone());
            assert!(reason.starts_with(beginning), "'{reason}' instead of {beginning}: {request:?}");
        }
    }

    /// Guards against a request that would verify as another episode than its header shows.
    #[test]
    fn every_field_of_a_request_is_compared() {
        assert_eq!(contradiction(&header(request())), None);
        assert_eq!(contradiction(&header(OpenRequest { sensors: vec![], ..request() })), None, "the server's choice");
        assert_eq!(contradiction(&header(OpenRequest { robot: "inspire".into(), ..request() })), None, "by its hands");
        assert_eq!(contradiction(&EpisodeHeader { request: None, ..header(request()) }), None);
        let cases = [
            (OpenRequest { policy: "walk".into(), ..request() }, "policy"),
            (OpenRequest { task: "S06".into(), ..request() }, "task"),
            (OpenRequest { task: "no task".into(), ..request() }, "task"),
            (OpenRequest { seed: 8, ..request() }, "seed"),
            (OpenRequest { mode: Mode::RealTime.into(), ..request() }, "mode"),
            (OpenRequest { gains: "sonic".into(), ..request() }, "gains"),
            (OpenRequest { robot: "g1_bare".into(), ..request() }, "robot"),
            (OpenRequest { episode_protocol: "published".into(), ..request() }, "episode_protocol"),
            (OpenRequest { reward: "training".into(), ..request() }, "reward"),
            (OpenRequest { image_width: 64, ..request() }, "image_width"),
            (OpenRequest { end_on: vec!["fall".into()], ..request() }, "end_on"),
            (OpenRequest { thresholds: [("fragility_n".into(), 30.0)].into(), ..request() }, "thresholds"),
            (OpenRequest { thresholds: [("nothing".into(), 30.0)].into(), ..request() }, "thresholds"),
            (
                OpenRequest {
                    randomization: Some(Randomization { fixed_layout: true, ..Randomization::default() }),
                    ..request()
                },
                "randomization",
            ),
            (
                OpenRequest { prop_scale: Some(PropScale { socket: 1.1, ..PropScale::default() }), ..request() },
                "domain_sample",
            ),
            (
                OpenRequest { ranges: [("gravity".into(), Range { least: 9.0, most: 10.0 })].into(), ..request() },
                "varied",
            ),
            (OpenRequest { sensors: vec![sensor("camera", 10.0)], ..request() }, "sensors"),
            (OpenRequest { sensors: vec![sensor("lidar", 10.0)], ..request() }, "sensors"),
        ];
        let ranging = |drawn: f64| {
            let ranges = [("gravity".into(), Range { least: 9.0, most: 10.0 })].into();
            let mut header = header(OpenRequest { ranges, ..request() });
            header.domain_sample.get_or_insert_default().varied.insert("gravity".into(), drawn);
            contradiction(&header)
        };
        assert_eq!(ranging(9.5), None);
        assert!(ranging(10.5).is_some() && ranging(f64::NAN).is_some());
        for (request, field) in cases {
            let difference = contradiction(&header(request.clone()));
            let found = difference.map(|difference| difference.field).unwrap_or_default();
            assert!(found.contains(field), "'{found}' instead of {field}: {request:?}");
        }
    }
}
