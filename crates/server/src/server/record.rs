//! The records of an episode: its header, its rows with their events, and its result.

use fiatlux_proto::encode;
use fiatlux_proto::v3::{
    ActionRecord, EpisodeEnd, EpisodeHeader, EpisodeResult, Event, Reward, RewardTerm, StepRecord,
};
use fiatlux_rules::{Criteria, Protocol, manifest};
use fiatlux_wire::{end_message, header_digest, judgement_message, state_message};
use fiatlux_world::Episode;

/// Encoded sensor data of a row; empty where the bag is not to have it.
#[derive(Debug, Default)]
pub(super) struct SensorData {
    pub observation: Vec<u8>,
    pub camera: Vec<u8>,
    pub lidar: Vec<u8>,
}

/// Turns the rows of one episode into records.
#[derive(Debug)]
pub(super) struct Record {
    header_digest: String,
    criteria: Criteria,
    seated: Vec<bool>,
}

fn event(step: u64, kind: &str, subject: &str, change: &str, detail: String) -> Event {
    Event { step, kind: kind.into(), subject: subject.into(), change: change.into(), detail }
}

impl Record {
    /// Row 0, with everything besides the rows that a reader must know.
    pub fn start(episode: &Episode, header: EpisodeHeader, scene: Vec<u8>, seen: SensorData) -> (Self, StepRecord) {
        let row = episode.row();
        let criteria = episode.verdict().criteria;
        let held = named(episode, &criteria);
        let held: Vec<&str> = held.filter(|(_, holds)| *holds).map(|(name, _)| name).collect();
        let start = event(row.step, "start", &header.task, "", format!("holds: {}", held.join(", ")));
        let header_digest = header_digest(&header);
        let record = Self {
            header_digest,
            criteria,
            seated: row.attachments.iter().map(|attachment| attachment.seated).collect(),
        };
        let first = StepRecord {
            episode: header.episode,
            step: row.step,
            header: Some(header),
            state: encode(&state_message(row)),
            observation: seen.observation,
            camera: seen.camera,
            lidar: seen.lidar,
            events: vec![encode(&start)],
            scene,
            ..StepRecord::default()
        };
        (record, first)
    }

    /// The row after a step, with the result if it is the last one.
    pub fn row(&mut self, episode: &Episode, action: &ActionRecord, seen: SensorData) -> StepRecord {
        let row = episode.row();
        let mut encoded = Vec::new();
        self.note_changes(episode, |event| encoded.push(encode(&event)));
        let result = end(episode).map(|end| {
            let (cause, detail) = (&end.cause, end.causes.join(", "));
            let change = if episode.end().is_some_and(|end| end.is_truncated()) { "truncated" } else { "terminated" };
            encoded.push(encode(&event(row.step, "end", cause, change, detail)));
            result(episode, end, self.header_digest.clone())
        });
        StepRecord {
            episode: episode.spec().episode,
            step: row.step,
            state: encode(&state_message(row)),
            action: encode(action),
            observation: seen.observation,
            camera: seen.camera,
            lidar: seen.lidar,
            reward: encode(&reward(episode)),
            events: encoded,
            result,
            ..StepRecord::default()
        }
    }

    fn note_changes(&mut self, episode: &Episode, mut out: impl FnMut(Event)) {
        let row = episode.row();
        let criteria = episode.verdict().criteria;
        if criteria != self.criteria {
            for ((name, holds), before) in named(episode, &criteria).zip(self.criteria.as_slice()) {
                if holds != *before {
                    let change = if holds { "holds" } else { "fails" };
                    out(event(row.step, "criterion", name, change, String::new()));
                }
            }
            self.criteria = criteria;
        }
        for ((thing, attachment), before) in manifest().held_by_socket().zip(&row.attachments).zip(&mut self.seated) {
            let seated = attachment.seated;
            if std::mem::replace(before, seated) != seated {
                let change = if seated { "seated" } else { "released" };
                out(event(row.step, "attachment", &manifest().things[thing].name, change, String::new()));
            }
        }
        for cause in episode.newly_met() {
            out(event(row.step, "condition", cause.name(), "met", String::new()));
        }
    }
}

/// The result of an episode that was cut short.
pub(super) fn cut_short(episode: &Episode, cause: &str, record: Option<&Record>) -> EpisodeResult {
    let header_digest = record.map(|record| record.header_digest.clone()).unwrap_or_default();
    result(episode, ended(episode, cause, Vec::new()), header_digest)
}

/// The end of an episode; `None` while it runs.
pub(super) fn end(episode: &Episode) -> Option<EpisodeEnd> {
    let end = episode.end()?;
    Some(ended(episode, end.cause().name(), end.causes.iter().map(|cause| cause.name().to_owned()).collect()))
}

fn ended(episode: &Episode, cause: &str, causes: Vec<String>) -> EpisodeEnd {
    end_message(&episode.summary(), cause, causes, episode.digest().hex())
}

fn named<'a>(episode: &Episode, criteria: &'a Criteria) -> impl Iterator<Item = (&'static str, bool)> + use<'a> {
    let judge = episode.judge();
    let names = judge.task().spec().gate.criteria_of(judge.protocol()).map(|criterion| criterion.name);
    names.zip(criteria.as_slice().iter().copied())
}

fn reward(episode: &Episode) -> Reward {
    let verdict = episode.verdict();
    let terms = episode.terms().iter().map(|term| RewardTerm {
        name: term.name.into(),
        value: term.value,
        weight: term.weight,
        reward: term.reward,
    });
    Reward {
        step: episode.row().step,
        terms: terms.collect(),
        total: episode.reward(),
        criteria: verdict.criteria.as_slice().to_vec(),
        gate_progress: verdict.progress,
    }
}

fn result(episode: &Episode, end: EpisodeEnd, header_digest: String) -> EpisodeResult {
    let (judges, totals) = (episode.judges(), episode.totals());
    let strict = (judges.protocol() == Protocol::Strict).then(|| judgement_message(judges.of(Protocol::Strict)));
    EpisodeResult {
        end: Some(end),
        unconverged: totals.unconverged,
        steps_outside_box: totals.steps_outside_box,
        missed_steps: 0,
        total_reward: totals.reward,
        published: Some(judgement_message(judges.of(Protocol::Published))),
        strict,
        header_digest,
        signature: None,
    }
}
