//! Where the robot can stand, and the postures for it.

use fiatlux_rules::errand;
use std::f64::consts::FRAC_PI_2;

use fiatlux_dynamics::Geometry;
use fiatlux_robot::Robot;
use fiatlux_tests::Rig;
use fiatlux_tests::posture::{Nearness, Posture, improve, nearby};
use fiatlux_world::config::LadderConfig;
use fiatlux_world::{Scene, ShapeOwner};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

/// Where the left palm rests, in the ladder's frame (the robot's left is -x there); the right one mirrors it.
#[derive(Debug, Clone, Copy)]
pub struct Rest {
    /// On the bar's axis, m.
    point: Vector3<f64>,
    axis: Vector3<f64>,
    /// Way that the palm faces.
    facing: Vector3<f64>,
}

#[derive(Debug, Clone)]
pub struct Place {
    pub name: String,
    /// Height of the tread or platform, m.
    height: f64,
    /// y of the ankles and of the centre of mass in the ladder's frame, m.
    ankle_y: f64,
    pub(super) com_y: f64,
    /// Bend of the knees from which the search starts, rad.
    knee: f64,
    rest: Rest,
}

/// Joints of the public order before those of the hands.
const BODY_JOINTS: usize = 29;
const FOOT_X: f64 = 0.10;
const ANKLE_HEIGHT: f64 = 0.035;
/// Gap that other parts of the robot keep to the ladder, m.
const CLEARANCE: f64 = 0.010;
/// Gap that the rest of a hand keeps, m.
const HAND_CLEARANCE: f64 = 0.003;

/// Lower and upper end of the left front rail's axis.
fn rail_ends(ladder: &LadderConfig) -> [Vector3<f64>; 2] {
    let ([width, depth, _], radius, [top_y, top_z]) = (ladder.size, ladder.rail_radius, ladder.rail_top);
    let x = radius - width / 2.0;
    [Vector3::new(x, radius - depth / 2.0, radius), Vector3::new(x, top_y, top_z)]
}

/// The point of the left front rail's axis at a height.
fn on_rail(ladder: &LadderConfig, z: f64) -> Vector3<f64> {
    let [low, high] = rail_ends(ladder);
    low.lerp(&high, (z - low.z) / (high.z - low.z))
}

/// Palm against the outside of a front rail.
fn rail(ladder: &LadderConfig, z: f64) -> Rest {
    let [low, high] = rail_ends(ladder);
    Rest { point: on_rail(ladder, z), axis: (high - low).normalize(), facing: Vector3::x() }
}

/// Palm on the guard bar.
fn guard_bar(ladder: &LadderConfig, x: f64) -> Rest {
    let z = ladder.size[2] - ladder.rail_radius;
    Rest { point: Vector3::new(-x, ladder.guard_y, z), axis: Vector3::x(), facing: -Vector3::z() }
}

/// Every tread from the lowest, then the platform.
pub fn places(ladder: &LadderConfig) -> Vec<Place> {
    // Ankles and centre of mass before the tread's centre, m; bend of the knees, rad; where the palms rest.
    let treads = [
        (-0.03, 0.0, 0.2, rail(ladder, 0.95)),
        (-0.03, 0.0, 0.2, rail(ladder, 1.10)),
        (-0.075, 0.0, 0.8, rail(ladder, 1.07)),
        (0.0, 0.02, 0.2, guard_bar(ladder, 0.16)),
    ];
    assert_eq!(treads.len(), ladder.tread_heights.len());
    let tread = |(&height, (ankle, com, knee, rest)): (&f64, (f64, f64, f64, Rest))| {
        let center = on_rail(ladder, height - ladder.tread_thickness / 2.0).y;
        let name = format!("tread at {height:.3} m");
        Place { name, height, ankle_y: center + ankle, com_y: center + com, knee, rest }
    };
    let mut places: Vec<Place> = ladder.tread_heights.iter().zip(treads).map(tread).collect();
    let (height, rest) = (ladder.platform_height, guard_bar(ladder, 0.2));
    places.push(Place { name: "platform".into(), height, ankle_y: 0.0, com_y: 0.03, knee: 0.3, rest });
    places
}

/// A vector of the left side in the ladder's frame, for either side.
fn on_side(v: Vector3<f64>, side: usize) -> Vector3<f64> {
    if side == 0 { v } else { Vector3::new(-v.x, v.y, v.z) }
}

/// Where the bar crosses the palm's face, in the palm's frame: towards the fingers, clear of the thumb.
fn palm_face(robot: &Robot, hand: usize) -> Point3<f64> {
    let shape = robot.shapes().iter().find(|s| s.link == robot.palms()[hand]).unwrap();
    let Geometry::Cuboid { half_extents } = shape.geometry else { panic!("the palm is not a box") };
    shape.link_from_shape * Point3::new(-half_extents.x, -0.02, 0.0)
}

/// Turn of a robot that faces the ladder from its steps.
fn facing() -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(Vector3::z() * FRAC_PI_2)
}

struct Task<'a> {
    scene: &'a Scene,
    place: &'a Place,
    hands: &'a [usize],
    press: f64,
    nominal: &'a [f64],
}

impl Task<'_> {
    fn residuals(&self, near: &[Nearness], posture: &Posture, poses: &[Isometry3<f64>]) -> Vec<f64> {
        let (robot, place) = (&self.scene.robot, self.place);
        let ladder_from_world = self.scene.world_from(errand::LADDER).inverse();
        let mut all = Vec::new();
        for (side, &foot) in robot.feet().iter().enumerate() {
            let pose = ladder_from_world * poses[foot];
            let target = on_side(Vector3::new(-FOOT_X, place.ankle_y, place.height + ANKLE_HEIGHT), side);
            let miss = pose.translation.vector - target;
            let turn = (facing().inverse() * pose.rotation).scaled_axis();
            all.extend([3.0 * miss.x, 10.0 * miss.y, 30.0 * miss.z]);
            all.extend([10.0 * turn.x, 10.0 * turn.y, turn.z]);
        }
        let com = (ladder_from_world * Point3::from(posture.center_of_mass(robot))).coords;
        all.extend([10.0 * com.x, 10.0 * (com.y - place.com_y)]);
        let lean = (facing().inverse() * (ladder_from_world * poses[0]).rotation).scaled_axis();
        all.extend([0.1 * lean.x, 0.1 * lean.y, 0.3 * lean.z]);
        for &hand in self.hands {
            let palm = ladder_from_world * poses[robot.palms()[hand]];
            let (axis, facing) = (on_side(place.rest.axis, hand), on_side(place.rest.facing, hand));
            let normal = palm * -Vector3::x();
            let reached =
                (palm * palm_face(robot, hand)).coords + normal * (self.scene.config.ladder.rail_radius - self.press);
            let miss = reached - on_side(place.rest.point, hand);
            let along = miss.dot(&axis);
            all.extend((miss - axis * along).iter().map(|m| 10.0 * m));
            all.extend([2.0 * along, normal.dot(&axis), 0.1 * (palm * Vector3::y()).dot(&axis)]);
            all.extend((normal - facing).iter().map(|m| 0.1 * m));
        }
        all.extend(posture.joints.iter().zip(self.nominal).map(|(q, n)| 0.02 * (q - n)));
        all.extend(near.iter().map(|n| 30.0 * (n.keep - n.gap(poses)).max(0.0)));
        all
    }
}

/// A posture with both soles on the place, the centre of mass above it, the palms of `hands` pressed into their bars by
/// `press` m, and everything else clear of the ladder.
pub fn find_posture(rig: &mut Rig, place: &Place, hands: &[usize], press: f64, start: Option<&Posture>) -> Posture {
    let scene = rig.scene.clone();
    let robot = &scene.robot;
    // The thumbs give way to the bars.
    let thumb = |&joint: &usize| {
        let name = &robot.joints()[joint].name;
        name.contains("thumb_proximal") && hands.iter().any(|&hand| name.starts_with(["L_", "R_"][hand]))
    };
    let free: Vec<usize> = (0..BODY_JOINTS).chain((BODY_JOINTS..robot.joints().len()).filter(thumb)).collect();
    let mut nominal = robot.q0().to_vec();
    let mut bend = |name: &str, value| nominal[robot.joint_index(name).unwrap()] = value;
    for side in ["left", "right"] {
        bend(&format!("{side}_hip_pitch_joint"), -0.5 * place.knee);
        bend(&format!("{side}_knee_joint"), place.knee);
        bend(&format!("{side}_ankle_pitch_joint"), -0.5 * place.knee);
    }
    for &hand in hands {
        // Thumb opposite the palm, the bar between them.
        bend(["L_thumb_proximal_yaw_joint", "R_thumb_proximal_yaw_joint"][hand], 0.8);
    }
    if hands.len() == 1 {
        // The free hand is held up, away from the ladder.
        bend("right_elbow_joint", -0.9);
        bend("right_shoulder_roll_joint", -0.2);
    }
    let pelvis = Vector3::new(0.0, place.ankle_y, place.height + 0.78 - 0.1 * place.knee);
    let pelvis = Isometry3::from_parts(pelvis.into(), facing());
    let first = Posture { world_from_pelvis: scene.world_from(errand::LADDER) * pelvis, joints: nominal.clone() };
    let mut posture = start.unwrap_or(&first).clone();
    let task = Task { scene: &scene, place, hands, press, nominal: &nominal };
    let limb = |link: usize| robot.feet().contains(&link) || robot.palms().contains(&link);
    for round in 0..150 {
        posture.apply(rig);
        let near = nearby(rig, 0.03, |a, b| match (a, b) {
            (ShapeOwner::LADDER, ShapeOwner::Robot(link)) | (ShapeOwner::Robot(link), ShapeOwner::LADDER) => {
                let hand = robot.hand_links().contains(&link);
                // A thumb may pass through its bar on the way.
                let counts = !(limb(link) || hand && start.is_none() && round < 60);
                counts.then_some(if hand { HAND_CLEARANCE } else { CLEARANCE })
            }
            (ShapeOwner::Robot(_), ShapeOwner::Robot(_)) => Some(0.0),
            _ => None,
        });
        posture = improve(robot, &posture, &free, |p, poses| task.residuals(&near, p, poses));
    }
    posture.apply(rig);
    posture
}
