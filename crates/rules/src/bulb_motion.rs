//! Compares a row with earlier ones: how the bulbs move.

use nalgebra::{Isometry3, Vector3};
use serde::{Deserialize, Serialize};

use crate::errand;
use crate::measure::GRAVITY;
use crate::parts::{BodyRow, Bulb};
use crate::row::{CONTROL_DT, Row};
use crate::settle::{self, PoseSpeed};
use crate::thresholds::Thresholds;

/// Low-passed speeds of both bulbs, and the last two rows.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct BulbMotion {
    pub speeds: [PoseSpeed; 2],
    /// Speeds in the frames of the palms, by bulb, then left and right, m/s.
    pub grip_speeds: [[f64; 2]; 2],
    /// The last row and the one before it.
    last: [Option<Instant>; 2],
}

/// Signs that a bulb was struck.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct BulbImpacts {
    /// The bulb's velocity has changed since the last row by more than free fall explains.
    pub impact: bool,
    /// Something touched the bulb and changed its velocity, since the last row or the one before it, by more than free
    /// fall explains. Two rows are compared because the physics steps of a blow can be on both sides of a row; then the
    /// earlier of these rows must not be one of the first, exempt rows.
    pub blow: bool,
}

#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct Instant {
    bulbs: [BodyRow; 2],
    /// Positions of the bulbs' origins in the frames of the palms, by bulb, then left and right, m.
    in_palms: [[[f64; 3]; 2]; 2],
    touched: [bool; 2],
}

impl BulbMotion {
    /// Takes a row that follows the last one, `steps` after the start; `touched` says which bulbs anything touched in it.
    pub fn advance(&mut self, row: &Row, touched: [bool; 2], steps: u64, thresholds: &Thresholds) -> BulbImpacts {
        let bulbs = errand::BULBS.map(|bulb| *row.body(bulb));
        let in_palms = bulbs.each_ref().map(|bulb| row.world_from_palm.each_ref().map(|palm| in_palm(palm, bulb)));
        let now = Instant { bulbs, in_palms, touched };
        let mut impacts = BulbImpacts::default();
        if let [Some(last), earlier] = &self.last {
            // At rest at reset and, as published, through the first step.
            if steps > 1 {
                for bulb in [0, 1] {
                    let (before, after) = (&last.bulbs[bulb].pose, &now.bulbs[bulb].pose);
                    self.speeds[bulb] = self.speeds[bulb].advance(before, after, thresholds.settle_time_s);
                    for (palm, speed) in self.grip_speeds[bulb].iter_mut().enumerate() {
                        let [from, to] = [last, &now].map(|at| Vector3::from(at.in_palms[bulb][palm]));
                        let moved = to - from;
                        *speed = settle::low_pass(*speed, moved.norm() / CONTROL_DT, thresholds.settle_time_s);
                    }
                }
            }
            let exempt = u64::from(thresholds.impact_exempt_rows);
            if steps > exempt {
                let earlier = earlier.as_ref().filter(|_| steps > exempt + 1);
                impacts = now.impacts(last, earlier, thresholds.impact_m_s);
            }
        }
        self.last = [Some(now), self.last[0]];
        impacts
    }
}

impl Instant {
    fn impacts(&self, last: &Instant, earlier: Option<&Instant>, limit: f64) -> BulbImpacts {
        let mut impacts = BulbImpacts::default();
        for bulb in Bulb::ALL.map(|bulb| bulb as usize) {
            let jumps_since = |before: &Instant, steps| jump(&before.bulbs[bulb], &self.bulbs[bulb], steps) > limit;
            let impact = jumps_since(last, 1.0);
            impacts.impact |= impact;
            impacts.blow |= impact && self.touched[bulb];
            impacts.blow |=
                (last.touched[bulb] || self.touched[bulb]) && earlier.is_some_and(|earlier| jumps_since(earlier, 2.0));
        }
        impacts
    }
}

/// Position of a bulb's origin in a palm's frame, m.
fn in_palm(world_from_palm: &Isometry3<f64>, bulb: &BodyRow) -> [f64; 3] {
    world_from_palm.inverse_transform_point(&bulb.pose.translation.vector.into()).coords.into()
}

/// Change of a bulb's velocity over some control steps, apart from free fall, m/s.
fn jump(before: &BodyRow, after: &BodyRow, steps: f64) -> f64 {
    let fall = Vector3::new(0.0, 0.0, -GRAVITY) * CONTROL_DT * steps;
    (after.linear_velocity - before.linear_velocity - fall).norm()
}
