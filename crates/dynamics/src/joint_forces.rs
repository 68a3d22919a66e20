//! Forces on single degrees of freedom: drives and joint limits.

use crate::spec::{Drive, Hinge};

/// Compliance of a joint limit, in units of the joint's inverse inertia.
const COMPLIANCE: f64 = 1e-2;
/// Part of a violated limit that one step takes back, and the fastest return, rad/s.
const BAUMGARTE: f64 = 0.2;
const MAX_RETURN: f64 = 1.0;

/// A drive over one step: its effort never rises with the velocity at the end of the step, so that its potential is convex.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ImplicitDrive {
    pub dof: usize,
    /// Effort is `offset - slope * v`, clamped at `limit`, which fades along the motion from `corner` to `speed_limit`.
    offset: f64,
    slope: f64,
    limit: f64,
    speed_limit: f64,
    /// Speed up to which the limit is the whole one.
    corner: f64,
}

/// The limits of a joint over one step.
#[derive(Debug, Clone, Copy)]
pub(crate) struct JointLimit {
    pub dof: usize,
    /// Velocity bounds and the compliance beyond them.
    low: f64,
    high: f64,
    compliance: f64,
}

impl ImplicitDrive {
    /// The drive of a joint that is `error` rad short of its target.
    pub fn new(dof: usize, drive: &Drive, error: f64, dt: f64) -> Self {
        let slope = drive.stiffness * dt + drive.damping;
        let (limit, speed_limit) = (drive.effort_limit, drive.speed_limit);
        Self { dof, offset: drive.stiffness * error, slope, limit, speed_limit, corner: Drive::CORNER * speed_limit }
    }

    /// Addition of caution to the derivative in the Hessian: for a saturated drive the secant to where its effort is zero,
    /// which bounds the potential from above (as for Huber's function).
    pub fn extra_stiffness(&self, velocity: f64, caution: f64) -> f64 {
        let (effort, slope) = self.effort(velocity);
        if slope == 0.0 && self.slope > 0.0 { caution * effort / (self.offset / self.slope - velocity) } else { 0.0 }
    }

    /// The same as [`Self::effort`] where nothing limits it: on an interval, between two velocities of which this is true.
    #[inline(always)]
    pub fn straight(&self, velocity: f64) -> Option<(f64, f64)> {
        let effort = self.offset - self.slope * velocity;
        (effort.abs() <= self.limit && velocity.abs() <= self.corner).then_some((effort, self.slope))
    }

    /// Effort at a velocity, and its decrease per velocity (0 when saturated).
    #[inline(always)]
    pub fn effort(&self, velocity: f64) -> (f64, f64) {
        if let Some(straight) = self.straight(velocity) {
            return straight;
        }
        let effort = self.offset - self.slope * velocity;
        if effort > 0.0 {
            self.accelerating(effort, velocity)
        } else {
            let (effort, slope) = self.accelerating(-effort, -velocity);
            (-effort, slope)
        }
    }
}

impl ImplicitDrive {
    /// A positive effort within what the motor has left at a velocity.
    #[inline(always)]
    fn accelerating(&self, effort: f64, velocity: f64) -> (f64, f64) {
        let (most, slope) = if velocity <= self.corner {
            (self.limit, 0.0)
        } else if velocity < self.speed_limit {
            let fade = self.limit / ((1.0 - Drive::CORNER) * self.speed_limit);
            (fade * (self.speed_limit - velocity), fade)
        } else {
            (0.0, 0.0)
        };
        if effort > most { (most, slope) } else { (effort, self.slope) }
    }
}

impl JointLimit {
    /// The limits of a joint at `q`; none if it has no limits.
    pub fn new(dof: usize, hinge: &Hinge, q: f64, inverse_weight: f64, dt: f64) -> Option<Self> {
        let rate = 1.0 / dt;
        let bound = |gap: f64| {
            // Up to the limit if it is ahead, back at a limited rate if it was passed.
            if gap >= 0.0 { gap * rate } else { (BAUMGARTE * gap * rate).max(-MAX_RETURN) }
        };
        let (low, high) = (-bound(q - hinge.lower), bound(hinge.upper - q));
        let limited = low > f64::NEG_INFINITY || high < f64::INFINITY;
        limited.then_some(Self { dof, low, high, compliance: COMPLIANCE * inverse_weight })
    }

    /// True if a velocity stays within the limits.
    #[inline(always)]
    pub fn allows(&self, velocity: f64) -> bool {
        velocity >= self.low && velocity <= self.high
    }

    /// Impulse at a velocity, and its decrease per velocity.
    #[inline(always)]
    pub fn impulse(&self, velocity: f64) -> (f64, f64) {
        let c = 1.0 / self.compliance;
        if velocity < self.low {
            ((self.low - velocity) * c, c)
        } else if velocity > self.high {
            ((self.high - velocity) * c, c)
        } else {
            (0.0, 0.0)
        }
    }
}
