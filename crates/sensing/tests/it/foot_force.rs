//! The feet's estimated force against the true one: on the floor, on the platform, on treads and stepping onto them.
//!
//! On treads the pelvis is held fast, as if by a crane, and the legs press the feet down: no balance is needed, and the
//! load can be chosen.

use std::f64::consts::{FRAC_PI_2, TAU};
use std::sync::Arc;

use crate::common::{document_measured, q0, scene, started};
use fiatlux_dynamics::{Dynamics, Input, State};
use fiatlux_robot::Robot;
use fiatlux_rules::{GRAVITY, Row, Task, errand};
use fiatlux_sensing::{foot_force_estimate, world_from_link};
use fiatlux_world::{PHYSICS_DT, SUBSTEPS, Scene, ShapeOwner};
use nalgebra::{Isometry3, Matrix6, Point3, Translation3, UnitQuaternion, Vector3, Vector6};

/// The G1 with Inspire hands.
const JOINTS: usize = 53;

/// Least force that counts as touching, N: that of the rulebook's contacts.
const TOUCH: f64 = 1.0;
/// From the ankle's frame down to the sole, m.
const SOLE: f64 = 0.035;
/// Joints of a leg, the first of the left leg at 0.
const LEG: usize = 6;

/// Statistics of a set of samples, one a foot and control step.
#[derive(Debug, Default)]
struct Stats {
    samples: usize,
    touching: usize,
    detected: usize,
    false_alarms: usize,
    /// Largest estimate where nothing touches, N.
    largest_false: f64,
    truth: f64,
    estimate: f64,
    error: f64,
}

impl Stats {
    fn add(&mut self, robot: &Robot, row: &Row, feet: &[usize]) {
        let estimates = foot_force_estimate(robot, row);
        for &foot in feet {
            let (truth, estimate) = (row.force(errand::LADDER_FORCE)[foot], estimates[foot]);
            self.samples += 1;
            if truth.norm() > TOUCH {
                self.touching += 1;
                self.detected += usize::from(estimate.norm() > TOUCH);
                self.truth += truth.norm();
                self.estimate += estimate.norm();
                self.error += (estimate - truth).norm();
            } else {
                self.false_alarms += usize::from(estimate.norm() > TOUCH);
                self.largest_false = self.largest_false.max(estimate.norm());
            }
        }
    }

    fn detection(&self) -> f64 {
        self.detected as f64 / self.touching as f64
    }

    fn false_share(&self) -> f64 {
        self.false_alarms as f64 / (self.samples - self.touching) as f64
    }

    fn line(&self, name: &str) -> String {
        let share = |part: usize, whole: usize| {
            if whole == 0 { String::new() } else { format!("{:.0} %", 100.0 * part as f64 / whole as f64) }
        };
        let mean =
            |sum: f64| if self.touching == 0 { String::new() } else { format!("{:.0}", sum / self.touching as f64) };
        let apart = self.samples - self.touching;
        let largest = if apart == 0 { String::new() } else { format!("{:.1}", self.largest_false) };
        format!(
            "| {name} | {} | {} | {} | {} | {largest} | {} | {} | {} |\n",
            self.samples,
            share(self.touching, self.samples),
            share(self.detected, self.touching),
            share(self.false_alarms, apart),
            mean(self.truth),
            mean(self.estimate),
            mean(self.error)
        )
    }
}

/// Leg angles that put a foot into a pose of the world, from those in the row.
fn reach(robot: &Robot, row: &mut Row, side: usize, world_from_foot: &Isometry3<f64>) {
    const STEP: f64 = 1e-6;
    let miss = |row: &Row| {
        let pose = world_from_link(robot, robot.feet()[side], row);
        let shift = pose.translation.vector - world_from_foot.translation.vector;
        let turn = (pose.rotation * world_from_foot.rotation.inverse()).scaled_axis();
        Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
    };
    for _ in 0..50 {
        let here = miss(row);
        let mut slope = Matrix6::zeros();
        for joint in 0..LEG {
            let mut moved = row.clone();
            moved.joint_position[LEG * side + joint] += STEP;
            slope.set_column(joint, &((miss(&moved) - here) / STEP));
        }
        let change =
            -(slope.transpose() * slope + Matrix6::identity() * 1e-8).try_inverse().unwrap() * slope.transpose() * here;
        for joint in 0..LEG {
            row.joint_position[LEG * side + joint] += change[joint].clamp(-0.2, 0.2);
        }
    }
    let left = miss(row).norm();
    assert!(left < 1e-6, "foot {side} is out of reach by {left}");
    for joint in LEG * side..LEG * (side + 1) {
        let (limits, angle) = (&robot.joints()[joint], row.joint_position[joint]);
        assert!((limits.lower..limits.upper).contains(&angle), "{} would be at {angle}", limits.name);
    }
}

/// Centre of a sole, m.
fn sole(robot: &Robot, row: &Row, side: usize) -> Vector3<f64> {
    (world_from_link(robot, robot.feet()[side], row) * Point3::new(0.038, 0.0, -SOLE)).coords
}

/// The robot before the fixed ladder of `climb`, its pelvis held fast.
struct Crane {
    scene: Arc<Scene>,
    dynamics: Dynamics,
    state: State,
    locked: Vec<bool>,
    /// Targets of the drives, rad.
    targets: Vec<f64>,
    /// As a world would report it: pelvis, joints, efforts and forces on the feet.
    row: Row,
    /// Joint angles that were last aimed at.
    wanted: Vec<f64>,
}

impl Crane {
    /// Feet at poses given by [`Crane::foot`], the pelvis at a height and behind the left foot, m.
    fn new(scene: &Arc<Scene>, height: f64, behind: f64, feet: [Isometry3<f64>; 2]) -> Self {
        let mut row = started(scene, Task::Climb).row().clone();
        row.robot.pose = feet[0] * Translation3::new(-behind, -0.1, 0.0);
        row.robot.pose.translation.z = height;
        let model = &scene.model;
        let mut state = model.reference_state();
        state.set_pose(model, scene.robot_ids.root, &row.robot.pose);
        let root = model.bodies()[scene.robot_ids.root.0].dof_start;
        let mut locked = vec![false; model.nv()];
        locked[root..root + 6].fill(true);
        let (dynamics, targets) = (Dynamics::new(model), vec![0.0; model.drives().len()]);
        let mut crane = Self { scene: Arc::clone(scene), dynamics, state, locked, targets, row, wanted: q0(scene) };
        crane.aim(feet);
        for (ids, angle) in scene.robot_ids.joints.iter().zip(&crane.wanted) {
            crane.state.qpos[ids.qpos] = *angle;
        }
        crane
    }

    /// Foot level on a height `z`, its ankle at `y` of the ladder's frame, turned as a robot that faces the ladder.
    fn foot(scene: &Scene, side: usize, y: f64, z: f64) -> Isometry3<f64> {
        let x = if side == 0 { -0.1 } else { 0.1 };
        let facing = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), FRAC_PI_2);
        scene.world_from(errand::LADDER) * Isometry3::from_parts(Translation3::new(x, y, z + SOLE), facing)
    }

    /// Targets that put the feet into poses.
    fn aim(&mut self, feet: [Isometry3<f64>; 2]) {
        let mut row = self.row.clone();
        row.joint_position.clone_from(&self.wanted);
        for (side, pose) in feet.iter().enumerate() {
            reach(&self.scene.robot, &mut row, side, pose);
        }
        self.wanted = row.joint_position;
        for (ids, angle) in self.scene.robot_ids.joints.iter().zip(&self.wanted) {
            self.targets[ids.drive] = *angle;
        }
    }

    fn step(&mut self) -> &Row {
        let scene = &self.scene;
        for _ in 0..SUBSTEPS {
            let input = Input { targets: &self.targets, wrenches: &[], locked: &self.locked };
            self.dynamics.step(&scene.model, &mut self.state, &input, PHYSICS_DT);
        }
        self.row.force_mut(errand::LADDER_FORCE).fill(Vector3::zeros());
        for contact in self.dynamics.contacts() {
            let owners = [contact.shape_a, contact.shape_b].map(|shape| scene.owner(shape));
            for (foot, &link) in scene.robot.feet().iter().enumerate() {
                // The contact's force acts on its second shape.
                if owners == [ShapeOwner::LADDER, ShapeOwner::Robot(link)] {
                    self.row.force_mut(errand::LADDER_FORCE)[foot] += contact.force;
                } else if owners == [ShapeOwner::Robot(link), ShapeOwner::LADDER] {
                    self.row.force_mut(errand::LADDER_FORCE)[foot] -= contact.force;
                }
            }
        }
        for (joint, ids) in scene.robot_ids.joints.iter().enumerate() {
            self.row.joint_position[joint] = self.state.qpos[ids.qpos];
            self.row.joint_effort[joint] = self.dynamics.efforts()[ids.drive];
        }
        &self.row
    }
}

/// y of a tread's centre in the ladder's frame, m, and its height.
fn tread(scene: &Scene, index: usize) -> (f64, f64) {
    let ladder = &scene.config.ladder;
    let foot = ladder.rail_radius - ladder.size[1] / 2.0;
    let (top, radius) = (ladder.tread_heights[index], ladder.rail_radius);
    let along = (top - ladder.tread_thickness / 2.0 - radius) / (ladder.rail_top[1] - radius);
    (foot + along * (ladder.rail_top[0] - foot), top)
}

/// A foot's movement in the air: up and down by `lift`, m, and about the ankle's pitch by `pitch`, rad, either way.
#[derive(Debug, Clone, Copy)]
struct Swing {
    lift: f64,
    pitch: f64,
    period: f64,
}

/// Both feet before the ladder, where they touch nothing, their lowest soles `lowest` above the floor, m. After a second the
/// samples of 4 s count. The estimate is there above the published height and not below it.
fn swinging(scene: &Arc<Scene>, lowest: f64, swing: Swing) -> Stats {
    const PUBLISHED_GATE: f64 = 0.10;
    let feet = |phase: f64| {
        let lift = lowest + swing.lift * (1.0 + phase.cos());
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), swing.pitch * phase.sin());
        [0, 1].map(|side| Crane::foot(scene, side, -0.9, lift) * turn)
    };
    let mut stats = Stats::default();
    let mut crane = Crane::new(scene, lowest + swing.lift + 0.69, 0.0, feet(0.0));
    for step in 0..250 {
        crane.aim(feet(TAU * f64::from(step) * 0.02 / swing.period));
        let row = crane.step();
        assert_eq!(row.force(errand::LADDER_FORCE), [Vector3::zeros(); 4], "the feet are in the air");
        let estimates = foot_force_estimate(&scene.robot, row);
        for (side, estimate) in estimates.iter().enumerate() {
            let height = sole(&scene.robot, row, side).z;
            assert_eq!(*estimate != Vector3::zeros(), height > PUBLISHED_GATE, "foot {side} at {height} m");
        }
        if step >= 50 {
            stats.add(&scene.robot, row, &[0, 1]);
        }
    }
    stats
}

/// Free on its feet at a task's start, its targets the standing posture.
fn standing(task: Task, steps: usize) -> Stats {
    let scene = scene(task, 1.0);
    let mut world = started(&scene, task);
    let (targets, mut stats) = (world.row().joint_target.clone(), Stats::default());
    for _ in 0..steps {
        let row = world.step(&[0.0; JOINTS], &targets).unwrap();
        stats.add(&scene.robot, row, &[0, 1]);
    }
    stats
}

/// Both feet on each tread in turn, its middle `ahead` of the ankles, m, pressed down by three depths.
fn on_treads(scene: &Arc<Scene>, ahead: f64) -> Stats {
    let mut stats = Stats::default();
    let treads = 0..scene.config.ladder.tread_heights.len();
    for (index, press) in treads.flat_map(|index| [0.005, 0.015, 0.03].map(|press| (index, press))) {
        let (y, top) = tread(scene, index);
        let feet = |depth: f64| [0, 1].map(|side| Crane::foot(scene, side, y - ahead, top - depth));
        let mut crane = Crane::new(scene, top + 0.69, 0.25, feet(-0.001));
        crane.aim(feet(press));
        for step in 0..100 {
            let row = crane.step();
            // The first moments are the landing, which `stepping` has.
            if step >= 25 {
                stats.add(&scene.robot, row, &[0, 1]);
            }
        }
    }
    stats
}

/// The right foot on a tread, the left one up and down on it, `period` s from one landing to the next.
fn stepping(scene: &Arc<Scene>, index: usize, period: f64) -> Stats {
    let (y, top) = tread(scene, index);
    let feet = |lift: f64| [(0, lift), (1, -0.015)].map(|(side, lift)| Crane::foot(scene, side, y - 0.06, top + lift));
    let mut stats = Stats::default();
    let mut crane = Crane::new(scene, top + 0.69, 0.25, feet(0.05));
    for step in 0..300 {
        let phase = TAU * f64::from(step) * 0.02 / period;
        crane.aim(feet(0.015 + 0.035 * phase.cos()));
        stats.add(&scene.robot, crane.step(), &[0]);
    }
    stats
}

/// Bars are at what was reached: small estimates for a foot in the air, no touch on the ladder missed.
#[test]
fn in_the_air_on_the_platform_and_on_treads() {
    let climb = scene(Task::Climb, 1.0);
    let mut text = String::from(
        "| case | samples | touching | detected | false | largest false, N | truth, N | estimate, N | error, N |\n\
         | ---- | ------: | -------: | -------: | ----: | ---------------: | -------: | ----------: | --------: |\n",
    );
    let mut list = |name: &str, stats: &Stats| text += &stats.line(name);
    let swing = |lift, pitch, period| Swing { lift, pitch, period };
    // With the largest estimate, N, and the share above 1 N that are allowed; those reached stand in the table.
    let swings = [
        ("still", swing(0.0, 0.0, 1.0), 0.3, 0.0),
        ("up and down by 50 mm in 4 s, 0.12 m/s2", swing(0.05, 0.0, 4.0), 0.8, 0.0),
        ("up and down by 50 mm in 2 s, 0.5 m/s2", swing(0.05, 0.0, 2.0), 1.0, 0.0),
        ("up and down by 50 mm in 1 s, 2 m/s2", swing(0.05, 0.0, 1.0), 2.5, 0.65),
        ("up and down by 50 mm in 0.5 s, 8 m/s2", swing(0.05, 0.0, 0.5), 8.0, 0.95),
        ("pitching by 0.2 rad in 2 s, 2 rad/s2", swing(0.0, 0.2, 2.0), 1.5, 0.5),
        ("pitching by 0.2 rad in 0.5 s, 32 rad/s2", swing(0.0, 0.2, 0.5), 5.5, 0.92),
    ];
    let mut air = Vec::new();
    for (name, swing, largest, share) in swings {
        let stats = swinging(&climb, 0.13, swing);
        list(&format!("in the air, {name}"), &stats);
        air.push((name, stats, largest, share));
    }
    // Through the published height, where the estimate goes on and off.
    swinging(&climb, 0.06, swing(0.05, 0.0, 1.0));
    let platform = standing(Task::S03, 50);
    list("standing on the platform, 1 s", &platform);
    let treads: Vec<Stats> = [0.10, 0.06, 0.03, 0.0].map(|ahead| on_treads(&climb, ahead)).into();
    for (ahead, stats) in ["100", "60", "30", "0"].into_iter().zip(&treads) {
        list(&format!("pressing on each tread, its middle {ahead} mm before the ankles"), stats);
    }
    let steps: Vec<Stats> = [2.0, 1.0, 0.5].map(|period| stepping(&climb, 2, period)).into();
    for (period, stats) in ["2", "1", "0.5"].into_iter().zip(&steps) {
        list(&format!("stepping on tread 3 every {period} s"), stats);
    }
    print!("{text}");
    document_measured("foot force", &text);
    for (name, stats, largest, share) in &air {
        assert_eq!((stats.samples, stats.touching), (400, 0), "{name}");
        assert!(stats.largest_false < *largest && stats.false_share() <= *share, "{name}: {stats:?}");
    }
    let touched = [&platform].into_iter().chain(&treads).chain(&steps);
    assert!(touched.map(Stats::detection).all(|share| share > 0.98));
    for (stats, bar) in steps.iter().zip([0.3, 0.45, 0.8]) {
        assert!(stats.false_share() < bar, "{stats:?}");
    }
}

/// For efforts worked out from a known force by virtual work: the estimate explains them, is no larger than the force, and
/// has no part that the ankle does not feel.
#[test]
fn the_estimate_is_the_smallest_that_explains_the_efforts() {
    const STEP: f64 = 1e-6;
    let scene = scene(Task::S03, 1.0);
    let robot = &scene.robot;
    let mut row = started(&scene, Task::S03).row().clone();
    let slope = |row: &Row, joint: usize, value: &dyn Fn(&Row) -> f64| {
        let at = |step: f64| {
            let mut moved = row.clone();
            moved.joint_position[joint] += step;
            value(&moved)
        };
        (at(STEP) - at(-STEP)) / (2.0 * STEP)
    };
    row.joint_position[4..6].copy_from_slice(&[0.3, -0.2]);
    row.joint_position[10..12].copy_from_slice(&[-0.5, 0.1]);
    let forces = [Vector3::new(30.0, -20.0, 170.0), Vector3::new(-5.0, 8.0, 60.0)];
    for (side, force) in forces.iter().enumerate() {
        for joint in [LEG * side + 4, LEG * side + 5] {
            let weight = GRAVITY * robot.total_mass();
            let work = |row: &Row| {
                let com = robot.center_of_mass(&row.joint_position, &row.robot.pose).unwrap();
                sole(robot, row, side).dot(force) - weight * com.z
            };
            row.joint_effort[joint] = -slope(&row, joint, &work);
        }
    }
    let estimates = foot_force_estimate(robot, &row);
    for (side, force) in forces.iter().enumerate() {
        let estimate = estimates[side];
        let lever = |joint: usize| {
            let along = |axis: Vector3<f64>| slope(&row, joint, &|row: &Row| sole(robot, row, side).dot(&axis));
            Vector3::new(along(Vector3::x()), along(Vector3::y()), along(Vector3::z()))
        };
        let levers = [lever(LEG * side + 4), lever(LEG * side + 5)];
        for lever in &levers {
            assert!(lever.dot(&(estimate - force)).abs() < 1e-5, "{estimate} does not explain {force}");
        }
        let unfelt = levers[0].cross(&levers[1]).normalize();
        assert!(estimate.dot(&unfelt).abs() < 1e-3 && estimate.norm() < force.norm());
    }
    // 0.10 m is where it begins to count.
    for (height, counts) in [(0.101, true), (0.099, false)] {
        row.robot.pose.translation.z += height - sole(robot, &row, 0).z;
        assert_eq!(foot_force_estimate(robot, &row)[0] != Vector3::zeros(), counts);
    }
}
