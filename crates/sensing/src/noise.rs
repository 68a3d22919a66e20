//! Uniform noise of sensors.

use fiatlux_world::{EpisodeSpec, Random, Stream};

/// Which episode's noise is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoiseSeed {
    /// Seed of the session.
    pub seed: u64,
    /// Index of the episode.
    pub episode: u64,
}

impl NoiseSeed {
    /// Of an episode; none where its sensors have no noise.
    pub fn of(spec: &EpisodeSpec) -> Option<Self> {
        spec.randomize.sensors.then_some(Self { seed: spec.seed, episode: spec.episode })
    }
}

/// Noise of one episode.
///
/// Each term has its own random stream, of which every row takes the same count: the noise of row k is the same whatever
/// the rows hold, and whichever of them are observed.
#[derive(Debug, Clone)]
pub(crate) struct Noise {
    seed: Option<NoiseSeed>,
    /// Factor of every half-width.
    pub scale: f64,
    streams: Vec<TermStream>,
}

#[derive(Debug, Clone)]
struct TermStream {
    term: &'static str,
    random: Random,
    /// Row whose noise comes next.
    next: u64,
}

impl TermStream {
    fn new(term: &'static str, NoiseSeed { seed, episode }: NoiseSeed) -> Self {
        Self { term, random: Random::of_term(Stream::Noise, term, seed, episode), next: 0 }
    }
}

/// Terms for which there is room from the start, so that no step allocates.
const TERMS: usize = 32;

impl Noise {
    /// Without a seed it adds nothing.
    pub fn new(seed: Option<NoiseSeed>) -> Self {
        let mut noise = Self { seed: None, scale: 1.0, streams: Vec::new() };
        noise.restart(seed);
        noise
    }

    /// Begins another episode.
    pub fn restart(&mut self, seed: Option<NoiseSeed>) {
        self.seed = seed;
        self.streams.clear();
        self.streams.reserve(TERMS);
    }

    /// Adds a term's noise in a row to its values: uniform within the half-width, in their unit. The term has the same
    /// count of values in every row.
    pub fn add(&mut self, term: &'static str, half_width: f64, step: u64, values: &mut [f64]) {
        let Some(seed) = self.seed else { return };
        let found = self.streams.iter().position(|stream| stream.term == term);
        let index = found.unwrap_or_else(|| {
            self.streams.push(TermStream::new(term, seed));
            self.streams.len() - 1
        });
        let stream = &mut self.streams[index];
        if step < stream.next {
            *stream = TermStream::new(term, seed);
        }
        let left_out = step - stream.next;
        stream.next = step + 1;
        if left_out > 0 {
            stream.random.skip(left_out.saturating_mul(values.len() as u64));
        }
        let width = half_width * self.scale;
        values.iter_mut().for_each(|value| *value += stream.random.uniform(-width, width));
    }
}
