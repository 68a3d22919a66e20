//! The contact law: a regularised Coulomb cone whose impulse is the projection of a linear one, so that it derives from a
//! convex potential (Castro, Permenter, Han: An Unconstrained Convex Formulation of Compliant Contact, 2023).

use crate::contact::Contact;
use crate::spatial::{Force, Motion, V3};

/// Compliance along the normal, in units of the pair's inverse mass.
const NORMAL_COMPLIANCE: f64 = 1e-2;
/// Compliance along the tangents, in units of the pair's inverse mass, which counts as 1/kg at most here: what a pair
/// creeps at under a given load does not grow further when it gets lighter.
const TANGENT_COMPLIANCE: f64 = 1e-3;
const MAX_TANGENT_INVERSE_MASS: f64 = 1.0;
/// The same of a contact that resists turning. Its lever is a fraction of a millimetre, so that the compliance above would let a
/// ball creep downhill.
const SPIN_COMPLIANCE: f64 = 1e-5;
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
    /// Minus the derivative of the impulse by the velocity: tt, tt', t't', tn, t'n, nn. Of a point with a spin see there.
    pub stiffness: [f64; 6],
    /// Resistance to turning, if the surfaces have it.
    pub spin: Option<Spin>,
}

/// Resistance of a contact point to turning: three more tangential components, in the same cone as those of sliding. A torque
/// counts as the force that does the same at its lever over the coefficient of friction.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Spin {
    normal: V3,
    /// Levers about the normal and about the tangents, over the coefficient of friction, m.
    torsion: f64,
    rolling: f64,
    /// Relative angular velocity times the levers, m/s; its change along the search direction.
    velocity: V3,
    direction: V3,
    /// Impulse on b, N s; times the levers it is a torque.
    impulse: V3,
    /// Stiffness along the slide and across it, that which couples the slide and the normal, and that of the normal.
    along: f64,
    across: f64,
    coupling: f64,
    normal_stiffness: f64,
    /// Unit vector of the slide: two components of sliding, three of turning.
    slide: [f64; 5],
}

impl Spin {
    fn new(contact: &Contact) -> Option<Self> {
        let &Contact { normal, friction, torsion, rolling, .. } = contact;
        let resists = friction > 0.0 && (torsion > 0.0 || rolling > 0.0);
        resists.then(|| Self {
            normal,
            torsion: torsion / friction,
            rolling: rolling / friction,
            velocity: V3::zeros(),
            direction: V3::zeros(),
            impulse: V3::zeros(),
            along: 0.0,
            across: 0.0,
            coupling: 0.0,
            normal_stiffness: 0.0,
            slide: [0.0; 5],
        })
    }

    /// A vector times the levers, which are symmetric: from turning to speed, from impulse to torque.
    #[inline(always)]
    fn by_levers(&self, v: &V3) -> V3 {
        v * self.rolling + self.normal * ((self.torsion - self.rolling) * self.normal.dot(v))
    }

    fn set_stiffness(&mut self, along: f64, across: f64, coupling: f64, normal: f64, slide: [f64; 5]) {
        (self.along, self.across, self.coupling, self.normal_stiffness) = (along, across, coupling, normal);
        self.slide = slide;
    }
}

impl Point {
    /// At `arm` from the pair's origin, with the normal towards the pair's second body; `inverse_mass` of the pair in 1/kg.
    pub fn new(arm: &V3, normal: &V3, contact: &Contact, inverse_mass: f64, dt: f64) -> Self {
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
        let spin = Spin::new(contact);
        let compliance = if spin.is_some() { SPIN_COMPLIANCE } else { TANGENT_COMPLIANCE };
        Self {
            rows: [row(&tangent), row(&other), row(normal)],
            friction: contact.friction,
            target_speed: target_speed(contact.distance, dt),
            inverse_normal: 1.0 / (NORMAL_COMPLIANCE * inverse_mass),
            inverse_tangent: 1.0 / (compliance * inverse_mass.min(MAX_TANGENT_INVERSE_MASS)),
            velocity: V3::zeros(),
            direction: V3::zeros(),
            impulse: V3::zeros(),
            stiffness: [0.0; 6],
            spin,
        }
    }

    /// Sets the velocity that belongs to a relative motion of the pair.
    #[inline(always)]
    pub fn set_velocity(&mut self, motion: &Motion) {
        for (k, row) in self.rows.iter().enumerate() {
            self.velocity[k] = motion.dot(row);
        }
        if let Some(spin) = &mut self.spin {
            spin.velocity = spin.by_levers(&motion.angular);
        }
    }

    /// Sets the search direction that belongs to a relative motion of the pair.
    #[inline(always)]
    pub fn set_direction(&mut self, motion: &Motion) {
        for (k, row) in self.rows.iter().enumerate() {
            self.direction[k] = motion.dot(row);
        }
        if let Some(spin) = &mut self.spin {
            spin.direction = spin.by_levers(&motion.angular);
        }
    }

    /// Moves along the search direction.
    #[inline(always)]
    pub fn advance(&mut self, step: f64) {
        self.velocity += self.direction * step;
        if let Some(spin) = &mut self.spin {
            spin.velocity += spin.direction * step;
        }
    }

    /// The impulse at a velocity, and what of it turns.
    #[inline(always)]
    fn impulse_at(&self, velocity: &V3, turning: Option<&V3>) -> (V3, V3, Region) {
        let normal = (self.target_speed - velocity.z) * self.inverse_normal;
        let (x, y) = (-velocity.x * self.inverse_tangent, -velocity.y * self.inverse_tangent);
        let mut square = x * x + y * y;
        let turn = turning.map_or_else(V3::zeros, |turning| turning * -self.inverse_tangent);
        if turning.is_some() {
            square += turn.norm_squared();
        }
        let slide = square.sqrt();
        let mu = self.friction;
        if slide <= mu * normal {
            return (V3::new(x, y, normal), turn, Region::Stick);
        }
        let ratio = mu * self.inverse_normal / self.inverse_tangent;
        if normal <= -ratio * slide {
            return (V3::zeros(), V3::zeros(), Region::Apart);
        }
        let pressed = (normal + ratio * slide) / (1.0 + mu * ratio);
        let (x, y, turn) = (x / slide, y / slide, turn / slide);
        let most = mu * pressed;
        (V3::new(most * x, most * y, pressed), turn * most, Region::Slide { x, y, turn, pressed, slide })
    }

    /// Sets the impulse and its stiffness at the current velocity. False if the contact carries nothing.
    #[inline]
    pub fn update(&mut self) -> bool {
        let (impulse, turned, region) = self.impulse_at(&self.velocity, self.spin.as_ref().map(|spin| &spin.velocity));
        self.impulse = impulse;
        self.stiffness = self.stiffness_in(&region);
        if let Some(mut spin) = self.spin {
            spin.impulse = turned;
            self.set_spin_stiffness(&mut spin, &region, 0.0);
            self.spin = Some(spin);
        }
        !matches!(region, Region::Apart)
    }

    fn set_spin_stiffness(&self, spin: &mut Spin, region: &Region, caution: f64) {
        match *region {
            Region::Apart => spin.set_stiffness(0.0, 0.0, 0.0, 0.0, [0.0; 5]),
            Region::Stick => {
                let tangent = self.inverse_tangent;
                spin.set_stiffness(tangent, tangent, 0.0, self.inverse_normal, [0.0; 5]);
            }
            Region::Slide { x, y, turn, pressed, slide } => {
                let (along, across) = self.slide_stiffness(pressed, slide);
                let (scale, slide) = (self.slide_scale(), [x, y, turn.x, turn.y, turn.z]);
                let along = along.max(caution * across);
                spin.set_stiffness(along, across, self.friction * scale, scale, slide);
            }
        }
    }

    fn stiffness_in(&self, region: &Region) -> [f64; 6] {
        match *region {
            Region::Apart => [0.0; 6],
            Region::Stick => [self.inverse_tangent, 0.0, self.inverse_tangent, 0.0, 0.0, self.inverse_normal],
            Region::Slide { x, y, pressed, slide, .. } => {
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

    /// Stiffness along the normal of a sliding contact.
    #[inline(always)]
    fn slide_scale(&self) -> f64 {
        let mu = self.friction;
        self.inverse_normal / (1.0 + mu * mu * self.inverse_normal / self.inverse_tangent)
    }

    fn sliding(&self, x: f64, y: f64, along: f64, across: f64) -> [f64; 6] {
        let (mu, scale) = (self.friction, self.slide_scale());
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
        let (_, _, region) = self.impulse_at(&self.velocity, self.spin.as_ref().map(|spin| &spin.velocity));
        if let Some(mut spin) = self.spin {
            self.set_spin_stiffness(&mut spin, &region, caution);
            self.spin = Some(spin);
        }
        if let Region::Slide { x, y, pressed, slide, .. } = region {
            let (along, across) = self.slide_stiffness(pressed, slide);
            self.stiffness = self.sliding(x, y, along.max(caution * across), across);
        }
    }

    /// First and second derivative of this contact's potential at `step` along the search direction.
    #[inline(always)]
    pub fn slope(&self, step: f64) -> (f64, f64) {
        let d = &self.direction;
        let velocity = self.velocity + d * step;
        let Some(mut spin) = self.spin else {
            let (impulse, _, region) = self.impulse_at(&velocity, None);
            let g = self.stiffness_in(&region);
            let curvature = g[0] * d.x * d.x
                + g[2] * d.y * d.y
                + g[5] * d.z * d.z
                + 2.0 * (g[1] * d.x * d.y + g[3] * d.x * d.z + g[4] * d.y * d.z);
            return (-impulse.dot(d), curvature);
        };
        let turn = spin.direction;
        let (impulse, turned, region) = self.impulse_at(&velocity, Some(&(spin.velocity + turn * step)));
        self.set_spin_stiffness(&mut spin, &region, 0.0);
        let [x, y, tx, ty, tz] = spin.slide;
        let forward = x * d.x + y * d.y + tx * turn.x + ty * turn.y + tz * turn.z;
        let square = d.x * d.x + d.y * d.y + turn.norm_squared();
        let curvature = spin.across * square
            + (spin.along - spin.across) * forward * forward
            + 2.0 * spin.coupling * forward * d.z
            + spin.normal_stiffness * d.z * d.z;
        (-impulse.dot(d) - turned.dot(&turn), curvature)
    }

    /// The impulse as a force about the pair's origin.
    pub fn wrench(&self) -> Force {
        let mut sum = Force::ZERO;
        for (row, size) in self.rows.iter().zip(self.impulse.iter()) {
            sum.torque += row.torque * *size;
            sum.force += row.force * *size;
        }
        if let Some(spin) = &self.spin {
            sum.torque += spin.by_levers(&spin.impulse);
        }
        sum
    }

    /// Adds the stiffness, from relative motion to force, of a loaded point that resists turning.
    pub fn add_spin_stiffness(&self, spin: &Spin, sum: &mut [[f64; 6]; 6]) {
        let flat = |f: &Force| [f.torque.x, f.torque.y, f.torque.z, f.force.x, f.force.y, f.force.z];
        let rows = [flat(&self.rows[0]), flat(&self.rows[1]), flat(&self.rows[2])];
        let turns = [0, 1, 2].map(|k| spin.by_levers(&V3::ith(k, 1.0)));
        let [x, y, tx, ty, tz] = spin.slide;
        let turn = spin.by_levers(&V3::new(tx, ty, tz));
        let mut slide = [turn.x, turn.y, turn.z, 0.0, 0.0, 0.0];
        for c in 0..6 {
            slide[c] += x * rows[0][c] + y * rows[1][c];
        }
        let extra = spin.along - spin.across;
        for r in 0..6 {
            for c in 0..6 {
                sum[r][c] += spin.across * (rows[0][r] * rows[0][c] + rows[1][r] * rows[1][c])
                    + extra * slide[r] * slide[c]
                    + spin.coupling * (slide[r] * rows[2][c] + rows[2][r] * slide[c])
                    + spin.normal_stiffness * rows[2][r] * rows[2][c];
            }
        }
        for r in 0..3 {
            for c in 0..3 {
                sum[r][c] += spin.across * turns[r].dot(&turns[c]);
            }
        }
    }
}

enum Region {
    Apart,
    Stick,
    Slide { x: f64, y: f64, turn: V3, pressed: f64, slide: f64 },
}
