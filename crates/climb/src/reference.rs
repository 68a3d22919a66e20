//! A plan as a reference for a policy: poses, and the targets that bear the robot at rest.

use fiatlux_dynamics::Mechanics;
use fiatlux_kinematics::{Acceleration, Support, SupportError, SupportSolver};
use fiatlux_robot::BODY;
use nalgebra::{Isometry3, Point3, Vector3};

use crate::body::Body;
use crate::plan::{Keyframe, Plan};

/// Friction of soles that the targets count on.
const FRICTION: f64 = 0.6;

/// A posture of a plan at one time, in the plan's frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Pose {
    /// The pelvis.
    pub pelvis: Isometry3<f64>,
    /// Angles of legs, waist and arms, rad.
    pub angles: [f64; BODY],
    /// Added to the angles so that the drives bear the robot at rest, rad.
    pub lead: [f64; BODY],
    /// Centre of mass, m.
    pub com: Vector3<f64>,
    /// Middle of each sole, left first.
    pub soles: [Isometry3<f64>; 2],
    /// Part of the weight that each foot may bear.
    pub bears: [f64; 2],
}

/// A plan's poses, in their order, and when they are due.
#[derive(Debug, Clone)]
pub struct Reference {
    poses: Vec<Pose>,
    /// s.
    times: Vec<f64>,
}

impl Reference {
    /// Works out a plan up to a time, s, for a robot whose joints begin with the plan's.
    ///
    /// # Errors
    /// [`SupportError`]: a body whose root is not free, or a plan without postures.
    pub fn new(body: &Body, plan: &Plan, until: f64) -> Result<Self, SupportError> {
        let mut solver = SupportSolver::new(&body.model, body.ids.root)?;
        let mut mechanics = Mechanics::new(&body.model);
        let (mut poses, mut times, mut time) = (Vec::new(), Vec::new(), 0.0);
        let mut targets = vec![0.0; body.model.drives().len()];
        let soles = [0, 1].map(|side| body.ids.site(&body.robot.soles()[side].site));
        for (index, key) in plan.keyframes.iter().enumerate() {
            time += if index == 0 { 0.0 } else { key.seconds };
            let state = body.state(&key.pelvis, &key.angles);
            mechanics.update_equation(&body.model, &state);
            let supports = supports(body, key);
            match solver.solve(&body.model, &mut mechanics, &supports, &Acceleration::default()) {
                Ok(()) | Err(SupportError::Unsupported | SupportError::Effort(_)) => {}
                Err(error) => return Err(error),
            }
            let posture = vec![0.0; targets.len()];
            solver.targets(&body.model, &mechanics, &posture, &mut targets);
            let mut pose = Pose {
                pelvis: key.pelvis,
                angles: [0.0; BODY],
                lead: [0.0; BODY],
                com: mechanics.center_of_mass(&body.model, body.ids.root).1,
                soles: soles.map(|site| mechanics.world_from_site(&site)),
                bears: key.bears,
            };
            for (joint, ids) in body.ids.joints.iter().enumerate().take(BODY) {
                pose.angles[joint] = key.angles[joint];
                pose.lead[joint] = targets[ids.drive];
            }
            poses.push(pose);
            times.push(time);
            if time >= until {
                break;
            }
        }
        if poses.is_empty() {
            return Err(SupportError::Unsupported);
        }
        Ok(Self { poses, times })
    }

    /// Time of its last pose, s.
    pub fn seconds(&self) -> f64 {
        self.times[self.times.len() - 1]
    }

    /// The pose that is due at a time, s; before the first and beyond the last one, these.
    pub fn at(&self, time: f64) -> Pose {
        let next = self.times.partition_point(|due| *due <= time);
        if next == 0 || next == self.poses.len() {
            return self.poses[next.saturating_sub(1)].clone();
        }
        let (a, b) = (&self.poses[next - 1], &self.poses[next]);
        let part = (time - self.times[next - 1]) / (self.times[next] - self.times[next - 1]);
        let mix = |a: f64, b: f64| a + part * (b - a);
        let pose = |a: &Isometry3<f64>, b: &Isometry3<f64>| {
            let at = a.translation.vector.lerp(&b.translation.vector, part);
            Isometry3::from_parts(at.into(), a.rotation.slerp(&b.rotation, part))
        };
        Pose {
            pelvis: pose(&a.pelvis, &b.pelvis),
            angles: std::array::from_fn(|joint| mix(a.angles[joint], b.angles[joint])),
            lead: std::array::from_fn(|joint| mix(a.lead[joint], b.lead[joint])),
            com: a.com.lerp(&b.com, part),
            soles: [0, 1].map(|side| pose(&a.soles[side], &b.soles[side])),
            bears: [0, 1].map(|side| mix(a.bears[side], b.bears[side])),
        }
    }
}

/// The corners of what bears of the soles.
fn supports(body: &Body, now: &Keyframe) -> Vec<Support> {
    let mut supports = Vec::new();
    let weight = body.robot.total_mass() * 9.81;
    for (side, sole) in body.robot.soles().iter().enumerate().filter(|(side, _)| now.bears[*side] > 0.0) {
        let link = &body.ids.links[sole.site.link];
        let [rear, front] = now.ranges[side];
        let most = if now.bears[side] < 1.0 { now.bears[side] * weight } else { f64::INFINITY };
        for [x, y] in [[front, 1.0], [front, -1.0], [rear, 1.0], [rear, -1.0]] {
            let corner = sole.site.link_from_site * Point3::new(x, y * sole.half_extents[1], 0.0);
            let point = (link.body_from_link * corner).coords;
            supports.push(Support { body: link.body, point, normal: Vector3::z_axis(), friction: FRICTION, most });
        }
    }
    supports
}
