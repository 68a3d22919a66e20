//! The contact law: a regularised Coulomb cone whose impulse is the projection of a linear one, so that it derives from a
//! convex potential (Castro, Permenter, Han: An Unconstrained Convex Formulation of Compliant Contact, 2023).

use crate::spatial::{Force, V3};

/// Compliance along the normal, in units of the pair's inverse mass.
const NORMAL_COMPLIANCE: f64 = 1e-2;
/// Compliance along the tangents, in units of the pair's inverse mass, which counts as 1/kg at most here: what a pair
/// creeps at under a given load does not grow further when it gets lighter.
const TANGENT_COMPLIANCE: f64 = 1e-3;
const MAX_TANGENT_INVERSE_MASS: f64 = 1.0;
/// Part of a penetration that one step takes back. There is no slop: the margin around shapes keeps contacts alive, and a
/// point that overlaps without load would resist sliding.
const BAUMGARTE: f64 = 0.2;
/// Fastest that a penetration is pushed out, m/s.
const MAX_PUSH_OUT: f64 = 1.0;

/// Separation speed that a contact asks for: no more approach than the gap allows, or push-out of a penetration.
pub(crate) fn target_speed(distance: f64, dt: f64) -> f64 {
    if distance > 0.0 { -distance / dt } else { (-BAUMGARTE * distance / dt).min(MAX_PUSH_OUT) }
}

/// One contact point in the solve. Components are (tangent, tangent, normal).
#[derive(Debug, Clone, Copy)]
pub(crate) struct Point {
    /// Directions as unit forces about the pair's origin.
    pub rows: [Force; 3],
    pub friction: f64,
    target_speed: f64,
    inverse_normal: f64,
    inverse_tangent: f64,
    /// Relative velocity, b less a, m/s.
    pub velocity: V3,
    /// Change of it along the search direction.
    pub direction: V3,
    /// Impulse on b, N s.
    pub impulse: V3,
    /// Minus the derivative of the impulse by the velocity: tt, tt', t't', tn, t'n, nn.
    pub stiffness: [f64; 6],
}

impl Point {
    /// At `arm` from the pair's origin; `inverse_mass` of the pair in 1/kg.
    pub fn new(arm: &V3, normal: &V3, friction: f64, distance: f64, inverse_mass: f64, dt: f64) -> Self {
        // The axis least along the normal gives well-conditioned tangents.
        // A constant stays in registers, where an indexed store would have to reach memory first.
        let axis = match normal.iamin() {
            0 => V3::x(),
            1 => V3::y(),
            _ => V3::z(),
        };
        let tangent = normal.cross(&axis).normalize();
        let other = normal.cross(&tangent);
        let row = |d: &V3| Force { torque: arm.cross(d), force: *d };
        Self {
            rows: [row(&tangent), row(&other), row(normal)],
            friction,
            target_speed: target_speed(distance, dt),
            inverse_normal: 1.0 / (NORMAL_COMPLIANCE * inverse_mass),
            inverse_tangent: 1.0 / (TANGENT_COMPLIANCE * inverse_mass.min(MAX_TANGENT_INVERSE_MASS)),
            velocity: V3::zeros(),
            direction: V3::zeros(),
            impulse: V3::zeros(),
            stiffness: [0.0; 6],
        }
    }

    #[inline(always)]
    fn impulse_at(&self, velocity: &V3) -> (V3, Region) {
        let normal = (self.target_speed - velocity.z) * self.inverse_normal;
        let (x, y) = (-velocity.x * self.inverse_tangent, -velocity.y * self.inverse_tangent);
        let slide = (x * x + y * y).sqrt();
        let mu = self.friction;
        if slide <= mu * normal {
            return (V3::new(x, y, normal), Region::Stick);
        }
        let ratio = mu * self.inverse_normal / self.inverse_tangent;
        if normal <= -ratio * slide {
            return (V3::zeros(), Region::Apart);
        }
        let pressed = (normal + ratio * slide) / (1.0 + mu * ratio);
        let (x, y) = (x / slide, y / slide);
        (V3::new(mu * pressed * x, mu * pressed * y, pressed), Region::Slide { x, y, pressed, slide })
    }

    /// Sets the impulse and its stiffness at the current velocity. False if the contact carries nothing.
    pub fn update(&mut self) -> bool {
        let (impulse, region) = self.impulse_at(&self.velocity);
        self.impulse = impulse;
        self.stiffness = self.stiffness_in(&region);
        !matches!(region, Region::Apart)
    }

    fn stiffness_in(&self, region: &Region) -> [f64; 6] {
        match *region {
            Region::Apart => [0.0; 6],
            Region::Stick => [self.inverse_tangent, 0.0, self.inverse_tangent, 0.0, 0.0, self.inverse_normal],
            Region::Slide { x, y, pressed, slide } => {
                let (along, across) = self.slide_stiffness(pressed, slide);
                self.sliding(x, y, along, across)
            }
        }
    }

    /// Tangential stiffness of a sliding contact along and across its slide.
    fn slide_stiffness(&self, pressed: f64, slide: f64) -> (f64, f64) {
        let mu_ratio = self.friction * self.friction * self.inverse_normal / self.inverse_tangent;
        let along = mu_ratio / (1.0 + mu_ratio) * self.inverse_tangent;
        (along, self.friction * pressed / slide * self.inverse_tangent)
    }

    fn sliding(&self, x: f64, y: f64, along: f64, across: f64) -> [f64; 6] {
        let mu = self.friction;
        let scale = self.inverse_normal / (1.0 + mu * mu * self.inverse_normal / self.inverse_tangent);
        [
            along * x * x + across * y * y,
            (along - across) * x * y,
            along * y * y + across * x * x,
            mu * scale * x,
            mu * scale * y,
            scale,
        ]
    }

    /// Makes the stiffness of a sliding contact as large along its slide as across it: friction's potential is a cone, and
    /// the paraboloid that touches it here bounds it from above, where its own curvature would run past the tip.
    pub fn bound_stiffness(&mut self, caution: f64) {
        if let (_, Region::Slide { x, y, pressed, slide }) = self.impulse_at(&self.velocity) {
            let (along, across) = self.slide_stiffness(pressed, slide);
            self.stiffness = self.sliding(x, y, along.max(caution * across), across);
        }
    }

    /// First and second derivative of this contact's potential at `step` along the search direction.
    #[inline(always)]
    pub fn slope(&self, step: f64) -> (f64, f64) {
        let (impulse, region) = self.impulse_at(&(self.velocity + self.direction * step));
        let g = self.stiffness_in(&region);
        let d = &self.direction;
        let curvature = g[0] * d.x * d.x
            + g[2] * d.y * d.y
            + g[5] * d.z * d.z
            + 2.0 * (g[1] * d.x * d.y + g[3] * d.x * d.z + g[4] * d.y * d.z);
        (-impulse.dot(d), curvature)
    }

    /// The impulse as a force about the pair's origin.
    pub fn wrench(&self) -> Force {
        let mut sum = Force::ZERO;
        for (row, size) in self.rows.iter().zip(self.impulse.iter()) {
            sum.torque += row.torque * *size;
            sum.force += row.force * *size;
        }
        sum
    }
}

enum Region {
    Apart,
    Stick,
    Slide { x: f64, y: f64, pressed: f64, slide: f64 },
}
