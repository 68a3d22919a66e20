//! Runs of servers that share hosted rooms and no folder.

use super::*;

/// Guards a hosted run of servers with folders of their own: each has the bags of its episodes, and together they are one run. It is finished
/// when all of them are; a missing journal costs its episodes, a second play or a registration after the end is refused and named.
#[test]
fn servers_of_a_group_have_their_own_folders() {
    let names = ["lab-1", "lab-2", "lab-3"];
    let episodes: Vec<_> = (0..6).map(|seed| planned(Task::S05, (1 << 40) + seed)).collect();
    let played = |name: &str, late: u64| {
        let folders = names.map(|server| Folder::new(&format!("{name}-{server}")));
        for (place, (folder, server)) in folders.iter().zip(names).enumerate() {
            let unix_ms = if place == 1 { late } else { 0 };
            let mut run = RunFolder::of_group(folder, server, &episodes, 6, (&names, unix_ms));
            (0..6).filter(|index| index % 3 == place as u32).for_each(|index| run.whole(index, WINS));
            run.finish();
        }
        folders
    };
    let grade = |folders: &[&Folder]| {
        let paths: Vec<PathBuf> = folders.iter().map(|folder| folder.0.join("first")).collect();
        grade(&paths, &GradeOptions::default(), &|_| {})
    };
    let folders = played("group", 0);
    let results = grade(&folders.each_ref()).expect("graded");
    let run = results.run.expect("a run");
    assert_eq!((run.registered, run.played, run.finished, run.hosted), (6, 6, true, true));
    assert_eq!(run.servers, names);

    let results = grade(&[&folders[0], &folders[2]]).expect("graded");
    let run = results.run.expect("a run");
    assert_eq!((run.played, run.finished), (4, false));
    assert!(run.notes.iter().any(|note| note.contains("server lab-2 is missing")), "{:?}", run.notes);

    // Who has seen the seeds in the first server's journal registers with the second one.
    let folders = played("group-late", 100);
    let error = grade(&folders.each_ref()).expect_err("known seeds");
    assert!(error.to_string().contains("with server lab-2 after server lab-1 had finished it"), "{error}");

    // A server that begins an episode of another one, as with a list of its own.
    let folders = played("group-twice", 0);
    let journal = journal_of(&folders[0].0.join("first"), "lab-1");
    fs::remove_file(&journal).expect("removed");
    let mut run = RunFolder::of_group(&folders[0], "lab-1", &episodes, 6, (&["lab-1"], 0));
    run.whole(1, WINS);
    run.finish();
    let error = grade(&folders.each_ref()).expect_err("another list");
    assert!(matches!(&error, ScoreError::Journals { field: "group of servers", .. }), "{error}");
}
