//! Plays `hands` in rooms and prints phases, forces and the judge's criteria:
//! `cargo run -p fiatlux-policies --example hands -- S08 1000..1003 [trace] [FILE.toml]`.
#![allow(missing_docs)]

use std::sync::Arc;

use fiatlux_client::{Command, Policy};
use fiatlux_policies::Hands;
use fiatlux_proto::v3::{Joint, SessionInfo, TaskInfo};
use fiatlux_render::Lighting;
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{Bulb, Task, errand};
use fiatlux_sensing::{NoiseSeed, Sensor, SensorSuite, Sensors, Setup, View};
use fiatlux_world::{ACTION_SCALE, Episode, EpisodeSpec, Scene, SceneConfig};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [task, seeds, rest @ ..] = arguments.as_slice() else { return Err("TASK FIRST..LAST [trace] [FILE.toml]".into()) };
    let trace = rest.iter().any(|word| word == "trace");
    let task = *Task::ALL.iter().find(|known| format!("{known:?}") == *task).ok_or("no such task")?;
    let (first, last) = seeds.split_once("..").ok_or("FIRST..LAST")?;
    let robot = Arc::new(Robot::g1_inspire()?);
    let sensors = Sensors::of(&[Sensor::Proprioception, Sensor::HandContact, Sensor::LastAction, Sensor::Privileged]);
    let bulb = if task == Task::S08 { Bulb::Fresh } else { Bulb::Old };
    let (mut passed, mut played) = (0, 0);
    let (mut peaks, mut times) = (Vec::new(), Vec::new());
    for seed in first.parse::<u64>()?..=last.parse()? {
        let spec = EpisodeSpec::new(task, seed, 0);
        let gains = robot.gains(GainSet::default());
        let scene = Arc::new(Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec.scene(gains.clone()))?);
        let mut episode = Episode::start(Arc::clone(&scene), &spec)?;
        let mut suite = SensorSuite::new(sensors, Setup::new(&scene, task));
        suite.begin(&scene, NoiseSeed::of(&spec), || unreachable!("no camera"), Lighting::default())?;
        let joint = |((joint, q0), gains): ((&fiatlux_robot::Joint, &f64), &fiatlux_robot::JointGains)| Joint {
            name: joint.name.clone(),
            q0: *q0,
            stiffness: gains.stiffness,
            damping: gains.damping,
            effort_limit: gains.effort_limit,
            ..Joint::default()
        };
        let info = SessionInfo {
            task: Some(TaskInfo { task: format!("{task:?}"), ..TaskInfo::default() }),
            joints: robot.joints().iter().zip(robot.q0()).zip(&gains.0).map(joint).collect(),
            hand_bodies: robot.hand_links().iter().map(|&link| robot.links()[link].name.clone()).collect(),
            action_scale: ACTION_SCALE,
            control_dt: 0.02,
            ..SessionInfo::default()
        };
        let mut hands = Hands::new()?;
        if let Some(file) = rest.iter().find(|word| word.ends_with(".toml")) {
            hands = hands.with_parameters(std::fs::read_to_string(file)?);
        }
        let mut phase = String::new();
        let mut observation = suite.observe(&View::of(&episode), sensors)?;
        hands.reset(&info, &observation)?;
        let mut peak = 0.0_f64;
        while episode.end().is_none() {
            let Command::JointTarget(targets) = hands.act(&observation)? else { return Err("no targets".into()) };
            let action = episode.action_for(&targets);
            episode.step(&action)?;
            let row = episode.row();
            let forces = row.force(errand::HAND_FORCE[bulb as usize]);
            let force = forces.iter().map(|force| force.norm()).fold(0.0, f64::max);
            peak = peak.max(force);
            let now = hands.phase().unwrap_or_default();
            if trace && (now != phase || row.step % 10 == 0) {
                let thing = row.body(bulb.thing()).pose;
                let up = thing.rotation * nalgebra::Vector3::z();
                let pelvis = row.robot.pose.translation.vector;
                let at = thing.translation.vector;
                let touching: Vec<usize> = (0..forces.len()).filter(|&body| forces[body].norm() > 0.3).collect();
                println!(
                    "{:6.2} {now:9} force {force:5.1} on {touching:?} bulb {:.3} {:.3} {:.3} up {:.2} pelvis {:.3} {:.3} {:.3} {} {}",
                    row.step as f64 * 0.02, at.x, at.y, at.z, up.z, pelvis.x, pelvis.y, pelvis.z,
                    hands.report(), episode.verdict().count
                );
            }
            phase = now;
            observation = suite.observe(&View::of(&episode), sensors)?;
        }
        let end = episode.end().ok_or("no end")?;
        let (time, success) = (end.step as f64 * 0.02, format!("{:?}", end.cause()) == "Success");
        played += 1;
        passed += usize::from(success);
        peaks.push(peak);
        if success {
            times.push(time);
        }
        println!("{seed}: {:?} after {time:.1} s in {phase}, peak {peak:.1} N", end.cause());
    }
    let median = |numbers: &mut Vec<f64>| {
        numbers.sort_by(f64::total_cmp);
        numbers.get(numbers.len() / 2).copied().unwrap_or(f64::NAN)
    };
    println!("{passed} of {played}; median peak {:.1} N, median time {:.1} s", median(&mut peaks), median(&mut times));
    Ok(())
}
