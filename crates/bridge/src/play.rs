//! Plays chunks: a fixed prefix in lockstep, or all rows that are still current in real time; blended or averaged on
//! request.

use std::collections::VecDeque;

use crate::{BridgeError, Row};

/// Maximum number of chunks to average.
const MAX_CHUNKS: usize = 16;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Play {
    /// Number of rows of each chunk to play before the next one is requested.
    pub prefix: usize,
    /// Control steps over which a new chunk takes over from the old one; 0 switches at once.
    pub blend: usize,
    /// Temporal ensembling with this m: rows of several chunks for one step are averaged, the i-th oldest with weight
    /// exp(-m i).
    pub ensemble: Option<f64>,
    pub steps_per_row: f64,
}

#[derive(Debug, Clone)]
struct ActiveChunk {
    rows: Vec<Row>,
    /// Step of the observation on which the chunk is based.
    observed: u64,
    arrived: u64,
    index: u64,
}

#[derive(Debug, Clone, PartialEq)]
pub struct PlayedRow {
    pub row: Row,
    /// Number of the chunk in the episode, from 0.
    pub chunk: u64,
    pub at: usize,
    /// Control steps since the observation on which the chunk is based.
    pub age: u64,
    /// The chunk has no row left for this step, and its last row is held.
    pub is_over: bool,
}

#[derive(Debug, Clone)]
pub struct Player {
    play: Play,
    /// Chunks in use, newest last.
    chunks: VecDeque<ActiveChunk>,
    count: u64,
}

impl Player {
    /// Starts an episode, without a chunk.
    pub fn new(play: Play) -> Self {
        Self { play, chunks: VecDeque::new(), count: 0 }
    }

    /// True if the next chunk should be requested at this step: the prefix of the current one has been played.
    pub fn wants(&self, step: u64) -> bool {
        self.chunks.back().is_none_or(|chunk| step >= chunk.observed + self.steps_of_prefix())
    }

    /// As [`Player::wants`], in real time with an expected latency in steps: rows that will be stale by then count as
    /// played.
    pub fn wants_by(&self, step: u64, latency: u64) -> bool {
        self.wants(step.saturating_add(latency))
    }

    /// True if a request falls on this step (`back` = 0) or `back` steps after it: both need pictures.
    pub fn asks_after(&self, step: u64, back: u64) -> bool {
        let Some(chunk) = self.chunks.back() else { return back == 0 };
        let next = chunk.observed + self.steps_of_prefix();
        let ahead = step.saturating_add(back).checked_sub(next);
        ahead.is_some_and(|ahead| ahead.is_multiple_of(self.steps_of_prefix()) || back == 0)
    }

    fn steps_of_prefix(&self) -> u64 {
        ((self.play.prefix as f64 * self.play.steps_per_row).round() as u64).max(1)
    }

    /// Takes a chunk that answers the observation of step `observed`, at step `present`. In real time the difference is
    /// the latency, and rows of past steps are skipped. Returns the number of the chunk.
    pub fn take(&mut self, rows: Vec<Row>, observed: u64, present: u64) -> Result<u64, BridgeError> {
        if rows.is_empty() {
            return Err(BridgeError::malformed("a chunk", "it has no rows"));
        }
        let index = self.count;
        self.count += 1;
        self.chunks.push_back(ActiveChunk { rows, observed, arrived: present, index });
        let most = if self.play.ensemble.is_some() { MAX_CHUNKS } else { 2 };
        while self.chunks.len() > most {
            self.chunks.pop_front();
        }
        Ok(index)
    }

    /// The row for a step; `None` before the first chunk.
    pub fn row(&self, step: u64) -> Option<PlayedRow> {
        let newest = self.chunks.back()?;
        let (mut row, at, is_over) = self.of(newest, step);
        if let Some(decay) = self.play.ensemble {
            row = self.averaged(step, decay).unwrap_or(row);
        } else if let Some(old) = self.chunks.len().checked_sub(2).and_then(|at| self.chunks.get(at)) {
            let since = step.saturating_sub(newest.arrived);
            let blend = self.play.blend as u64;
            if since < blend {
                let part = (since + 1) as f64 / (blend + 1) as f64;
                row = self.of(old, step).0.towards(&row, part);
            }
        }
        Some(PlayedRow { row, chunk: newest.index, at, age: step.saturating_sub(newest.observed), is_over })
    }

    /// A chunk's row for a step, interpolated where rows last longer than a step.
    fn of(&self, chunk: &ActiveChunk, step: u64) -> (Row, usize, bool) {
        let place = step.saturating_sub(chunk.observed) as f64 / self.play.steps_per_row;
        let last = chunk.rows.len() - 1;
        let at = (place as usize).min(last);
        let row = &chunk.rows[at];
        let part = place - at as f64;
        let is_over = place >= chunk.rows.len() as f64;
        if at == last || part < 1e-9 {
            return (row.clone(), at, is_over);
        }
        (row.towards(&chunk.rows[at + 1], part), at, is_over)
    }

    /// The weighted mean over all chunks that have a row for a step.
    fn averaged(&self, step: u64, decay: f64) -> Option<Row> {
        let rows = self.chunks.iter().map(|chunk| self.of(chunk, step)).filter(|(.., is_over)| !is_over);
        let mut mean: Option<(Row, f64)> = None;
        for (age, (row, ..)) in rows.enumerate() {
            let weight = (-decay * age as f64).exp();
            mean = Some(match mean {
                None => (row, weight),
                Some((sum, weights)) => (sum.towards(&row, weight / (weights + weight)), weights + weight),
            });
        }
        mean.map(|(row, _)| row)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn rows(numbers: impl IntoIterator<Item = f64>) -> Vec<Row> {
        numbers.into_iter().map(|number| Row { targets: vec![(0, number)], ..Row::default() }).collect()
    }

    fn angle(player: &Player, step: u64) -> f64 {
        player.row(step).unwrap().row.targets[0].1
    }

    const PLAIN: Play = Play { prefix: 4, blend: 0, ensemble: None, steps_per_row: 1.0 };

    #[test]
    fn lockstep_plays_the_prefix_of_each_chunk() {
        let mut player = Player::new(PLAIN);
        assert!(player.wants(0) && player.row(0).is_none());
        player.take(rows((0..8).map(f64::from)), 0, 0).unwrap();
        let played: Vec<f64> = (0..4).map(|step| angle(&player, step)).collect();
        assert_eq!((played, player.wants(3), player.wants(4)), (vec![0.0, 1.0, 2.0, 3.0], false, true));
        player.take(rows((10..18).map(f64::from)), 4, 4).unwrap();
        assert_eq!(angle(&player, 5), 11.0);
    }

    /// A chunk that took three steps begins with its row 3; after its end its last row is held.
    #[test]
    fn real_time_skips_what_is_stale() {
        let mut player = Player::new(PLAIN);
        player.take(rows((0..8).map(f64::from)), 0, 3).unwrap();
        let played = player.row(3).unwrap();
        assert_eq!((played.at, played.age, played.is_over), (3, 3, false));
        let late = player.row(20).unwrap();
        assert_eq!((late.at, late.is_over, late.row.targets[0].1), (7, true, 7.0));
    }

    #[test]
    fn a_blend_goes_over_step_by_step() {
        let mut player = Player::new(Play { blend: 3, ..PLAIN });
        player.take(rows([0.0; 8]), 0, 0).unwrap();
        player.take(rows([4.0; 8]), 4, 4).unwrap();
        assert_eq!((4..8).map(|step| angle(&player, step)).collect::<Vec<_>>(), [1.0, 2.0, 3.0, 4.0]);
    }

    /// ACT's weights: the oldest chunk has the largest weight.
    #[test]
    fn an_ensemble_is_the_weighted_mean() {
        let mut player = Player::new(Play { ensemble: Some(0.5), prefix: 1, ..PLAIN });
        for step in 0..3 {
            player.take(rows([step as f64; 4]), step, step).unwrap();
        }
        let weights: [f64; 3] = [1.0, (-0.5_f64).exp(), (-1.0_f64).exp()];
        let expected = (weights[1] + 2.0 * weights[2]) / weights.iter().sum::<f64>();
        assert!((angle(&player, 2) - expected).abs() < 1e-12);
    }

    #[test]
    fn slow_rows_are_interpolated() {
        let mut player = Player::new(Play { prefix: 2, steps_per_row: 2.0, ..PLAIN });
        player.take(rows([0.0, 2.0, 4.0]), 0, 0).unwrap();
        assert_eq!((0..5).map(|step| angle(&player, step)).collect::<Vec<_>>(), [0.0, 1.0, 2.0, 3.0, 4.0]);
        // Questions at 4, 8, 12: a frame of 6 steps before is needed at 2 and 6.
        assert!(player.asks_after(4, 0) && player.asks_after(2, 6) && player.asks_after(6, 6));
        assert!(!player.asks_after(3, 6) && !player.asks_after(3, 0));
        assert!(player.take(Vec::new(), 4, 4).is_err());
    }
}
