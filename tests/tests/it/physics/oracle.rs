//! The engine against MuJoCo: fixtures written by `tests/oracle/oracle.py` from our own export.

mod contacts;

use std::path::Path;

use fiatlux_dynamics::{Dynamics, Geometry, Input, Joint, Mechanics, Model, ModelBuilder, ShapeSpec, State};
use fiatlux_mjcf::ExportScene;
use fiatlux_robot::{BuildOptions, Robot};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde::Deserialize;
use serde::de::DeserializeOwned;

pub fn fixture<T: DeserializeOwned>(name: &str) -> T {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("oracle/fixtures/{name}.json"));
    let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_str(&text).unwrap()
}

fn check_bodies(model: &Model, names: &[String]) {
    let ours: Vec<&str> = model.bodies().iter().skip(1).map(|b| b.spec.name.as_str()).collect();
    let theirs: Vec<&str> = names.iter().map(String::as_str).filter(|name| *name != "world").collect();
    assert_eq!(ours, theirs, "the fixtures are of another model; run tests/oracle/oracle.py all");
}

pub fn rotation(qpos: &[f64]) -> UnitQuaternion<f64> {
    UnitQuaternion::new_normalize(Quaternion::new(qpos[3], qpos[4], qpos[5], qpos[6]))
}

/// Largest difference of root position (m), root rotation (rad) and joints (rad).
fn gaps(a: &[f64], b: &[f64]) -> [f64; 3] {
    let largest = |range: std::ops::Range<usize>| range.map(|k| (a[k] - b[k]).abs()).fold(0.0, f64::max);
    [largest(0..3), rotation(a).angle_to(&rotation(b)), largest(7..a.len())]
}

#[derive(Deserialize)]
struct DynamicsFixture {
    bodies: Vec<String>,
    probes: Vec<Vec<f64>>,
    states: Vec<DynamicsState>,
}

#[derive(Deserialize)]
struct DynamicsState {
    qpos: Vec<f64>,
    qvel: Vec<f64>,
    bias: Vec<f64>,
    mass_times_probe: Vec<Vec<f64>>,
    mass_lower: Option<Vec<f64>>,
}

#[test]
fn mass_matrix_and_bias_force_are_those_of_mujoco() {
    check_dynamics("g1_inspire", "dynamics");
}

/// MuJoCo has the welded fingers' masses as ours merges them into the wrists' bodies.
#[test]
fn those_of_the_robot_with_welded_fingers_too() {
    check_dynamics("g1_bare", "dynamics_bare");
    check_dynamics("g1_dex3", "dynamics_dex3");
}

fn check_dynamics(robot: &str, name: &str) {
    let scene = ExportScene::robot_only(robot, false).unwrap();
    let fixture: DynamicsFixture = fixture(name);
    check_bodies(&scene.model, &fixture.bodies);
    assert_eq!(fixture.states.len(), 20);
    let nv = scene.model.nv();
    let mut mechanics = Mechanics::new(&scene.model);
    let mut matrix = vec![0.0; nv * nv];
    let relative = |ours: &[f64], theirs: &[f64]| {
        let scale = theirs.iter().map(|v| v.abs()).fold(0.0, f64::max);
        ours.iter().zip(theirs).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / scale
    };
    let (mut mass_error, mut bias_error) = (0.0_f64, 0.0_f64);
    for expected in &fixture.states {
        let state = State { qpos: expected.qpos.clone(), qvel: expected.qvel.clone() };
        mechanics.update_equation(&scene.model, &state);
        mechanics.mass_matrix(&scene.model, &mut matrix);
        for (probe, product) in fixture.probes.iter().zip(&expected.mass_times_probe) {
            let row = |r: usize| (0..nv).map(|c| matrix[r * nv + c] * probe[c]).sum();
            let ours: Vec<f64> = (0..nv).map(row).collect();
            mass_error = mass_error.max(relative(&ours, product));
        }
        if let Some(lower) = &expected.mass_lower {
            let ours: Vec<f64> = (0..nv).flat_map(|r| matrix[r * nv..r * nv + r + 1].to_vec()).collect();
            mass_error = mass_error.max(relative(&ours, lower));
        }
        bias_error = bias_error.max(relative(mechanics.bias_force(), &expected.bias));
    }
    println!("{name}: relative error over 20 states: mass matrix {mass_error:.1e}, bias force {bias_error:.1e}");
    assert!(mass_error < 1e-9 && bias_error < 1e-9);
}

#[derive(Deserialize)]
struct Tumble {
    bodies: Vec<String>,
    timestep: f64,
    targets: Vec<f64>,
    rows: Vec<TumbleRow>,
    fine_rows: Vec<TumbleRow>,
}

#[derive(Deserialize)]
struct TumbleRow {
    qpos: Vec<f64>,
    qvel: Vec<f64>,
}

/// A robot in the air without contacts: MuJoCo has them disabled.
fn without_shapes(robot: &str) -> (Model, State) {
    let ExportScene { model, state, .. } = ExportScene::robot_only(robot, false).unwrap();
    let mut builder = ModelBuilder::new();
    for body in &model.bodies()[1..] {
        builder.add_body(body.spec.clone()).unwrap();
    }
    model.couplings().for_each(|coupling| builder.couple(*coupling).unwrap());
    (builder.build().unwrap(), state)
}

#[test]
fn a_tumble_in_the_air_is_that_of_mujoco_and_nearer_to_its_limit_at_5_ms_than_its_own_at_1_ms() {
    let fixture: Tumble = fixture("tumble");
    let (model, _) = without_shapes("g1_inspire");
    check_bodies(&model, &fixture.bodies);
    let start = State { qpos: fixture.rows[0].qpos.clone(), qvel: fixture.rows[0].qvel.clone() };
    // Rows are 0.1 s apart.
    let roll = |dt: f64| {
        let mut state = start.clone();
        let mut dynamics = Dynamics::new(&model);
        let mut rows = vec![state.qpos.clone()];
        for _ in 0..10 {
            for _ in 0..(0.1 / dt).round() as usize {
                let report =
                    dynamics.step(&model, &mut state, &Input { targets: &fixture.targets, ..Input::default() }, dt);
                assert!(report.converged);
            }
            rows.push(state.qpos.clone());
        }
        rows
    };
    let mut worst = [0.0_f64; 3];
    for (ours, theirs) in roll(fixture.timestep).iter().zip(&fixture.rows) {
        for (w, g) in worst.iter_mut().zip(gaps(ours, &theirs.qpos)) {
            *w = w.max(g);
        }
    }
    println!("1 ms against MuJoCo: root {:.1e} m, {:.1e} rad, joints {:.1e} rad", worst[0], worst[1], worst[2]);
    assert!(worst[0] < 5e-3 && worst[2] < 5e-3);

    let exact = &fixture.fine_rows.last().unwrap().qpos;
    let errors = [0.005, 0.0025, 0.00125].map(|dt| gaps(roll(dt).last().unwrap(), exact));
    let theirs = gaps(&fixture.rows.last().unwrap().qpos, exact);
    println!("error against MuJoCo's limit at 5, 2.5 and 1.25 ms: {errors:?}; MuJoCo at 1 ms: {theirs:?}");
    // Where the robot flies is of second order; joints are of first order, by the implicit drives.
    assert!(errors[0][0] < 0.25 * theirs[0] && errors[0][2] < 4e-3);
    for k in [0, 2] {
        assert!(errors[1][k] < errors[0][k] && errors[2][k] < errors[1][k], "smaller steps are nearer: {errors:?}");
    }
}

#[derive(Deserialize)]
struct Closing {
    bodies: Vec<String>,
    /// Indices of the fingers' joints in `qpos`; rows have these alone, 0.05 s apart.
    fingers: Vec<usize>,
    targets: Vec<f64>,
    fine_rows: Vec<Vec<f64>>,
    soft_error: f64,
}

/// One hand closes within its range, the other to its stops; MuJoCo ties the joints with equalities, at 16 us as hard as its stops.
#[test]
fn hands_with_coupled_joints_close_as_in_mujoco_within_the_error_of_the_step() {
    let fixture: Closing = fixture("closing");
    let (model, start) = without_shapes("g1_inspire6");
    check_bodies(&model, &fixture.bodies);
    let roll = |dt: f64| {
        let (mut dynamics, mut state) = (Dynamics::new(&model), start.clone());
        let mut rows = Vec::new();
        for row in 0..fixture.fine_rows.len() {
            for _ in 0..if row > 0 { (0.05 / dt).round() as usize } else { 0 } {
                let input = Input { targets: &fixture.targets, ..Input::default() };
                assert!(dynamics.step(&model, &mut state, &input, dt).converged);
            }
            rows.push(fixture.fingers.iter().map(|&at| state.qpos[at]).collect::<Vec<_>>());
        }
        rows
    };
    let apart = |a: &[Vec<f64>], b: &[Vec<f64>]| {
        a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    };
    let runs = [5e-3, 2.5e-3, 1.25e-3, 0.625e-3].map(roll);
    let own = runs[..3].iter().map(|run| apart(run, &runs[3])).collect::<Vec<_>>();
    let theirs = runs.iter().map(|run| apart(run, &fixture.fine_rows)).collect::<Vec<_>>();
    println!("from MuJoCo at 16 us, at 5, 2.5, 1.25 and 0.625 ms: {theirs:?} rad; from our own at 0.625 ms: {own:?}");
    println!("MuJoCo at 1 ms with its usual stops is {} rad from itself at 16 us", fixture.soft_error);
    assert!(theirs[0] < 0.015 && theirs[3] < 1.5e-3, "{theirs:?}");
    for (at, pair) in theirs.windows(2).enumerate() {
        assert!(pair[1] < 0.6 * pair[0], "smaller steps are nearer: {theirs:?}");
        // By the first order of a step, its error is twice what half the step changes.
        assert!(pair[0] < 2.2 * apart(&runs[at], &runs[at + 1]), "{theirs:?} is more than the step's own error");
    }
    // The right fists are at their stops, and every follower is where its leader has it.
    let last = &runs[0][fixture.fine_rows.len() - 1];
    let at_stop = fixture.fingers.iter().zip(last).filter(|(at, angle)| {
        let body = model.bodies().iter().find(|body| body.qpos_start == **at && body.dof_start > 5).unwrap();
        let Joint::Hinge(hinge) = &body.spec.joint else { panic!("a finger is a hinge") };
        (hinge.upper - **angle).abs() < 0.01
    });
    assert_eq!(at_stop.count(), 12, "the right hand is closed to its stops");
}

/// The robot over a floor, as exported, stiffness and damping of its ankles scaled.
fn robot_on_floor(ankles: f64) -> Model {
    let robot = Robot::benchmark().unwrap();
    let mut options = BuildOptions::new(&robot);
    options.gains.scale((0..robot.joints().len()).filter(|j| robot.joints()[*j].name.contains("ankle")), ankles);
    let mut builder = ModelBuilder::new();
    let placed = robot.add_to(&mut builder, &options).unwrap();
    let exported = ExportScene::robot_only("g1_inspire", true).unwrap().model;
    let floor = exported.shapes().iter().find(|shape| shape.geometry == Geometry::HalfSpace).unwrap();
    builder.add_shape(ShapeSpec { cull_group: placed.next_cull_group, ..floor.clone() }).unwrap();
    builder.build().unwrap()
}

#[derive(Deserialize)]
struct FallZeroAction {
    bodies: Vec<String>,
    fallen_height: f64,
    targets: Vec<f64>,
    cases: Vec<FallCase>,
}

#[derive(Deserialize)]
struct FallCase {
    start_qpos: Vec<f64>,
    step_5ms: FallTime,
    step_1ms: FallTime,
}

#[derive(Deserialize)]
struct FallTime {
    fall_seconds: f64,
    direction: String,
}

#[test]
fn zero_action_takes_as_long_to_fall_as_in_mujoco() {
    let fixture: FallZeroAction = fixture("fall_zero_action");
    let model = robot_on_floor(1.0);
    check_bodies(&model, &fixture.bodies);
    let dt = 0.005;
    for (number, case) in fixture.cases.iter().enumerate() {
        let mut state = State { qpos: case.start_qpos.clone(), qvel: vec![0.0; model.nv()] };
        let mut dynamics = Dynamics::new(&model);
        let mut seconds = 0.0;
        while state.qpos[2] > fixture.fallen_height {
            let before = state.qpos[2];
            let report =
                dynamics.step(&model, &mut state, &Input { targets: &fixture.targets, ..Input::default() }, dt);
            assert!(report.converged);
            let part = if state.qpos[2] > fixture.fallen_height {
                1.0
            } else {
                (before - fixture.fallen_height) / (before - state.qpos[2])
            };
            seconds += part * dt;
            assert!(seconds < 5.0, "case {number} does not fall");
        }
        let theirs = case.step_5ms.fall_seconds;
        println!("case {number}: {seconds:.3} s; MuJoCo {theirs:.3} s ({:.3} s at 1 ms)", case.step_1ms.fall_seconds);
        let heading = rotation(&case.start_qpos) * Vector3::x();
        let way = Vector3::from_column_slice(&state.qpos[..3]) - Vector3::from_column_slice(&case.start_qpos[..3]);
        let direction = if way.dot(&heading) > 0.0 { "forward" } else { "backward" };
        assert_eq!([direction, case.step_5ms.direction.as_str()], ["forward"; 2]);
        assert!((seconds / theirs - 1.0).abs() < 0.05);
    }
}

#[derive(Deserialize)]
struct FallAnklesOff {
    bodies: Vec<String>,
    duration: f64,
    start_qpos: Vec<f64>,
    targets: Vec<f64>,
    runs: Vec<RestRun>,
    other_laws: Vec<RestRun>,
}

#[derive(Deserialize)]
struct RestRun {
    qpos: Vec<f64>,
}

/// Largest gaps between any two runs.
fn spread(runs: &[&RestRun]) -> [f64; 3] {
    let pairs = runs.iter().flat_map(|a| runs.iter().map(|b| gaps(&a.qpos, &b.qpos)));
    pairs.reduce(|a, b| [0, 1, 2].map(|k| a[k].max(b[k]))).unwrap()
}

/// Gaps to the run whose root is nearest.
fn nearest(qpos: &[f64], runs: &[&RestRun]) -> [f64; 3] {
    runs.iter().map(|run| gaps(qpos, &run.qpos)).min_by(|a, b| a[0].total_cmp(&b[0])).unwrap()
}

/// The bar is twice MuJoCo's own spread. The root meets it. The joints do not under MuJoCo's default law of contact, whose
/// friction creeps: the wrists under the hands that the robot lands on unwind there for many seconds, here they stay
/// twisted. They meet it against the nearest of MuJoCo's laws of contact.
#[test]
fn a_fall_with_free_ankles_comes_to_rest_where_mujoco_does_but_for_creep() {
    let fixture: FallAnklesOff = fixture("fall_ankles_off");
    let model = robot_on_floor(0.0);
    check_bodies(&model, &fixture.bodies);
    let default_law: Vec<&RestRun> = fixture.runs.iter().collect();
    let all_laws: Vec<&RestRun> = fixture.runs.iter().chain(&fixture.other_laws).collect();
    let bar = spread(&default_law).map(|s| 2.0 * s);
    println!("bar, twice MuJoCo's spread (root m, root rad, joints rad): {bar:.3?}");
    for dt in [0.005, 0.002, 0.001] {
        let mut state = State { qpos: fixture.start_qpos.clone(), qvel: vec![0.0; model.nv()] };
        let mut dynamics = Dynamics::new(&model);
        for _ in 0..(fixture.duration / dt).round() as usize {
            let input = Input { targets: &fixture.targets, ..Input::default() };
            assert!(dynamics.step(&model, &mut state, &input, dt).converged);
        }
        let (to_default, to_all) = (nearest(&state.qpos, &default_law), nearest(&state.qpos, &all_laws));
        println!("at {dt} s, from the nearest run: default law {to_default:.3?}, all laws {to_all:.3?}");
        assert!(to_default[0] < bar[0] && to_default[1] < bar[1], "the root");
        // Reached, not the bar.
        assert!(to_default[2] < REACHED_JOINTS_RAD, "the joints");
    }
}

/// Reached: 0.42, 0.23 and 0.21 rad at steps of 5, 2 and 1 ms, where the bar is 0.13 rad.
const REACHED_JOINTS_RAD: f64 = 0.45;

#[derive(Deserialize)]
struct FirmAnkles {
    bodies: Vec<String>,
    factor: f64,
    duration: f64,
    start_qpos: Vec<f64>,
    cases: Vec<FirmCase>,
}

#[derive(Deserialize)]
struct FirmCase {
    lean: f64,
    targets: Vec<f64>,
    height: f64,
    lowest: f64,
}

#[test]
fn firm_ankles_hold_the_robot_only_when_they_lean_back_as_in_mujoco() {
    let fixture: FirmAnkles = fixture("firm_ankles");
    let model = robot_on_floor(fixture.factor);
    check_bodies(&model, &fixture.bodies);
    for case in &fixture.cases {
        let mut state = State { qpos: fixture.start_qpos.clone(), qvel: vec![0.0; model.nv()] };
        let mut dynamics = Dynamics::new(&model);
        let (dt, mut lowest) = (0.005, f64::INFINITY);
        for _ in 0..(fixture.duration / dt) as usize {
            dynamics.step(&model, &mut state, &Input { targets: &case.targets, ..Input::default() }, dt);
            lowest = lowest.min(state.qpos[2]);
        }
        println!("lean {}: pelvis at {:.4} m; MuJoCo {:.4} m", case.lean, state.qpos[2], case.height);
        let stands = case.lean > 0.0;
        assert_eq!([lowest > 0.7, case.lowest > 0.7], [stands; 2], "lean {}", case.lean);
        assert!(!stands || (state.qpos[2] - case.height).abs() < 1e-3);
    }
}

#[derive(Deserialize)]
struct TasksFixture {
    scenes: Vec<TaskScene>,
}

#[derive(Deserialize)]
struct TaskScene {
    task: String,
    bodies: f64,
    dofs: f64,
    drives: f64,
    shapes: f64,
    mass: f64,
}

#[test]
fn every_task_holds_in_mujoco_what_it_holds_here() {
    for (robot, name) in [("g1_inspire", "tasks"), ("g1_dex3", "tasks_dex3")] {
        check_tasks(robot, name);
    }
}

fn check_tasks(robot: &str, name: &str) {
    let fixture: TasksFixture = fixture(name);
    assert_eq!(fixture.scenes.len(), 14);
    for theirs in &fixture.scenes {
        let model = ExportScene::task(theirs.task.parse().unwrap(), 0, robot).unwrap().model;
        let mass: f64 = model.bodies().iter().map(|body| body.spec.mass).sum();
        let ours = [model.bodies().len() - 1, model.nv(), model.drives().len(), model.shapes().len()];
        let theirs_counted = [theirs.bodies, theirs.dofs, theirs.drives, theirs.shapes].map(|count| count as usize);
        assert_eq!(ours, theirs_counted, "{}: the fixture is of another scene; run oracle.py {name}", theirs.task);
        assert!((mass - theirs.mass).abs() < 1e-5, "{}: {mass} kg against {}", theirs.task, theirs.mass);
    }
}
