//! Test of whether one body among what is fixed would stay where it is.

use nalgebra::{Matrix3, Matrix6, Vector6};

use super::SPEED;
use crate::contact::Contact;
use crate::contact_law::Point;
use crate::kinematics::Kinematics;
use crate::model::Model;
use crate::parameters::{Inertial, Parameters};
use crate::solve::stiffness_of;
use crate::spatial::{Force, Inertia, Motion, Sym3, V3, Wrench};

/// Disturbance, in units of the weight: a force to each side, and a torque at the lever of the body's radius of gyration. It is
/// a slope of 0.3 degrees. What it tips, slides or rolls away does not lie firmly.
const DISTURBANCE: f64 = 0.005;
/// Speed that it may give a body that stays, m/s: contacts yield a little. A disturbance that nothing resists gives four times that
/// in a step of 5 ms.
const DISTURBED_SPEED: f64 = 5e-5;
/// Most Newton iterations; firm contact takes one or two.
const MAX_ITERATIONS: usize = 8;
/// Residual, in units of the weight's momentum over the step.
const TOLERANCE: f64 = 1e-6;
/// Contact points that there is memory for.
const CONTACTS: usize = 128;

#[derive(Debug, Clone)]
pub(crate) struct Trial {
    /// Contacts with what is fixed, for the body at rest.
    pub contacts: Vec<Contact>,
    points: Vec<Point>,
}

impl Trial {
    pub fn new() -> Self {
        Self { contacts: Vec::with_capacity(CONTACTS), points: Vec::with_capacity(CONTACTS) }
    }

    /// True if the body, at rest, would be as good as at rest after a step of `dt` s, and if disturbed too. Leaves the forces of
    /// the contacts.
    pub fn stays(
        &mut self,
        model: &Model,
        parameters: &Parameters,
        kin: &Kinematics,
        body: usize,
        wrench: &Wrench,
        dt: f64,
    ) -> bool {
        if self.contacts.len() > CONTACTS {
            return false;
        }
        let inertial = &parameters.bodies[body];
        let inverse_mass = parameters.inverse_weights.bodies[0] + parameters.inverse_weights.bodies[body];
        let inertia = inertia(inertial, &kin.rotation[body]);
        let (origin, com) = (kin.position[body], inertia.moment / inertia.mass);
        self.points.clear();
        for contact in &self.contacts {
            let sign = self.sign(model, contact);
            let arm = contact.position - origin;
            self.points.push(Point::new(&arm, &(contact.normal * sign), contact, inverse_mass, dt));
        }
        let weight = parameters.gravity * inertial.mass;
        let load = |push: &V3, turn: &V3| {
            let force = weight + wrench.force + push;
            Force { torque: com.cross(&force) + wrench.torque + turn, force }
        };
        let (scale, none) = (weight.norm() * DISTURBANCE, V3::zeros());
        let mut motion = Motion::ZERO;
        if !self.settles(&inertia, &load(&none, &none), &mut motion, SPEED, dt) {
            return false;
        }
        for index in 0..self.contacts.len() {
            let sign = self.sign(model, &self.contacts[index]);
            self.contacts[index].force = self.points[index].wrench().force * (sign / dt);
        }
        if scale == 0.0 {
            return true;
        }
        let up = weight.normalize();
        let across = if up.x.abs() < 0.6 { V3::x() } else { V3::y() };
        let first = up.cross(&across).normalize();
        let lever = gyration(inertial);
        [first, -first, up.cross(&first), -up.cross(&first)].iter().all(|side| {
            let push = side * scale;
            self.settles(&inertia, &load(&push, &none), &mut motion, DISTURBED_SPEED, dt)
                && self.settles(&inertia, &load(&none, &(push * lever)), &mut motion, DISTURBED_SPEED, dt)
        })
    }

    /// Sign by which a contact's normal points to the body.
    fn sign(&self, model: &Model, contact: &Contact) -> f64 {
        if model.shapes[contact.shape_b.0].body.0 == 0 { -1.0 } else { 1.0 }
    }

    /// Finds the velocity after a step from rest under a load, from the motion at hand; false if it is not as slow as that, m/s.
    fn settles(&mut self, inertia: &Inertia, load: &Force, motion: &mut Motion, slow: f64, dt: f64) -> bool {
        let mass = matrix_of(inertia);
        let momentum = flat_force(load) * dt;
        let limit = TOLERANCE * momentum.norm();
        for _ in 0..MAX_ITERATIONS {
            let mut gradient = mass * flat_motion(motion) - momentum;
            for point in &mut self.points {
                point.set_velocity(motion);
                if point.update() {
                    gradient -= flat_force(&point.wrench());
                }
            }
            if gradient.norm() <= limit {
                return speed(inertia, motion) <= slow;
            }
            let mut hessian = mass;
            if let Some(stiffness) = stiffness_of(&self.points) {
                hessian += Matrix6::from_fn(|r, c| stiffness[r][c]);
            }
            let Some(factor) = hessian.cholesky() else { return false };
            let step = factor.solve(&gradient);
            motion.angular -= step.fixed_rows::<3>(0).into_owned();
            motion.linear -= step.fixed_rows::<3>(3).into_owned();
        }
        false
    }
}

/// About the body's origin, in world axes.
pub(super) fn inertia(inertial: &Inertial, rotation: &Matrix3<f64>) -> Inertia {
    Inertia::new(inertial.mass, &(rotation * inertial.com), &Sym3::rotated(rotation, &inertial.inertia))
}

/// Root of twice the kinetic energy over the mass.
pub(super) fn speed(inertia: &Inertia, motion: &Motion) -> f64 {
    (motion.dot(&inertia.apply(motion)) / inertia.mass).max(0.0).sqrt()
}

/// Largest radius of gyration about the centre of mass.
fn gyration(inertial: &Inertial) -> f64 {
    (inertial.inertia.diagonal().max() / inertial.mass).sqrt()
}

fn matrix_of(inertia: &Inertia) -> Matrix6<f64> {
    let columns = [0, 1, 2, 3, 4, 5].map(|k| {
        let unit = Vector6::ith(k, 1.0);
        let motion =
            Motion { angular: unit.fixed_rows::<3>(0).into_owned(), linear: unit.fixed_rows::<3>(3).into_owned() };
        flat_force(&inertia.apply(&motion))
    });
    Matrix6::from_columns(&columns)
}

fn flat_motion(m: &Motion) -> Vector6<f64> {
    Vector6::new(m.angular.x, m.angular.y, m.angular.z, m.linear.x, m.linear.y, m.linear.z)
}

fn flat_force(f: &Force) -> Vector6<f64> {
    Vector6::new(f.torque.x, f.torque.y, f.torque.z, f.force.x, f.force.y, f.force.z)
}
