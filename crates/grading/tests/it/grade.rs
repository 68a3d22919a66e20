//! Grades bags on disk from end to end.

use crate::common::room::{OLD, take};
use crate::common::{Folder, Story, begin, header, result, rows, sealed, write};
use fiatlux_bag::{BagError, Unsimulated, convert, simulate_with};
use fiatlux_grading::{Fault, GradeOptions, Grader, Results, ScoreError, grade, report, tables};
use fiatlux_proto::{PROTOCOL, STOPPED, v3};
use fiatlux_rules::{BENCHMARK_VERSION, Task};

fn grade_in(folder: &Folder, options: GradeOptions) -> Result<Results, ScoreError> {
    grade(std::slice::from_ref(&folder.0), &GradeOptions { relative_to: folder.0.clone(), ..options }, &|_| {})
}

fn graded(folder: &Folder) -> Results {
    grade_in(folder, GradeOptions::default()).expect("graded")
}

fn bag(folder: &Folder, name: &str) -> std::path::PathBuf {
    folder.0.join(format!("{name}.mcap"))
}

/// S = (2.25 x 1 + 3 x 0) / 5.25 under seed 0, and 0 under seed 1, which has S01 alone.
#[test]
fn scores_are_those_of_the_rows() {
    let folder = Folder::new("scores");
    write(&bag(&folder, "a"), Task::S01, 0, Story::Succeeds(30));
    write(&bag(&folder, "b"), Task::S01, 1, Story::Falls(20));
    write(&bag(&folder, "c"), Task::S02, 0, Story::Falls(10));
    write(&bag(&folder, "d"), Task::Climb, 0, Story::Succeeds(5));
    let results = graded(&folder);
    let scores: Vec<_> = results.score.per_seed.iter().map(|seed| seed.score).collect();
    assert_eq!(scores, [2.25 / 5.25, 0.0]);
    assert_eq!(results.subtasks.iter().map(|task| task.id.as_str()).collect::<Vec<_>>(), ["S01", "S02"]);
    assert_eq!(results.extra_tasks[0].id, "climb");
    assert_eq!((results.overall.episodes, results.overall.clean_success.hits), (3, 1));
    assert_eq!(results.missing.len(), 11);
    let episodes: Vec<_> = results.episodes.iter().map(|e| (e.bag.as_str(), e.end.as_str(), e.steps)).collect();
    let expected =
        [("a.mcap", "success", 79), ("b.mcap", "fall", 20), ("c.mcap", "fall", 10), ("d.mcap", "success", 5)];
    assert_eq!(episodes, expected);
    assert!(results.excluded.is_empty() && !results.has_data_loss() && results.conditions.ranked);
    let back: Results = serde_json::from_str(&results.to_json().expect("JSON")).expect("reads back");
    assert_eq!(back.overall, results.overall);
}

/// Guards bags against the machine: without room for simulated rows nothing is graded, and none is called unreadable.
#[test]
fn a_machine_without_room_for_rows_grades_nothing() {
    simulate_with(|_, _, _| Err(Unsimulated::NoRoom("No space left on device".into())));
    let folder = Folder::new("room");
    write(&bag(&folder, "a"), Task::S01, 0, Story::Falls(20));
    write(&bag(&folder, "b"), Task::S01, 1, Story::Falls(20));
    assert!(convert(&bag(&folder, "b"), true).expect("thin"));
    let error = grade_in(&folder, GradeOptions::default()).expect_err("no room");
    assert!(matches!(&error, ScoreError::Machine(BagError::NoRoom { .. })), "{error}");
}

/// Guards that the number of threads does not matter.
#[test]
fn the_same_bags_give_the_same_bytes() {
    let folder = Folder::new("bytes");
    for seed in 0..6 {
        write(&bag(&folder, &format!("x{seed}")), Task::S03, seed, Story::Falls(20 + 10 * seed));
    }
    let all = |workers| {
        let results = grade_in(&folder, GradeOptions { workers, ..GradeOptions::default() }).expect("graded");
        let tables = [tables::text(&results), tables::csv(&results), tables::latex(&results), report::html(&results)];
        (results.to_json().expect("JSON"), tables)
    };
    assert_eq!(all(1), all(4));
}

#[test]
fn what_cannot_count_is_listed_with_its_reason() {
    let folder = Folder::new("excluded");
    write(&bag(&folder, "good"), Task::S03, 0, Story::Falls(30));
    std::fs::copy(bag(&folder, "good"), bag(&folder, "later")).expect("copied");
    let (head, all) = (header(Task::S03, 1), rows(Task::S03, 1, Story::Falls(30)));
    begin(&bag(&folder, "cut"), &head, &all[..20]).finish_cut("the link was lost").expect("finished");
    let mut changed = all.clone();
    changed[7].joint_position[3] += 1e-15;
    begin(&bag(&folder, "altered"), &head, &changed).finish(&result(&head, &all)).expect("finished");
    let gap: Vec<_> = all.iter().filter(|row| row.step != 9).cloned().collect();
    begin(&bag(&folder, "gap"), &head, &gap).finish(&result(&head, &all)).expect("finished");
    begin(&bag(&folder, "aborted"), &head, &all[..20]).finish(&result(&head, &all[..20])).expect("finished");
    std::fs::write(bag(&folder, "text"), "no bag").expect("written");
    std::fs::write(folder.0.join("late.mcap.part"), "").expect("written");
    let results = graded(&folder);
    let found: Vec<_> = results.excluded.iter().map(|bag| (bag.bag.as_str(), bag.reason)).collect();
    let expected = [
        ("aborted.mcap", Fault::Aborted),
        ("altered.mcap", Fault::Altered),
        ("cut.mcap", Fault::Cut),
        ("gap.mcap", Fault::Cut),
        ("late.mcap.part", Fault::Unfinished),
        ("later.mcap", Fault::Duplicate),
        ("text.mcap", Fault::Unreadable),
    ];
    assert_eq!(found, expected);
    for bag in &results.excluded {
        assert!(!bag.detail.starts_with(bag.reason.name()), "said twice: {}: {}", bag.reason.name(), bag.detail);
    }
    assert_eq!((results.episodes.len(), results.has_data_loss()), (1, true));
    let text = tables::text(&results);
    assert!(text.contains("the bag's numbers were changed") && text.contains("the link was lost"), "{text}");
    assert!(!text.contains(&folder.0.display().to_string()), "{text}");
}

#[test]
fn what_does_not_go_together_is_an_error() {
    let folder = Folder::new("mixed");
    write(&bag(&folder, "a"), Task::S03, 0, Story::Falls(30));
    let all = rows(Task::S03, 1, Story::Falls(30));
    let mut head = header(Task::S03, 1);
    head.thresholds.insert("fragility_n".into(), 30.0);
    let head = sealed(head);
    begin(&bag(&folder, "b"), &head, &all).finish(&result(&head, &all)).expect("finished");
    let error = grade_in(&folder, GradeOptions::default()).expect_err("mixed").to_string();
    assert!(error.contains("threshold fragility_n is 50 in a.mcap and 30 in b.mcap"), "{error}");

    let folder = Folder::new("conflict");
    write(&bag(&folder, "a"), Task::S03, 0, Story::Falls(30));
    write(&bag(&folder, "b"), Task::S03, 0, Story::Falls(40));
    let error = grade_in(&folder, GradeOptions::default()).expect_err("conflict").to_string();
    assert!(error.contains("two different recordings of S03, seed 0, episode 0"), "{error}");

    let options = GradeOptions { set: vec!["fragility=3".into()], ..GradeOptions::default() };
    assert!(matches!(grade_in(&folder, options), Err(ScoreError::Threshold(_))));
}

/// Guards that another version of rooms, physics or rules is another benchmark.
#[test]
fn benchmark_versions_do_not_share_a_table() {
    let folder = Folder::new("benchmarks");
    write(&bag(&folder, "a"), Task::S03, 0, Story::Falls(30));
    let all = rows(Task::S03, 1, Story::Falls(30));
    let (this, another) = (BENCHMARK_VERSION, BENCHMARK_VERSION + 1);
    let head = v3::EpisodeHeader { benchmark_version: another, ..header(Task::S03, 1) };
    begin(&bag(&folder, "b"), &head, &all).finish(&result(&head, &all)).expect("finished");
    let error = grade_in(&folder, GradeOptions::default()).expect_err("mixed").to_string();
    let expected = format!("benchmark_version is {this} in a.mcap and {another} in b.mcap; grade them apart");
    assert!(error.contains(&expected), "{error}");

    std::fs::remove_file(bag(&folder, "a")).expect("removed");
    let other = graded(&folder);
    assert_eq!((other.conditions.benchmark_version, other.conditions.ranked), (another, false));
    let written = [tables::text(&other), tables::latex(&other), other.to_json().expect("JSON")];
    for text in &written {
        // The text table wraps its lines.
        let words: Vec<&str> = text.split_whitespace().collect();
        let said = format!("the rules are those of benchmark version {this}, the episodes of {another}");
        assert!(words.join(" ").contains(&said), "{text}");
    }
    assert!(report::html(&other).contains(&format!("Benchmark version {another}, published protocol, public seeds")));
    assert!(tables::csv(&other).lines().nth(1).is_some_and(|line| line.contains(&format!(".mcap,{another},"))));
}

/// Rows of the benchmark's first version lack the speeds of joints: only its own scorer grades them.
#[test]
fn bags_of_another_row_layout_are_refused_with_the_remedy() {
    let folder = Folder::new("layouts");
    let all = rows(Task::S03, 0, Story::Falls(30));
    let head =
        v3::EpisodeHeader { benchmark_version: 1, digest_layout: "fiatlux-row/2".into(), ..header(Task::S03, 0) };
    begin(&bag(&folder, "old"), &head, &all).finish(&result(&head, &all)).expect("finished");
    let results = graded(&folder);
    assert!(results.episodes.is_empty() && results.has_data_loss());
    assert_eq!(results.excluded[0].reason, Fault::Unreadable);
    let detail = &results.excluded[0].detail;
    assert!(detail.contains("layout fiatlux-row/2, this scorer knows fiatlux-row/5"), "{detail}");
}

/// Guards that an episode that diverged has a whole bag, and fails in every table, whatever its gate says.
#[test]
fn an_episode_that_diverged_is_graded_as_a_failure() {
    let folder = Folder::new("diverged");
    let (head, mut all) = (header(Task::S02, 0), rows(Task::S02, 0, Story::Succeeds(30)));
    all.last_mut().expect("rows").joint_speed_peak = f64::INFINITY;
    begin(&bag(&folder, "a"), &head, &all).finish(&result(&head, &all)).expect("finished");
    let results = graded(&folder);
    assert!(results.excluded.is_empty(), "{:?}", results.excluded);
    let episode = &results.episodes[0];
    assert_eq!((episode.end.as_str(), episode.success, episode.clean), ("diverged", false, false));
    assert_eq!((episode.causes.as_slice(), episode.gate_progress), (["diverged".to_owned()].as_slice(), 0.0));
    assert!(episode.notes.is_empty(), "{:?}", episode.notes);
    assert!(tables::text(&results).contains("diverged 1"));
    let page = report::html(&results);
    assert!(page.contains("b-diverged\">diverged") && page.contains(".b-diverged {") && page.contains(".f-diverged {"));
}

/// Guards that the page says how to view an episode, and links to a replay next to its bag.
#[test]
fn a_page_leads_to_replays() {
    let folder = Folder::new("replays");
    let (head, all) = (header(Task::S02, 0), rows(Task::S02, 0, Story::Succeeds(30)));
    begin(&bag(&folder, "a b"), &head, &all).finish(&result(&head, &all)).expect("finished");
    let results = graded(&folder);
    let page = report::html(&results);
    assert!(page.contains("fiatlux view &#39;a b.mcap&#39;") && !page.contains("3D replay"));
    assert_eq!(report::html_in(&results, &folder.0), page);
    std::fs::write(folder.0.join("a b.html"), "a replay").expect("written");
    assert!(report::html_in(&results, &folder.0).contains("<a href=\"a%20b.html\">3D replay</a>"));
}

/// Guards a page that shows and not only tells: a still for each episode that has one, a click away from its replay, in the page itself.
#[test]
fn a_page_has_stills_that_lead_to_replays() {
    let folder = Folder::new("stills");
    for seed in [0, 1, 2] {
        let (head, all) = (header(Task::S02, seed), rows(Task::S02, seed, Story::Succeeds(30)));
        begin(&bag(&folder, &format!("s{seed}")), &head, &all).finish(&result(&head, &all)).expect("finished");
    }
    let results = graded(&folder);
    assert!(!report::html_in(&results, &folder.0).contains("<img"));
    let replays = folder.0.join(report::REPLAYS);
    std::fs::create_dir(&replays).expect("a folder");
    for (name, content) in [("s0.png", b"\x89PNG" as &[u8]), ("s0.html", b"a replay"), ("s1.png", b"<script>")] {
        std::fs::write(replays.join(name), content).expect("written");
    }
    let page = report::html_in(&results, &folder.0);
    let still = "<a class=\"still\" href=\"replays/s0.html\"><img src=\"data:image/png;base64,iVBORw==\"";
    assert!(page.contains(still) && page.contains("<a href=\"replays/s0.html\">3D replay</a>"), "{page}");
    assert_eq!(page.matches("<img").count(), 1, "what is no picture is left out");
    assert!(page.contains("1 of 3 episodes have a replay here; <code>fiatlux view BAG</code>"), "{page}");
}

/// Guards that a bag of an earlier protocol is refused by its version, not for its missing fields.
#[test]
fn bags_of_older_protocols_are_refused_with_the_remedy() {
    let folder = Folder::new("protocols");
    let all = rows(Task::S03, 0, Story::Falls(30));
    for protocol in [Some(v3::Version { major: 2, minor: 7 }), None] {
        let head = v3::EpisodeHeader { protocol, geometry: None, ..header(Task::S03, 0) };
        let error = Grader::new(&head, &[], false).expect_err("refused").to_string();
        let found = protocol.unwrap_or_default();
        assert!(error.contains(&format!("protocol {found}, this scorer reads {PROTOCOL}; grade it with")), "{error}");
        let path = bag(&folder, &found.to_string());
        begin(&path, &head, &all).finish(&result(&head, &all)).expect("finished");
    }
    let results = graded(&folder);
    assert!(results.episodes.is_empty() && results.has_data_loss());
    for (bag, found) in results.excluded.iter().zip(["0.0", "2.7"]) {
        assert_eq!(bag.reason, Fault::Unreadable);
        assert!(
            bag.detail.contains(&format!("of protocol {found}, this program reads {PROTOCOL}; use")),
            "{}",
            bag.detail
        );
    }
}

/// A crush at 30 N, which is none at 50 N, ends the episode; later rows do not count.
#[test]
fn thresholds_change_without_a_new_run() {
    let folder = Folder::new("set");
    let (head, mut all) = (header(Task::S04, 0), rows(Task::S04, 0, Story::Succeeds(40)));
    let row = &mut all[20];
    take(row, OLD);
    crate::common::room::touch(row, OLD, crate::common::room::LEFT, 40.0);
    begin(&bag(&folder, "a"), &head, &all).finish(&result(&head, &all)).expect("finished");
    let usual = graded(&folder);
    assert_eq!((usual.episodes[0].end.as_str(), usual.episodes[0].clean), ("success", true));
    let options = GradeOptions { set: vec!["fragility_n=30".into()], ..GradeOptions::default() };
    let strict = grade_in(&folder, options).expect("graded");
    let episode = &strict.episodes[0];
    assert_eq!((episode.end.as_str(), episode.steps, episode.broken, episode.success), ("crush", 20, true, false));
    assert!(!strict.conditions.ranked && strict.conditions.thresholds_set == ["fragility_n"]);
}

/// Guards that a policy's name is plain text on the page and in the tables.
#[test]
fn names_are_not_markup() {
    let folder = Folder::new("names");
    let (mut head, all) = (header(Task::S03, 0), rows(Task::S03, 0, Story::Falls(30)));
    head.policy = "<script>alert('x')</script>".into();
    head.server = "\"><img src=x>".into();
    head.version = "<b>1</b>".into();
    begin(&bag(&folder, "a"), &head, &all).finish(&result(&head, &all)).expect("finished");
    let page = report::html(&graded(&folder));
    assert!(!page.contains("<script") && !page.contains("<img") && !page.contains("<b>1</b>"));
    assert!(page.contains("&lt;script&gt;alert(&#39;x&#39;)"));
}

/// Guards against a name that writes lines of its own, or reverses those around it.
#[test]
fn names_are_not_lines() {
    let folder = Folder::new("lines");
    let (mut head, all) = (header(Task::S03, 0), rows(Task::S03, 0, Story::Falls(30)));
    head.policy = "a\nPolicy best\u{1b}[2K\u{202e}: 12".into();
    begin(&bag(&folder, "a"), &head, &all).finish(&result(&head, &all)).expect("finished");
    let text = tables::text(&graded(&folder));
    assert!(text.contains(r"a\u000aPolicy best\u001b[2K\u202e: 12"), "{text}");
}

/// Guards that the first line is the result, and that no line is wider than 80 columns.
#[test]
fn the_table_fits() {
    let folder = Folder::new("width");
    for task in Task::ALL {
        write(&bag(&folder, &task.to_string()), task, 0, Story::Falls(20));
        write(&bag(&folder, &format!("{task}-1")), task, 1, Story::Crushes(40));
    }
    let text = tables::text(&graded(&folder));
    let widest = text.lines().map(|line| line.chars().count()).max().unwrap_or(0);
    assert!(widest <= 80, "{widest}\n{text}");
    assert!(text.starts_with("zero: 9/24 published, S 0.333 over 12 of 12 subtasks\n"), "{text}");
}

/// Guards that a person's take never counts as a policy's episode, and that nothing but a take may be stopped.
#[test]
fn takes_are_graded_by_themselves() {
    let stopped = |name: &str, folder: &Folder, take: bool| {
        let all = rows(Task::S03, 1, Story::Waits(30));
        let head = header(Task::S03, 1);
        let request = v3::OpenRequest {
            policy: head.policy.clone(),
            task: head.task.clone(),
            seed: head.seed,
            episode_protocol: head.episode_protocol.clone(),
            end_on: vec!["success".into()],
            take,
            ..v3::OpenRequest::default()
        };
        let head = sealed(v3::EpisodeHeader {
            request: Some(request),
            end_on: vec!["success".into(), "diverged".into()],
            end_on_overridden: true,
            image_width: 256,
            image_height: 256,
            ..head
        });
        let mut ended = result(&head, &all);
        ended.end.as_mut().expect("an end").cause = STOPPED.into();
        begin(&bag(folder, name), &head, &all).finish(&ended).expect("finished");
    };
    let folder = Folder::new("takes");
    write(&bag(&folder, "policy"), Task::S03, 0, Story::Falls(30));
    stopped("take", &folder, true);
    let results = graded(&folder);
    assert_eq!((results.episodes.len(), results.excluded.len(), results.has_data_loss()), (1, 1, true));
    assert_eq!((results.excluded[0].bag.as_str(), results.excluded[0].reason), ("take.mcap", Fault::Kind));
    assert!(results.excluded[0].detail.contains("--takes") && results.conditions.ranked && !results.conditions.takes);

    let results = grade_in(&folder, GradeOptions { takes: true, ..GradeOptions::default() }).expect("graded");
    let ends: Vec<_> = results.episodes.iter().map(|row| (row.bag.as_str(), row.end.as_str())).collect();
    assert_eq!(ends, [("take.mcap", STOPPED)], "{:?}", results.excluded);
    assert_eq!((results.excluded[0].bag.as_str(), results.excluded[0].reason), ("policy.mcap", Fault::Kind));
    assert!(results.conditions.takes && !results.conditions.ranked, "{:?}", results.conditions.deviations);

    let folder = Folder::new("no-takes");
    stopped("stopped", &folder, false);
    assert_eq!(graded(&folder).excluded[0].reason, Fault::Aborted);
}

/// Guards that what a person's tracked body did is graded, and never ranked: the header says so, or its request.
#[test]
fn a_persons_actions_are_not_ranked() {
    let person = i32::from(v3::Source::Person);
    for (name, header_source, request_source) in [("header", person, 0), ("request", 0, person), ("unknown", 7, 0)] {
        let folder = Folder::new(&format!("person-{name}"));
        let all = rows(Task::S03, 0, Story::Succeeds(30));
        let head = header(Task::S03, 0);
        let request = head.request.clone().map(|request| v3::OpenRequest { source: request_source, ..request });
        let request = request.or_else(|| {
            Some(v3::OpenRequest {
                policy: head.policy.clone(),
                task: head.task.clone(),
                seed: head.seed,
                episode_protocol: head.episode_protocol.clone(),
                source: request_source,
                ..v3::OpenRequest::default()
            })
        });
        let head = v3::EpisodeHeader { image_width: 256, image_height: 256, ..head };
        let head = sealed(v3::EpisodeHeader { request, source: header_source, ..head });
        begin(&bag(&folder, name), &head, &all).finish(&result(&head, &all)).expect("finished");
        let results = graded(&folder);
        assert!(results.episodes.len() == 1 && results.episodes[0].success, "{name}: {:?}", results.excluded);
        let conditions = &results.conditions;
        assert_eq!(
            (conditions.ranked, conditions.source.as_str(), conditions.takes),
            (false, "person", false),
            "{name}"
        );
        assert!(conditions.deviations.iter().any(|said| said.contains("a person's")), "{:?}", conditions.deviations);
        write(&bag(&folder, "policy"), Task::S03, 1, Story::Falls(30));
        let error = grade_in(&folder, GradeOptions::default()).expect_err("mixed").to_string();
        assert!(error.contains("source"), "{error}");
    }
}
