//! The data of an episode's figure, reduced to what a screen can show.

use fiatlux_rules::{CONTROL_DT, Criteria};

pub const MAX_BUCKETS: usize = 300;

/// The share of a bucket's rows in which a criterion held.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum CriterionHeld {
    #[default]
    No,
    Partly,
    Throughout,
}

/// The figure of an episode: rows, from row 0 on, in equal buckets of time.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Series {
    /// Names of the criteria, in the order of the gate.
    pub criteria: Vec<&'static str>,
    pub held: Vec<Vec<CriterionHeld>>,
    /// Largest contact force of a bulb on a hand body in each bucket, N.
    pub hand_force_n: Vec<f64>,
    pub rows: usize,
    /// Time of the largest force, s.
    pub peak_time_s: f64,
}

impl Series {
    /// Time at which a bucket begins, s; the index after the last gives the end.
    pub fn time_of(&self, bucket: usize) -> f64 {
        let buckets = self.hand_force_n.len().max(1);
        (bucket * self.rows / buckets) as f64 * CONTROL_DT
    }
}

/// Collects rows; [`SeriesBuilder::finish`] reduces them to buckets.
#[derive(Debug, Default)]
pub(crate) struct SeriesBuilder {
    bits: Vec<u16>,
    force: Vec<f32>,
}

impl SeriesBuilder {
    /// Adds a row: the largest contact force of a bulb on a hand body, and the criteria that hold.
    pub(crate) fn push(&mut self, hand_force_n: f64, criteria: &Criteria) {
        let bits = criteria.as_slice().iter().enumerate().fold(0, |bits, (i, held)| bits | u16::from(*held) << i);
        self.bits.push(bits);
        self.force.push(hand_force_n as f32);
    }

    pub(crate) fn finish(&self, criteria: Vec<&'static str>) -> Series {
        let rows = self.bits.len();
        let buckets = rows.min(MAX_BUCKETS);
        let spans: Vec<_> = (0..buckets).map(|i| i * rows / buckets..(i + 1) * rows / buckets).collect();
        let held_in = |lane: usize, bits: &[u16]| match bits.iter().filter(|bits| *bits >> lane & 1 == 1).count() {
            0 => CriterionHeld::No,
            all if all == bits.len() => CriterionHeld::Throughout,
            _ => CriterionHeld::Partly,
        };
        let peak_of = |force: &[f32]| f64::from(force.iter().copied().fold(0.0, f32::max));
        let peak = peak_of(&self.force);
        let peak_row = self.force.iter().position(|force| f64::from(*force) == peak).unwrap_or(0);
        Series {
            held: (0..criteria.len())
                .map(|lane| spans.iter().map(|span| held_in(lane, &self.bits[span.clone()])).collect())
                .collect(),
            hand_force_n: spans.iter().map(|span| peak_of(&self.force[span.clone()])).collect(),
            criteria,
            rows,
            peak_time_s: peak_row as f64 * CONTROL_DT,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Guards that a single differing row among 6,001 shows in its bucket, both in the lane and in the force.
    #[test]
    fn no_single_row_is_lost() {
        let mut recorder = SeriesBuilder { bits: vec![0b01; 6001], force: vec![1.0; 6001] };
        recorder.bits[4321] = 0b10;
        recorder.force[4321] = 51.0;
        let series = recorder.finish(vec!["a", "b"]);
        let bucket = (0..MAX_BUCKETS).find(|i| series.time_of(i + 1) > 4321.0 * CONTROL_DT).expect("inside");
        assert_eq!((series.rows, series.hand_force_n.len()), (6001, MAX_BUCKETS));
        for i in 0..MAX_BUCKETS {
            let expected = if i == bucket {
                (CriterionHeld::Partly, CriterionHeld::Partly, 51.0)
            } else {
                (CriterionHeld::Throughout, CriterionHeld::No, 1.0)
            };
            assert_eq!((series.held[0][i], series.held[1][i], series.hand_force_n[i]), expected, "{i}");
        }
        assert!((series.peak_time_s - 86.42).abs() < 1e-9);
    }

    #[test]
    fn short_episodes_keep_every_row() {
        let recorder = SeriesBuilder { bits: vec![0, 1], force: vec![0.0, 2.0] };
        let series = recorder.finish(vec!["a"]);
        assert_eq!(series.held, [[CriterionHeld::No, CriterionHeld::Throughout]]);
        assert_eq!((series.time_of(1), series.time_of(2)), (CONTROL_DT, 2.0 * CONTROL_DT));
        assert_eq!(SeriesBuilder::default().finish(vec!["a"]).hand_force_n.len(), 0);
    }
}
