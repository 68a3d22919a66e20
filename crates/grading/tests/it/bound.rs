//! Guards that a bag that was changed after recording is not scored.

use crate::common::{Folder, Story, begin, header, result, rows, sealed};
use fiatlux_access::{Identity, sign_result};
use fiatlux_bag::topic;
use fiatlux_grading::{ExcludedBag, Fault, GradeOptions, Results, grade, tables};
use fiatlux_proto::v3::{self, EpisodeHeader, EpisodeResult};
use fiatlux_proto::{Message, PROTOCOL};
use fiatlux_rules::{Row, Task};
use fiatlux_wire::header_digest;

/// An episode that succeeded, the same for every test.
fn episode() -> (EpisodeHeader, Vec<Row>, EpisodeResult) {
    let (header, rows) = (header(Task::S01, 3), rows(Task::S01, 3, Story::Succeeds(30)));
    let result = result(&header, &rows);
    (header, rows, result)
}

fn graded(folder: &Folder) -> Results {
    let options = GradeOptions { relative_to: folder.0.clone(), ..GradeOptions::default() };
    grade(std::slice::from_ref(&folder.0), &options, &|_| {}).expect("graded")
}

/// The reason why grading refuses a bag of these parts.
fn refusal(name: &str, header: &EpisodeHeader, rows: &[Row], result: &EpisodeResult) -> Option<ExcludedBag> {
    let folder = Folder::new(&format!("bound-{name}"));
    begin(&folder.0.join("a.mcap"), header, rows).finish(result).expect("finished");
    graded(&folder).excluded.pop()
}

fn detail(name: &str, header: &EpisodeHeader, rows: &[Row], result: &EpisodeResult) -> String {
    let refused = refusal(name, header, rows, result).unwrap_or_else(|| panic!("{name} is scored"));
    assert_eq!(refused.reason, Fault::Altered, "{name}: {}", refused.detail);
    refused.detail
}

type Change = fn(&mut EpisodeHeader);

/// Fields that rows depend on: the start of the digest chain covers them.
const OF_THE_EPISODE: [(&str, Change); 17] = [
    ("task", |header| {
        header.task = "S06".into();
        header.task_id = Task::S06.id().into();
    }),
    ("seed", |header| header.seed = 1),
    ("episode", |header| header.episode = 1),
    ("layout seed", |header| random(header).fixed_layout = true),
    ("start", |header| random(header).fixed_start = true),
    ("threshold", |header| {
        header.thresholds.insert("placement_m".into(), 0.9);
    }),
    ("protocol of the episode", |header| header.episode_protocol = "strict".into()),
    ("ends", |header| header.end_on.retain(|name| name != "fall")),
    ("model", |header| header.model_digest = "0".repeat(64)),
    ("scene", |header| header.scene_digest = "0".repeat(64)),
    ("stiffness", |header| header.drives[7].stiffness = 101.0),
    ("armature", |header| header.drives[0].armature = 0.5),
    ("rated speed", |header| header.drives[52].speed_limit = Some(20.0)),
    ("prop scale", |header| scale(header).socket = 1.01),
    ("friction", |header| {
        sample(header).hand_friction = Some(v3::HandFriction { dynamic_friction: 0.5, ..Default::default() });
    }),
    ("gravity", |header| {
        sample(header).varied.insert("gravity".into(), 9.7);
    }),
    ("generator", |header| header.random = "other/1".into()),
];

/// Fields that only inform the reader.
const OF_THE_RUN: [(&str, Change); 23] = [
    ("mode", |header| header.mode = v3::Mode::RealTime.into()),
    ("sensors", |header| header.sensors.push(v3::Sensor { name: "privileged".into(), ..Default::default() })),
    ("exact sensors", |header| random(header).exact_sensors = true),
    ("light", |header| sample(header).light = Some(v3::Light { dome: 7.0, ..Default::default() })),
    ("image", |header| header.image_width = 64),
    ("width of the noise", |header| {
        sample(header).varied.insert("noise".into(), 2.0);
    }),
    ("weights", |header| header.weights = "trained".into()),
    ("meshes", |header| header.meshes = "meshes:0".into()),
    ("policy", |header| header.policy = "best".into()),
    ("server", |header| header.server = "official".into()),
    ("session", |header| header.session = "8".into()),
    ("version", |header| header.version = "9.9".into()),
    ("request", |header| header.request = Some(v3::OpenRequest { recorded: true, ..Default::default() })),
    ("robot", |header| header.robot = "g1_bare".into()),
    ("gains", |header| header.gains = "stiff".into()),
    ("task id", |header| header.task_id = Task::S02.id().into()),
    ("reward", |header| header.reward = "training".into()),
    ("geometry", |header| header.geometry.as_mut().expect("a geometry").ladder_top[2] = 0.5),
    ("joint", |header| header.joint_names.swap(3, 4)),
    ("body", |header| header.hand_bodies.swap(3, 4)),
    ("benchmark", |header| header.benchmark_version -= 1),
    ("own ends", |header| header.end_on_overridden = true),
    ("older protocol", |header| header.protocol = Some(v3::Version { minor: PROTOCOL.minor - 1, ..PROTOCOL })),
];

fn random(header: &mut EpisodeHeader) -> &mut v3::Randomization {
    header.randomization.get_or_insert_default()
}

fn sample(header: &mut EpisodeHeader) -> &mut v3::DomainSample {
    header.domain_sample.get_or_insert_default()
}

fn scale(header: &mut EpisodeHeader) -> &mut v3::PropScale {
    sample(header).prop_scale.get_or_insert_default()
}

#[test]
fn what_was_recorded_is_scored() {
    let (header, rows, result) = episode();
    assert_eq!(refusal("as-it-was", &header, &rows, &result), None);
}

/// Guards a changed header, also one whose digests were partly recomputed.
#[test]
fn a_header_that_was_changed_is_refused() {
    let (header, rows, result) = episode();
    for (name, change) in OF_THE_EPISODE.into_iter().chain(OF_THE_RUN) {
        let mut changed = header.clone();
        change(&mut changed);
        assert_ne!(changed, header, "{name}");
        assert!(detail(name, &changed, &rows, &result).contains("header was changed"), "{name}");
    }
    for (name, change) in OF_THE_EPISODE {
        let mut changed = header.clone();
        change(&mut changed);
        // With a fitting header_digest, the start of the chain still does not fit.
        let fitting = EpisodeResult { header_digest: header_digest(&changed), ..result.clone() };
        assert!(detail(name, &changed, &rows, &fitting).contains("make digest_context"), "{name}");
        // With a fitting start as well, the rows do not.
        let changed = sealed(changed);
        let fitting = EpisodeResult { header_digest: header_digest(&changed), ..result.clone() };
        let detail = detail(name, &changed, &rows, &fitting);
        assert!(detail.contains("numbers were changed"), "{name}: {detail}");
    }
}

/// Guards against a bag whose second run, which its request opens, would be of another episode than its header shows.
#[test]
fn a_request_that_contradicts_its_header_is_refused() {
    let (header, rows, _) = episode();
    let request = v3::OpenRequest {
        policy: header.policy.clone(),
        task: header.task.clone(),
        seed: header.seed,
        episode_protocol: header.episode_protocol.clone(),
        ..v3::OpenRequest::default()
    };
    let with = |request| {
        let header = EpisodeHeader { request: Some(request), image_width: 256, image_height: 256, ..header.clone() };
        refusal("request", &header, &rows, &result(&header, &rows)).map(|bag| bag.detail)
    };
    assert_eq!(with(request.clone()), None);
    let detail = with(v3::OpenRequest { seed: 99, ..request }).expect("refused");
    let seed = header.seed;
    assert_eq!(
        detail,
        format!("the bag's header contradicts itself: seed is 99 by the request in it, and {seed} in the header")
    );
}

/// Guards that neither an older nor a later protocol version bypasses the check.
#[test]
fn a_bag_that_binds_nothing_is_refused() {
    let (header, rows, result) = episode();
    let unbound = EpisodeResult { header_digest: String::new(), ..result.clone() };
    for minor in [0, PROTOCOL.minor - 1, PROTOCOL.minor] {
        let header = EpisodeHeader { protocol: Some(v3::Version { minor, ..PROTOCOL }), ..header.clone() };
        let refused = refusal("unbound", &header, &rows, &unbound).expect("refused");
        assert_eq!(refused.reason, Fault::Unreadable);
        assert!(refused.detail.contains("no header_digest"), "{}", refused.detail);
    }
    let newer = v3::Version { minor: PROTOCOL.minor + 1, ..PROTOCOL };
    let header = EpisodeHeader { protocol: Some(newer), ..header };
    let refused = refusal("newer", &header, &rows, &result).expect("refused");
    assert_eq!(refused.reason, Fault::Unreadable);
    assert!(
        refused.detail.contains(&format!("protocol {newer}, this scorer reads up to {PROTOCOL}")),
        "{}",
        refused.detail
    );
}

/// Guards that every number of a result that the rows determine is compared; the first that differs is named with both
/// values.
#[test]
fn a_result_that_was_changed_is_refused() {
    type Change = fn(&mut EpisodeResult);
    fn end(result: &mut EpisodeResult) -> &mut v3::EpisodeEnd {
        result.end.as_mut().expect("an end")
    }
    fn judged(result: &mut EpisodeResult) -> &mut v3::Judgement {
        result.published.as_mut().expect("a judgement")
    }
    let changes: [(&str, Change); 25] = [
        ("end.success is true by its rows, its result says false", |r| end(r).success = false),
        ("end.cause is success by its rows, its result says fall", |r| end(r).cause = "fall".into()),
        ("end.causes[0] is success by its rows, its result says tip", |r| end(r).causes = vec!["tip".into()]),
        ("end.gate_progress is 1.0 by its rows, its result says 0.5", |r| end(r).gate_progress = 0.5),
        ("end.broken", |r| end(r).broken = true),
        ("end.dropped", |r| end(r).dropped = true),
        ("published.success", |r| judged(r).success = false),
        ("published.cause", |r| judged(r).cause = "fall".into()),
        ("published.causes", |r| judged(r).causes.push("fall".into())),
        ("published.steps", |r| judged(r).steps += 1),
        ("published.broken", |r| judged(r).broken = true),
        ("published.dropped", |r| judged(r).dropped = true),
        ("published.gate_progress", |r| judged(r).gate_progress = 0.1),
        ("published.peak_hand_force_n", |r| judged(r).peak_hand_force_n += 1.0),
        ("published.control_effort", |r| judged(r).control_effort *= 0.999),
        ("published.start_count", |r| judged(r).start_count += 1),
        ("published.best_count", |r| judged(r).best_count += 1),
        ("published.leapt", |r| judged(r).leapt = true),
        ("published is {", |r| r.published = None),
        ("strict is nothing by its rows", |r| r.strict = r.published.clone()),
        ("unconverged is 0 by its rows, its result says 2", |r| r.unconverged = 2),
        ("steps_outside_box is 0 by its rows, its result says 3", |r| r.steps_outside_box = 3),
        ("missed_steps is 0 by its rows, its result says 4", |r| r.missed_steps = 4),
        ("total_reward", |r| r.total_reward += 1e-9),
        ("numbers were changed", |r| end(r).digest = "0".repeat(64)),
    ];
    let (header, rows, result) = episode();
    for (expected, change) in changes {
        let mut changed = result.clone();
        change(&mut changed);
        let detail = detail("result", &header, &rows, &changed);
        assert!(detail.contains(expected), "{expected}: {detail}");
    }
}

/// Guards against a failure that poses as a success by another bag's result, by fewer rows, or by repeated rows.
#[test]
fn rows_and_results_of_different_bags_do_not_mix() {
    let (header_a, rows_a, result_a) = episode();
    let (header_b, rows_b) = (header(Task::S01, 4), rows(Task::S01, 4, Story::Falls(60)));
    let result_b = result(&header_b, &rows_b);
    assert!(detail("swapped", &header_b, &rows_b, &result_a).contains("header was changed"));
    let bound = EpisodeResult { header_digest: header_digest(&header_b), ..result_a.clone() };
    let refused = refusal("bound", &header_b, &rows_b, &bound).expect("refused");
    assert_eq!(refused.reason, Fault::Cut, "{}", refused.detail);
    assert!(detail("other-rows", &header_b, &rows_a, &bound).contains("numbers were changed"));

    // The fall is left out.
    let fewer = &rows_b[..rows_b.len() - 5];
    let refused = refusal("fewer", &header_b, fewer, &result_b).expect("refused");
    assert!(refused.reason == Fault::Cut && refused.detail.contains("found 56 rows"), "{}", refused.detail);
    let mut shorter = result_b.clone();
    shorter.end.as_mut().expect("an end").steps -= 5;
    assert!(detail("shorter", &header_b, fewer, &shorter).contains("numbers were changed"));
    let mut twice = rows_a.clone();
    twice.insert(9, twice[8].clone());
    let refused = refusal("twice", &header_a, &twice, &result_a).expect("refused");
    assert!(refused.detail.contains("row 8 follows row 8"), "{}", refused.detail);

    // A reader of /result would take the first, and a reader of the metadata the last.
    let folder = Folder::new("bound-results");
    let mut writer = begin(&folder.0.join("a.mcap"), &header_a, &rows_a);
    writer.message(topic::RESULT, 7, &result_b.encode_to_vec()).expect("a message");
    writer.finish(&result_a).expect("finished");
    let refused = graded(&folder).excluded.remove(0);
    assert!(refused.detail.contains("2 messages on /result in place of one"), "{}", refused.detail);
}

/// Guards that a signature can be neither changed nor copied, and that the scores name the signer.
#[test]
fn signatures_fit_one_result() {
    let (header_a, rows_a, mut result_a) = episode();
    let server = Identity::generate().expect("an identity");
    sign_result(&server, &mut result_a);
    let folder = Folder::new("bound-signed");
    begin(&folder.0.join("a.mcap"), &header_a, &rows_a).finish(&result_a).expect("finished");
    assert_eq!(graded(&folder).episodes[0].signed_by, Some(server.public().to_string()));

    let (header_b, rows_b) = (header(Task::S01, 4), rows(Task::S01, 4, Story::Succeeds(30)));
    let copied = EpisodeResult { signature: result_a.signature.clone(), ..result(&header_b, &rows_b) };
    assert!(detail("copied", &header_b, &rows_b, &copied).contains("signature does not fit"));
    let mut other = result_a.clone();
    other.signature.as_mut().expect("signed").key = Identity::generate().expect("drawn").public().as_bytes().to_vec();
    assert!(detail("other-key", &header_a, &rows_a, &other).contains("signature does not fit"));
    // Without the signature the result names no server.
    let bare = EpisodeResult { signature: None, ..result_a };
    assert_eq!(refusal("bare", &header_a, &rows_a, &bare), None);
}

/// Guards that a number that is not finite is named with its row: servers never record one, and the bag is not cut.
#[test]
fn a_row_that_is_not_finite_is_named() {
    let (header, mut rows, result) = episode();
    rows[7].joint_position[3] = f64::NAN;
    let refused = refusal("nan", &header, &rows, &result).expect("refused");
    assert_eq!(refused.reason, Fault::Unreadable);
    assert_eq!(refused.detail, "row 7 cannot be judged: joint_position has a number that is not finite");
    assert_eq!(refused.steps, 6);
}

/// The text table names the fault as well.
#[test]
fn a_changed_bag_shows_in_the_table() {
    let (header, rows, result) = episode();
    let mut changed = header.clone();
    (OF_THE_EPISODE[0].1)(&mut changed);
    let folder = Folder::new("bound-shown");
    begin(&folder.0.join("a.mcap"), &changed, &rows).finish(&result).expect("finished");
    let results = graded(&folder);
    assert!(results.episodes.is_empty() && results.has_data_loss());
    assert!(tables::text(&results).contains("altered"), "{}", tables::text(&results));
}
