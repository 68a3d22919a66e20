//! Plans ways up the step ladder, from the floor to the platform: backwards, and with the face to it, which reversed is the way
//! down. Then, on the platform, the turn from the back to the face.
//!
//!     cargo run -p fiatlux-climb --example plan -- ladder crates/climb/src/ladder.txt
//!     cargo run -p fiatlux-climb --example plan -- descent crates/climb/src/descent.txt
//!     cargo run -p fiatlux-climb --example plan -- turn crates/climb/src/turn.txt
#![allow(clippy::unwrap_used, missing_docs, clippy::print_stdout)]

use std::f64::consts::PI;
use std::sync::Arc;

use fiatlux_climb::{Arm, Foothold, Places, Plan, Planner};
use fiatlux_dynamics::{Mechanics, ShapeId};
use fiatlux_kinematics::{Clearance, at_once};
use fiatlux_robot::{BODY, GainSet, MOVED, Robot};
use fiatlux_world::{Scene, SceneConfig, SceneKind, SceneSpec};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

const SURFACES: [&str; 6] =
    ["floor", "ladder_tread_0", "ladder_tread_1", "ladder_tread_2", "ladder_tread_3", "ladder_platform"];
const PLATFORM: usize = 5;
/// Half the depth of a tread, and of what bears on the platform inwards from its edge, m.
const HALF_DEPTH: f64 = 0.045;
const PLATFORM_DEPTH: f64 = 0.35;
/// Distance of the soles' middles from the ladder's, and ahead of a tread's middle, m.
const ASIDE: f64 = 0.11;
const OFFSET: f64 = -0.01;

/// Half extents of the platform, and distance of its middle from the ladder's, m.
const PLATFORM_HALF: [f64; 2] = [0.24, 0.20];
const TOP_POINT: f64 = 0.1;

/// The way in which the robot goes up.
#[derive(Debug, Clone, Copy)]
struct Way {
    /// 1 with the face to the ladder, -1 with the back to it.
    face: f64,
    /// Turn of the toes outwards, rad: the soles lie along the treads, so that the ankles' pitch, which has more to give,
    /// balances across the robot.
    out: f64,
    /// Where the feet stand on the floor, before the middle of the lowest tread, m.
    before: f64,
    /// Smallest gaps, m: of two parts of the robot, to the ladder, and of a foot in the air, and of the arms to the
    /// ladder.
    gaps: [f64; 4],
    /// As of [`Planner::arms`], if not its own.
    arms: Option<[Arm; 2]>,
    /// The arms on the platform, between guard rail and lamp; elsewhere they then move out of the ladder's way.
    on_platform: Option<[Arm; 2]>,
}

const LADDER: Way =
    Way { face: -1.0, out: 1.5, before: 0.12, gaps: [0.001, 0.010, 0.010, 0.010], arms: None, on_platform: None };
const FOLDED: Arm = Arm { pitch: 1.0, roll: 0.3, elbow: -1.0, ..Arm::ZERO };
const DRAWN_BACK: Arm = Arm { pitch: 1.1, roll: 0.35, elbow: -0.4, ..Arm::ZERO };
const DESCENT: Way = Way {
    face: 1.0,
    out: 1.57,
    before: 0.14,
    gaps: [0.001, 0.003, 0.010, 0.030],
    arms: Some([DRAWN_BACK; 2]),
    on_platform: Some([FOLDED; 2]),
};
impl Way {
    fn heading(&self) -> f64 {
        if self.face > 0.0 { 0.0 } else { PI }
    }
}

struct Ladder {
    way: Way,
    scene: Scene,
    mechanics: Mechanics,
}

impl Ladder {
    fn new(way: Way, config: &SceneConfig) -> Self {
        let robot = Arc::new(Robot::benchmark().unwrap());
        let spec = SceneSpec::new(SceneKind::Climb, 0, robot.gains(GainSet::default()));
        let scene = Scene::build(config, robot, spec).unwrap();
        let mut mechanics = Mechanics::new(&scene.model);
        mechanics.update(&scene.model, &scene.model.reference_state());
        Self { way, scene, mechanics }
    }

    fn site(&self, name: &str) -> Isometry3<f64> {
        self.mechanics.world_from_site(&self.scene.site(name).unwrap())
    }

    /// A foothold on a surface.
    fn foothold(&self, side: usize, surface: usize) -> Foothold {
        let mut at = self.site(SURFACES[surface.max(1)]).translation.vector;
        match surface {
            0 => (at.x, at.z) = (at.x - self.way.before, 0.0),
            PLATFORM => at.x -= 0.2 - HALF_DEPTH,
            _ => {}
        }
        at.x += OFFSET;
        let outwards = [1.0, -1.0][side];
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.way.heading() + outwards * self.way.out);
        let sole = Isometry3::from_parts((at + Vector3::y() * (self.way.face * outwards * ASIDE)).into(), turn);
        let half = self.scene.robot.soles()[side].half_extents;
        // A corner of the turned sole gets to the tread's edge before its middle does.
        let reach = |edge: f64| ((edge - half[1] * self.way.out.sin()) / self.way.out.cos()).clamp(0.0, half[0]);
        let depth = if surface == PLATFORM { PLATFORM_DEPTH } else { HALF_DEPTH };
        let range = match surface {
            0 => [-half[0], half[0]],
            _ if self.way.face > 0.0 => [-reach(HALF_DEPTH + OFFSET), reach(depth - OFFSET)],
            _ => [-reach(depth - OFFSET), reach(HALF_DEPTH + OFFSET)],
        };
        Foothold { sole, range, surface }
    }

    /// Part of a sole on the platform that is over it.
    fn range_on_platform(&self, side: usize, sole: &Isometry3<f64>) -> [f64; 2] {
        let [half, wide] = self.scene.robot.soles()[side].half_extents;
        let platform = self.site(SURFACES[PLATFORM]);
        let is_over = |ahead: f64| {
            [wide, -wide].iter().all(|aside| {
                let corner = platform.inverse() * sole * Point3::new(ahead, *aside, 0.0);
                corner.x.abs() < PLATFORM_HALF[0] && corner.y.abs() < PLATFORM_HALF[1]
            })
        };
        let reach =
            |sign: f64| (0..=100).map(|part| sign * half * f64::from(part) / 100.0).take_while(|x| is_over(*x)).last();
        [reach(-1.0).unwrap_or(0.0), reach(1.0).unwrap_or(0.0)]
    }

    fn clearances(&self, places: Places) -> Vec<Clearance> {
        let (model, ids) = (&self.scene.model, &self.scene.robot_ids);
        let shape = |id: ShapeId| &model.shapes()[id.0];
        let is_robot = |id: ShapeId| model.bodies()[shape(id).body.0].root == ids.root;
        let soles = self.scene.robot.soles();
        let foot = |id: ShapeId| soles.iter().position(|sole| ids.site(&sole.site).body == shape(id).body);
        let stands = |a: ShapeId, b: ShapeId| {
            let on = foot(a).and_then(|side| places[side]);
            on.is_some_and(
                |on| if on == 0 { !shape(b).name.starts_with("ladder") } else { shape(b).name == SURFACES[on] },
            )
        };
        let swings = |id: ShapeId| foot(id).is_some_and(|side| places[side].is_none());
        let is_arm = |id: ShapeId| {
            let name = &model.bodies()[shape(id).body.0].spec.name;
            is_robot(id) && ["shoulder", "elbow", "wrist", "L_", "R_"].iter().any(|part| name.contains(part))
        };
        let is_lamp = |id: ShapeId| shape(id).name.starts_with("fixture");
        let gap = |a: ShapeId, b: ShapeId| match is_robot(a) && is_robot(b) {
            true => self.way.gaps[0],
            false if is_lamp(a) || is_lamp(b) => LAMP_GAP,
            false if swings(a) || swings(b) => self.way.gaps[2],
            false if is_arm(a) || is_arm(b) => self.way.gaps[3],
            false => self.way.gaps[1],
        };
        let pairs =
            model.shape_pairs().filter(|&(a, b)| (is_robot(a) || is_robot(b)) && !stands(a, b) && !stands(b, a));
        pairs.map(|(a, b)| Clearance { shapes: (a, b), margin: gap(a, b) }).collect()
    }
}

/// The lamp beyond the guard rail, from the ladder's middle and above the floor, and the gap to it, m: it stands for a bulb and a
/// housing, which hang or stick out of a wall.
const LAMP: [f64; 2] = [0.47, 2.15];
const LAMP_GAP: f64 = 0.07;
/// As of [`Way::gaps`], while the robot turns round.
const TURNING_GAPS: [f64; 4] = [0.001, 0.020, 0.010, 0.030];
/// Arms while it turns round: hands beside the chest, clear of guard rail and lamp.
const BESIDE: Arm = Arm { pitch: 1.0, roll: 0.25, elbow: -0.5, ..Arm::ZERO };

/// A step of a robot that turns round.
struct Turn {
    side: usize,
    /// Headings of the toes at its end, and of the pelvis while the foot is in the air, degrees.
    toes: f64,
    pelvis: f64,
    /// Distance of the point that the robot turns about from the ladder's middle, m.
    middle: f64,
}

const fn turn_by(side: usize, toes: f64, pelvis: f64, middle: f64) -> Turn {
    Turn { side, toes, pelvis, middle }
}

/// The toes point away from the middle, and the feet go round it; the left foot begins at 270 degrees, the right one at 90.
const ROUND: [Turn; 7] = [
    turn_by(0, 300.0, 190.0, 0.03),
    turn_by(1, 120.0, 220.0, 0.045),
    turn_by(0, 350.0, 235.0, 0.045),
    turn_by(1, 170.0, 250.0, 0.045),
    turn_by(0, 400.0, 285.0, 0.045),
    turn_by(1, 220.0, 300.0, 0.045),
    turn_by(0, 420.0, 330.0, 0.045),
];
const ROUND_RADIUS: f64 = 0.12;
/// Then they go abreast, where a task on the platform begins.
const ABREAST: [Turn; 2] = [turn_by(1, 345.0, 335.0, 0.135), turn_by(0, 375.0, 385.0, 0.135)];
const ABREAST_ASIDE: f64 = 0.118;

/// Plans the turn on the platform, from where the way up ends.
fn turn(file: &str) {
    let mut config = SceneConfig::default();
    config.climb.fixture = [config.climb.ladder[0] + LAMP[0], config.climb.ladder[1], LAMP[1]];
    let ladder = Ladder::new(Way { gaps: TURNING_GAPS, ..LADDER }, &config);
    let scene = &ladder.scene;
    let ids = &scene.robot_ids;
    let mut planner = Planner::new(&scene.model, &scene.robot, ids, Box::new(|places| ladder.clearances(places)));
    planner.arms = [BESIDE; 2];
    let up = fiatlux_climb::ladder().unwrap();
    let last = up.keyframes.last().unwrap();
    let platform = ladder.site(SURFACES[PLATFORM]).translation.vector;
    let world_from_plan = Isometry3::translation(platform.x - TOP_POINT, platform.y, 0.0);
    let mut state = scene.model.reference_state();
    state.set_pose(&scene.model, ids.root, &(world_from_plan * last.pelvis));
    let rest = planner.rest([0.4; 2]);
    let angles = last.angles[..MOVED].iter().chain(&rest[MOVED..BODY]);
    ids.joints.iter().zip(angles).for_each(|(joint, angle)| state.qpos[joint.qpos] = *angle);
    let mut plan = Plan { keyframes: vec![last.clone()] };
    let mut feet = [0, 1].map(|side| ladder.foothold(side, PLATFORM));
    let mut facing = PI;
    planner.turn(facing, facing);
    let (next, key) = at_once(planner.stand(&state, feet)).expect("no posture to turn from");
    state = next;
    plan.extend([key]);
    let abreast = |turn: &Turn| Vector3::new(turn.middle, [1.0, -1.0][turn.side] * ABREAST_ASIDE, platform.z);
    let round = |turn: &Turn| {
        let (sin, cos) = turn.toes.to_radians().sin_cos();
        Vector3::new(turn.middle + ROUND_RADIUS * cos, ROUND_RADIUS * sin, platform.z)
    };
    let steps = ROUND.iter().map(|turn| (turn, round(turn))).chain(ABREAST.iter().map(|turn| (turn, abreast(turn))));
    for (turn, at) in steps {
        let (toes, pelvis) = (turn.toes.to_radians(), turn.pelvis.to_radians());
        let sole = world_from_plan * Isometry3::new(at, Vector3::z() * toes);
        let to = Foothold { sole, range: ladder.range_on_platform(turn.side, &sole), surface: PLATFORM };
        planner.turn(facing, pelvis);
        let Some((next, keyframes)) = at_once(planner.step(&state, feet, turn.side, to)) else {
            panic!("no way for foot {} to {} degrees", turn.side, turn.toes)
        };
        plan.extend(keyframes);
        (state, feet[turn.side], facing) = (next, to, pelvis);
        println!("foot {} at {} degrees: {:.1} s", turn.side, turn.toes, plan.seconds());
    }
    planner.turn(2.0 * PI, 2.0 * PI);
    let (_, key) = at_once(planner.stand(&state, feet)).expect("no posture after the turn");
    plan.extend([key]);
    plan.keyframes.remove(0);
    write(plan, &world_from_plan, file);
}

/// Writes a plan in the ladder's frame: its origin on the floor, x from the steps into it.
fn write(mut plan: Plan, world_from_plan: &Isometry3<f64>, file: &str) {
    plan.keyframes.iter_mut().for_each(|key| key.pelvis = world_from_plan.inverse() * key.pelvis);
    println!("{} postures, {:.1} s", plan.keyframes.len(), plan.seconds());
    std::fs::write(file, plan.write()).unwrap();
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [name, file] = arguments.as_slice() else { panic!("name the way and the file to write") };
    if name == "turn" {
        return turn(file);
    }
    let way = match name.as_str() {
        "ladder" => LADDER,
        "descent" => DESCENT,
        _ => panic!("{name} is not a way; name ladder, descent or turn"),
    };
    let ladder = Ladder::new(way, &SceneConfig::default());
    let scene = &ladder.scene;
    let mut planner =
        Planner::new(&scene.model, &scene.robot, &scene.robot_ids, Box::new(|places| ladder.clearances(places)));
    let mut feet = [0, 1].map(|side| ladder.foothold(side, 0));
    let mut state = scene.model.reference_state();
    let middle = (feet[0].sole.translation.vector + feet[1].sole.translation.vector) / 2.0;
    planner.out = way.out;
    planner.arms = way.arms.unwrap_or(planner.arms);
    if way.on_platform.is_some() {
        planner.move_arms();
    }
    let pelvis =
        Isometry3::new(middle + Vector3::z() * (scene.robot.standing_height() - 0.03), Vector3::z() * way.heading());
    state.set_pose(&scene.model, scene.robot_ids.root, &pelvis);
    let rest = planner.rest([0.3; 2]);
    scene.robot_ids.joints.iter().zip(&rest).for_each(|(joint, angle)| state.qpos[joint.qpos] = *angle);
    let mut plan = Plan::default();
    let (mut state, first) = at_once(planner.stand(&state, feet)).expect("no posture on the floor");
    plan.extend([first]);
    for surface in 1..=PLATFORM {
        for side in [1, 0] {
            let to = ladder.foothold(side, surface);
            let step = at_once(planner.step(&state, feet, side, to));
            let Some((next, keyframes)) = step else { panic!("no way for foot {side} to {}", SURFACES[surface]) };
            plan.extend(keyframes);
            (state, feet[side]) = (next, to);
            println!("{}: {:.1} s", SURFACES[surface], plan.seconds());
        }
    }
    if let Some(arms) = way.on_platform {
        planner.arms = arms;
        let rest = planner.rest([0.4; 2]);
        for index in MOVED..BODY {
            state.qpos[scene.robot_ids.joints[index].qpos] = rest[index];
        }
        let (_, last) = at_once(planner.stand(&state, feet)).expect("no posture on the platform");
        plan.extend([last]);
    }
    let platform = ladder.site(SURFACES[PLATFORM]).translation.vector;
    write(plan, &Isometry3::translation(platform.x - TOP_POINT, platform.y, 0.0), file);
}
