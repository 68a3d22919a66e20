//! Grades folders of runs from end to end: every registered episode counts.

mod group;

use std::fs;
use std::path::PathBuf;

use crate::common::{Folder, Story, begin, header, result, rows, sealed};
use fiatlux_bag::run::{Event, LedgerWriter, NOT_REPEATED, PlannedEpisode, Registration, journal_of};
use fiatlux_grading::{Fault, GradeOptions, Results, ScoreError, grade, report, tables};
use fiatlux_proto::PROTOCOL;
use fiatlux_proto::v3::{EpisodeHeader, OpenRequest, RunSpec, RunTicket};
use fiatlux_rules::Task;

const WINS: Story = Story::Succeeds(30);
const FALLS: Story = Story::Falls(20);

/// The folder of a run, with the journal of one server.
struct RunFolder {
    folder: PathBuf,
    writer: LedgerWriter,
    hosted: bool,
}

fn planned(task: Task, seed: u64) -> PlannedEpisode {
    PlannedEpisode { task: task.to_string(), seed }
}

impl RunFolder {
    fn new(folder: &Folder, server: &str, episodes: &[PlannedEpisode]) -> Self {
        Self::with(folder, server, episodes, 0)
    }

    fn with(folder: &Folder, server: &str, episodes: &[PlannedEpisode], hosted_seeds: u32) -> Self {
        Self::of_group(folder, server, episodes, hosted_seeds, (&[], 0))
    }

    /// Of a group, registered at this time.
    fn of_group(
        folder: &Folder,
        server: &str,
        episodes: &[PlannedEpisode],
        hosted_seeds: u32,
        (group, unix_ms): (&[&str], u64),
    ) -> Self {
        let session = OpenRequest { episode_protocol: "published".into(), ..OpenRequest::default() };
        let registration = Registration {
            protocol: PROTOCOL,
            version: "0.1.0".into(),
            server: server.into(),
            run: "first".into(),
            key_sha256: "ab".repeat(32),
            spec: RunSpec {
                policy: "zero".into(),
                policy_version: "7".into(),
                policy_link: "https://example.org".into(),
                session: Some(session),
                hosted_seeds,
                ..RunSpec::default()
            },
            episodes: episodes.to_vec(),
            unix_ms,
            holder: String::new(),
            group: group.iter().map(|name| (*name).to_owned()).collect(),
        };
        let folder = folder.0.join("first");
        let writer = LedgerWriter::create(&folder, registration).expect("a journal");
        Self { folder, writer, hosted: hosted_seeds > 0 }
    }

    fn append(&mut self, event: Event) {
        self.writer.append(event).expect("it follows");
    }

    fn server(&self) -> String {
        self.writer.ledger().registration().server.clone()
    }

    fn bag_name(&self, episode: u32) -> String {
        format!("{}-e{episode}.mcap", self.server())
    }

    fn bag(&self, episode: u32) -> PathBuf {
        self.folder.join(self.bag_name(episode))
    }

    fn header(&self, episode: u32, attempt: u32) -> EpisodeHeader {
        let PlannedEpisode { task, seed } = &self.writer.ledger().registration().episodes[episode as usize];
        let ticket = RunTicket {
            run: self.writer.ledger().registration().run.clone(),
            episode,
            attempt,
            hosted: self.hosted,
            policy_version: "7".into(),
            policy_link: "https://example.org".into(),
        };
        sealed(EpisodeHeader { run: Some(ticket), ..header(task.parse().expect("a task"), *seed) })
    }

    fn open(&mut self, episode: u32, unix_ms: u64) -> u32 {
        let attempt = self.writer.ledger().episodes()[episode as usize].attempts + 1;
        self.append(Event::Opened { episode, attempt, session: format!("s-{episode}-{attempt}"), unix_ms });
        attempt
    }

    /// Writes the bag of the open attempt, and a line in the journal that it was played.
    fn play(&mut self, episode: u32, attempt: u32, story: Story) {
        let header = self.header(episode, attempt);
        let rows = rows(header.task.parse().expect("a task"), header.seed, story);
        let result = result(&header, &rows);
        begin(&self.bag(episode), &header, &rows).finish(&result).expect("finished");
        let end = result.end.expect("an end");
        let (session, bag) = (format!("s-{episode}-{attempt}"), self.bag_name(episode));
        let (digest, cause, success, steps) = (end.digest, end.cause, end.success, end.steps);
        self.append(Event::Played { episode, attempt, session, bag, digest, cause, success, steps });
    }

    fn whole(&mut self, episode: u32, story: Story) {
        let attempt = self.open(episode, 1 + u64::from(episode));
        self.play(episode, attempt, story);
    }

    fn abandon(&mut self, episode: u32) {
        let attempt = self.writer.ledger().episodes()[episode as usize].attempts;
        let (session, cause) = (format!("s-{episode}-{attempt}"), "the client is gone".into());
        let (steps, digest, marks) = (0, String::new(), Default::default());
        self.append(Event::Abandoned { episode, attempt, session, steps, digest, marks, cause });
    }

    fn finish(mut self) {
        self.append(Event::Finished { unix_ms: 99 });
    }
}

fn grade_in(folder: &Folder) -> Result<Results, ScoreError> {
    let options = GradeOptions { relative_to: folder.0.clone(), ..GradeOptions::default() };
    grade(&[folder.0.join("first")], &options, &|_| {})
}

fn graded(folder: &Folder) -> Results {
    grade_in(folder).expect("graded")
}

fn causes(results: &Results) -> Vec<&str> {
    results.run.as_ref().expect("a run").failures.iter().map(|failure| failure.cause.as_str()).collect()
}

/// The text table without its line breaks.
fn words(results: &Results) -> String {
    tables::text(results).split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The folder has the bag of an aborted episode, which still counts as one of two.
#[test]
fn a_success_and_an_abort_are_half() {
    let folder = Folder::new("half");
    let mut run = RunFolder::new(&folder, "lab", &[planned(Task::S03, 0), planned(Task::S03, 1)]);
    run.whole(0, WINS);
    let attempt = run.open(1, 9);
    let (head, all) = (run.header(1, attempt), rows(Task::S03, 1, FALLS));
    begin(&run.bag(1), &head, &all[..10]).finish(&result(&head, &all[..10])).expect("finished");
    fs::write(run.folder.join("late.mcap.part"), "").expect("written");
    run.abandon(1);
    run.finish();
    let results = graded(&folder);
    assert!(results.excluded.is_empty() && !results.has_data_loss(), "{:?}", results.excluded);
    let task = &results.subtasks[0];
    assert_eq!((task.episodes, task.success_rate, task.score_mean), (2, 0.5, 0.5));
    assert_eq!((results.overall.episodes, results.overall.success.hits), (2, 1));
    // Only one has rows: 79 steps.
    assert_eq!(task.mean_steps, results.episodes[0].steps as f64);
    assert_eq!(
        task.ends.iter().map(|(end, n)| (end.as_str(), *n)).collect::<Vec<_>>(),
        [("abandoned", 1), ("success", 1)]
    );
    let weight = Task::S03.weight() / Task::SUBTASKS.into_iter().map(Task::weight).sum::<f64>();
    let scores: Vec<f64> = results.score.per_seed.iter().map(|seed| seed.score).collect();
    assert!((scores[0] - weight).abs() < 1e-15 && scores[1] == 0.0, "{scores:?}");
    assert_eq!((results.missing.len(), results.seeds.as_slice()), (11, [0, 1].as_slice()));
    let failed = &results.episodes[1];
    assert_eq!((failed.end.as_str(), failed.failure.as_deref()), ("abandoned", Some("abandoned")));
    assert_eq!(failed.notes, ["the client is gone"]);
    let found = results.run.as_ref().expect("a run");
    assert_eq!((found.registered, found.played, found.finished, found.hosted), (2, 1, true, false));
    assert_eq!(
        (found.policy_version.as_str(), found.folder.as_str(), found.servers.as_slice()),
        ("7", "first", ["lab".to_owned()].as_slice())
    );
    let line = "Run first: 2 episodes registered, 1 played, 1 failed (abandoned 1)";
    assert!(words(&results).contains(line) && report::html(&results).contains(&format!("{line}.")));
    assert!(!words(&results).contains("NOT FINISHED"));
    assert!(report::html(&results).contains("scorer grade first --html"));
    let back: Results = serde_json::from_str(&results.to_json().expect("JSON")).expect("reads back");
    assert_eq!(back.run, results.run);
    // Graded as loose bags, they give another result.
    let bags = [folder.0.join("first/lab-e0.mcap"), folder.0.join("first/lab-e1.mcap")];
    let loose = grade(&bags, &GradeOptions::default(), &|_| {}).expect("graded");
    assert!(loose.run.is_none() && loose.has_data_loss() && loose.subtasks[0].success_rate == 1.0);
    // In each form S comes with the number of subtasks that it is over.
    for (results, subtasks, says) in [
        (&results, 12, "over 12 of 12 subtasks, 11 of them not registered and 0"),
        (&loose, 1, "over 1 of 12 subtasks: not comparable"),
    ] {
        assert_eq!(results.score.subtasks, subtasks);
        for form in [words(results), tables::latex(results)] {
            assert!(form.contains(says), "{form}");
        }
        // The cards of a single task have its own score.
        let html = report::html(results);
        assert!(html.contains("Score s, published") && html.contains("S03 Remove Old Bulb<br>of 1"), "{html}");
        assert!(!html.contains("Score S") && !html.contains("Missing subtasks"), "{html}");
    }
}

/// Guards that the page says once, and by name, which subtasks a run left out, next to the number of subtasks in S.
#[test]
fn subtasks_that_were_not_registered_are_named_once() {
    let folder = Folder::new("left-out");
    let mut run = RunFolder::new(&folder, "lab", &[planned(Task::S03, 0), planned(Task::S05, 0)]);
    run.whole(0, WINS);
    run.whole(1, FALLS);
    run.finish();
    let html = report::html(&graded(&folder));
    let says = "<b>Missing subtasks.</b> Not registered, so 0 in S: S01, S02, S04,";
    assert!(html.contains(says) && html.to_lowercase().matches("not registered").count() == 1, "{html}");
    assert!(html.contains("Score S, published") && html.contains("over 12 of 12 subtasks<br>"), "{html}");
}

/// Guards that bags of a run without its journal are reported. Bags that were recorded in no run need none.
#[test]
fn a_run_without_its_journal_says_so() {
    let folder = Folder::new("no-journal");
    let mut run = RunFolder::new(&folder, "lab", &[planned(Task::S03, 0), planned(Task::S03, 1)]);
    run.whole(0, WINS);
    run.whole(1, FALLS);
    run.finish();
    assert_eq!(graded(&folder).lost_journal(), None);
    fs::remove_file(folder.0.join("first/lab.run.jsonl")).expect("removed");
    fs::remove_file(folder.0.join("first/lab-e1.mcap")).expect("removed");
    let results = graded(&folder);
    let said =
        "these bags belong to the run first, whose journal is missing: nobody can tell which episodes were left out";
    assert_eq!(results.lost_journal().as_deref(), Some(said));
    assert!(results.has_data_loss() && results.excluded.is_empty() && results.episodes.len() == 1);
    assert!(report::html(&results).contains(said));
    fs::remove_file(folder.0.join("first/lab-e0.mcap")).expect("removed");
    crate::common::write(&folder.0.join("first/loose.mcap"), Task::S03, 0, WINS);
    assert!(!graded(&folder).has_data_loss());
}

#[test]
fn bags_that_the_journal_names_must_be_there_and_be_those() {
    let folder = Folder::new("named");
    let episodes = [0, 1, 2, 3, 4, 5].map(|seed| planned(Task::S03, seed));
    let mut run = RunFolder::new(&folder, "lab", &episodes);
    (0..6).for_each(|episode| run.whole(episode, if episode == 2 { WINS } else { FALLS }));
    fs::remove_file(run.bag(0)).expect("removed");
    // A row was changed.
    let (head, all) = (run.header(1, 1), rows(Task::S03, 1, FALLS));
    let mut changed = all.clone();
    changed[7].joint_position[3] += 1e-15;
    begin(&folder.0.join("x"), &head, &changed).finish(&result(&head, &all)).expect("finished");
    fs::rename(folder.0.join("x"), run.bag(1)).expect("renamed");
    // A success replaces a fall: another episode's bag, once unchanged and once with a new header.
    fs::copy(run.bag(2), run.bag(3)).expect("copied");
    let (head, all) = (run.header(4, 1), rows(Task::S03, 4, WINS));
    begin(&folder.0.join("x"), &head, &all).finish(&result(&head, &all)).expect("finished");
    fs::rename(folder.0.join("x"), run.bag(4)).expect("renamed");
    fs::write(run.bag(5), "no bag").expect("written");
    run.finish();
    let results = graded(&folder);
    assert_eq!(causes(&results), ["bag lost", "altered", "altered", "altered", "bag lost"]);
    let found: Vec<_> = results.excluded.iter().map(|bag| (bag.bag.as_str(), bag.reason)).collect();
    let expected = [
        ("first/lab-e0.mcap", Fault::Lost),
        ("first/lab-e1.mcap", Fault::Altered),
        ("first/lab-e3.mcap", Fault::Altered),
        ("first/lab-e4.mcap", Fault::Altered),
        ("first/lab-e5.mcap", Fault::Unreadable),
    ];
    assert_eq!(found, expected);
    assert!(results.excluded[2].detail.contains("its index in the run is '2', but '3' in the journal"));
    assert!(results.excluded[3].detail.contains("the digest of its rows"));
    assert!(results.has_data_loss());
    assert_eq!((results.subtasks[0].episodes, results.overall.success.hits), (6, 1));
}

/// Guards that an episode counts as played if one server played it. Of two plays the one begun first counts, apart from
/// attempts of a dead server.
#[test]
fn journals_of_several_servers_are_one_run() {
    let folder = Folder::new("servers");
    let episodes = [0, 1, 2, 3].map(|seed| planned(Task::S03, seed));
    let [mut a, mut b] = ["a", "b"].map(|server| RunFolder::new(&folder, server, &episodes));
    a.whole(0, WINS);
    let at_b = b.open(1, 5);
    let at_a = a.open(1, 6);
    b.play(1, at_b, FALLS);
    a.play(1, at_a, WINS);
    b.open(2, 1);
    b.append(Event::Restarted { unix_ms: 2 });
    let at_a = a.open(2, 7);
    let at_b = b.open(2, 8);
    a.play(2, at_a, FALLS);
    b.play(2, at_b, WINS);
    let attempt = b.open(3, 9);
    b.append(Event::Failed { episode: 3, attempt, cause: NOT_REPEATED.into() });
    a.finish();
    b.finish();
    let results = graded(&folder);
    let bags: Vec<_> = results.episodes.iter().map(|episode| episode.bag.as_str()).collect();
    assert_eq!(bags, ["first/a-e0.mcap", "first/b-e1.mcap", "first/a-e2.mcap", ""]);
    assert_eq!(causes(&results), ["not repeated"]);
    let run = results.run.as_ref().expect("a run");
    assert_eq!(
        (run.servers.as_slice(), run.repeated, run.begun_again),
        (["a".to_owned(), "b".to_owned()].as_slice(), 2, 1)
    );
    assert_eq!(run.notes.len(), 2, "{:?}", run.notes);
    assert!(words(&results).contains("Note: S03, seed 1 was played on b and on a; b began it first and counts"));

    let other = Folder::new("others");
    drop([RunFolder::new(&other, "a", &episodes), RunFolder::new(&other, "b", &episodes[1..])]);
    let error = grade_in(&other).expect_err("two runs").to_string();
    assert!(error.contains("the list of episodes differs"), "{error}");
}

#[test]
fn a_run_that_is_not_finished_says_so() {
    let folder = Folder::new("unfinished");
    let episodes: Vec<_> = Task::SUBTASKS.map(|task| planned(task, 1 << 40)).into();
    let mut run = RunFolder::with(&folder, "lab", &episodes, 1);
    run.whole(0, WINS);
    run.open(1, 9);
    run.open(2, 9);
    run.abandon(2);
    let results = graded(&folder);
    assert!(words(&results).contains(
        "Run first: 12 episodes registered, 1 played, 11 failed (abandoned 1, not run 9, open 1); NOT FINISHED"
    ));
    assert!(results.missing.is_empty() && results.subtasks.len() == 12);
    let latex = tables::latex(&results);
    assert!(latex.contains("Run first: 12 episodes registered, 1 played, 11 failed"), "{latex}");
    let csv = tables::csv(&results);
    assert!(csv.lines().nth(1).is_some_and(|line| line.ends_with(",first,12,1,false")), "{csv}");
    let weight = Task::S01.weight() / Task::SUBTASKS.into_iter().map(Task::weight).sum::<f64>();
    assert!((results.score.mean.expect("a score") - weight).abs() < 1e-15);
    assert_eq!(results.conditions.seeds, "hosted");
    assert!(tables::text(&results).lines().all(|line| line.chars().count() <= 80), "{}", tables::text(&results));

    // Not a single episode was played.
    let folder = Folder::new("unplayed");
    drop(RunFolder::new(&folder, "lab", &episodes));
    let results = graded(&folder);
    assert_eq!(
        (results.score.mean, results.score_strict.is_none(), results.conditions.ranked),
        (Some(0.0), true, false)
    );
    assert!(words(&results).contains("0 played, 12 failed (not run 12)") && results.policy == "zero");
    assert!(report::html(&results).contains("0 played"));
}

impl RunFolder {
    /// A part of an evaluation, or the part of a run that another server has, in a folder of its own.
    fn part(folder: &Folder, run: &str, server: &str, rooms: &[PlannedEpisode], policy: &str) -> Self {
        let mut registration = Self::new(folder, "scratch", rooms).writer.ledger().registration().clone();
        fs::remove_dir_all(folder.0.join("first")).expect("removed");
        registration.run = run.into();
        registration.server = server.into();
        registration.key_sha256 = format!("{:0<64}", run.len());
        registration.spec.policy = policy.into();
        registration.spec.seeds = rooms.iter().map(|room| room.seed).collect();
        let folder = folder.0.join(run);
        let writer = LedgerWriter::create(&folder, registration).expect("a journal");
        Self { folder, writer, hosted: false }
    }
}

/// Guards one run on two machines, each with a folder of its own: its halves are graded as if they were in one.
#[test]
fn the_halves_of_a_run_in_two_folders_are_one_result() {
    let rooms = [planned(Task::S03, 0), planned(Task::S05, 0), planned(Task::S07, 0)];
    let [one, two] = ["half-1", "half-2"].map(Folder::new);
    let mut first = RunFolder::part(&one, "first", "lab-1", &rooms, "zero");
    let mut second = RunFolder::part(&two, "first", "lab-2", &rooms, "zero");
    first.whole(0, WINS);
    second.whole(1, FALLS);
    second.whole(2, WINS);
    [first, second].into_iter().for_each(RunFolder::finish);
    let merged = grade(&[one.0.clone(), two.0.clone()], &GradeOptions::default(), &|_| {}).expect("graded");
    let run = merged.run.as_ref().expect("a run");
    assert_eq!((run.registered, run.played, run.finished, run.name.as_str()), (3, 3, true, "first"));
    assert_eq!(run.servers, ["lab-1", "lab-2"]);
    assert!(merged.excluded.is_empty() && !merged.has_data_loss(), "{:?}", merged.excluded);
    let alone = grade(std::slice::from_ref(&one.0), &GradeOptions::default(), &|_| {}).expect("graded");
    assert_eq!(alone.run.expect("a run").played, 1);

    // A journal that is there twice is not two servers'.
    let copy = Folder::new("half-copy");
    fs::create_dir_all(copy.0.join("first")).expect("made");
    for file in fs::read_dir(one.0.join("first")).expect("read") {
        let file = file.expect("a file");
        fs::copy(file.path(), copy.0.join("first").join(file.file_name())).expect("copied");
    }
    let error = grade(&[one.0.clone(), copy.0.clone()], &GradeOptions::default(), &|_| {}).expect_err("a copy");
    assert!(matches!(&error, ScoreError::Copies { server, .. } if server == "lab-1"), "{error}");
}

/// Guards shards, each a run by itself: one result, unless they are of different policies, or a room is in both with another
/// outcome.
#[test]
fn shards_of_an_evaluation_are_one_result() {
    let part = |name: &str, run: &str, policy: &str, rooms: &[(Task, u64, Option<Story>)]| {
        let folder = Folder::new(name);
        let planned: Vec<_> = rooms.iter().map(|(task, seed, _)| planned(*task, *seed)).collect();
        let mut part = RunFolder::part(&folder, run, "local", &planned, policy);
        for (index, (_, _, story)) in (0..).zip(rooms) {
            if let Some(story) = story {
                part.whole(index, *story);
            }
        }
        part.finish();
        folder
    };
    let graded = |folders: &[&Folder]| {
        let paths: Vec<_> = folders.iter().map(|folder| folder.0.clone()).collect();
        grade(&paths, &GradeOptions::default(), &|_| {})
    };
    let one = part("shard-1", "a", "zero", &[(Task::S03, 0, Some(WINS)), (Task::S03, 1, Some(FALLS))]);
    let two = part("shard-2", "bb", "zero", &[(Task::S03, 2, Some(WINS)), (Task::S03, 3, None)]);
    let merged = graded(&[&one, &two]).expect("graded");
    let run = merged.run.as_ref().expect("a run");
    assert_eq!((run.registered, run.played, run.finished, run.name.as_str()), (4, 3, true, "a+bb"));
    assert_eq!(
        run.failures.iter().map(|failure| (failure.seed, &*failure.cause)).collect::<Vec<_>>(),
        [(3, "not run")]
    );
    assert_eq!(merged.episodes.len(), 4, "what was not run counts as a failure");
    assert!(merged.excluded.is_empty() && !merged.has_data_loss(), "{:?}", merged.excluded);

    let again = part("shard-again", "ccc", "zero", &[(Task::S03, 2, Some(WINS)), (Task::S03, 3, Some(WINS))]);
    let run = graded(&[&one, &two, &again]).expect("graded").run.expect("a run");
    assert_eq!((run.registered, run.played), (4, 4), "the same rows count once, and what was not run is filled in");
    let other = part("shard-other", "dddd", "zero", &[(Task::S03, 1, Some(WINS))]);
    let error = graded(&[&one, &other]).expect_err("another outcome").to_string();
    assert!(error.contains("S03, seed 1 is in") && error.contains("shard-other"), "{error}");
    let policy = part("shard-policy", "eeeee", "one", &[(Task::S03, 9, Some(WINS))]);
    let error = graded(&[&one, &policy]).expect_err("another policy").to_string();
    assert!(error.contains("different policies") && error.contains("grade them apart"), "{error}");
}

/// Guards that a folder above that of a run is not a run.
#[test]
fn runs_are_graded_one_by_one() {
    let folder = Folder::new("above");
    let mut run = RunFolder::new(&folder, "lab", &[planned(Task::S03, 0)]);
    run.whole(0, WINS);
    run.finish();
    let above = || grade(std::slice::from_ref(&folder.0), &GradeOptions::default(), &|_| {});
    assert_eq!(above().expect("graded").run.expect("the only one").name, "first");
    crate::common::write(&folder.0.join("loose.mcap"), Task::S03, 1, FALLS);
    let error = above().expect_err("a run and a bag").to_string();
    assert!(error.contains("a run is graded by itself") && error.contains("first"), "{error}");
    let journal = fs::read_to_string(folder.0.join("first/lab.run.jsonl")).expect("read");
    fs::write(folder.0.join("first/lab.run.jsonl"), journal.replace("\"success\":true", "\"success\":false"))
        .expect("written");
    assert!(matches!(grade_in(&folder), Err(ScoreError::Ledger(_))));
}

/// Guards against journals that are cut, renamed or copied without notice.
#[test]
fn odd_journals_are_named() {
    let folder = Folder::new("odd-journals");
    let mut run = RunFolder::new(&folder, "lab", &[planned(Task::S01, 3), planned(Task::S01, 4)]);
    run.whole(0, WINS);
    let journal = journal_of(&run.folder, "lab");
    assert_eq!(graded(&folder).run.expect("a run").notes, [""; 0]);
    // The line of the second episode is partial.
    let whole = fs::read(&journal).expect("a journal");
    run.whole(1, WINS);
    let more = fs::read(&journal).expect("a journal");
    fs::write(&journal, &more[..whole.len() + 20]).expect("torn");
    let notes = graded(&folder).run.expect("a run").notes;
    assert!(notes.len() == 1 && notes[0].contains("lab.run.jsonl ends in a partial line"), "{notes:?}");
    // A copy under another name would count every attempt twice.
    fs::write(&journal, &whole).expect("written");
    let copy = journal_of(&run.folder, "copy");
    fs::write(&copy, &whole).expect("written");
    let error = grade_in(&folder).expect_err("two").to_string();
    assert!(error.contains("are both journals of server lab; keep the server's own"), "{error}");
    fs::remove_file(&journal).expect("removed");
    let notes = graded(&folder).run.expect("a run").notes;
    assert!(notes.len() == 1 && notes[0].contains("copy.run.jsonl is the journal of server lab"), "{notes:?}");
}
