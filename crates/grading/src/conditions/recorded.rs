//! The conditions of an episode as its bag's header has them.

use std::collections::BTreeMap;

use fiatlux_proto::{is_of_images, plain, v3};
use fiatlux_rules::{Relay, pins};

pub(super) fn is_named(asset: &v3::Asset) -> bool {
    let is_place = |byte: u8| byte.is_ascii_lowercase() || byte == b'_';
    let is_hex = |byte: u8| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte);
    let place = (1..=32).contains(&asset.place.len()) && asset.place.bytes().all(is_place);
    place && asset.digest.len() == 64 && asset.digest.bytes().all(is_hex)
}

pub(super) fn assets(header: &v3::EpisodeHeader) -> Vec<String> {
    header.assets.iter().map(|asset| format!("{} {}", asset.place, asset.digest)).collect()
}

/// True for a take, which a person drove.
pub(crate) fn is_take(header: &v3::EpisodeHeader) -> bool {
    header.request.as_ref().is_some_and(|request| request.take)
}

/// The argument by which the shipped client follows a tracked person.
pub(super) const STREAM: &str = "stream=";

/// True where the bag says that a person moved the robot: by hand, or through a tracked body.
pub(crate) fn is_person(header: &v3::EpisodeHeader) -> bool {
    is_take(header)
        || header.source != 0
        || header.request.as_ref().is_some_and(|request| request.source != 0)
        || header.policy.contains(STREAM)
}

/// Subtasks that other policies of a relay played, as the policy's name says.
pub(super) fn relay(header: &v3::EpisodeHeader) -> Vec<String> {
    let guests = Relay::of(&header.policy).map(|relay| relay.guests).unwrap_or_default();
    guests.iter().map(|guest| plain(&guest.to_string()).into_owned()).collect()
}

pub(super) fn protocol(header: &v3::EpisodeHeader) -> &str {
    &header.episode_protocol
}

pub(super) fn seeds(header: &v3::EpisodeHeader) -> &'static str {
    if header.run.as_ref().is_some_and(|run| run.hosted) { "hosted" } else { "public" }
}

pub(super) fn action_delay_ms(header: &v3::EpisodeHeader) -> u32 {
    header.request.as_ref().map_or(0, |request| request.action_delay_ms)
}

/// Time for which a whole-body command stays in force in real time, s, by PROTOCOL.md.
pub(super) const COMMAND_TIMEOUT_S: f64 = 0.5;

pub(super) fn observations(header: &v3::EpisodeHeader) -> &'static str {
    let shown = header.sensors.iter().filter(|sensor| !sensor.bag_only);
    let kinds: Vec<_> = shown.map(|sensor| pins::observations_with(&sensor.name)).collect();
    let exact = header.randomization.is_some_and(|random| random.exact_sensors);
    if kinds.contains(&"privileged") {
        "privileged"
    } else if exact || is_untrained(header) || !meshes(header).is_empty() || kinds.contains(&"other") {
        "other"
    } else if kinds.contains(&"goal") {
        "goal"
    } else {
        "standard"
    }
}

pub(super) fn time(header: &v3::EpisodeHeader) -> &'static str {
    match header.mode() {
        v3::Mode::RealTime => "real time",
        v3::Mode::Lockstep | v3::Mode::Unspecified => "lockstep",
    }
}

/// The benchmark's robot.
pub(super) const ROBOT: &str = pins::RANKED_ROBOTS[0];

pub(super) fn gains(header: &v3::EpisodeHeader) -> &str {
    if header.gains.is_empty() { "fiatlux" } else { &header.gains }
}

pub(super) fn robot(header: &v3::EpisodeHeader) -> &str {
    if header.robot.is_empty() { ROBOT } else { &header.robot }
}

/// Value of `prop_scale` for props of the benchmark's sizes.
pub(super) const PUBLISHED: &str = "published";

/// Conditions that are fixed in these episodes, although the benchmark varies them.
pub(super) fn fixed(header: &v3::EpisodeHeader) -> Vec<&'static str> {
    let random = header.randomization.unwrap_or_default();
    let switches = [
        ("layout", random.fixed_layout),
        ("start", random.fixed_start),
        ("hand_friction", random.fixed_hand_friction),
        ("light", random.fixed_light),
        ("tint", random.fixed_tint),
        ("sensors", random.exact_sensors),
    ];
    switches.into_iter().filter(|(_, is_fixed)| *is_fixed).map(|(what, _)| what).collect()
}

pub(super) fn prop_scale(header: &v3::EpisodeHeader) -> String {
    if header.randomization.is_some_and(|random| random.prop_scale) {
        return "random".into();
    }
    let scale = header.request.as_ref().and_then(|request| request.prop_scale).unwrap_or_default();
    let factors = [
        ("ladder_x", scale.ladder_x),
        ("ladder_y", scale.ladder_y),
        ("ladder_z", scale.ladder_z),
        ("socket", scale.socket),
        ("fresh_bulb", scale.fresh_bulb),
    ];
    let changed = factors.into_iter().filter(|(_, factor)| ![0.0, 1.0].contains(factor));
    let changed: Vec<_> = changed.map(|(name, factor)| format!("{name} {factor}")).collect();
    if changed.is_empty() { PUBLISHED.into() } else { changed.join(", ") }
}

/// Ranges of what the benchmark holds constant and these episodes drew.
pub(super) fn ranges(header: &v3::EpisodeHeader) -> BTreeMap<String, [f64; 2]> {
    let ranges = header.request.iter().flat_map(|request| &request.ranges);
    ranges.map(|(name, range)| (name.clone(), [range.least, range.most])).collect()
}

pub(crate) fn described(ranges: &BTreeMap<String, [f64; 2]>) -> String {
    let each = ranges.iter().map(|(name, [least, most])| format!("{} from {least} to {most}", plain(name)));
    listed(&each.collect::<Vec<_>>())
}

/// Sensors of a session that named none: they differ from task to task.
pub(super) const OWN: &str = "the task's own";
/// Those that a task may have of its own.
pub(super) const OF_THE_BODY: [&str; 4] = ["proprioception", "hand_contact", "limb_contact", "last_action"];

/// The sensors, in one word where the session left them to the task: episodes of several tasks share a table then.
pub(super) fn comparable_sensors(header: &v3::EpisodeHeader) -> Vec<String> {
    let names_none = header.request.as_ref().is_none_or(|request| request.sensors.iter().all(|sensor| sensor.bag_only));
    let mut shown = header.sensors.iter().filter(|sensor| !sensor.bag_only);
    let is_own = |sensor: &v3::Sensor| !sensor.on_request && OF_THE_BODY.contains(&&*sensor.name);
    if names_none && shown.all(is_own) { vec![OWN.into()] } else { sensors(header) }
}

pub(super) fn sensors(header: &v3::EpisodeHeader) -> Vec<String> {
    let rate = |sensor: &v3::Sensor| match sensor {
        v3::Sensor { on_request: true, .. } => "look".into(),
        v3::Sensor { rate_hz, .. } => format!("{rate_hz}"),
    };
    let sensed = header.sensors.iter().filter(|sensor| !sensor.bag_only);
    let sight = |sensor: &v3::Sensor| if sensor.see_room { " with room" } else { "" };
    let named = sensed.map(|sensor| format!("{}@{}{}", sensor.name, rate(sensor), sight(sensor)));
    let mut sensors: Vec<String> = named.collect();
    if sees(header) {
        sensors.push(format!("image {}x{}", header.image_width, header.image_height));
    }
    sensors
}

/// True if the policy could read the camera's features.
pub(super) fn senses_features(header: &v3::EpisodeHeader) -> bool {
    header.sensors.iter().any(|sensor| !sensor.bag_only && ["features", "flat"].contains(&&*sensor.name))
}

/// Label of the weights of the camera's features; empty if the policy could not read them.
pub(super) fn weights(header: &v3::EpisodeHeader) -> &str {
    if senses_features(header) { &header.weights } else { "" }
}

/// True if the policy could read features of an untrained network: only weights from a file count as trained.
pub(super) fn is_untrained(header: &v3::EpisodeHeader) -> bool {
    senses_features(header) && !header.weights.starts_with("safetensors:")
}

/// Label of the meshes; empty if no sensor of the session sees them.
pub(super) fn meshes(header: &v3::EpisodeHeader) -> &str {
    if sees(header) { &header.meshes } else { "" }
}

/// True if the policy could read anything computed from a camera's image.
pub(super) fn sees(header: &v3::EpisodeHeader) -> bool {
    header.sensors.iter().any(|sensor| !sensor.bag_only && is_of_images(&sensor.name))
}

pub(super) fn listed(names: &[impl AsRef<str>]) -> String {
    if names.is_empty() { "nothing".into() } else { names.iter().map(AsRef::as_ref).collect::<Vec<_>>().join(", ") }
}

pub(super) fn quoted(text: &str) -> String {
    format!("'{text}'")
}
