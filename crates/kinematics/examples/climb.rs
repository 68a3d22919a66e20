//! Plans a climb of the step ladder, one foot after the other, and plays it with the balance controller on the free ladder.
//!
//!     cargo run -p fiatlux-kinematics --example climb -- [ROOMS]
#![allow(clippy::unwrap_used, missing_docs, clippy::print_stdout)]

use std::collections::HashMap;
use std::sync::Arc;

use fiatlux_dynamics::{Dynamics, Input, Model, ModelBuilder, ShapeId, State};
use fiatlux_kinematics::{
    Clearance, Goal, InverseKinematics, Mechanics, Outcome, Part, SearchOptions, Site, Stance, StanceController,
    Support,
};
use fiatlux_robot::{BuildOptions, GainSet, Robot, RobotIds};
use fiatlux_world::{PHYSICS_DT, SUBSTEPS, Scene, SceneConfig, SceneKind, SceneSpec};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

const SURFACES: [&str; 6] =
    ["floor", "ladder_tread_0", "ladder_tread_1", "ladder_tread_2", "ladder_tread_3", "ladder_platform"];
const PLATFORM: usize = 5;
/// Half the depth of a tread, m.
const HALF_DEPTH: f64 = 0.045;
/// Smallest gap of shapes, m.
const MARGIN: f64 = 0.003;
/// Side of a foot from the middle, m.
const ASIDE: f64 = 0.12;
/// A swing's largest step between two postures, m.
const STRIDE: f64 = 0.02;

fn env(name: &str, default: f64) -> f64 {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(default)
}

fn scene(kind: SceneKind, seed: u64) -> Scene {
    let robot = Arc::new(Robot::by_name("g1_bare").unwrap());
    let spec = SceneSpec::new(kind, seed, robot.gains(GainSet::default()));
    Scene::build(&SceneConfig::default(), robot, spec).unwrap()
}

/// Where a foot is: a surface and how far the middle of the sole is behind the middle of that tread, m.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Foothold {
    surface: usize,
    behind: f64,
}

/// A posture of the plan.
#[derive(Debug, Clone)]
struct Key {
    state: State,
    seconds: f64,
    /// Part of the weight that each foot may bear.
    bears: [f64; 2],
    feet: [Foothold; 2],
    /// Feet whose heel is up.
    on_toes: [bool; 2],
    name: String,
}

/// How a foot is held: flat, turned about its middle or about its toes.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Hold {
    Flat,
    Free,
    Toes(f64),
}

/// Legs and waist; the arms are held behind.
fn moves(joint: &str) -> bool {
    ["hip", "knee", "ankle", "waist"].iter().any(|part| joint.contains(part))
}

struct Planner {
    scene: Scene,
    mechanics: Mechanics,
    inverse: HashMap<[Option<usize>; 2], InverseKinematics>,
    out: f64,
}

impl Planner {
    fn new(out: f64) -> Self {
        let scene = scene(SceneKind::Climb, 0);
        let mut mechanics = Mechanics::new(&scene.model);
        mechanics.update(&scene.model, &scene.model.reference_state());
        Self { scene, mechanics, inverse: HashMap::new(), out }
    }

    /// The middle of a surface, x ahead.
    fn surface(&self, surface: usize) -> Vector3<f64> {
        let name = SURFACES[surface.max(1)];
        let mut at = self.mechanics.world_from_site(&self.scene.site(name).unwrap()).translation.vector;
        if surface == 0 {
            at.z = 0.0;
        }
        if surface == PLATFORM {
            at.x -= 0.2 - HALF_DEPTH;
        }
        at
    }

    fn faces(&self) -> f64 {
        self.facing().cos().signum()
    }

    fn facing(&self) -> f64 {
        env("FACING", 3.141592653589793)
    }

    fn sole(&self, side: usize, hold: Foothold) -> Isometry3<f64> {
        let (at, outwards) = (self.surface(hold.surface), [1.0, -1.0][side]);
        let place = at + Vector3::new(-hold.behind, self.faces() * outwards * env("ASIDE", ASIDE), 0.0);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), outwards * self.out + self.facing());
        Isometry3::from_parts(place.into(), turn)
    }

    /// How far what bears of a sole reaches to the rear and ahead of its middle, m.
    fn range(&self, side: usize, hold: Foothold) -> [f64; 2] {
        if hold.surface == 0 {
            return [-0.1, 0.1];
        }
        let corner = self.scene.robot.soles()[side].half_extents[1] * self.out.tan();
        let front = if hold.surface == PLATFORM { 0.35 } else { HALF_DEPTH };
        let [near, far] = [corner - HALF_DEPTH + hold.behind, front + hold.behind - corner];
        let range = if self.faces() > 0.0 { [near, far] } else { [-far, -near] };
        range.map(|x| x.clamp(-0.1, 0.1))
    }

    /// Where a foot bears, world.
    fn bearing(&self, side: usize, hold: Foothold) -> Vector3<f64> {
        let [rear, front] = self.range(side, hold);
        (self.sole(side, hold) * Point3::new((rear + front) / 2.0, 0.0, 0.0)).coords
    }

    fn inverse(&mut self, stands: [Option<usize>; 2]) -> &mut InverseKinematics {
        let scene = &self.scene;
        self.inverse.entry(stands).or_insert_with(|| {
            let (model, ids) = (&scene.model, &scene.robot_ids);
            let joints = scene.robot.joints().iter().zip(&ids.joints).filter(|(joint, _)| moves(&joint.name));
            let joints: Vec<_> = joints.map(|(_, ids)| ids.body).collect();
            let mut inverse = InverseKinematics::new(model, ids.root, &joints, true).unwrap();
            inverse.options = SearchOptions {
                tries: env("TRIES", 8.0) as usize,
                steps: 60,
                limit_margin: 0.02,
                spread: env("SPREAD", 0.4),
                rest_pull: env("PULL", 0.1),
                position_tolerance: 1e-3,
                rotation_tolerance: 1e-2,
            };
            let shape = |id: ShapeId| &model.shapes()[id.0];
            let is_robot = |id: ShapeId| model.bodies()[shape(id).body.0].root == ids.root;
            let soles = scene.robot.soles();
            let treads = |a: ShapeId, b: ShapeId| {
                let side = soles.iter().position(|sole| ids.site(&sole.site).body == shape(a).body);
                side.is_some_and(|side| {
                    stands[side].is_some_and(|on| {
                        if on == 0 { !shape(b).name.starts_with("ladder") } else { shape(b).name == SURFACES[on] }
                    })
                })
            };
            let pairs =
                model.shape_pairs().filter(|&(a, b)| (is_robot(a) || is_robot(b)) && !treads(a, b) && !treads(b, a));
            let swings = |id: ShapeId| {
                (0..2).any(|side| stands[side].is_none() && ids.site(&soles[side].site).body == shape(id).body)
            };
            let margin = |(a, b): (ShapeId, ShapeId)| {
                if is_robot(a) && is_robot(b) {
                    1e-3
                } else if swings(a) || swings(b) {
                    env("SWING", 0.015)
                } else {
                    env("MARGIN", 0.008)
                }
            };
            let clearances: Vec<_> = pairs.map(|shapes| Clearance { shapes, margin: margin(shapes) }).collect();
            inverse.set_clearances(model, &clearances).unwrap();
            inverse
        })
    }

    /// Angles that joints rest at: bent by so much at each leg.
    fn rest(&self, bends: [f64; 2]) -> Vec<f64> {
        let angle = |name: &str| {
            let (side, joint) = name.split_once('_').unwrap();
            let (outwards, bend) = if side == "left" { (1.0, bends[0]) } else { (-1.0, bends[1]) };
            match joint {
                "hip_pitch_joint" => -0.6 * bend,
                "hip_yaw_joint" => outwards * self.out,
                "knee_joint" => bend,
                "ankle_pitch_joint" => -0.4 * bend,
                "shoulder_pitch_joint" => env("SP", 0.7),
                "shoulder_roll_joint" => outwards * 0.3,
                "elbow_joint" => env("EL", 1.0),
                _ => 0.0,
            }
        };
        self.scene.robot.joints().iter().map(|joint| angle(&joint.name)).collect()
    }

    /// A posture near another one.
    fn solve(
        &mut self,
        from: &State,
        soles: [(Isometry3<f64>, Hold); 2],
        stands: [Option<usize>; 2],
        com: Vector3<f64>,
        bends: [f64; 2],
    ) -> Option<State> {
        self.solve_from(from, soles, stands, com, bends, false)
    }

    #[allow(clippy::too_many_arguments)]
    fn solve_from(
        &mut self,
        from: &State,
        soles: [(Isometry3<f64>, Hold); 2],
        stands: [Option<usize>; 2],
        com: Vector3<f64>,
        bends: [f64; 2],
        first: bool,
    ) -> Option<State> {
        let rest = self.rest(bends);
        let ids = &self.scene.robot_ids;
        let [left, right] = [0, 1].map(|side| ids.site(&self.scene.robot.soles()[side].site));
        let pelvis = Site { body: ids.root, body_from_site: Isometry3::identity() };
        let goal = |mut site: Site, (mut pose, hold): (Isometry3<f64>, Hold)| {
            if let Hold::Toes(front) = hold {
                let toes = Isometry3::translation(front, 0.0, 0.0);
                (site.body_from_site, pose) = (site.body_from_site * toes, pose * toes);
            }
            let mut goal = Goal::pose(site, pose);
            if hold != Hold::Flat {
                goal.rotation[1] = 0.0;
            }
            goal
        };
        let mut upright =
            Goal { position: [0.0; 3], ..Goal::pose(pelvis, Isometry3::rotation(Vector3::z() * self.facing())) };
        upright.rotation = [env("ROLL", 0.0), env("PITCH", 0.0), env("YAW", 0.0)];
        let goals = [goal(left, soles[0]), goal(right, soles[1]), Goal::com_over(com.x, com.y), upright];
        let mut state = from.clone();
        let model = self.scene.model.clone();
        let names: Vec<String> = self.scene.robot.joints().iter().map(|joint| joint.name.clone()).collect();
        let inverse = self.inverse(stands);
        let named = rest.iter().zip(&names);
        let rest: Vec<f64> = named.filter(|(_, name)| moves(name)).map(|(angle, _)| *angle).collect();
        inverse.set_rest(&rest).unwrap();
        inverse.options.tries = if first { 8 } else { 1 };
        let found = inverse.solve(&model, &mut state, &goals).unwrap();
        let _ = Part::CenterOfMass;
        if found.outcome != Outcome::Reached && std::env::var_os("WHY").is_some() {
            println!(
                "    {stands:?} {bends:?} com {:.3} {:.3} {:?} position {:.4} rotation {:.3} clearance {:.4}",
                com.x, com.y, found.outcome, found.position_error, found.rotation_error, found.clearance_error
            );
            for contact in model.contacts_at(&state.qpos, MARGIN - 5e-4).unwrap() {
                let [a, b] = [contact.shape_a, contact.shape_b].map(|shape| &model.shapes()[shape.0]);
                let robot = [a, b].iter().any(|shape| model.bodies()[shape.body.0].root == self.scene.robot_ids.root);
                if robot {
                    println!("        {} / {}", a.name, b.name);
                }
            }
        }
        let change = self
            .scene
            .robot_ids
            .joints
            .iter()
            .map(|j| (from.qpos[j.qpos] - state.qpos[j.qpos]).abs())
            .fold(0.0, f64::max);
        (found.outcome == Outcome::Reached && (change < env("JUMP", 0.35) || first)).then_some(state)
    }

    fn first(&mut self, feet: [Foothold; 2]) -> Option<Key> {
        let mut state = self.scene.model.reference_state();
        let [left, right] = [0, 1].map(|side| self.sole(side, feet[side]));
        let com = (self.bearing(0, feet[0]) + self.bearing(1, feet[1])) / 2.0;
        let height = left.translation.z.min(right.translation.z) + self.scene.robot.standing_height() - 0.03;
        let pelvis = Isometry3::from_parts(
            Vector3::new(com.x, com.y, height).into(),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.facing()),
        );
        let rest = self.rest([0.3; 2]);
        state.set_pose(&self.scene.model, self.scene.robot_ids.root, &pelvis);
        self.scene.robot_ids.joints.iter().zip(&rest).for_each(|(joint, angle)| state.qpos[joint.qpos] = *angle);
        let stands = feet.map(|foot| Some(foot.surface));
        let state = self.solve_from(&state, [(left, Hold::Flat), (right, Hold::Flat)], stands, com, [0.3; 2], true)?;
        Some(Key { state, seconds: 1.0, bears: [1.0; 2], feet, on_toes: [false; 2], name: "start".into() })
    }

    /// Moves the weight over the other foot, and that foot to its next hold.
    fn step(&mut self, from: &Key, side: usize, to: Foothold) -> Option<Vec<Key>> {
        let why = std::env::var_os("WHY").is_some();
        for on_toes in [false, true] {
            for ahead in if env("AHEAD", 0.0) == 0.0 { [0.0, -0.015, 0.015] } else { [-0.01, -0.02, 0.0] } {
                for high in [0.9, 0.5, 1.3] {
                    let Some(shift) = self.shift(from, side, ahead, high, on_toes) else { continue };
                    for back in [0.1, 0.085, 0.07] {
                        if let Some(swing) = self.swing(&shift, from, side, to, ahead, back, high) {
                            if why {
                                println!("  on_toes {on_toes} ahead {ahead} high {high} back {back}");
                            }
                            return Some(shift.0.into_iter().chain(swing).collect());
                        }
                    }
                }
            }
        }
        None
    }

    /// Moves the weight over the other foot.
    #[allow(clippy::type_complexity)]
    fn shift(
        &mut self,
        from: &Key,
        side: usize,
        ahead: f64,
        high: f64,
        on_toes: bool,
    ) -> Option<(Vec<Key>, [(Isometry3<f64>, Hold); 2], [f64; 2])> {
        let (feet, other) = (from.feet, 1 - side);
        let mut keys: Vec<Key> = Vec::new();
        let mut state = from.state.clone();
        let mut soles = [0, 1].map(|foot| (self.sole(foot, feet[foot]), Hold::Flat));
        let mut are_on_toes = [false; 2];
        let stands = feet.map(|foot| Some(foot.surface));
        let over = self.bearing(other, feet[other]) + Vector3::x() * ahead;
        self.mechanics.update(&self.scene.model, &state);
        let com = self.mechanics.center_of_mass(&self.scene.model, self.scene.robot_ids.root).1;
        let mut bends = [0.4; 2];
        if feet[other].surface > feet[side].surface {
            bends = [env("LOW", 0.05); 2];
            bends[other] = high;
        }
        let shifts = ((com - over).xy().norm() / 0.01).ceil().max(1.0) as usize;
        for shift in 1..=shifts {
            let part = shift as f64 / shifts as f64;
            let com = com.lerp(&over, part);
            if on_toes && part > env("TOES", 0.6) {
                soles[side].1 = Hold::Toes(self.range(side, feet[side])[1] - 0.01);
                are_on_toes[side] = true;
            }
            state = self.solve(&state, soles, stands, com, bends)?;
            keys.push(Key {
                state: state.clone(),
                seconds: 0.2,
                bears: [1.0; 2],
                feet,
                on_toes: are_on_toes,
                name: format!("shift {part:.2}"),
            });
        }
        let mut bears = [1.0; 2];
        bears[side] = 0.0;
        keys.push(Key { state: state.clone(), seconds: 0.6, bears, feet, on_toes: are_on_toes, name: "unload".into() });
        Some((keys, soles, bends))
    }

    /// Moves a foot that bears nothing to its next hold.
    #[allow(clippy::too_many_arguments, clippy::type_complexity)]
    fn swing(
        &mut self,
        shift: &(Vec<Key>, [(Isometry3<f64>, Hold); 2], [f64; 2]),
        from: &Key,
        side: usize,
        to: Foothold,
        ahead: f64,
        back: f64,
        high: f64,
    ) -> Option<Vec<Key>> {
        let (feet, other) = (from.feet, 1 - side);
        let (soles, mut bends) = (shift.1, shift.2);
        let mut state = shift.0.last().unwrap().state.clone();
        let mut keys: Vec<Key> = Vec::new();
        let up = feet[other].surface > feet[side].surface;
        let mut bears = [1.0; 2];
        bears[side] = 0.0;
        let stands = feet.map(|foot| Some(foot.surface));
        let over = self.bearing(other, feet[other]) + Vector3::x() * ahead;
        // The foot, from where its sole is now.
        self.mechanics.update(&self.scene.model, &state);
        let site = self.scene.robot_ids.site(&self.scene.robot.soles()[side].site);
        let (start, end) = (self.mechanics.world_from_site(&site), self.sole(side, to));
        let (a, b) = (start.translation.vector, end.translation.vector);
        let high = a.z.max(b.z) + 0.05;
        let back = if to.surface > 0 { a.x.min(b.x) - back } else { a.x.min(b.x) };
        let via = [
            Vector3::new(a.x - 0.02, a.y, a.z + 0.03),
            Vector3::new(back, a.y, a.z + 0.08),
            Vector3::new(back, b.y, high),
            Vector3::new(b.x, b.y, high),
            Vector3::new(b.x, b.y, b.z + 0.02),
        ];
        let mut at = a;
        let mut swing_stands = stands;
        bends[side] = 1.5;
        bends[other] = if up { high.min(0.8) } else { 0.3 };
        for (index, via) in via.into_iter().enumerate() {
            if index == 4 {
                // Level again.
                self.mechanics.update(&self.scene.model, &state);
                let from = self.mechanics.world_from_site(&site).rotation;
                let turns = (from.angle_to(&end.rotation) / 0.06).ceil() as usize;
                for turn in 1..=turns {
                    let rotation = from.slerp(&end.rotation, turn as f64 / turns as f64);
                    let mut goals = soles;
                    goals[side] = (Isometry3::from_parts(at.into(), rotation), Hold::Flat);
                    state = self.solve(&state, goals, swing_stands, over, bends)?;
                    keys.push(Key {
                        state: state.clone(),
                        seconds: 0.1,
                        bears,
                        feet,
                        on_toes: [false; 2],
                        name: "level".into(),
                    });
                }
            }
            let strides = ((via - at).norm() / STRIDE).ceil().max(1.0) as usize;
            for stride in 1..=strides {
                let place = at.lerp(&via, stride as f64 / strides as f64);
                let hold = if index == 4 { Hold::Flat } else { Hold::Free };
                swing_stands[side] = if index == 0 { stands[side] } else { None };
                let mut goals = soles;
                goals[side] = (Isometry3::from_parts(place.into(), end.rotation), hold);
                let Some(next) = self.solve(&state, goals, swing_stands, over, bends) else {
                    if std::env::var_os("WHY").is_some() {
                        println!("    no posture at via {index}, {stride} of {strides}");
                    }
                    return None;
                };
                state = next;
                keys.push(Key {
                    state: state.clone(),
                    seconds: 0.1,
                    bears,
                    feet,
                    on_toes: [false; 2],
                    name: format!("swing {index}"),
                });
            }
            at = via;
        }
        let mut feet = feet;
        feet[side] = to;
        let mut goals = soles;
        goals[side] = (end, Hold::Flat);
        let stands = feet.map(|foot| Some(foot.surface));
        state = self.solve(&state, goals, stands, over, bends)?;
        keys.push(Key { state: state.clone(), seconds: 0.5, bears, feet, on_toes: [false; 2], name: "down".into() });
        keys.push(Key { state, seconds: 0.5, bears: [1.0; 2], feet, on_toes: [false; 2], name: "load".into() });
        Some(keys)
    }

    fn search(&mut self, from: &Key, moves: &[(usize, usize)], depth: usize) -> Option<Vec<Key>> {
        let Some(&(side, surface)) = moves.first() else { return Some(Vec::new()) };
        let other = from.feet[1 - side];
        let options: Vec<f64> = if surface == 0 {
            vec![0.12]
        } else if surface == PLATFORM {
            vec![0.0, -0.03, -0.06, -0.1, 0.03]
        } else if other.surface == surface {
            let mut all = vec![other.behind, 0.0, -0.015, 0.015, -0.03, 0.03, -0.045, 0.045];
            all.dedup();
            all
        } else {
            vec![0.0, 0.015, -0.015, 0.03, -0.03, 0.045, -0.045]
        };
        for behind in options {
            let to = Foothold { surface, behind };
            let Some(keys) = self.step(from, side, to) else { continue };
            println!("{:depth$}{} foot on {} behind {behind}", "", ["left", "right"][side], SURFACES[surface]);
            if let Some(rest) = self.search(keys.last().unwrap(), &moves[1..], depth + 1) {
                return Some(keys.into_iter().chain(rest).collect());
            }
        }
        println!("{:depth$}no way for the {} foot to {}", "", ["left", "right"][side], SURFACES[surface]);
        None
    }
}

struct Own {
    model: Model,
    ids: RobotIds,
    state: State,
}

impl Own {
    fn new(scene: &Scene) -> Self {
        let (robot, mut builder) = (&scene.robot, ModelBuilder::new());
        let placed = robot.add_to(&mut builder, &BuildOptions::new(robot)).unwrap();
        let model = builder.build().unwrap();
        let ids = placed.ids(&model).unwrap();
        Self { state: model.reference_state(), model, ids }
    }

    fn see(&self, scene: &Scene, from: &State, to: &mut State) {
        copy(&scene.robot_ids, from, &self.ids, to);
    }
}

fn copy(from_ids: &RobotIds, from: &State, to_ids: &RobotIds, to: &mut State) {
    to.qpos[to_ids.root_qpos..][..7].copy_from_slice(&from.qpos[from_ids.root_qpos..][..7]);
    to.qvel[to_ids.root_dof..][..6].copy_from_slice(&from.qvel[from_ids.root_dof..][..6]);
    for (from_joint, to_joint) in from_ids.joints.iter().zip(&to_ids.joints) {
        to.qpos[to_joint.qpos] = from.qpos[from_joint.qpos];
        to.qvel[to_joint.dof] = from.qvel[from_joint.dof];
    }
}

/// Plays a plan in a room; the height of the pelvis at the end, m.
fn play(planner: &Planner, keys: &[Key], room: u64, noise: bool) -> (bool, f64, String) {
    let scene = scene(SceneKind::CoupledLadder, room);
    let (model, ids, robot) = (&scene.model, &scene.robot_ids, &scene.robot);
    let mut own = Own::new(&scene);
    let mut controller = StanceController::new(&own.model, own.ids.root).unwrap();
    let mut mechanics = Mechanics::new(model);
    let mut state = model.reference_state();
    mechanics.update(model, &state);
    let tread = mechanics.world_from_site(&scene.site("ladder_tread_0").unwrap());
    let plan_tread = planner.mechanics.world_from_site(&planner.scene.site("ladder_tread_0").unwrap());
    let world_from_plan = tread * plan_tread.inverse();
    // Plan in this robot's own state.
    let plan: Vec<State> = keys
        .iter()
        .map(|key| {
            let mut own_state = own.model.reference_state();
            own.see(&planner.scene, &key.state, &mut own_state);
            let mut pose = Isometry3::identity();
            pose.translation.vector.copy_from_slice(&own_state.qpos[own.ids.root_qpos..][..3]);
            let q = &own_state.qpos[own.ids.root_qpos + 3..][..4];
            pose.rotation = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(q[0], q[1], q[2], q[3]));
            own_state.set_pose(&own.model, own.ids.root, &(world_from_plan * pose));
            own_state
        })
        .collect();
    copy(&own.ids, &plan[0], ids, &mut state);
    let mut dynamics = Dynamics::new(model);
    let mut targets = vec![0.0; model.drives().len()];
    let mut draws = 7_u64 + room;
    let mut one = || {
        draws = draws.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (draws >> 11) as f64 * 2.0_f64.powi(-52) - 1.0
    };
    let weight = robot.total_mass() * 9.81;
    let dt = PHYSICS_DT * SUBSTEPS as f64;
    let (mut worst, mut worst_joint) = (0.0_f64, String::new());
    let ladder_start = tread.translation.vector;
    let trace = std::env::var_os("TRACE").is_some();
    let lerp = |a: &State, b: &State, part: f64| {
        let mut state = a.clone();
        let root = own.ids.root_qpos;
        for k in 0..3 {
            state.qpos[root + k] = a.qpos[root + k] + part * (b.qpos[root + k] - a.qpos[root + k]);
        }
        let q = |s: &State| {
            let q = &s.qpos[root + 3..][..4];
            UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(q[0], q[1], q[2], q[3]))
        };
        let q = q(a).slerp(&q(b), part);
        state.qpos[root + 3..][..4].copy_from_slice(&[q.w, q.i, q.j, q.k]);
        for joint in &own.ids.joints {
            state.qpos[joint.qpos] = a.qpos[joint.qpos] + part * (b.qpos[joint.qpos] - a.qpos[joint.qpos]);
        }
        state
    };
    let own_model = own.model.clone();
    let own_ids = own.ids.clone();
    let starts: Vec<f64> = keys
        .iter()
        .scan(0.0, |time, key| {
            *time += key.seconds;
            Some(*time)
        })
        .collect();
    let at = |time: f64| -> State {
        let next = starts.iter().position(|end| *end > time).unwrap_or(keys.len() - 1);
        if next == 0 {
            return plan[0].clone();
        }
        let part = ((time - starts[next - 1]) / keys[next].seconds).clamp(0.0, 1.0);
        lerp(&plan[next - 1], &plan[next], part)
    };
    let mut touched: Vec<String> = Vec::new();
    let mut last_off = 0;
    let mut offsets = [[0.0_f64; 6]; 2];
    assert!(robot.joints()[6].name.contains("right_hip"), "{}", robot.joints()[6].name);
    let end = starts.last().unwrap() + 3.0;
    let lead: f64 = std::env::var("LEAD").ok().and_then(|lead| lead.parse().ok()).unwrap_or(0.4);
    for step in 0..(end / dt) as usize {
        let time = step as f64 * dt;
        let next = starts.iter().position(|end| *end > time).unwrap_or(keys.len() - 1);
        let before = next.saturating_sub(1);
        let part = if next == 0 { 1.0 } else { ((time - starts[before]) / keys[next].seconds).clamp(0.0, 1.0) };
        let key = &keys[next];
        let wanted = at(time);
        let ahead = at(time + lead);
        let mut supports = Vec::new();
        for side in 0..2 {
            let bears = keys[before].bears[side] + part * (key.bears[side] - keys[before].bears[side]);
            if bears <= 0.0 {
                continue;
            }
            let sole = &robot.soles()[side];
            let link = &own_ids.links[sole.site.link];
            let [rear, front] = planner.range(side, key.feet[side]);
            let rear = if key.on_toes[side] { front - 0.02 } else { rear };
            for [x, y] in [[front, 1.0], [front, -1.0], [rear, 1.0], [rear, -1.0]] {
                let corner = sole.site.link_from_site * Point3::new(x, y * sole.half_extents[1], 0.0);
                let point = (link.body_from_link * corner).coords;
                let most = if bears >= 1.0 { f64::INFINITY } else { bears * weight };
                supports.push(Support { body: link.body, point, normal: Vector3::z_axis(), friction: 0.6, most });
            }
        }
        let mut stance = Stance::new(&own_model, own_ids.root, &wanted, supports.clone());
        let lead = Stance::new(&own_model, own_ids.root, &ahead, Vec::new());
        stance.com = lead.com;
        stance.world_from_trunk = lead.world_from_trunk;
        let mut seen = own.state.clone();
        own.see(&scene, &state, &mut seen);
        if noise {
            for joint in &own_ids.joints {
                seen.qpos[joint.qpos] += 0.01 * one();
                seen.qvel[joint.dof] += 1.5 * one();
            }
            if step > 0 {
                for joint in &own_ids.joints {
                    let (q, v) = (own.state.qpos[joint.qpos], own.state.qvel[joint.dof]);
                    let v = v + env("FV", 0.1) * (seen.qvel[joint.dof] - v);
                    let predicted = q + v * dt;
                    seen.qpos[joint.qpos] = predicted + env("FQ", 0.2) * (seen.qpos[joint.qpos] - predicted);
                    seen.qvel[joint.dof] = v;
                }
            } else {
                for joint in &own_ids.joints {
                    seen.qvel[joint.dof] = 0.0;
                }
            }
        }
        own.state = seen;
        let mut planned = Mechanics::new(&own_model);
        planned.update(&own_model, &at(time + env("FOOT_LEAD", 0.0)));
        let mut now = Mechanics::new(&own_model);
        now.update(&own_model, &own.state);
        for side in 0..2 {
            let swings = key.bears[side] == 0.0;
            let site = own_ids.site(&robot.soles()[side].site);
            let (want, real) = (planned.world_from_site(&site), now.world_from_site(&site));
            let shift = want.translation.vector - real.translation.vector;
            let turn = (want.rotation * real.rotation.inverse()).scaled_axis();
            let error = nalgebra::Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
            let mut jacobian = vec![0.0; 6 * own_model.nv()];
            now.jacobian(&own_model, &site, &mut jacobian);
            let leg: Vec<usize> = (0..6).map(|k| 6 * side + k).collect();
            let nv = own_model.nv();
            let j = nalgebra::Matrix6::from_fn(|row, k| jacobian[row * nv + own_ids.joints[leg[k]].dof]);
            let damped = j * j.transpose() + nalgebra::Matrix6::identity() * 1e-3;
            let change = j.transpose() * damped.try_inverse().unwrap() * error;
            for k in 0..6 {
                let o = &mut offsets[side][k];
                *o =
                    if swings { (*o + env("INT", 0.06) * change[k]).clamp(-0.2, 0.2) } else { *o * env("DECAY", 0.99) };
                stance.posture[own_ids.joints[leg[k]].drive] += *o;
            }
        }
        let own_targets = controller.targets(&own_model, &own.state, &stance).unwrap().to_vec();
        for (own_joint, there) in own_ids.joints.iter().zip(&ids.joints) {
            targets[there.drive] = own_targets[own_joint.drive];
        }
        for _ in 0..SUBSTEPS {
            dynamics.step(model, &mut state, &Input { targets: &targets, ..Input::default() }, PHYSICS_DT);
        }
        for (joint, there) in robot.joints().iter().zip(&ids.joints) {
            let share = dynamics.efforts()[there.drive].abs() / joint.gains.effort_limit;
            if share > worst {
                (worst, worst_joint) = (share, joint.name.clone());
            }
        }
        mechanics.update(model, &state);
        let com = mechanics.center_of_mass(model, ids.root).1;
        let off = com - Stance::new(&own_model, own_ids.root, &wanted, Vec::new()).com;
        let pelvis = mechanics.world_from_body(ids.root).translation.vector;
        let wanted_pelvis = wanted.qpos[own_ids.root_qpos + 2];
        for contact in dynamics.contacts() {
            let names = [contact.shape_a, contact.shape_b].map(|shape| model.shapes()[shape.0].name.clone());
            let is_robot = |shape: ShapeId| model.bodies()[model.shapes()[shape.0].body.0].root == ids.root;
            let swing = (0..2).find(|side| key.bears[*side] == 0.0 && keys[before].bears[*side] == 0.0);
            let swing = swing.map_or("none", |side| ["left", "right"][side]);
            if (is_robot(contact.shape_a) != is_robot(contact.shape_b)) && contact.force.norm() > 5.0 {
                let sole = names
                    .iter()
                    .any(|name| name.ends_with("roll_sole") && (!name.starts_with(swing) || key.name == "down"));
                let text = format!("{next} {} {} {}", key.name, names[0], names[1]);
                if !sole && !touched.contains(&text) {
                    println!("    {time:.1} {text} {:.0}", contact.force.norm());
                    touched.push(text);
                }
            }
        }
        if off.norm() > 0.015 && next != last_off && std::env::var_os("OFF").is_some() {
            last_off = next;
            println!("    {time:.1} {next} {} off {:.3} {:.3} {:.3}", key.name, off.x, off.y, off.z);
        }
        if step % 50 == 0 && std::env::var_os("FEET").is_some() {
            let mut text = String::new();
            let mut m2 = Mechanics::new(&own_model);
            m2.update(&own_model, &wanted);
            for side in 0..2 {
                let site = &robot.soles()[side].site;
                let real = mechanics.world_from_site(&ids.site(site));
                let want = m2.world_from_site(&own_ids.site(site));
                let d = real.translation.vector - want.translation.vector;
                let turn = (want.rotation.inverse() * real.rotation).scaled_axis();
                text += &format!(
                    " | {:5.1} {:5.1} {:5.1} yaw {:5.2} pitch {:5.2}",
                    1e3 * d.x,
                    1e3 * d.y,
                    1e3 * d.z,
                    turn.z,
                    turn.y
                );
            }
            let trunk = mechanics.world_from_body(ids.root);
            let turn = (m2.world_from_body(own_ids.root).rotation.inverse() * trunk.rotation).scaled_axis();
            println!(
                "{time:5.1} {next:3} {:10} com {:5.1} {:5.1} {:5.1} trunk {:5.2} {:5.2} {:5.2}{text}",
                key.name,
                1e3 * off.x,
                1e3 * off.y,
                1e3 * off.z,
                turn.x,
                turn.y,
                turn.z
            );
        }
        if trace && step % 10 == 0 {
            let mut touching: Vec<String> = Vec::new();
            for contact in dynamics.contacts() {
                let names = [contact.shape_a, contact.shape_b].map(|shape| model.shapes()[shape.0].name.clone());
                let is_robot = |shape: ShapeId| model.bodies()[model.shapes()[shape.0].body.0].root == ids.root;
                if is_robot(contact.shape_a) != is_robot(contact.shape_b) && contact.force.norm() > 1.0 {
                    let text = format!("{}-{} {:.0}", names[0], names[1], contact.force.norm());
                    touching.push(text);
                }
            }
            println!(
                "{time:6.2} {:10} com off {:6.3} {:6.3} {:6.3} pelvis {:.3} wanted {wanted_pelvis:.3} borne {} {}",
                key.name,
                off.x,
                off.y,
                off.z,
                pelvis.z,
                controller.is_borne(),
                touching.join(", ")
            );
        }
        if (pelvis.z - wanted_pelvis).abs() > 0.15 || off.norm() > 0.2 {
            return (false, pelvis.z, format!("fell at {time:.2} s in {} ({next})", key.name));
        }
    }
    let moved =
        (mechanics.world_from_site(&scene.site("ladder_tread_0").unwrap()).translation.vector - ladder_start).norm();
    let pelvis = mechanics.world_from_body(ids.root).translation.z;
    (true, pelvis, format!("{end:.1} s, {worst_joint} at {:.0} %, ladder moved {:.1} mm", 100.0 * worst, 1e3 * moved))
}

fn main() {
    let rooms: u64 = std::env::args().nth(1).map_or(1, |text| text.parse().unwrap());
    let out = env("OUT_ANGLE", 0.2);
    let most: usize = std::env::var("TOP").ok().and_then(|text| text.parse().ok()).unwrap_or(2);
    let mut planner = Planner::new(out);
    let from = env("FROM", 0.0) as usize;
    let feet = [Foothold { surface: from, behind: if from == 0 { env("FLOOR", 0.12) } else { 0.0 } }; 2];
    let first = planner.first(feet).expect("no first posture");
    let moves: Vec<(usize, usize)> = (from + 1..=most).flat_map(|surface| [(1, surface), (0, surface)]).collect();
    let Some(rest) = planner.search(&first, &moves, 0) else {
        println!("no plan");
        return;
    };
    let mut keys: Vec<Key> = std::iter::once(first).chain(rest).collect();
    for index in 1..keys.len() {
        let (a, b) = (&keys[index - 1].state, &keys[index].state);
        let change =
            planner.scene.robot_ids.joints.iter().map(|j| (a.qpos[j.qpos] - b.qpos[j.qpos]).abs()).fold(0.0, f64::max);
        if change > 0.3 {
            println!("{index} {} jumps by {change:.2}", keys[index].name);
        }
        keys[index].seconds = (keys[index].seconds * env("SLOW", 1.0)).max(change / env("RATE", 0.5));
    }
    println!("{} postures, {:.1} s", keys.len(), keys.iter().map(|key| key.seconds).sum::<f64>());
    for room in env("ROOM", 1000.0) as u64..env("ROOM", 1000.0) as u64 + rooms {
        for noise in [true] {
            let (held, pelvis, text) = play(&planner, &keys, room, noise);
            println!("room {room}, noise {noise}: {held}, pelvis {pelvis:.3}, {text}");
        }
    }
}
