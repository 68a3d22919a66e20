//! The robot standing on every tread and on the platform of the free ladder, its palms on the rails, on the guard bar
//! where it is within reach, with and without a bulb in the right hand. All gains are times 8; [`published`] has the
//! published ones.
//!
//! A posture is solved for, its targets press the palms on by a little, and the robot is left alone.

mod places;
mod published;

use std::f64::consts::PI;
use std::sync::Arc;

use fiatlux_dynamics::BodyId;
use fiatlux_robot::{GainSet, Gains, JointGains, Robot};
use fiatlux_rules::{AttachmentRow, BodyRow, Bulb, GRAVITY, LIMBS, Row, errand, measure};
use fiatlux_tests::grasp::close_hand;
use fiatlux_tests::posture::held_targets;
use fiatlux_tests::{Rig, robot, scaled_gains};
use fiatlux_world::{
    LadderStart, Layout, PHYSICS_DT, Place as Spot, Scene, SceneConfig, SceneKind, SceneSpec, ShapeOwner, World,
};
use nalgebra::{Point3, Vector2, Vector3};

use places::{Place, find_posture, places};

/// The G1 with Inspire hands.
const JOINTS: usize = 53;
const SETTLE_SECONDS: f64 = 3.0;
const STATIC_SECONDS: f64 = 10.0;
/// Depth to which the targets press a palm into its bar, m.
const PRESS: f64 = 0.010;

/// A seed whose fixture is at the south wall.
const SOUTH: u64 = 5;

/// All gains times 8; a hand that holds a bulb keeps its own.
fn gains(robot: &Robot, with_bulb: bool) -> Gains {
    let stiff = scaled_gains(robot, &[""], 8.0);
    let own = robot.gains(GainSet::Fiatlux);
    let hand = |index: usize| with_bulb && robot.joints()[index].name.starts_with("R_");
    let pick = |index: usize| -> JointGains { if hand(index) { own.0[index] } else { stiff.0[index] } };
    Gains((0..robot.joints().len()).map(pick).collect())
}

/// Corners of both soles in the ladder's frame.
fn soles(rig: &Rig) -> Vec<Point3<f64>> {
    let ladder_from_world = rig.pose(rig.scene.body(errand::LADDER).unwrap()).inverse();
    let robot = &rig.scene.robot;
    let corners = [[-0.063, -0.033], [-0.063, 0.033], [0.139, -0.033], [0.139, 0.033]];
    robot
        .feet()
        .iter()
        .flat_map(|&foot| {
            let pose = ladder_from_world * rig.link_pose(&robot.links()[foot].name);
            corners.map(|[x, y]| pose * Point3::new(x, y, -0.035))
        })
        .collect()
}

/// Middles of both palms in the ladder's frame.
fn palms(rig: &Rig) -> Vec<Point3<f64>> {
    let ladder_from_world = rig.pose(rig.scene.body(errand::LADDER).unwrap()).inverse();
    let robot = &rig.scene.robot;
    let origin = |&palm: &usize| ladder_from_world * rig.link_pose(&robot.links()[palm].name) * Point3::origin();
    robot.palms().iter().map(origin).collect()
}

/// Farthest that one of the points moved, m.
fn farthest(now: &[Point3<f64>], before: &[Point3<f64>]) -> f64 {
    now.iter().zip(before).map(|(now, before)| (now - before).norm()).fold(0.0, f64::max)
}

/// Upward force on the robot by all of the ladder, N.
fn carried(rig: &Rig) -> f64 {
    let on_robot = rig.contacts_between(|o| matches!(o, ShapeOwner::Robot(_)), |by| by == ShapeOwner::LADDER);
    on_robot.iter().map(|(_, contact)| contact.force.z).sum()
}

/// Upward force on the ladder by the floor, N.
fn floor_load(rig: &Rig) -> f64 {
    let on_ladder = rig.contacts_between(|o| o == ShapeOwner::LADDER, |by| by == ShapeOwner::Floor);
    on_ladder.iter().map(|(_, contact)| contact.force.z).sum()
}

/// The row of a world that starts from this state, one control step on.
fn reported(rig: &Rig) -> Row {
    let scene = &rig.scene;
    let mut world = World::new(scene.clone());
    let mut row = world.row().clone();
    let body = |id: BodyId| {
        let velocity = rig.dynamics.velocity(id);
        BodyRow { pose: rig.pose(id), linear_velocity: velocity.linear, angular_velocity: velocity.angular }
    };
    row.robot = body(scene.robot_ids.root);
    row.things[errand::LADDER] = body(scene.body(errand::LADDER).unwrap());
    for bulb in errand::BULBS {
        row.things[bulb] = body(scene.body(bulb).unwrap());
    }
    let mut targets = [0.0; JOINTS];
    for (joint, ids) in scene.robot_ids.joints.iter().enumerate() {
        row.joint_position[joint] = rig.state.qpos[ids.qpos];
        row.joint_velocity[joint] = rig.state.qvel[ids.dof];
        targets[joint] = rig.targets[ids.drive];
    }
    row.attachments.fill(AttachmentRow::FREE);
    world.reset_to(&row).unwrap();
    world.step(&[0.0; JOINTS], &targets).unwrap().clone()
}

/// Measurements of 10 s of standing.
struct Stand {
    /// Farthest that a corner of a sole moved on the ladder, and that the ladder moved, m.
    slip: f64,
    ladder_drift: f64,
    /// Farthest that a resting palm moved on the ladder, and how much lower the pelvis was than at the start, m.
    palm_slip: f64,
    sunk: f64,
    /// Farthest that a corner of a sole and a resting palm moved while the robot settled, m.
    settled: [f64; 2],
    /// Fastest link, m/s, and deepest overlap of any two shapes, m.
    speed: f64,
    depth: f64,
    /// Weight of the robot with what it holds, and with the ladder, N.
    weight: f64,
    weight_with_ladder: f64,
    carried: f64,
    floor_load: f64,
    /// Forces that a world reports on feet and palms (left, right), and the old bulb's largest one on a hand body, N.
    reported: [Vector3<f64>; LIMBS],
    grip: f64,
    unconverged: u32,
}

/// The room in which the postures were looked for: at the published gains few of them hold, and headings of the ladder in
/// other rooms, different in the last bits, shift which.
fn room(gains: Gains) -> Arc<Scene> {
    let config = SceneConfig::default();
    let anchor = Spot { position: Vector2::new(0.46913596737548824, -2.709), yaw: measure::wrap_angle(-PI) };
    let robot_spot = Spot { position: Vector2::new(2.7619077184120093, -1.0055922951605578), yaw: 0.0 };
    let mut layout = Layout::draw(&config, SOUTH, LadderStart::Coupled).unwrap();
    layout.world_from_fixture.translation.x = anchor.position.x;
    layout = Layout {
        anchor,
        ladder: anchor,
        robot: robot_spot,
        bench: Some(Vector2::new(-1.3139868154291485, 1.7122042037822474)),
        crate_: Some(Vector2::new(-2.45817726825475, -1.7136742596645411)),
        ..layout
    };
    let spec = SceneSpec { layout: Some(layout), ..SceneSpec::new(SceneKind::CoupledLadder, SOUTH, gains) };
    Arc::new(Scene::build(&config, robot(), spec).unwrap())
}

/// Stands 10 s; the palms' targets lie `press` times [`PRESS`] within their bars.
fn stand(place: &Place, with_bulb: bool, gains: Gains, press: f64) -> Stand {
    let robot = robot();
    let scene = room(gains);
    let ladder = scene.body(errand::LADDER).unwrap();
    let mut rig = Rig::new(&scene);
    // A rig has no socket that would hold the bulb.
    rig.lock_body(scene.body(errand::OLD_BULB).unwrap(), true);
    let hands: &[usize] = if with_bulb { &[0] } else { &[0, 1] };
    let start = find_posture(&mut rig, place, hands, 0.0, None);
    let pressed = find_posture(&mut rig, place, hands, PRESS, Some(&start));
    let held = held_targets(&robot, &start, &scene.spec.gains);
    start.apply(&mut rig);
    if with_bulb {
        close_hand(&mut rig);
        rig.lock_robot(false);
    }
    let holds = |joint: usize| with_bulb && robot.joints()[joint].name.starts_with("R_");
    for joint in (0..JOINTS).filter(|&joint| !holds(joint)) {
        rig.targets[scene.robot_ids.joints[joint].drive] =
            held[joint] + press * (pressed.joints[joint] - start.joints[joint]);
    }
    rig.update();
    let resting = |rig: &Rig| hands.iter().map(|&hand| palms(rig)[hand]).collect::<Vec<_>>();
    let (soles_at_first, palms_at_first, height) = (soles(&rig), resting(&rig), rig.pelvis_height());
    rig.run(SETTLE_SECONDS);

    let (soles_before, palms_before, ladder_before) = (soles(&rig), resting(&rig), rig.pose(ladder).translation.vector);
    let settled = [farthest(&soles_before, &soles_at_first), farthest(&palms_before, &palms_at_first)];
    let (mut slip, mut palm_slip, mut speed, mut depth) = (0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
    for _ in 0..(STATIC_SECONDS / 0.1).round() as usize {
        for _ in 0..(0.1 / PHYSICS_DT).round() as usize {
            rig.step();
            depth = depth.max(rig.penetration());
        }
        rig.update();
        slip = slip.max(farthest(&soles(&rig), &soles_before));
        palm_slip = palm_slip.max(farthest(&resting(&rig), &palms_before));
        let links = &scene.robot_ids.links;
        speed = links.iter().map(|link| rig.dynamics.velocity(link.body).linear.norm()).fold(speed, f64::max);
    }
    let bulb_mass = if with_bulb { scene.config.bulb.mass } else { 0.0 };
    let weight = (robot.total_mass() + bulb_mass) * GRAVITY;
    let row = reported(&rig);
    Stand {
        slip,
        palm_slip,
        sunk: height - rig.pelvis_height(),
        settled,
        ladder_drift: (rig.pose(ladder).translation.vector - ladder_before).norm(),
        speed,
        depth,
        weight,
        weight_with_ladder: weight + scene.config.ladder.mass * GRAVITY,
        carried: carried(&rig),
        floor_load: floor_load(&rig),
        reported: std::array::from_fn(|limb| row.force(errand::LADDER_FORCE)[limb]),
        grip: row.force(errand::HAND_FORCE[Bulb::Old as usize]).iter().map(Vector3::norm).fold(0.0, f64::max),
        unconverged: rig.unconverged,
    }
}

fn check(with_bulb: bool) {
    let mut failed = Vec::new();
    for place in places(&SceneConfig::default().ladder) {
        let s = stand(&place, with_bulb, gains(&robot(), with_bulb), 1.0);
        let reported: f64 = s.reported.iter().map(|force| force.z).sum();
        println!(
            "{}: slip {:.3} mm, ladder {:.3} mm, speed {:.2} mm/s, depth {:.2} mm; of {:.1} N the ladder carries {:.1}, \
             reported {reported:.1}, of {:.1} N the floor {:.1}; feet and palms {:.1?} N, \
             grip {:.1} N, unconverged {}",
            place.name,
            1e3 * s.slip,
            1e3 * s.ladder_drift,
            1e3 * s.speed,
            1e3 * s.depth,
            s.weight,
            s.carried,
            s.weight_with_ladder,
            s.floor_load,
            s.reported.map(|force| force.norm()),
            s.grip,
            s.unconverged,
        );
        let near = |load: f64, weight: f64| (load - weight).abs() < 0.05 * weight;
        let palms = &s.reported[2..if with_bulb { 3 } else { 4 }];
        let bars = [
            ("slip", s.slip < 1e-3),
            ("ladder drift", s.ladder_drift < 1e-3),
            ("speed", s.speed < 0.01),
            ("depth", s.depth < 2e-3),
            ("carried", near(s.carried, s.weight)),
            ("reported", near(reported, s.weight)),
            ("floor load", near(s.floor_load, s.weight_with_ladder)),
            ("palms touch", palms.iter().all(|force| force.norm() > 1.0)),
            ("bulb held", !with_bulb || s.grip > 1.0),
            ("converged", s.unconverged == 0),
        ];
        failed.extend(bars.iter().filter(|(_, met)| !met).map(|(bar, _)| format!("{}: {bar}", place.name)));
    }
    assert!(failed.is_empty(), "{failed:?}");
}

#[test]
fn with_both_palms() {
    check(false);
}

#[test]
fn with_a_bulb_in_the_right_hand() {
    check(true);
}
