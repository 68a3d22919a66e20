//! Stunts: open-loop traces that pass a published gate without doing the task, and what the strict judge says of them.
//!
//! `examples/stunts` found them and finds others; `docs/stunts.md` describes them. They still pass after changes of their
//! knots that are far larger than what another order of roundings makes.

use std::ops::ControlFlow;
use std::path::Path;

use fiatlux_rules::{Cause, Protocol, Task};

#[expect(dead_code, reason = "the search uses more of it")]
#[path = "../../examples/stunts/trace.rs"]
mod trace;

use self::trace::{Runs, Stage, TAIL_STEPS, Trace, is_clean_success};

/// A fixture, and the criteria that never hold for the strict window.
const STUNTS: &[(&str, &[&str])] = &[
];

fn read(name: &str) -> Trace {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/stunts");
    Trace::read(&folder.join(name).with_extension("toml")).unwrap()
}

/// Each is a clean success by the published gate and none by the strict one.
#[test]
fn stunts_pass_published_and_fail_strict() {
    for (name, too_short) in STUNTS {
        let trace = read(name);
        let task: Task = trace.task.parse().unwrap();
        let again = format!(
            "{name}: if physics changed, find it again: cargo run --release -p fiatlux-world --example stunts -- \
             search {task} --out crates/world/tests/stunts/{name}.toml"
        );
        let mut runs = Runs::new(task, Protocol::Strict);
        let episode = Stage::of(&trace).unwrap().play(&trace, TAIL_STEPS, |episode| {
            runs.follow(episode);
            ControlFlow::Continue(())
        });
        let episode = episode.unwrap();
        let [published, strict] = Protocol::ALL.map(|protocol| episode.judges().of(protocol));
        assert!(is_clean_success(published), "{:?}; {again}", published.verdict());
        assert!(!strict.verdict().success, "{name} passes strict: {:?}", strict.verdict());
        let found: Vec<&str> = runs.too_short(task).into_iter().map(|(name, _)| name).collect();
        assert_eq!(found, *too_short, "{again}");
        assert_eq!(strict.first_met(Cause::Success), None, "{name}");
    }
}
