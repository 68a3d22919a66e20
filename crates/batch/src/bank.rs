//! Rows from which the episodes of a batch start.

use std::sync::Arc;

use fiatlux_dynamics::Variation;
use fiatlux_robot::{Gains, Robot};
use fiatlux_rules::Row;
use fiatlux_world::{Episode, EpisodeSpec, Light, Random, Randomization, Scene, SceneConfig, SceneSpec, Stream, World};

use crate::{BankError, Drawn, Ranges};

/// A scene, and the starts of worlds in it.
#[derive(Debug, Clone)]
pub struct Bank {
    /// The scene that the starts are in; worlds share it.
    pub scene: Arc<Scene>,
    /// Starts of episodes; the weight of each says how likely it is.
    pub starts: Vec<Start>,
    /// The ranges that the starts' variations were drawn from by [`Bank::varied`].
    pub ranges: Ranges,
}

/// A row to start from, and how a world that starts there differs from the scene.
#[derive(Debug, Clone)]
pub struct Start {
    /// Any row of the scene: a task's start, or a recorded row. It becomes row 0.
    pub row: Row,
    /// Masses, gains and friction of the world.
    pub variation: Variation,
    /// Light of the episode, which cameras see.
    pub light: Light,
    /// Relative likelihood among the bank's starts: finite, at least 0, and above 0 for one start of the bank.
    pub weight: f64,
    /// Values drawn for it besides the light, by name, for [`Batch::drawn`](crate::Batch::drawn).
    pub drawn: Drawn,
}

impl Bank {
    /// A scene with its reference state as the only start: the robot in its standing posture.
    pub fn standing(scene: Arc<Scene>) -> Self {
        let row = World::new(Arc::clone(&scene)).row().clone();
        let (variation, light) = (Variation::default(), Light::default());
        let start = Start { row, variation, light, weight: 1.0, drawn: Drawn::new() };
        Self { scene, starts: vec![start], ranges: Ranges::NOMINAL }
    }

    /// The starts of episodes, with one bank for each scene. Friction of the hands is a variation, so that the episodes
    /// of a room share a scene.
    ///
    /// # Errors
    /// [`BankError`]: a scene that cannot be built, or an episode without a start.
    pub fn of_episodes(
        config: &SceneConfig,
        robot: &Arc<Robot>,
        gains: &Gains,
        episodes: &[EpisodeSpec],
    ) -> Result<Vec<Self>, BankError> {
        let mut banks: Vec<Self> = Vec::new();
        for episode in episodes {
            let build = |spec: SceneSpec| {
                let (task, seed) = (episode.task, episode.seed);
                let scene = Scene::build(config, Arc::clone(robot), spec);
                scene.map(Arc::new).map_err(|source| BankError::Scene { task, seed, source })
            };
            let wanted = episode.scene(gains.clone());
            let shared = SceneSpec { hand_friction: None, ..wanted.clone() };
            let found = banks.iter().position(|bank| bank.scene.spec == shared);
            let index = match found {
                Some(index) => index,
                None => {
                    banks.push(Self { scene: build(shared)?, starts: Vec::new(), ranges: Ranges::NOMINAL });
                    banks.len() - 1
                }
            };
            let scene = Arc::clone(&banks[index].scene);
            let mut variation = Variation::default();
            let mut drawn = Drawn::from([("episode".to_owned(), vec![episode.episode as f64])]);
            let own = match wanted.hand_friction {
                Some(friction) => {
                    scene.set_hand_friction(friction, &mut variation);
                    drawn.insert("hand_friction".to_owned(), vec![friction]);
                    build(wanted)?
                }
                None => scene,
            };
            let row = Episode::start(own, episode)?.row().clone();
            banks[index].starts.push(Start { row, variation, light: episode.light(), weight: 1.0, drawn });
        }
        Ok(banks)
    }

    /// Repeats each start `times` times, and draws a variation for each copy on top of its own.
    #[must_use]
    pub fn varied(self, ranges: &Ranges, times: usize, seed: u64) -> Self {
        let Self { scene, starts, .. } = self;
        let mut varied = Vec::with_capacity(starts.len() * times);
        for (index, start) in starts.into_iter().enumerate() {
            for time in 0..times {
                let draw = (index * times + time) as u64;
                let mut random = Random::of_term(Stream::Batch, "variation", seed, draw);
                let mut start = start.clone();
                start.drawn.extend(ranges.draw(&scene, &mut random, &mut start.variation));
                if ranges.light {
                    start.light = Light::draw(seed, draw, &Randomization::default());
                }
                varied.push(start);
            }
        }
        Self { scene, starts: varied, ranges: ranges.clone() }
    }
}
