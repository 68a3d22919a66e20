//! Lets a policy drive another simulator: a line of JSON in for each control step, a line out, as `python/benchmarks/policy_in_mujoco.py` does.
//! `cargo run -p fiatlux-policies --example drive -- hands S08 1000` is told of the benchmark's room 1000.
#![allow(missing_docs)]

use std::error::Error;
use std::io::{BufRead, Write};
use std::sync::Arc;

use fiatlux_client::Command;
use fiatlux_policies::Policies;
use fiatlux_proto::v3::{Observation, Pose, Privileged, Proprioception, SessionInfo};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{SeedOwner, Task};
use fiatlux_world::{EpisodeSpec, Scene, SceneConfig};
use serde::Deserialize;

/// Measurements of the other simulator; joints and hand bodies in the order of the first line out, quaternions w first.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Measured {
    step: u64,
    base_angular_velocity: Vec<f32>,
    projected_gravity: Vec<f32>,
    base_linear_velocity: Vec<f32>,
    base_height: f32,
    /// Relative to `q0` of the first line out, rad.
    joint_position: Vec<f32>,
    joint_velocity: Vec<f32>,
    hand_contact_force: Vec<f32>,
    last_action: Vec<f32>,
    robot: [f64; 7],
    ladder: [f64; 7],
    socket: [f64; 7],
    fresh_bulb: [f64; 7],
    old_bulb: [f64; 7],
    #[serde(rename = "crate")]
    crate_: [f64; 7],
    /// Held in the socket: old bulb, fresh bulb.
    seated: [bool; 2],
}

/// Answers lines with joint targets until there are no more. The first line out has the session's joints and hand bodies.
fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [policy, task, seed] = arguments.as_slice() else { return Err("POLICY TASK SEED".into()) };
    let mut policy = Policies::default().make(policy)?;
    let info = session(task.parse()?, SeedOwner::check_training(seed.parse()?)?)?;
    let joints: Vec<(&str, f64)> = info.joints.iter().map(|joint| (joint.name.as_str(), joint.q0)).collect();
    let mut out = std::io::stdout().lock();
    writeln!(out, "{}", serde_json::json!({ "joints": joints, "hand_bodies": info.hand_bodies }))?;
    out.flush()?;
    for (index, line) in std::io::stdin().lock().lines().enumerate() {
        let observation = observation(serde_json::from_str(&line?)?);
        if index == 0 {
            policy.reset(&info, &observation)?;
        }
        let Command::JointTarget(targets) = policy.act(&observation)? else { return Err("no targets".into()) };
        writeln!(out, "{}", serde_json::json!({ "targets": targets }))?;
        out.flush()?;
    }
    Ok(())
}

/// A session in a room.
fn session(task: Task, seed: u64) -> Result<SessionInfo, Box<dyn Error>> {
    let robot = Arc::new(Robot::benchmark()?);
    let of_scene = EpisodeSpec::new(task, seed, 0).scene(robot.gains(GainSet::default()));
    Ok(fiatlux_wire::session_terms(task, &Scene::build(&SceneConfig::default(), robot, of_scene)?))
}

fn observation(measured: Measured) -> Observation {
    let pose = |[x, y, z, w, i, j, k]: [f64; 7]| Some(Pose { position: vec![x, y, z], quaternion: vec![w, i, j, k] });
    Observation {
        step: measured.step,
        proprioception: Some(Proprioception {
            base_angular_velocity: measured.base_angular_velocity,
            projected_gravity: measured.projected_gravity,
            base_linear_velocity: measured.base_linear_velocity,
            base_height: measured.base_height,
            joint_position: measured.joint_position,
            joint_velocity: measured.joint_velocity,
        }),
        hand_contact_force: measured.hand_contact_force,
        last_action: measured.last_action,
        privileged: Some(Privileged {
            robot: pose(measured.robot),
            ladder: pose(measured.ladder),
            socket: pose(measured.socket),
            fresh_bulb: pose(measured.fresh_bulb),
            old_bulb: pose(measured.old_bulb),
            crate_: pose(measured.crate_),
            seated: measured.seated.to_vec(),
            ..Privileged::default()
        }),
        ..Observation::default()
    }
}
