//! Rows that episodes of a batch start from.

use std::sync::Arc;

use fiatlux_dynamics::Variation;
use fiatlux_robot::{Gains, Robot};
use fiatlux_rules::Row;
use fiatlux_world::{Episode, EpisodeSpec, Random, Scene, SceneConfig, SceneSpec, Stream, World};

use crate::{BankError, Ranges};

/// One scene, and where worlds start in it.
#[derive(Debug, Clone)]
pub struct Bank {
    /// The scene that the starts are in; worlds share it.
    pub scene: Arc<Scene>,
    /// An episode starts from one of them, each as likely as another.
    pub starts: Vec<Start>,
}

/// A row to start from and what differs from the scene in a world that starts there.
#[derive(Debug, Clone)]
pub struct Start {
    /// Any row of the scene: a task's start, or one that was recorded. It becomes row 0.
    pub row: Row,
    /// Masses, gains and friction.
    pub variation: Variation,
}

impl Bank {
    /// A scene with its reference state for a start: the robot in its standing posture.
    pub fn standing(scene: Arc<Scene>) -> Self {
        let row = World::new(Arc::clone(&scene)).row().clone();
        Self { scene, starts: vec![Start { row, variation: Variation::default() }] }
    }

    /// The starts of episodes, a bank for each scene among them. Friction of the hands is a variation of the scene, so that
    /// the episodes of a room share one.
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
                    banks.push(Self { scene: build(shared)?, starts: Vec::new() });
                    banks.len() - 1
                }
            };
            let scene = Arc::clone(&banks[index].scene);
            let mut variation = Variation::default();
            let own = match wanted.hand_friction {
                Some(friction) => {
                    scene.set_hand_friction(friction, &mut variation);
                    build(wanted)?
                }
                None => scene,
            };
            let row = Episode::start(own, episode)?.row().clone();
            banks[index].starts.push(Start { row, variation });
        }
        Ok(banks)
    }

    /// Each start `times` times, with a variation drawn for each over its own.
    #[must_use]
    pub fn varied(self, ranges: &Ranges, times: usize, seed: u64) -> Self {
        let Self { scene, starts } = self;
        let mut varied = Vec::with_capacity(starts.len() * times);
        for (index, start) in starts.into_iter().enumerate() {
            for time in 0..times {
                let draw = (index * times + time) as u64;
                let mut random = Random::of_term(Stream::Batch, "variation", seed, draw);
                let mut start = start.clone();
                ranges.draw(&scene, &mut random, &mut start.variation);
                varied.push(start);
            }
        }
        Self { scene, starts: varied }
    }
}
