//! The conditions of a run, which must be equal before two results share a table.

use std::collections::BTreeMap;

use fiatlux_proto::{is_of_images, plain, v3};
use fiatlux_rules::{BENCHMARK_VERSION, Relay, Thresholds, pins};
use serde::{Deserialize, Serialize};

/// Conditions that all episodes of a table share; `RESULTS.md` describes the fields.
///
/// Four words say how a run was played, each independent of the others: [`protocol`](Self::protocol),
/// [`seeds`](Self::seeds), [`observations`](Self::observations) and [`time`](Self::time). Each combination has a
/// ranking of its own. Any other departure from the benchmark is a deviation.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Conditions {
    #[serde(default)]
    pub benchmark_version: u32,
    #[serde(default)]
    pub protocol: String,
    #[serde(default)]
    pub seeds: String,
    #[serde(default)]
    pub observations: String,
    #[serde(default)]
    pub time: String,
    pub gains: String,
    pub robot: String,
    pub noise: bool,
    #[serde(default)]
    pub fixed: Vec<String>,
    #[serde(default)]
    pub prop_scale: String,
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub ranges: BTreeMap<String, [f64; 2]>,
    #[serde(default)]
    pub sensors: Vec<String>,
    #[serde(default)]
    pub weights: String,
    #[serde(default)]
    pub meshes: String,
    #[serde(default)]
    pub action_delay_ms: u32,
    pub end_on_overridden: Vec<String>,
    #[serde(default)]
    pub takes: bool,
    /// `person` where the actions are a person's, of takes too; else `policy`.
    #[serde(default)]
    pub source: String,
    #[serde(default)]
    pub ranked: bool,
    pub deviations: Vec<String>,
    /// Thresholds that this grading judged by, by name.
    pub thresholds: BTreeMap<String, f64>,
    /// Names of those among them that this grading set in place of the recorded ones.
    pub thresholds_set: Vec<String>,
    /// Criteria were counted as in the published numbers, and not from the reset state.
    pub published_counting: bool,
    pub model_digest: String,
    pub scene_digest: String,
    /// Objects from files in place of the scene's own things, each as its place and digest.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub assets: Vec<String>,
    /// Subtasks of the errand that another policy than the run's played, each as `SUBTASK=POLICY`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub relay: Vec<String>,
}

/// Beginnings of the deviations that are about what the policy was shown.
const OF_SENSES: [&str; 3] =
    ["sensors are exact", "the camera's features are those of an untrained network", "the robot is drawn with"];

/// True for a deviation that changes what the policy was shown, and nothing else.
pub fn is_of_senses(deviation: &str) -> bool {
    OF_SENSES.iter().any(|beginning| deviation.starts_with(beginning))
}

/// Beginning of the deviation of a scene with objects from files; it is followed by [`Conditions::assets`].
pub const OBJECTS: &str = "objects from files are ";

fn is_named(asset: &v3::Asset) -> bool {
    let is_place = |byte: u8| byte.is_ascii_lowercase() || byte == b'_';
    let is_hex = |byte: u8| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte);
    let place = (1..=32).contains(&asset.place.len()) && asset.place.bytes().all(is_place);
    place && asset.digest.len() == 64 && asset.digest.bytes().all(is_hex)
}

fn assets(header: &v3::EpisodeHeader) -> Vec<String> {
    header.assets.iter().map(|asset| format!("{} {}", asset.place, asset.digest)).collect()
}

/// The conditions that are compared between bags: names and values in the words of a report.
pub(crate) fn compared(header: &v3::EpisodeHeader) -> Vec<(String, String)> {
    let end_on = if header.end_on_overridden { listed(&header.end_on) } else { "the task's own".into() };
    let mut fields: Vec<(String, String)> = [
        ("benchmark_version", header.benchmark_version.to_string()),
        ("takes", is_take(header).to_string()),
        ("source", if is_person(header) { "person" } else { "policy" }.into()),
        ("policy", quoted(&header.policy)),
        ("protocol", protocol(header).into()),
        ("seeds", seeds(header).into()),
        ("time", time(header).into()),
        ("gains", gains(header).into()),
        ("robot", robot(header).into()),
        ("fixed", listed(&fixed(header))),
        ("prop_scale", prop_scale(header)),
        ("ranges", described(&ranges(header))),
        ("sensors", listed(&comparable_sensors(header))),
        ("weights", quoted(weights(header))),
        ("meshes", quoted(meshes(header))),
        ("action_delay_ms", action_delay_ms(header).to_string()),
        ("command_timeout_s", header.command_timeout_s.to_string()),
        ("end_on", end_on),
        ("model_digest", quoted(&header.model_digest)),
        ("scene_digest", quoted(&header.scene_digest)),
        ("assets", listed(&assets(header))),
    ]
    .map(|(name, value)| (name.into(), value))
    .into();
    let mut thresholds: Vec<_> = header.thresholds.iter().collect();
    thresholds.sort_by(|a, b| a.0.cmp(b.0));
    fields.extend(thresholds.into_iter().map(|(key, value)| (format!("threshold {key}"), value.to_string())));
    fields
}

impl Conditions {
    /// Takes the header of one episode, and the thresholds that it was graded by.
    pub(crate) fn new(header: &v3::EpisodeHeader, thresholds: &Thresholds, set: &[String], published: bool) -> Self {
        let thresholds_set: Vec<String> =
            set.iter().filter_map(|set| set.split_once('=')).map(|(k, _)| k.trim().into()).collect();
        let mut deviations = Vec::new();
        if is_take(header) {
            deviations.push("the episodes are takes, which a person drove".into());
        } else if is_person(header) {
            deviations.push("the actions are a person's, whose body the robot followed".into());
        }
        if header.request.is_none() {
            deviations.push("the bags have no request, so their conditions cannot be compared with it".into());
        }
        if header.benchmark_version != BENCHMARK_VERSION {
            let played = header.benchmark_version;
            deviations.push(format!(
                "the rules are those of benchmark version {BENCHMARK_VERSION}, the episodes of {played}"
            ));
        }
        if pins::rules_digest() != pins::RULES {
            deviations.push("this scorer's rules are not the pinned ones".into());
        }
        if gains(header) != "fiatlux" {
            deviations.push(format!("gains are {}", quoted(gains(header))));
        }
        if !pins::RANKED_ROBOTS.contains(&robot(header)) {
            deviations.push(format!("the robot is {}", quoted(robot(header))));
        }
        if pins::model(robot(header)).is_some_and(|pinned| pinned != header.model_digest) {
            deviations.push("the robot is not the pinned one".into());
        }
        deviations.extend(fixed(header).into_iter().map(|what| match what {
            "sensors" => "sensors are exact".into(),
            what => format!("{what} is fixed"),
        }));
        if prop_scale(header) != PUBLISHED {
            deviations.push(format!("sizes of props are {}", prop_scale(header)));
        }
        if !ranges(header).is_empty() {
            deviations.push(format!("each episode draws {}", described(&ranges(header))));
        }
        let assets = assets(header);
        if assets.is_empty() {
            if header.scene_digest != pins::SCENE || !header.scene_config.is_empty() {
                deviations.push("the scene is not the pinned one".into());
            }
        } else {
            if header.base_scene_digest != pins::SCENE {
                deviations.push("the scene without its objects is not the pinned one".into());
            }
            if !header.assets.iter().all(is_named) {
                deviations.push("an object's place or digest is malformed".into());
            }
            deviations.push(format!("{OBJECTS}{}", listed(&assets)));
        }
        if is_untrained(header) {
            let label = quoted(weights(header));
            deviations.push(format!("the camera's features are those of an untrained network, {label}"));
        }
        if !meshes(header).is_empty() {
            deviations.push("the robot is drawn with the user's own meshes".into());
        }
        if action_delay_ms(header) > 0 {
            deviations.push(format!("actions are delayed by {} ms", action_delay_ms(header)));
        }
        // Bags of lockstep, and those before protocol 3.7, have none.
        if ![0.0, COMMAND_TIMEOUT_S].contains(&header.command_timeout_s) {
            deviations.push(format!("commands expire after {} s", header.command_timeout_s));
        }
        if header.end_on_overridden {
            deviations.push(format!("episodes ended on {}", listed(&header.end_on)));
        }
        let usual = Thresholds::default();
        for ((key, value), (_, usual)) in thresholds.entries().zip(usual.entries()) {
            if value != usual {
                deviations.push(format!("{key} is {value} instead of {usual}"));
            }
        }
        let relay = relay(header);
        if !relay.is_empty() {
            deviations.push(format!("several policies played the errand: {}", listed(&relay)));
        }
        if published {
            deviations.push("criteria are counted as in the published numbers".into());
        }
        Self {
            benchmark_version: header.benchmark_version,
            protocol: protocol(header).into(),
            seeds: seeds(header).into(),
            observations: observations(header).into(),
            time: time(header).into(),
            gains: gains(header).into(),
            robot: robot(header).into(),
            noise: !fixed(header).iter().any(|what| ["start", "sensors"].contains(what)),
            fixed: fixed(header).into_iter().map(str::to_owned).collect(),
            prop_scale: prop_scale(header),
            ranges: ranges(header),
            sensors: comparable_sensors(header),
            weights: weights(header).into(),
            meshes: meshes(header).into(),
            action_delay_ms: action_delay_ms(header),
            end_on_overridden: if header.end_on_overridden { header.end_on.clone() } else { Vec::new() },
            takes: is_take(header),
            source: if is_person(header) { "person" } else { "policy" }.into(),
            ranked: deviations.is_empty(),
            deviations,
            thresholds: thresholds.entries().map(|(key, value)| (key.into(), value)).collect(),
            thresholds_set,
            published_counting: published,
            model_digest: header.model_digest.clone(),
            scene_digest: header.scene_digest.clone(),
            assets,
            relay,
        }
    }

    /// Conditions of a run without a bag, from its registration.
    pub(crate) fn unplayed(spec: &v3::RunSpec) -> Self {
        let request = spec.session.clone().unwrap_or_default();
        let header = v3::EpisodeHeader { mode: request.mode, ..v3::EpisodeHeader::default() };
        Self {
            protocol: if request.episode_protocol.is_empty() { "strict".into() } else { request.episode_protocol },
            seeds: if spec.hosted_seeds > 0 { "hosted" } else { "public" }.into(),
            observations: "unknown".into(),
            time: time(&header).into(),
            deviations: vec!["no episode has a bag, so its conditions are unknown".into()],
            ..Self::default()
        }
    }
}

/// True for a take, which a person drove.
pub(crate) fn is_take(header: &v3::EpisodeHeader) -> bool {
    header.request.as_ref().is_some_and(|request| request.take)
}

/// The argument by which the shipped client follows a tracked person.
const STREAM: &str = "stream=";

/// True where the bag says that a person moved the robot: by hand, or through a tracked body.
pub(crate) fn is_person(header: &v3::EpisodeHeader) -> bool {
    is_take(header)
        || header.source != 0
        || header.request.as_ref().is_some_and(|request| request.source != 0)
        || header.policy.contains(STREAM)
}

/// Subtasks that other policies of a relay played, as the policy's name says.
fn relay(header: &v3::EpisodeHeader) -> Vec<String> {
    let guests = Relay::of(&header.policy).map(|relay| relay.guests).unwrap_or_default();
    guests.iter().map(|guest| plain(&guest.to_string()).into_owned()).collect()
}

fn protocol(header: &v3::EpisodeHeader) -> &str {
    &header.episode_protocol
}

fn seeds(header: &v3::EpisodeHeader) -> &'static str {
    if header.run.as_ref().is_some_and(|run| run.hosted) { "hosted" } else { "public" }
}

fn action_delay_ms(header: &v3::EpisodeHeader) -> u32 {
    header.request.as_ref().map_or(0, |request| request.action_delay_ms)
}

/// Time for which a whole-body command stays in force in real time, s, by PROTOCOL.md.
const COMMAND_TIMEOUT_S: f64 = 0.5;

fn observations(header: &v3::EpisodeHeader) -> &'static str {
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

fn time(header: &v3::EpisodeHeader) -> &'static str {
    match header.mode() {
        v3::Mode::RealTime => "real time",
        v3::Mode::Lockstep | v3::Mode::Unspecified => "lockstep",
    }
}

/// The benchmark's robot.
pub(crate) const ROBOT: &str = pins::RANKED_ROBOTS[0];

fn gains(header: &v3::EpisodeHeader) -> &str {
    if header.gains.is_empty() { "fiatlux" } else { &header.gains }
}

fn robot(header: &v3::EpisodeHeader) -> &str {
    if header.robot.is_empty() { ROBOT } else { &header.robot }
}

/// Value of `prop_scale` for props of the benchmark's sizes.
const PUBLISHED: &str = "published";

/// Conditions that are fixed in these episodes, although the benchmark varies them.
fn fixed(header: &v3::EpisodeHeader) -> Vec<&'static str> {
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

fn prop_scale(header: &v3::EpisodeHeader) -> String {
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
fn ranges(header: &v3::EpisodeHeader) -> BTreeMap<String, [f64; 2]> {
    let ranges = header.request.iter().flat_map(|request| &request.ranges);
    ranges.map(|(name, range)| (name.clone(), [range.least, range.most])).collect()
}

pub(crate) fn described(ranges: &BTreeMap<String, [f64; 2]>) -> String {
    let each = ranges.iter().map(|(name, [least, most])| format!("{} from {least} to {most}", plain(name)));
    listed(&each.collect::<Vec<_>>())
}

/// Sensors of a session that named none: they differ from task to task.
const OWN: &str = "the task's own";
/// Those that a task may have of its own.
const OF_THE_BODY: [&str; 4] = ["proprioception", "hand_contact", "limb_contact", "last_action"];

/// The sensors, in one word where the session left them to the task: episodes of several tasks share a table then.
fn comparable_sensors(header: &v3::EpisodeHeader) -> Vec<String> {
    let names_none = header.request.as_ref().is_none_or(|request| request.sensors.iter().all(|sensor| sensor.bag_only));
    let mut shown = header.sensors.iter().filter(|sensor| !sensor.bag_only);
    let is_own = |sensor: &v3::Sensor| !sensor.on_request && OF_THE_BODY.contains(&&*sensor.name);
    if names_none && shown.all(is_own) { vec![OWN.into()] } else { sensors(header) }
}

fn sensors(header: &v3::EpisodeHeader) -> Vec<String> {
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
fn senses_features(header: &v3::EpisodeHeader) -> bool {
    header.sensors.iter().any(|sensor| !sensor.bag_only && ["features", "flat"].contains(&&*sensor.name))
}

/// Label of the weights of the camera's features; empty if the policy could not read them.
fn weights(header: &v3::EpisodeHeader) -> &str {
    if senses_features(header) { &header.weights } else { "" }
}

/// True if the policy could read features of an untrained network: only weights from a file count as trained.
fn is_untrained(header: &v3::EpisodeHeader) -> bool {
    senses_features(header) && !header.weights.starts_with("safetensors:")
}

/// Label of the meshes; empty if no sensor of the session sees them.
fn meshes(header: &v3::EpisodeHeader) -> &str {
    if sees(header) { &header.meshes } else { "" }
}

/// True if the policy could read anything computed from a camera's image.
fn sees(header: &v3::EpisodeHeader) -> bool {
    header.sensors.iter().any(|sensor| !sensor.bag_only && is_of_images(&sensor.name))
}

fn listed(names: &[impl AsRef<str>]) -> String {
    if names.is_empty() { "nothing".into() } else { names.iter().map(AsRef::as_ref).collect::<Vec<_>>().join(", ") }
}

fn quoted(text: &str) -> String {
    format!("'{text}'")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn new(header: v3::EpisodeHeader) -> Conditions {
        Conditions::new(&header, &Thresholds::default(), &[], false)
    }

    fn pinned() -> v3::EpisodeHeader {
        v3::EpisodeHeader {
            request: Some(v3::OpenRequest::default()),
            benchmark_version: BENCHMARK_VERSION,
            episode_protocol: "strict".into(),
            model_digest: pins::model(ROBOT).unwrap_or_default().into(),
            scene_digest: pins::SCENE.into(),
            ..v3::EpisodeHeader::default()
        }
    }

    fn words(conditions: &Conditions) -> [&str; 4] {
        [&conditions.protocol, &conditions.seeds, &conditions.observations, &conditions.time].map(String::as_str)
    }

    /// Guards that `evaluate --tasks all,climb` gives one table, and that a session which names its sensors is no part of it.
    #[test]
    fn sensors_that_are_left_to_the_task_are_no_difference() {
        let with = |task: &str, sensors: &[&str], named: &[&str]| v3::EpisodeHeader {
            task: task.into(),
            sensors: sensors.iter().map(|name| (*name).into()).collect(),
            request: Some(v3::OpenRequest {
                sensors: named.iter().map(|name| (*name).into()).collect(),
                ..v3::OpenRequest::default()
            }),
            ..pinned()
        };
        let carry = with("S05", &["proprioception", "hand_contact"], &[]);
        let sensors = |header: &v3::EpisodeHeader| new(header.clone()).sensors;
        assert_eq!(sensors(&carry), [OWN]);
        for (task, contacts) in [("climb", &["limb_contact"][..]), ("S02", &["hand_contact", "limb_contact"])] {
            let other = with(task, &[&["proprioception"], contacts].concat(), &[]);
            assert_eq!(compared(&other), compared(&carry), "{task}");
            let named =
                with(task, &[&["proprioception"], contacts].concat(), &[&["proprioception"], contacts].concat());
            assert_ne!(compared(&named), compared(&carry), "{task}");
        }
        let mut recorded = carry.clone();
        let camera = v3::Sensor { bag_only: true, recorded: true, ..v3::Sensor::from("camera") };
        recorded.sensors.push(camera.clone());
        recorded.request.get_or_insert_default().sensors.push(camera);
        assert_eq!(compared(&recorded), compared(&carry));
        // A header that does not say what it has is not believed.
        let seen = with("S05", &["proprioception", "privileged"], &[]);
        assert_eq!(sensors(&seen), ["proprioception@0", "privileged@0"]);
    }

    /// Guards that objects from files are the only thing that may differ from the pinned scene, and that they are told apart.
    #[test]
    fn objects_from_files_are_named_in_a_pinned_scene() {
        let with = |place: &str, digest: String| v3::EpisodeHeader {
            scene_digest: "1".into(),
            scene_config: "[assets]".into(),
            base_scene_digest: pins::SCENE.into(),
            assets: vec![v3::Asset { place: place.into(), name: "box".into(), digest }],
            ..pinned()
        };
        let conditions = new(with("crate", "ab".repeat(32)));
        let named = format!("crate {}", "ab".repeat(32));
        assert_eq!(conditions.deviations, [format!("{OBJECTS}{named}")]);
        assert_eq!((conditions.ranked, conditions.assets), (false, vec![named]));
        assert_ne!(compared(&with("crate", "ab".repeat(32))), compared(&with("crate", "cd".repeat(32))));
        let elsewhere = v3::EpisodeHeader { base_scene_digest: "2".into(), ..with("crate", "ab".repeat(32)) };
        assert!(new(elsewhere).deviations[0].contains("without its objects is not the pinned one"));
        for (place, digest) in [("<b>", "ab".repeat(32)), ("crate", "AB".repeat(32)), ("crate", String::new())] {
            assert!(new(with(place, digest)).deviations[0].contains("malformed"), "{place}");
        }
        // An object cannot hide a changed scene.
        let none = v3::EpisodeHeader { assets: Vec::new(), ..with("crate", String::new()) };
        assert_eq!(new(none).deviations, ["the scene is not the pinned one"]);
    }

    /// Guards that randomization, sizes of props and sensors are conditions, and that fields of a single bag are not.
    #[test]
    fn sessions_that_differ_are_told_apart() {
        let header = || v3::EpisodeHeader { sensors: vec!["proprioception".into()], ..pinned() };
        let usual = new(header());
        assert!(usual.ranked, "{:?}", usual.deviations);
        assert_eq!(words(&usual), ["strict", "public", "standard", "lockstep"]);
        let random = |random: v3::Randomization| v3::EpisodeHeader { randomization: Some(random), ..header() };
        let default = v3::Randomization::default();
        let sized = v3::PropScale { ladder_z: 1.05, ..v3::PropScale::default() };
        let request = v3::OpenRequest { prop_scale: Some(sized), ..v3::OpenRequest::default() };
        let delayed = v3::OpenRequest { action_delay_ms: 40, ..v3::OpenRequest::default() };
        let range = |name: &str, least, most| (name.to_owned(), v3::Range { least, most });
        let ranges = [range("noise", 0.5, 2.0), range("gravity", 9.6, 10.0)].into();
        let ranging = v3::OpenRequest { ranges, ..v3::OpenRequest::default() };
        let sensing = |sensor: v3::Sensor| v3::EpisodeHeader { sensors: vec![sensor], ..header() };
        let seeded = v3::EpisodeHeader { weights: "fiatlux-resnet18-seeded/1:0".into(), ..sensing("flat".into()) };
        let cases = [
            (random(v3::Randomization { fixed_start: true, ..default }), "start is fixed", "standard"),
            (random(v3::Randomization { fixed_layout: true, ..default }), "layout is fixed", "standard"),
            (random(v3::Randomization { exact_sensors: true, ..default }), "sensors are exact", "other"),
            (random(v3::Randomization { prop_scale: true, ..default }), "sizes of props are random", "standard"),
            (v3::EpisodeHeader { request: Some(request), ..header() }, "sizes of props are ladder_z 1.05", "standard"),
            (v3::EpisodeHeader { request: Some(delayed), ..header() }, "actions are delayed by 40 ms", "standard"),
            (
                v3::EpisodeHeader { request: Some(ranging), ..header() },
                "each episode draws gravity from 9.6 to 10, noise from 0.5 to 2",
                "standard",
            ),
            (
                v3::EpisodeHeader { scene_config: "[bench]".into(), ..header() },
                "the scene is not the pinned one",
                "standard",
            ),
            (v3::EpisodeHeader { scene_digest: "1".into(), ..header() }, "the scene is not the pinned one", "standard"),
            (v3::EpisodeHeader { model_digest: "1".into(), ..header() }, "the robot is not the pinned one", "standard"),
            (seeded, "the camera's features are those of an untrained network, 'fiatlux-resnet18-seeded/1:0'", "other"),
            (
                v3::EpisodeHeader { benchmark_version: 7, ..header() },
                &format!("the rules are those of benchmark version {BENCHMARK_VERSION}, the episodes of 7"),
                "standard",
            ),
        ];
        for (other, deviation, observations) in cases {
            let conditions = new(other);
            assert!(!conditions.ranked && conditions.deviations == [deviation], "{:?}", conditions.deviations);
            assert_eq!(conditions.observations, observations, "{deviation}");
        }
        // The four words are not deviations: they separate rankings.
        for (header, expected) in [
            (sensing("verdict".into()), ["strict", "public", "privileged", "lockstep"]),
            (sensing("privileged".into()), ["strict", "public", "privileged", "lockstep"]),
            (
                v3::EpisodeHeader { mode: v3::Mode::RealTime.into(), ..header() },
                ["strict", "public", "standard", "real time"],
            ),
            (
                v3::EpisodeHeader { run: Some(v3::RunTicket { hosted: true, ..v3::RunTicket::default() }), ..header() },
                ["strict", "hosted", "standard", "lockstep"],
            ),
        ] {
            let conditions = new(header);
            assert!(conditions.ranked, "{:?}", conditions.deviations);
            assert_eq!(words(&conditions), expected);
        }
        let camera = |width| v3::EpisodeHeader { image_width: width, image_height: 256, ..sensing("camera".into()) };
        assert_ne!(compared(&camera(256)), compared(&camera(512)), "the image's size");
        assert!(new(camera(512)).ranked);
        let lidar = |rate_hz| sensing(v3::Sensor { rate_hz, ..v3::Sensor::from("lidar") });
        assert_ne!(compared(&lidar(10.0)), compared(&lidar(50.0)), "the rate");
        let in_bag = v3::Sensor { bag_only: true, recorded: true, ..v3::Sensor::from("camera") };
        let mut recorded = header();
        recorded.sensors.push(in_bag);
        assert_eq!(compared(&recorded), compared(&header()), "fields of a single bag");
        let delayed = |action_delay_ms| v3::EpisodeHeader {
            request: Some(v3::OpenRequest { action_delay_ms, ..v3::OpenRequest::default() }),
            ..header()
        };
        assert_ne!(compared(&delayed(20)), compared(&delayed(40)), "the delay");
        assert_eq!(compared(&delayed(0)), compared(&header()));
    }

    /// Guards that what cannot be compared is not ranked, and that what a person did is not.
    #[test]
    fn bags_without_a_request_and_of_persons_are_not_ranked() {
        let header = || v3::EpisodeHeader { sensors: vec!["proprioception".into()], ..pinned() };
        assert!(new(header()).ranked);
        assert!(new(v3::EpisodeHeader { request: None, ..header() }).deviations[0].contains("no request"));
        let take = v3::OpenRequest { take: true, ..v3::OpenRequest::default() };
        let persons = [
            v3::EpisodeHeader { request: Some(take), ..header() },
            v3::EpisodeHeader { policy: "sonic:models,stream=tcp://192.0.2.1:5555".into(), ..header() },
        ];
        for header in persons {
            assert_ne!(compared(&header), compared(&pinned()));
            let conditions = new(header);
            assert!(conditions.source == "person" && !conditions.ranked, "{:?}", conditions.deviations);
        }
    }

    /// Guards that other meshes are other conditions only for a policy that sees pictures of them.
    #[test]
    fn meshes_count_where_they_are_seen() {
        let header = |sensor: &str, meshes: &str| v3::EpisodeHeader {
            sensors: vec!["proprioception".into(), sensor.into()],
            meshes: meshes.into(),
            weights: "safetensors:1".into(),
            ..pinned()
        };
        for sensor in ["camera", "features", "flat"] {
            assert_ne!(compared(&header(sensor, "meshes:1")), compared(&header(sensor, "meshes:2")), "{sensor}");
            assert_ne!(compared(&header(sensor, "meshes:1")), compared(&header(sensor, "")), "{sensor}");
            let conditions = new(header(sensor, "meshes:1"));
            assert_eq!(conditions.deviations, ["the robot is drawn with the user's own meshes"]);
            assert!(!conditions.ranked && conditions.meshes == "meshes:1" && conditions.observations == "other");
            assert!(new(header(sensor, "")).ranked);
        }
        assert_eq!(compared(&header("lidar", "meshes:1")), compared(&header("lidar", "")));
        assert!(new(header("lidar", "meshes:1")).ranked);
    }
}
