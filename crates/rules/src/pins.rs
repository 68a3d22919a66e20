//! Digests that pin the benchmark: of the published robot, scene, rules and sensors of [`BENCHMARK_VERSION`].
//!
//! Whoever changes one of them changes the benchmark: raise the version, then set the digest here. A test recomputes all of
//! them (`tests/tests/it/pins.rs`), and the scorer says of a run whether it was played in what is pinned.
//!
//! [`BENCHMARK_VERSION`]: crate::BENCHMARK_VERSION

use fiatlux_judge::Protocol;
use std::fmt::Write;

use data_encoding::HEXLOWER;
use sha2::{Digest, Sha256};

use crate::divergence;
use crate::measure::GRAVITY;
use crate::rewards::{self, Variant};
use crate::row::CONTROL_DT;
use crate::task::Task;
use crate::thresholds::Thresholds;

/// The benchmark version that last changed how a robot moves on its own. What was trained before a change of rules, or of how
/// bulbs roll and things lie still (version 6), is still fit.
pub const ENGINE_VERSION: u32 = 4;

/// Digest of each robot's file, by its name. Robots that are not here play, but are not ranked.
pub const MODELS: [(&str, &str); 3] = include!("../pins/models.in");

/// Robots that results are ranked by, each in divisions of its own. The first is the benchmark's.
pub const RANKED_ROBOTS: [&str; 2] = include!("../pins/ranked.in");

/// Digest of the scene config with the published values.
pub const SCENE: &str = "a76e87155de54ca3cab01909f05f3661f19d70c57695db948d18b98a29f5df8f";

/// Digest of the rules, see [`rules_digest`].
pub const RULES: &str = "0f46ab8f52ba2cedbd1e00793b9980b570194dad4db49c7ae306227210f66bcd";

/// The benchmark's sensors that a robot could have as well.
const STANDARD_SENSORS: [&str; 9] = [
    "proprioception",
    "hand_contact",
    "limb_contact",
    "last_action",
    "lidar",
    "camera",
    "features",
    "flat",
    "chest_camera",
];

/// The benchmark's sensors that say what no robot could sense.
const PRIVILEGED_SENSORS: [&str; 2] = ["privileged", "verdict"];

/// The sensor that says where the lamp is, as a map would.
const GOAL_SENSOR: &str = "goal";

/// Digest of the benchmark's sensors: names, costs, cameras, and of their terms names, fields, shapes, units, ranges, scales
/// and noise. The test says how it is made.
pub const SENSORS: &str = "5b23bbc5824ca5cd33770f55741285d12d07d755b2aadba433617b9a5d59d418";

/// The pinned digest of a robot; `None` for one that the benchmark does not know.
pub fn model(robot: &str) -> Option<&'static str> {
    MODELS.into_iter().find(|(name, _)| *name == robot).map(|(_, digest)| digest)
}

/// The observations of a run with the sensor of that name: `standard`, `privileged`, `goal` for the lamp's place, or `other` for another
/// sensor that is not a part of the benchmark.
pub fn observations_with(sensor: &str) -> &'static str {
    if PRIVILEGED_SENSORS.contains(&sensor) {
        "privileged"
    } else if STANDARD_SENSORS.contains(&sensor) {
        "standard"
    } else if sensor == GOAL_SENSOR {
        "goal"
    } else {
        "other"
    }
}

/// SHA-256 over the rules as data, hexadecimal: the default thresholds, the bounds of divergence, and for each task its
/// start, gate, ends, weight, horizon, special rules and the names and weights of its reward terms. The computations of
/// predicates are not in it: the tests of the rules guard those.
pub fn rules_digest() -> String {
    let mut text = format!("control_dt {CONTROL_DT:?}\ngravity {GRAVITY:?}\n");
    let mut line = |line: std::fmt::Arguments<'_>| {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{line}");
    };
    let thresholds = Thresholds::default();
    for (name, value) in thresholds.entries() {
        line(format_args!("threshold {name} {value:?}"));
    }
    line(format_args!("diverged {:?}", divergence::BOUNDS));
    for task in Task::ALL {
        let spec = task.spec();
        line(format_args!("task {} {} {} {}", spec.short_id, spec.id, spec.name, spec.instruction));
        line(format_args!("weight {:?} {:?} modes {:?}", spec.weight, spec.factors, spec.modes));
        line(format_args!("horizon {} bulbs {:?} start {:?}", spec.horizon_steps, spec.bulbs, spec.start));
        for protocol in Protocol::ALL {
            for criterion in spec.gate.criteria_of(protocol) {
                line(format_args!("{protocol} criterion {}", criterion.name));
            }
            line(format_args!("{protocol} window {}", spec.gate.window(protocol)));
        }
        line(format_args!("start_count {} goals {}", spec.start_count, spec.gate.goals));
        for cause in spec.also_ends_on.iter() {
            line(format_args!("ends on {}", cause.name()));
        }
        let special = &spec.special;
        line(format_args!("drops below {:?}, parked {}", (special.fresh_drop_m)(&thresholds), special.bulbs_parked));
        line(format_args!("keeps {:?}, notes {}", special.keeps_seated, special.notes_working_height));
        for variant in [Variant::Benchmark, Variant::Training] {
            for term in rewards::specs(task, spec.also_ends_on, variant) {
                line(format_args!("{variant:?} {} {:?} {}", term.name, term.weight, term.kind.name()));
            }
        }
    }
    HEXLOWER.encode(&Sha256::digest(text))
}
