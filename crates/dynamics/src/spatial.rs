//! Velocities, forces and inertias. [`Motion`], [`Force`] and [`Inertia`] are six-dimensional, in world axes, about a tree's
//! origin (the position of its root); [`Velocity`] and [`Wrench`] are what callers see of them.

use nalgebra::{Matrix3, Vector3};

pub(crate) type V3 = Vector3<f64>;

/// Angular velocity, and the velocity of the body's point at the origin.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Motion {
    pub angular: V3,
    pub linear: V3,
}

/// Torque about the origin, and force.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Force {
    pub torque: V3,
    pub force: V3,
}

impl Motion {
    pub const ZERO: Motion = Motion { angular: V3::new(0.0, 0.0, 0.0), linear: V3::new(0.0, 0.0, 0.0) };

    #[inline(always)]
    pub fn dot(&self, f: &Force) -> f64 {
        self.angular.dot(&f.torque) + self.linear.dot(&f.force)
    }

    #[inline(always)]
    pub fn add_scaled(&mut self, m: &Motion, s: f64) {
        self.angular += m.angular * s;
        self.linear += m.linear * s;
    }

    /// Rate of change of `m` when it is fixed to a body that moves with `self`.
    #[inline(always)]
    pub fn cross_motion(&self, m: &Motion) -> Motion {
        Motion {
            angular: self.angular.cross(&m.angular),
            linear: self.angular.cross(&m.linear) + self.linear.cross(&m.angular),
        }
    }

    /// Rate of change of `f` when it is fixed to a body that moves with `self`.
    #[inline(always)]
    pub fn cross_force(&self, f: &Force) -> Force {
        Force {
            torque: self.angular.cross(&f.torque) + self.linear.cross(&f.force),
            force: self.angular.cross(&f.force),
        }
    }

    /// The same motion about an origin moved by `shift`.
    #[inline(always)]
    pub fn moved(&self, shift: &V3) -> Motion {
        Motion { angular: self.angular, linear: self.linear + self.angular.cross(shift) }
    }
}

impl Force {
    pub const ZERO: Force = Force { torque: V3::new(0.0, 0.0, 0.0), force: V3::new(0.0, 0.0, 0.0) };

    #[inline(always)]
    pub fn add(&mut self, f: &Force) {
        self.torque += f.torque;
        self.force += f.force;
    }
}

/// Velocity of a body's origin and its angular velocity, both in world axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Velocity {
    /// Velocity of the body's origin, m/s.
    pub linear: Vector3<f64>,
    /// Angular velocity of the body, rad/s.
    pub angular: Vector3<f64>,
}

/// A force at a body's centre of mass (where it is at the start of the step, the world's variation included) and a torque, in
/// world axes. A push `f` at another point `p` is `Wrench { force: f, torque: (p - com).cross(&f) }`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wrench {
    /// Force that acts at the centre of mass, N.
    pub force: Vector3<f64>,
    /// Torque that acts besides, N m.
    pub torque: Vector3<f64>,
}

/// A symmetric 3 x 3 matrix.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sym3 {
    pub xx: f64,
    pub yy: f64,
    pub zz: f64,
    pub xy: f64,
    pub xz: f64,
    pub yz: f64,
}

impl Sym3 {
    /// The matrix in rotated axes: `r m r^T`.
    #[inline(always)]
    pub fn rotated(r: &Matrix3<f64>, m: &Matrix3<f64>) -> Sym3 {
        let t = r * m;
        let entry = |i: usize, j: usize| t[(i, 0)] * r[(j, 0)] + t[(i, 1)] * r[(j, 1)] + t[(i, 2)] * r[(j, 2)];
        Sym3 { xx: entry(0, 0), yy: entry(1, 1), zz: entry(2, 2), xy: entry(0, 1), xz: entry(0, 2), yz: entry(1, 2) }
    }

    #[inline(always)]
    pub fn mul(&self, v: &V3) -> V3 {
        V3::new(
            self.xx * v.x + self.xy * v.y + self.xz * v.z,
            self.xy * v.x + self.yy * v.y + self.yz * v.z,
            self.xz * v.x + self.yz * v.y + self.zz * v.z,
        )
    }
}

/// A rigid body's (or a subtree's) inertia about the origin: mass, mass times centre of mass, rotational inertia.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Inertia {
    pub mass: f64,
    pub moment: V3,
    pub rotational: Sym3,
}

impl Inertia {
    /// Of a body with centre of mass `com` (from the origin) and world-axes inertia `about_com`.
    #[inline(always)]
    pub fn new(mass: f64, com: &V3, about_com: &Sym3) -> Inertia {
        let h = com * mass;
        let s = h.dot(com);
        let i = about_com;
        let rotational = Sym3 {
            xx: i.xx + s - h.x * com.x,
            yy: i.yy + s - h.y * com.y,
            zz: i.zz + s - h.z * com.z,
            xy: i.xy - h.x * com.y,
            xz: i.xz - h.x * com.z,
            yz: i.yz - h.y * com.z,
        };
        Inertia { mass, moment: h, rotational }
    }

    #[inline(always)]
    pub fn add(&mut self, other: &Inertia) {
        self.mass += other.mass;
        self.moment += other.moment;
        let (a, b) = (&mut self.rotational, &other.rotational);
        a.xx += b.xx;
        a.yy += b.yy;
        a.zz += b.zz;
        a.xy += b.xy;
        a.xz += b.xz;
        a.yz += b.yz;
    }

    /// Momentum of a motion, or force of an acceleration.
    #[inline(always)]
    pub fn apply(&self, m: &Motion) -> Force {
        Force {
            torque: self.rotational.mul(&m.angular) + self.moment.cross(&m.linear),
            force: m.linear * self.mass + m.angular.cross(&self.moment),
        }
    }
}
