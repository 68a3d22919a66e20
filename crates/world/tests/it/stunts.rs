//! Stunts: open-loop traces that pass a published gate without doing the task, and what the strict judge says of them.
//!
//! `examples/stunts` found them and finds others; `docs/stunts.md` describes them. They still pass after changes of their
//! knots by 1e-3 rad, far more than another order of roundings makes.

use std::ops::ControlFlow;
use std::path::Path;

use fiatlux_rules::Protocol;
use fiatlux_world::Episode;

#[expect(dead_code, reason = "the search uses more of it")]
#[path = "../../examples/stunts/trace.rs"]
mod trace;

use self::trace::{Runs, Stage, TAIL_STEPS, Trace, is_clean_success};

fn replay(name: &str) -> (Episode, Vec<&'static str>) {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/stunts").join(name).with_extension("toml");
    let trace = Trace::read(&file).unwrap();
    let stage = Stage::of(&trace).unwrap();
    let mut runs = Runs::new(stage.task(), Protocol::Strict);
    let episode = stage.play(&trace, TAIL_STEPS, |episode| {
        runs.follow(episode);
        ControlFlow::Continue(())
    });
    (episode.unwrap(), runs.too_short(stage.task()).into_iter().map(|(criterion, _)| criterion).collect())
}

/// Remedy to print where a trace no longer does what it did.
fn remedy(name: &str, protocol: Protocol) -> String {
    let task = name[..3].to_uppercase();
    format!(
        "{name}: if physics changed, find another one: cargo run --release -p fiatlux-world --example stunts -- \
         search {task} --protocol {protocol} --out crates/world/tests/stunts/{name}.toml"
    )
}

/// Each is a clean success by the published gate and none by the strict one. Which strict criteria never hold for their window,
/// and what spoils it (broken, dropped, leapt), shows what a change of the rules does.
#[test]
fn stunts_pass_published_and_fail_strict() {
    let stunts: [(&str, &[&str], [bool; 3]); 5] = [
        ("s02_jump", &["at_ladder_top", "carried_by_treads", "upright"], [false, false, true]),
        ("s03_snatch", &["old_bulb_in_grip"], [true, false, false]),
        ("s04_leap", &["carried_by_floor"], [true, false, true]),
        ("s06_swing", &["old_bulb_in_crate", "old_bulb_at_rest", "carried_by_floor"], [true, false, false]),
        ("s12_drop", &["at_ladder_foot", "carried_by_floor", "upright"], [false, false, true]),
    ];
    for (name, too_short, spoilt) in stunts {
        let (episode, found) = replay(name);
        let remedy = remedy(name, Protocol::Published);
        let [published, strict] = Protocol::ALL.map(|protocol| episode.judges().of(protocol));
        assert!(is_clean_success(published), "{:?}; {remedy}", published.verdict());
        let verdict = strict.verdict();
        assert!(!verdict.success, "{name} passes strict: {verdict:?}");
        assert_eq!(
            (found.as_slice(), [verdict.broken, verdict.dropped, verdict.leapt]),
            (too_short, spoilt),
            "{remedy}"
        );
    }
}

/// A grip so loose that the bulb counts as released before it is where it belongs: half of the published progress of S11 costs
/// nothing.
#[test]
fn a_loose_grip_earns_nothing_strict() {
    let (episode, _) = replay("s11_loose_grip");
    let [published, strict] = Protocol::ALL.map(|protocol| episode.judges().of(protocol).verdict());
    assert_eq!((published.progress, strict.progress, strict.success), (0.5, 0.0, false), "{strict:?}");
}

/// A bulb that an arm presses and throws up is neither gripped nor lifted, whatever the published progress says.
#[test]
fn a_pressed_bulb_earns_nothing_strict() {
    let (episode, too_short) = replay("s08_press");
    let [published, strict] = Protocol::ALL.map(|protocol| episode.judges().of(protocol).verdict());
    assert_eq!((published.progress, strict.progress, strict.success), (1.0, 0.0, false), "{strict:?}");
    assert_eq!(too_short, ["fresh_bulb_lifted", "fresh_bulb_in_grip"]);
}
