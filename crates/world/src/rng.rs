//! Random numbers that are the same on every machine.

use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::Rng as _;
use sha2::{Digest, Sha256};

/// Name and version of the generator and of its seeding, for records.
pub const RNG_NAME: &str = "fiatlux-pcg64mcg-sha256/1";

/// Generators of all numbers in an episode, for records: [`RNG_NAME`], and the generator of the published rooms.
pub const GENERATORS: &str = "fiatlux-pcg64mcg-sha256/1, rooms python-mt19937";

/// Purposes of random numbers, each with its own stream. The room is not among them: [`Layout::draw`]
/// uses the published generator.
///
/// [`Layout::draw`]: crate::Layout::draw
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stream {
    /// Start poses of an episode.
    Reset,
    /// Sensor noise of an episode.
    Noise,
    /// Friction of the hands in an episode.
    HandFriction,
    /// Light of an episode.
    Light,
    /// Tint of the room in an episode.
    Tint,
    /// Sizes of the props; drawn by seed alone.
    Props,
    /// Ranges that a session asks for, besides the benchmark's.
    Ranges,
    /// Trials of benchmarks and tests; no episode draws from it.
    Trial,
    /// Worlds of a batch; by its seed and the world's index.
    Batch,
}

impl Stream {
    fn name(self) -> &'static str {
        match self {
            Stream::Reset => "reset",
            Stream::Noise => "noise",
            Stream::HandFriction => "grip",
            Stream::Light => "light",
            Stream::Tint => "tint",
            Stream::Props => "props",
            Stream::Ranges => "ranges",
            Stream::Trial => "trial",
            Stream::Batch => "batch",
        }
    }
}

/// PCG64-MCG (XSL-RR 128/64). Its state is the first 16 bytes, little-endian, of the SHA-256 of [`RNG_NAME`], the
/// stream's name (each followed by a zero byte), seed and episode (each 8 bytes, little-endian), and the term's name
/// where the stream has terms.
#[derive(Debug, Clone)]
pub struct Random {
    generator: Pcg64Mcg,
    drawn: u64,
}

impl Random {
    /// The stream of an episode; what is drawn by seed alone uses episode 0.
    pub fn new(stream: Stream, seed: u64, episode: u64) -> Self {
        Self::of_term(stream, "", seed, episode)
    }

    /// A term's own part of an episode's stream, so that its numbers do not depend on which other terms draw.
    pub fn of_term(stream: Stream, term: &str, seed: u64, episode: u64) -> Self {
        let mut hash = Sha256::new();
        hash.update(RNG_NAME);
        hash.update([0]);
        hash.update(stream.name());
        hash.update([0]);
        hash.update(seed.to_le_bytes());
        hash.update(episode.to_le_bytes());
        hash.update(term);
        let mut state = [0; 16];
        state.copy_from_slice(&hash.finalize()[..16]);
        Self { generator: Pcg64Mcg::new(u128::from_le_bytes(state)), drawn: 0 }
    }

    /// Uniform in [0, 1), a multiple of 2^-53.
    pub fn unit(&mut self) -> f64 {
        const SCALE: f64 = 1.0 / (1_u64 << 53) as f64;
        self.drawn = self.drawn.wrapping_add(1);
        (self.generator.next_u64() >> 11) as f64 * SCALE
    }

    /// Skips that many numbers.
    pub fn skip(&mut self, count: u64) {
        self.drawn = self.drawn.wrapping_add(count);
        self.generator.advance(u128::from(count));
    }

    /// Count of numbers drawn or skipped: [`Random::skip`] of as many takes a new stream to the same place.
    pub fn drawn(&self) -> u64 {
        self.drawn
    }

    /// Uniform between two bounds.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// A whole number, uniform in 0..n.
    pub fn index(&mut self, n: usize) -> usize {
        ((self.unit() * n as f64) as usize).min(n.saturating_sub(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_seeds_and_episodes_differ_and_repeat() {
        let draw = |stream, seed, episode| {
            let mut random = Random::new(stream, seed, episode);
            [random.unit(), random.unit()]
        };
        let cases = [
            (Stream::Reset, 0, 0),
            (Stream::Noise, 0, 0),
            (Stream::HandFriction, 0, 0),
            (Stream::Light, 0, 0),
            (Stream::Tint, 0, 0),
            (Stream::Props, 0, 0),
            (Stream::Ranges, 0, 0),
            (Stream::Batch, 0, 0),
            (Stream::Reset, 1, 0),
            (Stream::Reset, 0, 1),
        ];
        for (i, &(stream, seed, episode)) in cases.iter().enumerate() {
            assert_eq!(draw(stream, seed, episode), draw(stream, seed, episode));
            for &(other, other_seed, other_episode) in &cases[..i] {
                assert_ne!(draw(stream, seed, episode), draw(other, other_seed, other_episode));
            }
        }
    }

    /// Recorded from the seeding without terms: a layout or a start never changes because a stream was divided.
    #[test]
    fn terms_leave_the_streams_as_they_were() {
        let first = |mut random: Random| random.unit();
        assert_eq!(first(Random::new(Stream::Reset, 3, 5)), 0.8265777945349678);
        let terms = ["", "a", "b"].map(|term| first(Random::of_term(Stream::Noise, term, 3, 5)));
        assert_eq!(terms[0], first(Random::new(Stream::Noise, 3, 5)));
        assert!(terms[0] != terms[1] && terms[1] != terms[2] && terms[0] != terms[2]);
    }

    #[test]
    fn numbers_are_uniform() {
        let mut random = Random::new(Stream::Noise, 7, 0);
        let n = 20_000;
        let draws: Vec<f64> = (0..n).map(|_| random.uniform(-1.0, 1.0)).collect();
        assert!(draws.iter().all(|x| (-1.0..1.0).contains(x)));
        let mean = draws.iter().sum::<f64>() / f64::from(n);
        let variance = draws.iter().map(|x| x * x).sum::<f64>() / f64::from(n);
        assert!(mean.abs() < 0.02 && (variance - 1.0 / 3.0).abs() < 0.01, "{mean} {variance}");
    }
}
