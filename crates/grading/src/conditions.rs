//! The conditions of a run, which must be equal before two results share a table.

mod deviations;
mod recorded;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use fiatlux_proto::v3;
use fiatlux_rules::Thresholds;
use serde::{Deserialize, Serialize};

use self::recorded::*;
pub(crate) use self::recorded::{described, is_person, is_take};

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
        let deviations = deviations::of(header, thresholds, published);
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
            assets: assets(header),
            relay: relay(header),
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
