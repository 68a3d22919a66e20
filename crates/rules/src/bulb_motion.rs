//! What compares a row with those before it: how the bulbs move.

use nalgebra::{Isometry3, Vector3};

use crate::gate::Context;
use crate::measure::GRAVITY;
use crate::protocol::Protocol;
use crate::row::{BodyRow, Bulb, CONTROL_DT, Row};
use crate::settle::{self, PoseSpeed};

/// Low-passed speeds of both bulbs, and the two rows before the next one.
#[derive(Debug, Clone, Default)]
pub(crate) struct BulbMotion {
    pub speeds: [PoseSpeed; 2],
    /// In the frames of the palms, by bulb, then left and right, m/s; only followed in protocol `strict`.
    pub grip_speeds: [[f64; 2]; 2],
    /// The last row and the one before it.
    last: [Option<Instant>; 2],
}

#[derive(Debug, Clone, Copy)]
struct Instant {
    bulbs: [BodyRow; 2],
    world_from_palm: [Isometry3<f64>; 2],
    touched: [bool; 2],
}

impl Instant {
    fn of(row: &Row) -> Self {
        let touched =
            |bulb: usize| row.other_force_peak[bulb] > 0.0 || row.hand_force_peak[bulb].iter().any(|peak| *peak > 0.0);
        Self { bulbs: row.bulbs, world_from_palm: row.world_from_palm, touched: [0, 1].map(touched) }
    }
}

impl BulbMotion {
    /// Takes the speeds on to a row that follows the last one.
    pub fn follow(&mut self, row: &Row, protocol: Protocol, time_constant_s: f64) {
        let Some(last) = &self.last[0] else { return };
        for bulb in [0, 1] {
            let speed = &mut self.speeds[bulb];
            *speed = speed.advance(&last.bulbs[bulb].pose, &row.bulbs[bulb].pose, time_constant_s);
            if protocol == Protocol::Published {
                continue;
            }
            for (palm, speed) in self.grip_speeds[bulb].iter_mut().enumerate() {
                let before = in_palm(&last.world_from_palm[palm], &last.bulbs[bulb]);
                let moved = in_palm(&row.world_from_palm[palm], &row.bulbs[bulb]) - before;
                *speed = settle::low_pass(*speed, moved.norm() / CONTROL_DT, time_constant_s);
            }
        }
    }

    /// Some bulb's velocity changed since the last row by more than free fall explains.
    pub fn had_impact(&self, row: &Row, cx: &Context<'_>) -> bool {
        let jumps =
            |last: &Instant| Bulb::ALL.iter().any(|bulb| jump(last, row, *bulb, 1.0) > cx.thresholds.impact_m_s);
        self.last[0].as_ref().is_some_and(jumps)
    }

    /// Something touched some bulb and changed its velocity since the last row, or the last but one, by more than free fall
    /// explains. Over two rows, because the physics steps of a blow can lie on both sides of a row; there the row before both
    /// must not be one of the first, exempt rows.
    pub fn had_blow(&self, row: &Row, cx: &Context<'_>, steps: u64) -> bool {
        let [Some(last), earlier] = &self.last else { return false };
        let touches = |bulb: usize| Instant::of(row).touched[bulb];
        let earlier = earlier.as_ref().filter(|_| steps > u64::from(cx.thresholds.impact_exempt_rows) + 1);
        Bulb::ALL.iter().any(|&bulb| {
            let (i, limit) = (bulb as usize, cx.thresholds.impact_m_s);
            (jump(last, row, bulb, 1.0) > limit && touches(i))
                || (earlier.is_some_and(|earlier| jump(earlier, row, bulb, 2.0) > limit)
                    && (last.touched[i] || touches(i)))
        })
    }

    /// Makes a row the last one.
    pub fn shift(&mut self, row: &Row) {
        self.last = [Some(Instant::of(row)), self.last[0]];
    }

    /// Drops what the rows before said.
    pub fn forget(&mut self) {
        *self = Self::default();
    }
}

/// Place of a bulb's origin in a palm's frame, m.
fn in_palm(world_from_palm: &Isometry3<f64>, bulb: &BodyRow) -> Vector3<f64> {
    world_from_palm.inverse_transform_point(&bulb.pose.translation.vector.into()).coords
}

/// Change of a bulb's velocity over some control steps, free fall apart, m/s.
fn jump(before: &Instant, after: &Row, bulb: Bulb, steps: f64) -> f64 {
    let fall = Vector3::new(0.0, 0.0, -GRAVITY) * CONTROL_DT * steps;
    (after.bulbs[bulb as usize].linear_velocity - before.bulbs[bulb as usize].linear_velocity - fall).norm()
}
