//! Demonstrations: only clean episodes, each played once.

use std::fs;
use std::process::Command;
use std::sync::atomic::AtomicBool;

use clap::Parser;
use fiatlux_bag::Bag;
use fiatlux_client::SessionArgs;
use fiatlux_policies::Policies;
use fiatlux_rules::Task;
use fiatlux_runs::{BAGS, DemonstrateOptions, Demonstrated, EvaluateOptions, demonstrate};
use fiatlux_world::SceneConfig;

use crate::common::folder;

#[derive(Parser)]
struct Flags {
    #[command(flatten)]
    session: SessionArgs,
}

fn options(name: &str, policy: &str, task: Task, flags: &[&str]) -> DemonstrateOptions {
    let session = Flags::parse_from([&["test"], flags].concat()).session;
    DemonstrateOptions {
        evaluation: EvaluateOptions {
            policies: Policies::default(),
            policy: policy.into(),
            tasks: Vec::new(),
            seeds: Vec::new(),
            out: folder(name),
            thin: false,
            workers: 2,
            weights: None,
            meshes: None,
            scene: SceneConfig::default(),
            session,
            shard: None,
        },
        task,
        episodes: 1,
        first_seed: 1000,
        max_rooms: 2,
        unclean: false,
    }
}

fn run(options: &DemonstrateOptions) -> Demonstrated {
    demonstrate(options, &AtomicBool::new(false), &mut |_, _| ()).unwrap()
}

/// A second call plays only what is missing, and one for fewer takes the others away again.
#[test]
fn demonstrations_go_on_from_those_that_there_are() {
    let mut options = options("demonstrations", "expert", Task::S06, &["--record", "camera@5", "--image", "64x48"]);
    let first = run(&options);
    assert_eq!((first.kept.len(), first.rooms, first.clean, first.outcome.resumed), (1, 1, 1, 0));
    let bag = Bag::open(&first.kept[0].bag).unwrap();
    assert_eq!((bag.header().seed, bag.header().instruction.is_empty()), (1000, false));
    options.episodes = 2;
    let both = run(&options);
    assert_eq!((both.kept.len(), both.outcome.resumed), (2, 1));
    assert_eq!(both.kept[0], first.kept[0]);
    options.episodes = 1;
    assert_eq!(run(&options).kept, first.kept);
    assert_eq!(fs::read_dir(options.evaluation.out.join(BAGS)).unwrap().count(), 1);
    options.task = Task::S08;
    let error = demonstrate(&options, &AtomicBool::new(false), &mut |_, _| ()).unwrap_err().to_string();
    assert!(error.contains("holds demonstrations of S06, not S08") && error.contains("--out"), "{error}");
}

/// Failures are played once and left out, unless they are asked for; rooms for judging are not played at all.
#[test]
fn failures_are_no_demonstrations() {
    // A robot that leans has fallen.
    let mut options = options("failures", "zero", Task::S05, &["--set", "fall_tilt_rad=0.05"]);
    let none = run(&options);
    assert_eq!((none.kept.len(), none.rooms, none.clean), (0, 1, 0));
    options.unclean = true;
    let failed = run(&options);
    assert_eq!((failed.kept.len(), failed.kept[0].clean, failed.outcome.resumed), (1, false, 1));
    options.first_seed = 999;
    let error = demonstrate(&options, &AtomicBool::new(false), &mut |_, _| ()).unwrap_err().to_string();
    assert!(error.contains("use seeds 1000 to 99999"), "{error}");
}

/// Pictures are most of a bag: with `--no-pictures` it has none, and is a fraction of the size.
#[test]
fn pictures_can_be_left_out() {
    let recorded = |name: &str, flags: &[&str]| {
        let out = folder(name);
        let (task, room) =
            (["--task", "S05", "--policy", "zero", "--unclean"], ["--episodes", "1", "--max-rooms", "1"]);
        let mut command = Command::new(env!("CARGO_BIN_EXE_fiatlux"));
        command.arg("demonstrate").args(task).args(room).args(["--set", "fall_tilt_rad=0.05", "--image", "64x64"]);
        let done = command.args(flags).arg("--out").arg(&out).output().unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        let [bag] = &fs::read_dir(out.join(BAGS)).unwrap().map(|entry| entry.unwrap().path()).collect::<Vec<_>>()[..]
        else {
            panic!("one bag")
        };
        let read = Bag::open(bag).unwrap();
        (read.images().count(), read.states().count())
    };
    let (pictures, rows) = recorded("with-pictures", &[]);
    assert!(pictures > 0, "{rows} rows");
    assert_eq!(recorded("without-pictures", &["--no-pictures"]), (0, rows));
}

/// A change of the expert changes the public list: `--write-recipe` makes its lines. Three tasks of twelve without `FIATLUX_SLOW_TESTS`.
#[test]
fn the_public_list_has_what_this_version_plays() {
    let list = concat!(env!("CARGO_MANIFEST_DIR"), "/../demonstrations.txt");
    let every = if std::env::var_os("FIATLUX_SLOW_TESTS").is_some() { 1 } else { 4 };
    for task in Task::SUBTASKS.into_iter().step_by(every) {
        let (task, out) = (task.short_id(), folder(&format!("listed-{}", task.short_id())));
        let mut command = Command::new(env!("CARGO_BIN_EXE_fiatlux"));
        command.args(["demonstrate", "--task", task, "--episodes", "1", "--no-pictures", "--recipe", list, "--out"]);
        let done = command.arg(out).output().unwrap();
        let said = String::from_utf8_lossy(&done.stderr);
        assert!(done.status.success() && said.contains("1 of 1 are those of the list"), "{task}: {said}");
    }
}
