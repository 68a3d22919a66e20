//! The conditions of a run: what must be equal before two results stand in one table.

use std::collections::BTreeMap;

use fiatlux_proto::v1;
use fiatlux_rules::Thresholds;
use serde::{Deserialize, Serialize};

/// Conditions that all episodes of a table share.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Conditions {
    /// `lockstep` or `real time`.
    pub mode: String,
    /// Named set of gains.
    pub gains: String,
    /// Hands.
    pub hands: String,
    /// Noise of reset and of sensors.
    pub noise: bool,
    /// What ended the episodes, where that was the session's own choice; else empty, and it was the task's.
    pub end_on_overridden: Vec<String>,
    /// Whether thresholds, gains, noise and ends are those of the standard protocol. Other runs have no place in a
    /// ranking with it.
    pub standard: bool,
    /// What is not standard, in words.
    pub deviations: Vec<String>,
    /// Thresholds that this grading judged by.
    pub thresholds: BTreeMap<String, f64>,
    /// Those among them that this grading set in place of the recorded ones.
    pub thresholds_set: Vec<String>,
    /// Conjuncts were counted as in the published numbers.
    pub published_counting: bool,
    /// SHA-256 of the robot model, hexadecimal.
    pub model_digest: String,
    /// SHA-256 of the scene config, hexadecimal.
    pub scene_digest: String,
}

/// What is compared between bags, by name, as a person would write it.
pub(crate) fn compared(header: &v1::EpisodeHeader) -> Vec<(String, String)> {
    let end_on = if header.end_on_overridden { named_ends(&header.end_on) } else { "the task's own".into() };
    let mut fields: Vec<(String, String)> = [
        ("policy", quoted(&header.policy)),
        ("mode", mode(header).into()),
        ("gains", gains(header).into()),
        ("hands", hands(header).into()),
        ("noise", if header.no_noise { "off" } else { "on" }.into()),
        ("end_on", end_on),
        ("model_digest", quoted(&header.model_digest)),
        ("scene_digest", quoted(&header.scene_digest)),
    ]
    .map(|(name, value)| (name.into(), value))
    .into();
    let mut thresholds: Vec<_> = header.thresholds.iter().collect();
    thresholds.sort_by(|a, b| a.0.cmp(b.0));
    fields.extend(thresholds.into_iter().map(|(key, value)| (format!("threshold {key}"), value.to_string())));
    fields
}

impl Conditions {
    /// From the header of one of the episodes and the thresholds that it was graded by.
    pub(crate) fn new(header: &v1::EpisodeHeader, thresholds: &Thresholds, set: &[String], published: bool) -> Self {
        let thresholds_set: Vec<String> =
            set.iter().filter_map(|set| set.split_once('=')).map(|(k, _)| k.trim().into()).collect();
        let mut deviations = Vec::new();
        if mode(header) != "lockstep" {
            deviations.push(format!("mode is {}", mode(header)));
        }
        if gains(header) != "fiatlux" {
            deviations.push(format!("gains are {}", quoted(gains(header))));
        }
        if hands(header) != "inspire" {
            deviations.push(format!("hands are {}", quoted(hands(header))));
        }
        if header.no_noise {
            deviations.push("noise is off".into());
        }
        if header.end_on_overridden {
            deviations.push(format!("episodes ended on {}", named_ends(&header.end_on)));
        }
        let usual = Thresholds::default();
        for ((key, value), (_, usual)) in thresholds.entries().zip(usual.entries()) {
            if value != usual {
                deviations.push(format!("{key} is {value} instead of {usual}"));
            }
        }
        if published {
            deviations.push("conjuncts are counted as in the published numbers".into());
        }
        Self {
            mode: mode(header).into(),
            gains: gains(header).into(),
            hands: hands(header).into(),
            noise: !header.no_noise,
            end_on_overridden: if header.end_on_overridden { header.end_on.clone() } else { Vec::new() },
            standard: deviations.is_empty(),
            deviations,
            thresholds: thresholds.entries().map(|(key, value)| (key.into(), value)).collect(),
            thresholds_set,
            published_counting: published,
            model_digest: header.model_digest.clone(),
            scene_digest: header.scene_digest.clone(),
        }
    }
}

fn mode(header: &v1::EpisodeHeader) -> &'static str {
    match header.mode() {
        v1::Mode::RealTime => "real time",
        v1::Mode::Lockstep | v1::Mode::Unspecified => "lockstep",
    }
}

fn gains(header: &v1::EpisodeHeader) -> &str {
    if header.gains.is_empty() { "fiatlux" } else { &header.gains }
}

fn hands(header: &v1::EpisodeHeader) -> &str {
    if header.hands.is_empty() { "inspire" } else { &header.hands }
}

fn quoted(text: &str) -> String {
    format!("'{text}'")
}

fn named_ends(ends: &[String]) -> String {
    if ends.is_empty() { "nothing".into() } else { ends.join(", ") }
}
