//! Microseconds of readings, inverse kinematics and forces of supports on one thread, and how often they find what they are
//! asked for: `cargo run --release -p fiatlux-kinematics --example time_kinematics`.

#![allow(clippy::disallowed_methods)] // It measures time.

use std::error::Error;
use std::hint::black_box;
use std::time::{Duration, Instant};

use fiatlux_dynamics::{BodyId, Model, ModelBuilder, State};
use fiatlux_kinematics::{Acceleration, Goal, InverseKinematics, Mechanics, Site, Support, SupportSolver};
use fiatlux_robot::{BuildOptions, Robot, RobotIds};
use fiatlux_world::{Random, Stream};
use nalgebra::{Isometry3, Vector3};

/// Readings are timed this often, and inverse kinematics and stances solved.
const READINGS: usize = 20_000;
const TARGETS: usize = 10_000;
const STANCES: usize = 5_000;

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// Prints a row: mean, median and 99th percentile.
fn report(name: &str, mut samples: Vec<Duration>, solved: Option<usize>) {
    samples.sort_unstable();
    let count = samples.len();
    let micros = |time: Duration| time.as_secs_f64() * 1e6;
    let mean = micros(samples.iter().sum()) / count as f64;
    let share = solved.map_or("-".into(), |solved| format!("{:.2}", 100.0 * solved as f64 / count as f64));
    let (median, late) = (micros(samples[count / 2]), micros(samples[count * 99 / 100]));
    println!("| {name:<46} | {count:>6} | {mean:>7.2} | {median:>7.2} | {late:>7.2} | {share:>9} |");
}

/// The robot in the air.
struct Stage {
    robot: Robot,
    model: Model,
    ids: RobotIds,
    random: Random,
}

impl Stage {
    fn new(name: &str) -> Result<Self> {
        let robot = Robot::by_name(name)?;
        let mut builder = ModelBuilder::new();
        let placed = robot.add_to(&mut builder, &BuildOptions::new(&robot))?;
        let model = builder.build()?;
        let ids = placed.ids(&model)?;
        Ok(Self { robot, model, ids, random: Random::new(Stream::Reset, 36, 0) })
    }

    fn site(&self, name: &str) -> Result<Site> {
        let site = self.robot.sites().into_iter().find(|site| site.name == name).ok_or("the robot lacks a site")?;
        Ok(self.ids.site(&site))
    }

    fn standing(&self) -> State {
        let mut state = self.model.reference_state();
        self.ids.joints.iter().zip(self.robot.q0()).for_each(|(joint, q0)| state.qpos[joint.qpos] = *q0);
        state
    }

    /// Bodies of the joints whose names contain one of these parts.
    fn joints(&self, parts: &[String]) -> Vec<BodyId> {
        let joints = self.robot.joints().iter().zip(&self.ids.joints);
        let named = joints.filter(|(joint, _)| parts.iter().any(|part| joint.name.contains(part)));
        named.map(|(_, ids)| ids.body).collect()
    }

    /// Draws the angles of these joints.
    fn draw(&mut self, joints: &[BodyId], state: &mut State) {
        for (joint, ids) in self.robot.joints().iter().zip(&self.ids.joints) {
            if joints.contains(&ids.body) {
                state.qpos[ids.qpos] = self.random.uniform(joint.lower, joint.upper);
            }
        }
    }
}

fn main() -> Result<()> {
    println!("| call{:42} |  calls | mean us | p50, us | p99, us | solved, % |", "");
    println!("|-{:-<46}-|-------:|--------:|--------:|--------:|----------:|", "");
    let mut stage = Stage::new(Robot::NAMES[0])?;
    readings(&stage)?;
    for side in ["left", "right"] {
        for (with, waist) in [("", false), (" and waist", true)] {
            let mut parts: Vec<String> = ["shoulder", "elbow", "wrist"].map(|part| format!("{side}_{part}")).into();
            parts.extend(waist.then(|| "waist".to_owned()));
            inverse(&mut stage, side, &parts, &format!("pose of the {side} palm, by arm{with}"))?;
        }
    }
    let mut bare = Stage::new("g1_bare")?;
    supports(&mut bare, "forces of two soles", false)?;
    supports(&mut bare, "forces of two soles and two palms", true)
}

fn readings(stage: &Stage) -> Result<()> {
    let (model, root, nv) = (&stage.model, stage.ids.root, stage.model.nv());
    let (palm, state) = (stage.site("left_palm")?, stage.standing());
    let mut mechanics = Mechanics::new(model);
    let (mut jacobian, mut matrix, mut forces) = (vec![0.0; 6 * nv], vec![0.0; nv * nv], vec![0.0; nv]);
    let acceleration = vec![1.0; nv];
    mechanics.update_equation(model, &state);
    let mut time = |name: &str, call: &mut dyn FnMut(&mut Mechanics)| {
        let mut samples = Vec::with_capacity(READINGS);
        for _ in 0..READINGS {
            let start = Instant::now();
            call(&mut mechanics);
            samples.push(start.elapsed());
        }
        report(name, samples, None);
    };

    time("poses and velocities of all links", &mut |m| m.update(model, black_box(&state)));
    time("the same, mass matrix and bias force", &mut |m| m.update_equation(model, black_box(&state)));
    time("Jacobian of a palm", &mut |m| m.jacobian(model, black_box(&palm), &mut jacobian));
    time("Jacobian of the centre of mass", &mut |m| m.com_jacobian(model, root, &mut jacobian[..3 * nv]));
    time("mass matrix, in full", &mut |m| m.mass_matrix(model, &mut matrix));
    time("inverse dynamics", &mut |m| m.inverse_dynamics(model, black_box(&acceleration), &mut forces));
    Ok(())
}

fn inverse(stage: &mut Stage, side: &str, parts: &[String], name: &str) -> Result<()> {
    let (joints, palm) = (stage.joints(parts), stage.site(&format!("{side}_palm"))?);
    let mut solver = InverseKinematics::new(&stage.model, stage.ids.root, &joints, false)?;
    let (mut mechanics, start) = (Mechanics::new(&stage.model), stage.standing());
    let (mut state, mut samples, mut solved) = (start.clone(), Vec::with_capacity(TARGETS), 0);
    for _ in 0..TARGETS {
        stage.draw(&joints, &mut state);
        mechanics.update(&stage.model, &state);
        let target = mechanics.world_from_site(&palm);
        state.qpos.copy_from_slice(&start.qpos);
        let clock = Instant::now();
        let found = solver.solve(&stage.model, &mut state, &[Goal::pose(palm, target)])?;
        samples.push(clock.elapsed());
        solved += usize::from(found.position_error < 1e-3 && found.rotation_error < 0.01);
    }
    report(name, samples, Some(solved));
    Ok(())
}

fn supports(stage: &mut Stage, name: &str, palms: bool) -> Result<()> {
    let firm = |body, point, normal, most| Support { body, point, normal, friction: 0.8, most };
    let mut all = Vec::new();
    for sole in stage.robot.soles() {
        let body = stage.ids.site(&sole.site).body;
        all.extend(sole.corners().map(|point| firm(body, point, Vector3::z_axis(), f64::INFINITY)));
    }
    for (palm, normal) in
        [("left_palm", -Vector3::y_axis()), ("right_palm", Vector3::y_axis())].into_iter().filter(|_| palms)
    {
        let Site { body, body_from_site: Isometry3 { translation, .. } } = stage.site(palm)?;
        all.push(firm(body, translation.vector, normal, 50.0));
    }
    let mut solver = SupportSolver::new(&stage.model, stage.ids.root)?;
    let (mut mechanics, start) = (Mechanics::new(&stage.model), stage.standing());
    let (mut state, mut samples, mut solved) = (start.clone(), Vec::with_capacity(STANCES), 0);
    for _ in 0..STANCES {
        for (joint, q0) in stage.ids.joints.iter().zip(stage.robot.q0()) {
            state.qpos[joint.qpos] = q0 + stage.random.uniform(-0.05, 0.05);
        }
        mechanics.update_equation(&stage.model, &state);
        let wanted =
            Acceleration { com: Vector3::new(stage.random.uniform(-0.5, 0.5), 0.0, 0.0), ..Acceleration::default() };
        let clock = Instant::now();
        let result = solver.solve(&stage.model, &mut mechanics, &all, &wanted);
        samples.push(clock.elapsed());
        solved += usize::from(result.is_ok());
    }
    report(name, samples, Some(solved));
    Ok(())
}
