//! Departures of a run from the benchmark, each in words.

use fiatlux_proto::v3;
use fiatlux_rules::{BENCHMARK_VERSION, Thresholds, pins};

use super::OBJECTS;
use super::recorded::*;

/// A departure from the benchmark, if an episode has it.
type Departure = fn(&v3::EpisodeHeader) -> Option<String>;

/// In the order in which reports name them. Fixed conditions, objects and thresholds have lists of their own.
const OF_THE_RUN: [Departure; 4] = [
    |header| {
        let played = match (is_take(header), is_person(header)) {
            (true, _) => "the episodes are takes, which a person drove",
            (false, true) => "the actions are a person's, whose body the robot followed",
            (false, false) => return None,
        };
        Some(played.into())
    },
    |header| {
        let unknown = "the bags have no request, so their conditions cannot be compared with it";
        header.request.is_none().then(|| unknown.into())
    },
    |header| {
        let played = header.benchmark_version;
        (played != BENCHMARK_VERSION)
            .then(|| format!("the rules are those of benchmark version {BENCHMARK_VERSION}, the episodes of {played}"))
    },
    |_| (pins::rules_digest() != pins::RULES).then(|| "this scorer's rules are not the pinned ones".into()),
];
const OF_THE_ROBOT: [Departure; 3] = [
    |header| (gains(header) != "fiatlux").then(|| format!("gains are {}", quoted(gains(header)))),
    |header| {
        let robot = robot(header);
        (!pins::RANKED_ROBOTS.contains(&robot)).then(|| format!("the robot is {}", quoted(robot)))
    },
    |header| {
        let is_other = pins::model(robot(header)).is_some_and(|pinned| pinned != header.model_digest);
        is_other.then(|| "the robot is not the pinned one".into())
    },
];
const OF_THE_DRAW: [Departure; 2] = [
    |header| (prop_scale(header) != PUBLISHED).then(|| format!("sizes of props are {}", prop_scale(header))),
    |header| (!ranges(header).is_empty()).then(|| format!("each episode draws {}", described(&ranges(header)))),
];
const OF_THE_SESSION: [Departure; 5] = [
    |header| {
        let label = quoted(weights(header));
        is_untrained(header).then(|| format!("the camera's features are those of an untrained network, {label}"))
    },
    |header| (!meshes(header).is_empty()).then(|| "the robot is drawn with the user's own meshes".into()),
    |header| {
        let delay = action_delay_ms(header);
        (delay > 0).then(|| format!("actions are delayed by {delay} ms"))
    },
    |header| {
        // Bags of lockstep, and those before protocol 3.7, have none.
        let timeout = header.command_timeout_s;
        (![0.0, COMMAND_TIMEOUT_S].contains(&timeout)).then(|| format!("commands expire after {timeout} s"))
    },
    |header| header.end_on_overridden.then(|| format!("episodes ended on {}", listed(&header.end_on))),
];

/// Those of an episode, and of the way in which it was graded.
pub(super) fn of(header: &v3::EpisodeHeader, thresholds: &Thresholds, published: bool) -> Vec<String> {
    let each = |departures: &'static [Departure]| departures.iter().filter_map(move |departs| departs(header));
    let mut all: Vec<String> = each(&OF_THE_RUN).chain(each(&OF_THE_ROBOT)).collect();
    all.extend(fixed(header).into_iter().map(|what| match what {
        "sensors" => "sensors are exact".into(),
        what => format!("{what} is fixed"),
    }));
    all.extend(each(&OF_THE_DRAW));
    all.extend(of_the_scene(header));
    all.extend(each(&OF_THE_SESSION));
    let usual = Thresholds::default();
    let set = thresholds.entries().zip(usual.entries()).filter(|((_, value), (_, usual))| value != usual);
    all.extend(set.map(|((key, value), (_, usual))| format!("{key} is {value} instead of {usual}")));
    let relay = relay(header);
    if !relay.is_empty() {
        all.push(format!("several policies played the errand: {}", listed(&relay)));
    }
    if published {
        all.push("criteria are counted as in the published numbers".into());
    }
    all
}

/// An object from a file may differ from the pinned scene, and nothing else.
fn of_the_scene(header: &v3::EpisodeHeader) -> Vec<String> {
    let assets = assets(header);
    if assets.is_empty() {
        let is_other = header.scene_digest != pins::SCENE || !header.scene_config.is_empty();
        return is_other.then(|| "the scene is not the pinned one".into()).into_iter().collect();
    }
    let faults = [
        (header.base_scene_digest != pins::SCENE, "the scene without its objects is not the pinned one"),
        (!header.assets.iter().all(is_named), "an object's place or digest is malformed"),
    ];
    let faults = faults.into_iter().filter(|(is_there, _)| *is_there).map(|(_, fault)| fault.into());
    faults.chain([format!("{OBJECTS}{}", listed(&assets))]).collect()
}
