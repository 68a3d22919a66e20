//! Pushes and wrenches from outside, world by world.

use fiatlux_dynamics::Wrench;
use fiatlux_rules::CONTROL_DT;
use fiatlux_world::{AppliedWrench, Push, Random, Target};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::{BatchError, Control};

/// Disturbances of the robots, drawn separately for each world.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Disturbances {
    /// Sudden changes of velocity; `None` for none.
    pub pushes: Option<Pushes>,
    /// Forces and torques that last for a while; `None` for none.
    pub wrenches: Option<Wrenches>,
}

/// Sudden changes of the velocity of the whole robot. A push by the task in the same step replaces one of these.
#[derive(Debug, Clone, PartialEq)]
pub struct Pushes {
    /// Time from one to the next, s.
    pub interval_s: [f64; 2],
    /// Largest change along each of the world's horizontal axes, m/s.
    pub linear: f64,
    /// Largest change about each of the world's axes, rad/s.
    pub angular: f64,
}

/// Forces through a link's centre of mass and torques about it.
#[derive(Debug, Clone, PartialEq)]
pub struct Wrenches {
    /// Index of the link, into [`Robot::links`](fiatlux_robot::Robot::links).
    pub link: usize,
    /// Time from the end of one to the start of the next, s.
    pub interval_s: [f64; 2],
    /// Duration of each, s.
    pub duration_s: [f64; 2],
    /// Largest force along each of the world's axes, N.
    pub force_n: f64,
    /// Largest torque about each of the world's axes, N m.
    pub torque_nm: f64,
}

impl Disturbances {
    pub(crate) fn check(&self, links: usize) -> Result<(), BatchError> {
        let (pushes, wrenches) = (self.pushes.as_ref(), self.wrenches.as_ref());
        let times = [
            ("pushes.interval_s", pushes.map(|pushes| pushes.interval_s)),
            ("wrenches.interval_s", wrenches.map(|wrenches| wrenches.interval_s)),
            ("wrenches.duration_s", wrenches.map(|wrenches| wrenches.duration_s)),
        ];
        for (field, range) in times {
            if range.is_some_and(|[low, high]| !(low >= 0.0 && high >= low && high < 1e6)) {
                return Err(BatchError::Disturbance { field, rule: "must be [least, most], finite and not negative" });
            }
        }
        let sizes = [
            ("pushes.linear", pushes.map(|pushes| pushes.linear)),
            ("pushes.angular", pushes.map(|pushes| pushes.angular)),
            ("wrenches.force_n", wrenches.map(|wrenches| wrenches.force_n)),
            ("wrenches.torque_nm", wrenches.map(|wrenches| wrenches.torque_nm)),
        ];
        for (field, size) in sizes {
            if size.is_some_and(|size| !(0.0..1e6).contains(&size)) {
                return Err(BatchError::Disturbance { field, rule: "must be finite and not negative" });
            }
        }
        if wrenches.is_some_and(|wrenches| wrenches.link >= links) {
            return Err(BatchError::Disturbance { field: "wrenches.link", rule: "must be a link of the robot" });
        }
        Ok(())
    }
}

/// Disturbances under way in one world; times are in control steps.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct Disturber {
    until_push: u32,
    until_wrench: u32,
    left_of_wrench: u32,
    /// Force and torque.
    wrench: Option<[[f64; 3]; 2]>,
}

impl Disturber {
    /// Draws anew when the next push and wrench of the episode are due.
    pub fn begin(&mut self, settings: &Disturbances, random: &mut Random) {
        *self = Self::default();
        if let Some(pushes) = &settings.pushes {
            self.until_push = steps(pushes.interval_s, random);
        }
        if let Some(wrenches) = &settings.wrenches {
            self.until_wrench = steps(wrenches.interval_s, random);
        }
    }

    /// Adds what acts in a control step.
    pub fn act(&mut self, settings: &Disturbances, random: &mut Random, control: &mut Control) {
        if let Some(pushes) = &settings.pushes {
            self.until_push = self.until_push.saturating_sub(1);
            if self.until_push == 0 {
                let [x, y] = [(); 2].map(|()| random.uniform(-pushes.linear, pushes.linear));
                let angular = within(pushes.angular, random);
                let push = Push { linear: Vector3::new(x, y, 0.0), angular };
                control.push.get_or_insert(push);
                self.until_push = steps(pushes.interval_s, random);
            }
        }
        let Some(wrenches) = &settings.wrenches else { return };
        if self.left_of_wrench == 0 {
            self.wrench = None;
            self.until_wrench = self.until_wrench.saturating_sub(1);
            if self.until_wrench == 0 {
                let [force, torque] = [wrenches.force_n, wrenches.torque_nm].map(|size| within(size, random).into());
                self.wrench = Some([force, torque]);
                self.left_of_wrench = steps(wrenches.duration_s, random);
                self.until_wrench = steps(wrenches.interval_s, random);
            }
        }
        if let Some([force, torque]) = self.wrench {
            self.left_of_wrench -= 1;
            let wrench = Wrench { force: force.into(), torque: torque.into() };
            control.wrenches.push(AppliedWrench { target: Target::Link(wrenches.link), point: None, wrench });
        }
    }
}

/// A time, at least one step.
fn steps([low, high]: [f64; 2], random: &mut Random) -> u32 {
    libm::round(random.uniform(low, high) / CONTROL_DT).max(1.0) as u32
}

fn within(size: f64, random: &mut Random) -> Vector3<f64> {
    Vector3::from_fn(|_, _| random.uniform(-size, size))
}
