//! Reward terms of following the plan, a second.

use fiatlux_climb::Pose;
use fiatlux_robot::MOVED;
use fiatlux_rules::{Limb, Row, errand};
use fiatlux_world::World;
use nalgebra::{Isometry3, Vector3};

use super::Climbing;

/// The input of a term. Poses are in the plan's frame.
pub(super) struct View<'a> {
    pub climbing: &'a Climbing,
    pub row: &'a Row,
    pub pelvis: Isometry3<f64>,
    pub soles: [Isometry3<f64>; 2],
    /// Centre of mass, as averaged, off the one that is due over the feet where they are, m.
    pub com_error: Vector3<f64>,
    /// Force of the ladder on other parts than feet, N.
    pub touch: f64,
    pub is_lost: bool,
}

/// Name, weight a second, value.
pub(super) type TermOf = (&'static str, f64, fn(&View<'_>) -> f64);

pub(super) const TERMS: [TermOf; 18] = [
    ("alive", 1.0, |_| 1.0),
    ("track_base_position", 1.0, |view| kernel(pelvis_error(view).norm_squared(), 0.04)),
    ("track_base_orientation", 0.7, |view| {
        kernel(square(view.pelvis.rotation.angle_to(&view.climbing.tracker.due().pelvis.rotation)), 0.2)
    }),
    ("track_com", 1.5, |view| kernel(com_error(view), 0.03)),
    ("com_error", -4.0, |view| com_error(view).sqrt().min(0.2)),
    ("track_com_vel", 0.7, |view| kernel(view.row.com_velocity.norm_squared(), 0.15)),
    ("track_feet_position", 1.5, |view| 0.5 * feet(view, |(way, _)| kernel(way * way, 0.03))),
    ("track_feet_orientation", 0.7, |view| 0.5 * feet(view, |(_, turn)| kernel(turn * turn, 0.15))),
    ("track_joint_pos", 0.7, track_joint_pos),
    ("feet_contact", 1.0, feet_contact),
    ("feet_contact_error", -1.5, feet_contact_error),
    ("undesired_contacts", -0.01, |view| view.touch.min(200.0)),
    ("ladder_vel", -5.0, |view| view.row.things[errand::LADDER].linear_velocity.norm().min(1.0)),
    ("joint_torques", -1e-5, |view| squares(view.row.joint_effort.iter().take(MOVED))),
    ("joint_vel", -5e-3, |view| squares(view.row.joint_velocity.iter().take(MOVED)).min(400.0)),
    ("action_rate", -0.05, |view| {
        let [new, old] = view.climbing.tracker.actions();
        new.iter().zip(old).map(|(new, old)| square(new - old)).sum()
    }),
    ("action_l2", -0.01, |view| squares(view.climbing.tracker.actions()[0].iter())),
    ("termination", -250.0, |view| f64::from(u8::from(view.is_lost))),
];

/// Upward force of floor and ladder on each foot, N.
fn loads(row: &Row) -> [f64; 2] {
    [Limb::LeftFoot, Limb::RightFoot].map(|foot| {
        let force = |measure| row.force(measure)[foot as usize].z;
        force(errand::FLOOR_FORCE) + force(errand::LADDER_FORCE)
    })
}

fn square(number: f64) -> f64 {
    number * number
}

fn squares<'a>(numbers: impl Iterator<Item = &'a f64>) -> f64 {
    numbers.map(|number| number * number).sum()
}

/// Of a squared error.
fn kernel(error: f64, width: f64) -> f64 {
    libm::exp(-error / (width * width))
}

fn pelvis_error(view: &View<'_>) -> Vector3<f64> {
    view.pelvis.translation.vector - view.climbing.tracker.due().pelvis.translation.vector
}

/// Squared, level, m^2.
fn com_error(view: &View<'_>) -> f64 {
    view.com_error.xy().norm_squared()
}

/// Sum over the feet of what a way (m) and a turn (rad) from the plan are worth.
fn feet(view: &View<'_>, value: impl Fn((f64, f64)) -> f64) -> f64 {
    let feet = view.soles.iter().zip(&view.climbing.tracker.due().soles);
    feet.map(|(sole, due)| {
        let way = (sole.translation.vector - due.translation.vector).norm();
        value((way, sole.rotation.angle_to(&due.rotation)))
    })
    .sum()
}

/// Mean way of the feet that bear from their places, m.
pub(super) fn support_error(due: &Pose, soles: &[Isometry3<f64>; 2]) -> Vector3<f64> {
    let errors = soles.iter().zip(&due.soles).zip(due.bears).filter(|(_, bears)| *bears > 0.0);
    let errors = errors.map(|((sole, due), _)| sole.translation.vector - due.translation.vector);
    let (sum, count) = errors.fold((Vector3::zeros(), 0.0), |(sum, count), error| (sum + error, count + 1.0));
    sum / f64::max(count, 1.0)
}

fn track_joint_pos(view: &View<'_>) -> f64 {
    let due = &view.climbing.tracker.due().angles;
    let errors = view.row.joint_position.iter().zip(due).take(MOVED).map(|(q, due)| square(q - due));
    kernel(errors.sum(), 0.5)
}

/// Feet that bear as the plan says: one that bears all has more than 200 N, one of two has more than 10 N, one in the air less than 30 N.
fn feet_contact(view: &View<'_>) -> f64 {
    let (loads, bears) = (loads(view.row), view.climbing.tracker.due().bears);
    let is_right = |side: usize| {
        let alone = bears[1 - side] <= 0.0;
        match bears[side] > 0.0 {
            true => loads[side] > if alone { 200.0 } else { 10.0 },
            false => loads[side] < 30.0,
        }
    };
    (0..2).map(|side| 0.5 * f64::from(u8::from(is_right(side)))).sum()
}

/// Load of a foot that is in the air beyond 30 N, in 100 N.
fn feet_contact_error(view: &View<'_>) -> f64 {
    let (loads, bears) = (loads(view.row), view.climbing.tracker.due().bears);
    (0..2).filter(|side| bears[*side] <= 0.0).map(|side| (loads[side] / 100.0 - 0.3).clamp(0.0, 3.0)).sum()
}

/// Force of the ladder on the robot but for its feet, N.
pub(super) fn touch(world: &World) -> f64 {
    let scene = world.scene();
    let Some(ladder) = scene.body(errand::LADDER) else { return 0.0 };
    let (model, ids) = (&scene.model, &scene.robot_ids);
    let feet = scene.robot.feet();
    let is_foot = |body| feet.iter().any(|foot| ids.links[*foot].body == body);
    let contacts = world.dynamics().contacts().iter().filter_map(|contact| {
        let [a, b] = [contact.shape_a, contact.shape_b].map(|shape| model.shapes()[shape.0].body);
        let other = if a == ladder {
            b
        } else if b == ladder {
            a
        } else {
            return None;
        };
        let is_robot = model.bodies()[other.0].root == ids.root;
        (is_robot && !is_foot(other)).then(|| contact.force.norm())
    });
    contacts.sum()
}
