//! Runs every command of the README and of the pages that go on from it, and compares their program with its example.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use fiatlux_rules::Task;
use fiatlux_tests::programs::{PATIENCE, Running, Scratch, free_port, program, wait_until};

/// Pages in the order in which a reader takes them: commands use what earlier ones made.
const PAGES: [&str; 8] = [
    "README.md",
    "docs/index.md",
    "docs/machines.md",
    "docs/cluster.md",
    "docs/observations.md",
    "docs/policies.md",
    "docs/bags.md",
    "docs/performance.md",
];

/// The fenced blocks of a text in a language, in order.
fn blocks(text: &str, language: &str) -> Vec<String> {
    let opening = format!("\n```{language}\n");
    text.split(&opening).skip(1).map(|rest| rest.split("\n```").next().unwrap().to_owned()).collect()
}

/// Commands of our own programs in a text's blocks that name no language, without the remarks behind them.
fn commands(text: &str) -> Vec<String> {
    // Every second part is a block.
    let blocks = text.split("\n```").skip(1).step_by(2).filter(|block| block.starts_with('\n'));
    let lines = blocks.flat_map(str::lines).map(|line| line.split("  #").next().unwrap_or_default().trim());
    lines.filter(|line| line.starts_with("target/release/") || line.starts_with("(umask")).map(str::to_owned).collect()
}

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().into()
}

fn pages() -> String {
    PAGES.map(|page| std::fs::read_to_string(repository().join(page)).unwrap()).concat()
}

#[test]
fn the_policy_is_the_example() {
    let example = std::fs::read_to_string(repository().join("policy-client/examples/wave.rs")).unwrap();
    let [shown] = &blocks(&pages(), "rust")[..] else { panic!("one program") };
    assert!(example.contains(shown), "the policy of docs/policies.md is not that of policy-client/examples/wave.rs");
}

/// A folder in which the commands find what they name: the programs of the profile under test in `target/release`, where
/// `fiatlux` plays and draws less, and a `cargo` that runs them.
fn stage(scratch: &Scratch) -> PathBuf {
    let programs = program("fiatlux").parent().unwrap().to_owned();
    let (release, bin) = (scratch.path().join("target/release"), scratch.path().join("bin"));
    [&release, &bin].into_iter().for_each(|folder| std::fs::create_dir_all(folder).unwrap());
    for name in ["sim-server", "recorder", "policy-client", "scorer", "fiatlux-bench", "examples"] {
        std::os::unix::fs::symlink(programs.join(name), release.join(name)).unwrap();
    }
    let fiatlux = "case \"$*\" in\n\
        'evaluate --policy expert') set -- \"$@\" --seeds 0 --tasks S05,S08 ;;\n\
        'render '*.mp4*) set -- \"$@\" --size 160x90 --to 4 ;;\n\
        'render '*) set -- \"$@\" --size 160x90 ;;\n\
        esac\n";
    let fiatlux = format!("{fiatlux}exec {} \"$@\"\n", programs.join("fiatlux").display());
    let cargo = "case \"$*\" in\n\
        'run --release -p policy-client --example wave') exec target/release/examples/wave ;;\n\
        'run --release -p fiatlux-bench -- service') exec target/release/fiatlux-bench service --seconds 0.5 --sessions 3 ;;\n\
        'run --release -p fiatlux-bench -- sensors') exec target/release/fiatlux-bench sensors --seconds 0.5 ;;\n\
        'run --release -p fiatlux-bench -- batch') exec target/release/fiatlux-bench batch --worlds 8 --rounds 2 --seconds 0.05 ;;\n\
        'run --release -p fiatlux-bench -- camera') exec target/release/fiatlux-bench camera --alone --rounds 1 --seconds 0.05 ;;\n\
        'run --release -p fiatlux-bench -- shares') exec target/release/fiatlux-bench shares --chunks 1 ;;\n\
        'run --release -p fiatlux-bench -- violence') exec target/release/fiatlux-bench violence --runs 2 --starts 4 ;;\n\
        'run --release -p fiatlux-bench --features rapier -- world') exec target/release/fiatlux-bench world --seconds 0.5 ;;\n\
        'run --release -- '*) shift 3; exec target/release/fiatlux \"$@\" ;;\n\
        'build --release --workspace --bins --features network') ;;\n\
        *) echo \"unexpected: cargo $*\" >&2; exit 2 ;;\n\
        esac\n";
    for (path, script) in [(release.join("fiatlux"), fiatlux.as_str()), (bin.join("cargo"), cargo)] {
        std::fs::write(&path, format!("#!/bin/sh\n{script}")).unwrap();
        assert!(Command::new("chmod").arg("+x").arg(&path).status().unwrap().success());
    }
    bin
}

/// Commands of pages whose programs go on, as a reader takes them who has played `zero`: each in a terminal of its own, with the page's
/// addresses on this machine.
fn commands_work(page: &str, expected: usize) {
    let scratch = Scratch::new(&page.replace(['/', '.'], "-"));
    stage(&scratch);
    let ports = [("7447", free_port()), ("8080", free_port())];
    let lines = commands(&std::fs::read_to_string(repository().join(page)).unwrap());
    assert_eq!(lines.len(), expected, "{lines:#?}");
    if lines.iter().any(|line| line.contains("results/zero")) {
        let play = "target/release/fiatlux evaluate --policy zero --tasks S05,S07 --seeds 0 --out results/zero";
        assert!(Running::start_line(play, &scratch).finish(PATIENCE).0.success());
    }
    let mut terminals = Vec::new();
    for line in lines {
        let mut line = ports
            .iter()
            .fold(line.replace("192.168.1.7", "127.0.0.1"), |line, (port, free)| line.replace(port, &free.to_string()));
        // Ports that the page leaves to the programs.
        let flags = [
            ("fiatlux keys", " --port ", 0),
            ("sim-server --record", " --listen tcp/127.0.0.1:", 0),
            ("scorer serve", " --http 127.0.0.1:", 1),
        ];
        if let Some((_, flag, port)) = flags.into_iter().find(|(program, ..)| line.contains(program)) {
            line += &format!("{flag}{}", ports[port].1);
        }
        if line.contains("BAG") {
            wait_until("a bag is recorded", PATIENCE, || !scratch.files("s0-e0.mcap").is_empty());
            line = line.replace("BAG", &scratch.files("s0-e0.mcap")[0].display().to_string());
        }
        let ready = [
            ("fiatlux router", "router"),
            ("sim-server", " as lab"),
            ("sim-server --record", " as "),
            ("scorer serve", "http://"),
        ];
        let daemon = ready.iter().rfind(|(program, _)| line.contains(&format!("target/release/{program}")));
        match daemon {
            Some((_, says)) => {
                let mut running = Running::start_line(&line, &scratch);
                running.wait_for(says);
                terminals.push(running);
            }
            None if line.contains("target/release/recorder") => terminals.push(Running::start_line(&line, &scratch)),
            None => {
                let done = Command::new("bash").args(["-c", &line]).current_dir(scratch.path()).output().unwrap();
                let [out, log] = [&done.stdout, &done.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
                assert!(done.status.success(), "{line}: {}\n{out}\n{log}", done.status);
            }
        }
    }
}

#[test]
fn the_commands_of_access_work() {
    commands_work("docs/access.md", 6);
}

#[test]
fn the_commands_of_the_leaderboard_work() {
    commands_work("docs/leaderboard.md", 5);
}

/// A line with each number as 0: fewer rooms and tasks are played here than the pages name, so that S is not comparable, too.
fn form(line: &str) -> String {
    let mut text = String::new();
    for letter in line.chars() {
        let letter = if letter.is_ascii_digit() { '0' } else { letter };
        if letter != '0' || !text.ends_with('0') {
            text.push(letter);
        }
    }
    text
}

/// Compares what a page quotes below a command with what it printed: result and head of the table, and the columns of its rows.
fn assert_quoted(page: &str, command: &str, printed: &str) {
    let text = std::fs::read_to_string(repository().join(page)).unwrap();
    let (_, after) =
        text.split_once(&format!("{command}\n```\n\n```\n")).expect("the page quotes the command's output");
    let quoted: Vec<&str> = after.split("\n```").next().unwrap().lines().take_while(|line| *line != "...").collect();
    let printed: Vec<&str> = printed.lines().collect();
    let is_row = |line: &&str| Task::ALL.iter().any(|task| line.starts_with(&format!("{task} ")));
    let (rows, head): (Vec<&str>, Vec<&str>) = quoted.into_iter().partition(is_row);
    for (quoted, printed) in head.iter().zip(&printed) {
        let printed = printed.trim_end_matches(": not comparable");
        assert_eq!(form(quoted), form(printed), "{page}: {command} prints another line");
    }
    let width = printed.iter().find(|line| is_row(line)).expect("a row of the table").len();
    for row in &rows {
        let spec = Task::ALL.iter().find(|task| row.starts_with(&format!("{task} "))).unwrap().spec();
        assert!(row.len() == width && row.contains(spec.name), "{page}: a row is not as {command} prints it: {row}");
    }
    assert!(head.len() >= 4 && rows.len() >= 2, "{page} quotes a table");
}

/// Commands run in the order of the pages. Servers and recorders go on until the end; the second pair of machines is this
/// one, at another port, where each new server takes the place of the one before. `tests/run` is what runs this.
#[test]
fn every_command_works() {
    let scratch = Scratch::new("readme");
    let bin = stage(&scratch);
    let path = format!("{}:{}", bin.display(), std::env::var("PATH").unwrap());
    let (mut background, mut lab, mut external) = (Vec::new(), None, None);
    let (mut lab_port, mut second_port) = (free_port(), free_port());
    let mut quoted = 0;
    for line in blocks(&pages(), "sh").iter().flat_map(|block| block.lines()) {
        let listens_to_all = line.contains("0.0.0.0");
        // It stays next to the first one.
        let is_second = line.contains("--name lab-2");
        if listens_to_all && !is_second {
            drop(lab.take());
            (lab_port, second_port) = (free_port(), free_port());
        }
        let line = match listens_to_all || line.contains("192.168.1.7") {
            true => {
                let line = line.replace("0.0.0.0", "127.0.0.1").replace("192.168.1.7", "127.0.0.1");
                line.replace(":7447", &format!(":{lab_port}")).replace(":7448", &format!(":{second_port}"))
            }
            false => line.to_owned(),
        };
        if line.contains("fiatlux keys --out keys") && scratch.path().join("keys").exists() {
            std::fs::rename(scratch.path().join("keys"), scratch.path().join("moved-keys")).unwrap();
        }
        // One episode of the run is enough here.
        let line = if line.contains("policy-client evaluate") { line + " --tasks S07 --seeds 0" } else { line };
        let words: Vec<&str> = line.split_whitespace().collect();
        if line.contains("evaluate --external") {
            let out = scratch.path().join("results/lab").display().to_string();
            let args: Vec<&str> = words[1..].iter().copied().chain(["--out", &out]).collect();
            let mut running = Running::start("fiatlux", &args, &scratch);
            running.wait_for("policy-client evaluate");
            external = Some(running);
            continue;
        }
        let daemon = ["sim-server", "recorder"].into_iter().find(|name| words[0] == format!("target/release/{name}"));
        match daemon {
            _ if line == "tests/run" => {}
            Some(name) if words.get(1) != Some(&"export") => {
                let is_path = |word: &str| word == "bags" || word == "lab-runs" || word.starts_with("keys/");
                let place = |word: &&str| match is_path(word) {
                    true => scratch.path().join(word).display().to_string(),
                    false => (*word).to_owned(),
                };
                let args: Vec<String> = words[1..].iter().map(place).collect();
                let args: Vec<&str> = args.iter().map(String::as_str).collect();
                let mut running = Running::start(name, &args, &scratch);
                if name == "sim-server" {
                    running.wait_for("listening on");
                }
                match listens_to_all && !is_second {
                    true => lab = Some(running),
                    false => background.push(running),
                }
            }
            _ => {
                println!("{line}");
                let mut shell = Command::new("bash");
                shell.args(["-c", &line]).env("PATH", &path).current_dir(scratch.path()).stdin(Stdio::null());
                let done = shell.output().unwrap();
                let [out, log] = [&done.stdout, &done.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
                assert!(done.status.success(), "{line}: {}\n{out}\n{log}", done.status);
                assert!(!log.contains("file of known servers"), "{line}: {log}");
                if line.ends_with("evaluate --policy expert") {
                    assert_quoted("README.md", &line, &out);
                } else if line.ends_with("results/walk1000") && line.contains("evaluate") {
                    let result = out.lines().next().unwrap_or_default();
                    assert!(
                        pages().contains(&format!("`{result}`")),
                        "docs/index.md quotes another result than {result}"
                    );
                    quoted += 1;
                }
                assert!(!out.is_empty() || log.is_empty() || line.contains("export"), "{line} says nothing: {log}");
            }
        }
    }
    assert!(scratch.path().join("results/expert/report.html").exists());
    assert_eq!(quoted, 1, "docs/index.md quotes a result");
    let (status, _) = external.unwrap().finish(std::time::Duration::from_secs(60));
    assert!(status.success(), "{status}");
    assert!(scratch.path().join("results/lab/results.json").exists());
}
