//! Evaluations in shards, as the files for clusters start them.

use std::collections::BTreeSet;
use std::path::Path;
use std::process::{Command, Output};

use fiatlux_tests::programs::{Scratch, program};

const SHARDS: usize = 16;
/// Fewer episodes than shards.
const OPTIONS: [&str; 6] = ["--policy", "zero", "--tasks", "S05,S09", "--seeds", "0..3"];

fn said(done: &Output) -> String {
    [&done.stdout, &done.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned()).concat()
}

/// Starts a command as each of the shards, all at once; `results/` is in the folder then.
fn start(folder: &Path, words: &[String], index: &str, more: &[(&str, &str)]) {
    std::fs::create_dir_all(folder).unwrap();
    let programs = program("fiatlux").parent().unwrap().to_owned();
    let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap());
    let shard = |k: usize| {
        let mut command = Command::new(&words[0]);
        command.args(&words[1..]).current_dir(folder).env("PATH", &path).env(index, k.to_string());
        command.envs(more.iter().copied()).output().unwrap()
    };
    std::thread::scope(|scope| {
        let shards: Vec<_> = (0..SHARDS).map(|k| scope.spawn(move || shard(k))).collect();
        for done in shards.into_iter().map(|shard| shard.join().unwrap()) {
            assert!(done.status.success(), "{}", said(&done));
        }
    });
}

/// The results that merging the shards in a folder gives.
fn merged(folder: &Path) -> Vec<u8> {
    let mut merge = Command::new("bash");
    merge.args(["-c", "\"$0\" merge results/zero results/zero-*of16"]).arg(program("scorer"));
    let done = merge.current_dir(folder).output().unwrap();
    assert!(done.status.success(), "{}", said(&done));
    std::fs::read(folder.join("results/zero/results.json")).unwrap()
}

#[test]
fn the_files_for_slurm_and_kubernetes_play_what_one_process_does() {
    let repository = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let scratch = Scratch::new("cluster");
    let folder = |name: &str| scratch.path().join(name);
    std::fs::create_dir_all(folder("one")).unwrap();
    let alone = Command::new(program("fiatlux")).arg("evaluate").args(OPTIONS).current_dir(folder("one")).output();
    let alone = alone.unwrap();
    assert!(alone.status.success(), "{}", said(&alone));
    let expected = std::fs::read(folder("one/results/zero/results.json")).unwrap();

    let script = repository.join("deploy/slurm/evaluate.sbatch");
    let text = std::fs::read_to_string(&script).unwrap();
    assert!(text.contains(&format!("#SBATCH --array=0-{}\n", SHARDS - 1)), "the script's array has {SHARDS} tasks");
    let words: Vec<String> = ["bash", script.to_str().unwrap()].into_iter().chain(OPTIONS).map(Into::into).collect();
    start(&folder("slurm"), &words, "SLURM_ARRAY_TASK_ID", &[("SLURM_CPUS_PER_TASK", "1")]);
    assert!(merged(&folder("slurm")) == expected, "the results of Slurm's tasks are others");

    let job = std::fs::read_to_string(repository.join("deploy/kubernetes/evaluate.yaml")).unwrap();
    let value = |key: &str| {
        let line = job.lines().find_map(|line| line.trim().strip_prefix(key)).unwrap();
        line.trim().to_owned()
    };
    let mut words: Vec<String> = serde_json::from_str(&value("command:")).unwrap();
    let count = value("value:");
    assert_eq!(count.trim_matches('"'), value("completions:"));
    for (option, own) in OPTIONS.chunks(2).map(|pair| (pair[0], pair[1])) {
        let at = words.iter().position(|word| word == option).unwrap();
        words[at + 1] = own.into();
    }
    assert!(job.contains("- name: FIATLUX_SHARDS\n"));
    start(&folder("kubernetes"), &words, "JOB_COMPLETION_INDEX", &[("FIATLUX_SHARDS", count.trim_matches('"'))]);
    assert!(merged(&folder("kubernetes")) == expected, "the results of Kubernetes' pods are others");
}

/// Guards the programs' own words in the fleet's objects: every flag and value is one that they read.
#[test]
fn the_commands_of_a_fleet_are_read() {
    let repository = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let objects = std::fs::read_to_string(repository.join("deploy/kubernetes/fleet.yaml")).unwrap();
    let commands = objects.split("command: ").skip(1).map(|rest| &rest[..=rest.find(']').unwrap()]);
    let commands: Vec<Vec<String>> = commands.map(|words| serde_json::from_str(words).unwrap()).collect();
    let programs: Vec<&str> = commands.iter().map(|words| words[0].as_str()).collect();
    assert_eq!(programs, ["fiatlux", "sim-server", "scorer"]);
    for words in commands {
        // Kubernetes puts the pod's name there.
        let args = words[1..].iter().map(|word| if word == "$(POD)" { "lab-0" } else { word });
        // Help comes once what stands before it was read.
        let output = Command::new(program(&words[0])).args(args).arg("--help").output().unwrap();
        assert!(output.status.success() && !output.stdout.is_empty(), "{words:?}: {}", said(&output));
    }
}

/// Guards the dashboard: each series that it draws is one that a scorer or a server has, by its whole name.
#[test]
fn the_dashboard_draws_what_there_is() {
    let repository = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let read = |path: &str| std::fs::read_to_string(repository.join(path)).unwrap();
    let sources = read("crates/leaderboard/src/metrics.rs") + &read("sim-server/src/metrics.rs");
    let named: Vec<&str> = sources.split('"').skip(1).step_by(2).collect();
    let dashboard: serde_json::Value = serde_json::from_str(&read("deploy/grafana/fleet.json")).unwrap();
    let targets = dashboard["panels"].as_array().unwrap().iter().flat_map(|panel| panel["targets"].as_array().unwrap());
    let words = targets.flat_map(|target| {
        target["expr"].as_str().unwrap().split(|letter: char| !letter.is_alphanumeric() && letter != '_')
    });
    let drawn: BTreeSet<&str> = words.filter_map(|word| word.strip_prefix("fiatlux_")).collect();
    for series in &drawn {
        let stem = series.strip_suffix("_bucket").unwrap_or(series);
        assert!(named.contains(&stem), "no metric is named {series}");
    }
    assert!(drawn.len() > 12, "{drawn:?}");
}

/// Guards shards against a kill: the same command goes on, and the result is that of one process.
#[test]
fn shards_that_are_killed_go_on() {
    let scratch = Scratch::new("cluster-kills");
    let options = ["--policy", "walk", "--tasks", "S05", "--seeds", "0..3"];
    let evaluate = |out: &str, more: &[&str]| {
        let mut command = Command::new(program("fiatlux"));
        command.arg("evaluate").args(options).args(["--out", out]).args(more).current_dir(scratch.path());
        command
    };
    assert!(evaluate("one", &[]).output().unwrap().status.success());
    for (part, wait_ms) in [("1/2", 700), ("2/2", 1500)] {
        let out = format!("part-{}", &part[..1]);
        let mut killed = evaluate(&out, &["--shard", part]).spawn().unwrap();
        std::thread::sleep(std::time::Duration::from_millis(wait_ms));
        killed.kill().unwrap();
        killed.wait().unwrap();
        let done = evaluate(&out, &["--shard", part]).output().unwrap();
        assert!(done.status.success(), "{}", said(&done));
        // Another shard does not go into its folder.
        let other = evaluate(&out, &["--shard", "1/3"]).output().unwrap();
        assert!(
            other.status.code() == Some(1) && said(&other).contains(&format!("it has shard {part}")),
            "{}",
            said(&other)
        );
    }
    let merge = |shards: &[&str]| {
        let done =
            Command::new(program("scorer")).args(["merge", "all"]).args(shards).current_dir(scratch.path()).output();
        let done = done.unwrap();
        (done.status.code(), said(&done))
    };
    let (code, text) = merge(&["part-1"]);
    assert_eq!(code, Some(3), "{text}");
    let command = "play shard 2/2 with: fiatlux evaluate --policy walk --tasks S05 --seeds 0..3 --shard 2/2 --out";
    assert!(text.split_whitespace().collect::<Vec<_>>().join(" ").contains(command), "{text}");
    let (code, text) = merge(&["part-1", "part-2"]);
    assert_eq!(code, Some(0), "{text}");
    let read = |folder: &str| std::fs::read(scratch.path().join(folder).join("results.json")).unwrap();
    assert!(read("all") == read("one"), "the merged results are others");
}
