//! Assembles results from graded bags: sorts out which are scored, which are excluded, and which cannot share a table.

use std::collections::{BTreeMap, BTreeSet};

use fiatlux_proto::v3;
use fiatlux_rules::{Benchmark, Episode, Protocol, Rate, SeedScore, Spread, SubtaskScore, Summary, Task, manifest};

use crate::conditions::compared;
use crate::episode::GradedEpisode;
use crate::flaw::Flaw;
use crate::parts::summed;
use crate::results::{
    EpisodeRow, ExcludedBag, Fault, Overall, RESULTS_VERSION, RateRow, Results, RunFailure, Score, Scores, SeedRow,
    TaskResult, Versions,
};
use crate::run::{RunJournals, failed};
use crate::{Conditions, GradeOptions, ScoreError, Series};

/// A bag that was graded, or could not be.
#[derive(Debug)]
pub(crate) struct GradedBag {
    /// Path of the bag, relative to the folder of the results.
    pub bag: String,
    /// Header and verdicts, or the reason why the bag cannot be read.
    pub content: Result<BagContent, (Fault, String)>,
}

/// A bag that could be read, at least in part.
#[derive(Debug)]
pub(crate) struct BagContent {
    pub header: v3::EpisodeHeader,
    /// The fault of the file; `None` for a whole bag, whose rows can still have a [`GradedEpisode::flaw`].
    pub damage: Option<(Fault, String)>,
    pub graded: GradedEpisode,
}

/// A bag on its way into the tables.
struct TableEntry {
    bag: String,
    header: v3::EpisodeHeader,
    graded: GradedEpisode,
}

impl TableEntry {
    fn key(&self) -> (Task, u64, u64) {
        (self.graded.summary.task, self.header.seed, self.header.episode)
    }
}

/// Sorts loose bags, sets aside those that cannot be scored, and sums up the rest.
pub(crate) fn assemble(judged: Vec<GradedBag>, options: &GradeOptions) -> Result<Results, ScoreError> {
    let (mut entries, mut excluded) = (Vec::new(), Vec::new());
    for GradedBag { bag, content } in judged {
        match content {
            Err((reason, detail)) => excluded.push(excluded_bag(bag, reason, detail, None)),
            Ok(BagContent { header, damage, graded }) => match fault(damage, &graded) {
                Some((reason, detail)) => excluded.push(excluded_bag(bag, reason, detail, Some((&header, &graded)))),
                None => entries.push(TableEntry { bag, header, graded }),
            },
        }
    }
    sort(&mut entries);
    let entries = without_copies(entries, &mut excluded)?;
    roll_up(entries, excluded, None, options)
}

/// As [`assemble`], but for a run: takes the bags of the played episodes, each with the episode's index.
pub(crate) fn assemble_run(
    run: &RunJournals,
    judged: Vec<(usize, GradedBag)>,
    options: &GradeOptions,
) -> Result<Results, ScoreError> {
    let (mut entries, mut excluded, mut lost) = (Vec::new(), Vec::new(), BTreeMap::new());
    for (index, GradedBag { bag, content }) in judged {
        let ((reason, detail), content) = match content {
            Err(fault) => (fault, None),
            Ok(BagContent { header, damage, graded }) => {
                let altered = || run.disagreement(index, &header, &graded).map(|detail| (Fault::Altered, detail));
                match fault(damage, &graded).or_else(altered) {
                    Some(fault) => (fault, Some((header, graded))),
                    None => {
                        entries.push(TableEntry { bag, header, graded });
                        continue;
                    }
                }
            }
        };
        let content = content.as_ref().map(|(header, graded)| (header, graded));
        excluded.push(excluded_bag(bag, reason, detail.clone(), content));
        lost.insert(index, (reason, detail));
    }
    sort(&mut entries);
    let failures = run.failures(&lost);
    roll_up(entries, excluded, Some((run, failures)), options)
}

fn sort(entries: &mut [TableEntry]) {
    entries.sort_by(|a, b| a.key().cmp(&b.key()).then_with(|| a.bag.cmp(&b.bag)));
}

/// Sums up sorted entries and the failures of a run.
fn roll_up(
    entries: Vec<TableEntry>,
    mut excluded: Vec<ExcludedBag>,
    run: Option<(&RunJournals, Vec<RunFailure>)>,
    options: &GradeOptions,
) -> Result<Results, ScoreError> {
    check_conditions(&entries)?;
    excluded.sort_by(|a, b| a.bag.cmp(&b.bag));
    let failures: Vec<(Task, &RunFailure)> = run
        .iter()
        .flat_map(|(run, failures)| failures.iter().map(|failure| (run.episodes[failure.index as usize].task, failure)))
        .collect();
    let failed = || failures.iter().map(|(task, failure)| Episode { seed: failure.seed, summary: failed(*task) });

    let episode = |entry: &TableEntry, summary| Episode { seed: entry.header.seed, summary };
    let with_rows: Vec<Episode> = entries.iter().map(|entry| episode(entry, entry.graded.summary)).collect();
    let episodes: Vec<Episode> = with_rows.iter().copied().chain(failed()).collect();
    let conditions = match (entries.first(), &run) {
        (Some(entry), _) => {
            Conditions::new(&entry.header, &entry.graded.thresholds, &options.set, options.published_counting)
        }
        (None, Some((run, _))) => Conditions::unplayed(run.spec()),
        (None, None) => Conditions::default(),
    };
    let strict: Option<Vec<Episode>> =
        entries.iter().map(|entry| entry.graded.strict.map(|summary| episode(entry, summary))).collect();
    let is_strict = !entries.is_empty() || conditions.protocol == Protocol::Strict.name();
    let strict = strict.filter(|_| is_strict).map(|strict| strict.into_iter().chain(failed()).collect::<Vec<_>>());
    let seeds: BTreeSet<u64> = match &run {
        Some((run, _)) => run.seeds(),
        None => entries.iter().map(|entry| entry.header.seed).collect(),
    };
    let ticket = |entry: &TableEntry| Some(entry.header.run.as_ref()?.run.clone());
    let without_journal: BTreeSet<String> = match run {
        Some(_) => BTreeSet::new(),
        None => entries.iter().filter_map(ticket).filter(|run| !run.is_empty()).collect(),
    };
    let played = EpisodeSet {
        episodes: &episodes,
        strict: strict.as_deref(),
        with_rows: &with_rows,
        registered: run.is_some().then_some(&seeds),
    };
    let Scores { score, score_strict, subtasks, missing, overall, extra_tasks } =
        played.scores(|task| ends(task, &entries, &failures));
    let policy = entries.first().map(|entry| entry.header.policy.as_str());
    let policy = policy.or(run.as_ref().map(|(run, _)| run.policy())).unwrap_or_default().to_owned();
    let versions = versions(&entries);
    let episodes = rows(entries, &failures, strict.is_some());
    let results = Results {
        parts: summed(&policy, &episodes),
        policy,
        score,
        score_strict,
        subtasks,
        missing,
        overall,
        extra_tasks,
        excluded,
        conditions,
        versions,
        episodes,
        seeds: seeds.into_iter().collect(),
        run: None,
        without_journal: without_journal.into_iter().collect(),
    };
    drop(failures);
    Ok(Results { run: run.map(|(run, failures)| run.result(failures, options.folder())), ..results })
}

impl Scores {
    /// Scores of loose episodes by the published judge and, if there are verdicts of it, by the strict one. `ends`
    /// counts a task's episodes by the cause of their end.
    pub fn of(episodes: &[Episode], strict: Option<&[Episode]>, ends: impl Fn(Task) -> BTreeMap<String, u64>) -> Self {
        EpisodeSet { episodes, strict, with_rows: episodes, registered: None }.scores(ends)
    }
}

/// Episodes from which scores are made, by both judges.
struct EpisodeSet<'a> {
    /// By the published judge.
    episodes: &'a [Episode],
    strict: Option<&'a [Episode]>,
    /// Those with rows: a failure without rows has no length and no effort.
    with_rows: &'a [Episode],
    registered: Option<&'a BTreeSet<u64>>,
}

impl EpisodeSet<'_> {
    fn scores(&self, ends: impl Fn(Task) -> BTreeMap<String, u64>) -> Scores {
        let benchmark = Benchmark::of(self.episodes);
        let of = |score: &SubtaskScore| {
            let strict = self.strict.and_then(|episodes| SubtaskScore::of(score.task, episodes));
            let with_rows = SubtaskScore::of(score.task, self.with_rows);
            (score.task, task_result(score, strict.as_ref(), with_rows.as_ref(), ends(score.task)))
        };
        let (subtasks, extra_tasks): (Vec<_>, Vec<_>) =
            benchmark.subtasks.iter().map(of).partition(|(task, _)| Task::SUBTASKS.contains(task));
        let results = |tasks: Vec<(Task, TaskResult)>| tasks.into_iter().map(|(_, result)| result).collect();
        Scores {
            score: score(self.episodes, self.registered),
            score_strict: self.strict.map(|strict| score(strict, self.registered)),
            subtasks: results(subtasks),
            missing: benchmark.missing.iter().map(Task::to_string).collect(),
            overall: overall(self.episodes, self.strict),
            extra_tasks: results(extra_tasks),
        }
    }
}

/// Rows of all episodes, sorted by task, seed and index.
fn rows(entries: Vec<TableEntry>, failures: &[(Task, &RunFailure)], is_strict: bool) -> Vec<EpisodeRow> {
    let failed = failures.iter().map(|(task, failure)| ((*task, failure.seed, 0), failed_row(failure, is_strict)));
    let mut rows: Vec<_> = entries.into_iter().map(|entry| (entry.key(), episode_row(entry))).chain(failed).collect();
    rows.sort_by_key(|(key, _)| *key);
    rows.into_iter().map(|(_, row)| row).collect()
}

fn fault(damage: Option<(Fault, String)>, graded: &GradedEpisode) -> Option<(Fault, String)> {
    // An aborted episode's bag may be whole, and a cut bag has no result: the file's state comes first.
    if damage.is_some() {
        return damage;
    }
    let flaw = graded.flaw.as_ref()?;
    let reason = match flaw {
        Flaw::Aborted => Fault::Aborted,
        Flaw::Unended | Flaw::Gap(_) => Fault::Cut,
        Flaw::Header { .. }
        | Flaw::Identity { .. }
        | Flaw::Request(_)
        | Flaw::Unplayable(_)
        | Flaw::Signature
        | Flaw::Altered { .. }
        | Flaw::Result(_) => Fault::Altered,
        Flaw::Unbound | Flaw::Row { .. } | Flaw::NotFinite => Fault::Unreadable,
    };
    Some((reason, flaw.to_string()))
}

fn excluded_bag(
    bag: String,
    reason: Fault,
    detail: String,
    content: Option<(&v3::EpisodeHeader, &GradedEpisode)>,
) -> ExcludedBag {
    ExcludedBag {
        bag,
        reason,
        detail,
        task: content.map(|(_, graded)| graded.summary.task.to_string()),
        seed: content.map(|(header, _)| header.seed),
        episode: content.map(|(header, _)| header.episode),
        steps: content.map_or(0, |(_, graded)| graded.summary.steps),
        gate_progress: content.map_or(0.0, |(_, graded)| graded.summary.gate_progress),
    }
}

/// Keeps one bag for each episode. A copy with the same rows is listed as such. Two different recordings are an error:
/// the name of a file must not decide which one counts.
fn without_copies(entries: Vec<TableEntry>, excluded: &mut Vec<ExcludedBag>) -> Result<Vec<TableEntry>, ScoreError> {
    let mut kept: Vec<TableEntry> = Vec::with_capacity(entries.len());
    for entry in entries {
        match kept.last().filter(|last| last.key() == entry.key() && last.header.policy == entry.header.policy) {
            Some(first) if first.graded.digest == entry.graded.digest => {
                let detail = format!("has the rows of {}", first.bag);
                let content = Some((&entry.header, &entry.graded));
                excluded.push(excluded_bag(entry.bag.clone(), Fault::Duplicate, detail, content));
            }
            Some(first) => {
                return Err(ScoreError::Conflict {
                    task: entry.graded.summary.task.to_string(),
                    seed: entry.header.seed,
                    episode: entry.header.episode,
                    first_bag: first.bag.clone(),
                    second_bag: entry.bag,
                });
            }
            None => kept.push(entry),
        }
    }
    Ok(kept)
}

fn check_conditions(entries: &[TableEntry]) -> Result<(), ScoreError> {
    let Some(first) = entries.first() else { return Ok(()) };
    let expected = compared(&first.header);
    for entry in &entries[1..] {
        let found = compared(&entry.header);
        let names: BTreeSet<&String> = expected.iter().chain(&found).map(|(name, _)| name).collect();
        let value = |fields: &[(String, String)], name: &String| {
            fields.iter().find(|(field, _)| field == name).map_or("not given".to_owned(), |(_, value)| value.clone())
        };
        for name in names {
            let (first_value, second_value) = (value(&expected, name), value(&found, name));
            if first_value != second_value {
                return Err(ScoreError::Mixed {
                    field: name.clone(),
                    first: first_value,
                    first_bag: first.bag.clone(),
                    second: second_value,
                    second_bag: entry.bag.clone(),
                });
            }
        }
    }
    Ok(())
}

/// Score S of these episodes. In a run, whose seeds are known, all twelve subtasks count under each seed.
fn score(episodes: &[Episode], registered: Option<&BTreeSet<u64>>) -> Score {
    let weight_total: f64 = Task::SUBTASKS.into_iter().map(Task::weight).sum();
    let ran = Benchmark::of(episodes).per_seed;
    let per_seed: Vec<SeedScore> = match registered {
        None => ran,
        Some(seeds) => seeds.iter().map(|&seed| of_all(seed, &ran, weight_total)).collect(),
    };
    let ran_once = |task: &Task| registered.is_some() || per_seed.iter().any(|seed| !seed.missing.contains(task));
    let subtasks = Task::SUBTASKS.iter().filter(|task| ran_once(task)).count() as u64;
    let spread = Spread::of(&per_seed.iter().map(|seed| seed.score).collect::<Vec<_>>());
    let seed_row = |seed: &SeedScore| SeedRow {
        seed: seed.seed,
        score: seed.score,
        weight_covered: seed.weight_covered,
        weight_total,
        missing: seed.missing.iter().map(Task::to_string).collect(),
    };
    Score {
        mean: spread.map(|score| score.mean),
        std: spread.and_then(|score| score.std),
        subtasks,
        per_seed: per_seed.iter().map(seed_row).collect(),
    }
}

/// The score under a seed, with 0 for each missing subtask.
fn of_all(seed: u64, ran: &[SeedScore], weight_total: f64) -> SeedScore {
    let none = || SeedScore { seed, score: 0.0, weight_covered: 0.0, missing: Task::SUBTASKS.into() };
    let ran = ran.iter().find(|ran| ran.seed == seed).cloned().unwrap_or_else(none);
    match ran.missing.is_empty() {
        true => ran,
        false => SeedScore { score: ran.score * ran.weight_covered / weight_total, ..ran },
    }
}

fn ends(task: Task, entries: &[TableEntry], failures: &[(Task, &RunFailure)]) -> BTreeMap<String, u64> {
    let of_entries = entries.iter().filter(|entry| entry.graded.summary.task == task).map(|entry| &entry.graded.end);
    let of_failures = failures.iter().filter(|(other, _)| *other == task).map(|(_, failure)| &failure.cause);
    let mut ends = BTreeMap::new();
    of_entries.chain(of_failures).for_each(|end| *ends.entry(end.clone()).or_insert(0) += 1);
    ends
}

fn task_result(
    score: &SubtaskScore,
    strict: Option<&SubtaskScore>,
    with_rows: Option<&SubtaskScore>,
    ends: BTreeMap<String, u64>,
) -> TaskResult {
    let value = |rate: Rate| rate.value().unwrap_or_default();
    let interval = |rate: Rate| rate.interval().unwrap_or([0.0, 1.0]);
    TaskResult {
        id: score.task.to_string(),
        name: score.task.name().into(),
        weight: score.task.weight(),
        score_mean: score.score.mean,
        score_std: score.score.std,
        success_rate: value(score.success),
        clean_success_rate: value(score.clean_success),
        gate_progress: score.gate_progress,
        broken_rate: value(score.broken),
        dropped_rate: value(score.dropped),
        peak_hand_force_n: score.peak_hand_force_n,
        control_effort: with_rows.map_or(0.0, |with_rows| with_rows.control_effort),
        mean_steps: with_rows.map_or(0.0, |with_rows| with_rows.mean_steps),
        episodes: score.success.trials,
        episode_score: score.episode_score,
        success_interval: interval(score.success),
        clean_success_interval: interval(score.clean_success),
        broken_interval: interval(score.broken),
        dropped_interval: interval(score.dropped),
        ends,
        strict_score_mean: strict.map(|strict| strict.score.mean),
        strict_score_std: strict.and_then(|strict| strict.score.std),
        strict_success_rate: strict.map(|strict| value(strict.success)),
        strict_clean_success_rate: strict.map(|strict| value(strict.clean_success)),
        strict_progress: strict.map(|strict| strict.gate_progress),
        strict_success_interval: strict.map(|strict| interval(strict.success)),
        strict_clean_success_interval: strict.map(|strict| interval(strict.clean_success)),
    }
}

fn overall(episodes: &[Episode], strict: Option<&[Episode]>) -> Overall {
    let own = |episodes: &[Episode]| -> Vec<Summary> {
        episodes.iter().filter(|e| Task::SUBTASKS.contains(&e.summary.task)).map(|e| e.summary).collect()
    };
    let rate = |summaries: &[Summary], is: fn(&Summary) -> bool| {
        let rate = Rate::of(summaries.iter().map(is));
        RateRow { hits: rate.hits, rate: rate.value(), interval: rate.interval() }
    };
    let (published, strict) = (own(episodes), strict.map(own));
    Overall {
        episodes: published.len() as u64,
        clean_success: rate(&published, Summary::clean),
        success: rate(&published, |s| s.success),
        strict_success: strict.as_deref().map(|strict| rate(strict, |s| s.success)),
        strict_clean_success: strict.as_deref().map(|strict| rate(strict, Summary::clean)),
        broken: rate(&published, |s| s.broken),
        dropped: rate(&published, |s| s.dropped),
    }
}

fn episode_row(entry: TableEntry) -> EpisodeRow {
    let TableEntry { bag, header, graded } = entry;
    let (summary, strict) = (graded.summary, graded.strict);
    EpisodeRow {
        task: summary.task.to_string(),
        seed: header.seed,
        success: summary.success,
        clean: summary.clean(),
        broken: summary.broken,
        dropped: summary.dropped,
        gate_progress: summary.gate_progress,
        peak_hand_force_n: summary.peak_hand_force_n,
        control_effort: summary.control_effort,
        steps: summary.steps,
        end: graded.end,
        state_digest: graded.digest,
        rows_digest: graded.rows_digest,
        bag,
        failure: None,
        episode: header.episode,
        causes: graded.causes,
        strict_success: strict.map(|strict| strict.success),
        strict_clean: strict.map(|strict| strict.clean()),
        strict_progress: strict.map(|strict| strict.gate_progress),
        strict_end: strict.and_then(|strict| strict.end).map(|end| end.cause().name().into()),
        strict_steps: strict.map(|strict| strict.steps),
        steps_in_gate: graded.steps_in_gate,
        notes: graded.notes,
        signed_by: graded.signer.map(|key| key.to_string()),
        parts: graded.parts,
        series: graded.series,
    }
}

/// The row of a failure that has no bag.
fn failed_row(failure: &RunFailure, is_strict: bool) -> EpisodeRow {
    EpisodeRow {
        task: failure.task.clone(),
        seed: failure.seed,
        success: false,
        clean: false,
        broken: false,
        dropped: false,
        gate_progress: 0.0,
        peak_hand_force_n: 0.0,
        control_effort: 0.0,
        steps: 0,
        end: failure.cause.clone(),
        state_digest: String::new(),
        rows_digest: String::new(),
        bag: String::new(),
        failure: Some(failure.cause.clone()),
        episode: 0,
        causes: Vec::new(),
        strict_success: is_strict.then_some(false),
        strict_clean: is_strict.then_some(false),
        strict_progress: is_strict.then_some(0.0),
        strict_end: is_strict.then(|| failure.cause.clone()),
        strict_steps: is_strict.then_some(0),
        steps_in_gate: 0,
        notes: Some(failure.detail.clone()).filter(|detail| !detail.is_empty()).into_iter().collect(),
        signed_by: None,
        parts: Vec::new(),
        series: Series::default(),
    }
}

fn versions(entries: &[TableEntry]) -> Versions {
    let each = |value: fn(&v3::EpisodeHeader) -> String| {
        let values: BTreeSet<String> = entries.iter().map(|entry| value(&entry.header)).collect();
        values.into_iter().filter(|value| !value.is_empty()).collect()
    };
    Versions {
        results: RESULTS_VERSION,
        scorer: env!("CARGO_PKG_VERSION").into(),
        server: each(|header| header.version.clone()),
        protocol: each(|header| header.protocol.as_ref().map(ToString::to_string).unwrap_or_default()),
        random: each(|header| header.random.clone()),
        digest_layout: manifest().layout.clone(),
    }
}
