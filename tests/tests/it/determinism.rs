//! The same bytes from the same inputs: in two processes, next to another world, and from any row.

use std::process::Command;
use std::sync::Arc;
use std::sync::mpsc;

use fiatlux_robot::GainSet;
use fiatlux_rules::Row;
use fiatlux_tests::{at_full_length, robot, scene};
use fiatlux_world::{ACTION_SCALE, Random, SceneKind, Stream, World};

/// The G1 with Inspire hands.
const JOINTS: usize = 53;

/// Tells a copy of this test binary to print its digest and stop.
const CHILD: &str = "FIATLUX_DIGEST_CHILD";

/// The action of a step, whatever was stepped before.
fn action(step: u64) -> [f64; JOINTS] {
    let mut random = Random::new(Stream::Noise, 1, step);
    std::array::from_fn(|_| random.uniform(-1.0, 1.0))
}

fn world() -> World {
    World::new(scene(SceneKind::FreeLadder, 3, robot().gains(GainSet::Fiatlux)))
}

fn advance(world: &mut World) {
    let action = action(world.row().step);
    let q0: Vec<f64> = world.scene().robot.q0().to_vec();
    let target: [f64; JOINTS] = std::array::from_fn(|j| q0[j] + ACTION_SCALE * action[j]);
    world.step(&action, &target).unwrap();
}

/// Digest over the rows up to `until`, and the row at `keep`.
fn run(world: &mut World, until: u64, keep: u64) -> (String, Option<Row>) {
    let mut digest = fiatlux_rules::RowDigest::new(b"determinism");
    let mut kept = None;
    while world.row().step < until {
        advance(world);
        digest.push(world.row());
        if world.row().step == keep {
            kept = Some(world.row().clone());
        }
    }
    (digest.hex(), kept)
}

#[test]
fn two_processes_and_two_worlds_give_the_same_digest() {
    let mut first = world();
    let steps = if at_full_length() { 6000 } else { 1500 };
    let (alone, _) = run(&mut first, steps, 0);
    if std::env::var_os(CHILD).is_some() {
        println!("digest {alone}");
        return;
    }
    let (send, receive) = mpsc::channel();
    for mut world in [world(), world()] {
        let send = send.clone();
        std::thread::spawn(move || send.send(run(&mut world, steps, 0).0).unwrap());
    }
    assert_eq!([alone.as_str(); 2], [receive.recv().unwrap(), receive.recv().unwrap()]);

    let child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "determinism::two_processes_and_two_worlds_give_the_same_digest", "--nocapture"])
        .env(CHILD, "1")
        .output()
        .unwrap();
    let output = String::from_utf8(child.stdout).unwrap();
    assert!(output.contains(&format!("digest {alone}")), "another process gave {output}, this one {alone}");
}

#[test]
fn a_restart_from_any_row_gives_the_same_bytes() {
    let mut original = world();
    for keep in [1, 77, 1234] {
        let (_, row) = run(&mut original, keep, keep);
        let row = row.unwrap();
        let mut restarted = World::new(Arc::clone(original.scene()));
        // Scratch memory of another past must not show.
        for _ in 0..50 {
            advance(&mut restarted);
        }
        restarted.reset_to(&row).unwrap();
        let until = keep + 500;
        let mut continued = original.clone();
        assert_eq!(run(&mut restarted, until, 0).0, run(&mut continued, until, 0).0, "restart at {keep}");
    }
}

/// A change of the engine's bytes must be a decision, not an accident: whoever makes it renews this digest. It is the same
/// in debug and release builds.
#[test]
fn the_first_second_has_the_recorded_digest() {
    let (digest, _) = run(&mut world(), 50, 0);
    assert_eq!(digest, "b2aaa97767b10d5d3de8d3fa9914b5874d5c6ec3f5cb3efcf6c4f42250985630");
}
