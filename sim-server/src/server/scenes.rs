//! Scenes, built once and shared by the sessions that play in them.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, OnceLock};

use fiatlux_proto::Message;
use fiatlux_render::Visuals;
use fiatlux_robot::{GainSet, Robot};
use fiatlux_world::{Scene, SceneConfig, SceneError, SceneKind, SceneSpec};

use super::lock;

/// Scenes that are kept; each takes some hundreds of kB.
const KEPT: usize = 32;

type Key = (SceneKind, u64, GainSet);

/// A scene, and its shapes for a viewer.
#[derive(Debug, Clone)]
pub(super) struct Built {
    pub scene: Arc<Scene>,
    /// An encoded `foxglove.SceneUpdate`.
    pub shapes: Arc<[u8]>,
    /// Its meshes, once a camera has asked for them.
    visuals: Arc<OnceLock<Arc<Visuals>>>,
}

impl Built {
    fn new(scene: Arc<Scene>) -> Self {
        let shapes = crate::show::scene_update(&scene).encode_to_vec().into();
        Self { scene, shapes, visuals: Arc::default() }
    }

    /// The scene's meshes.
    pub fn visuals(&self) -> Arc<Visuals> {
        Arc::clone(self.visuals.get_or_init(|| Arc::new(Visuals::new(&self.scene))))
    }
}

/// Builds scenes of one config and keeps those last used.
#[derive(Debug)]
pub(super) struct Scenes {
    config: SceneConfig,
    robot: Arc<Robot>,
    /// The last used is the last.
    kept: Mutex<VecDeque<(Key, Built)>>,
}

impl Scenes {
    pub fn new(config: SceneConfig, robot: Arc<Robot>) -> Self {
        Self { config, robot, kept: Mutex::default() }
    }

    pub fn get(&self, kind: SceneKind, seed: u64, gains: GainSet) -> Result<Built, SceneError> {
        let key = (kind, seed, gains);
        if let Some(built) = self.find(key) {
            return Ok(built);
        }
        // Two sessions may build the same scene at once; that costs time only.
        let spec = SceneSpec { kind, seed, gains: self.robot.gains(gains), hand_friction: None };
        let built = Built::new(Arc::new(Scene::build(&self.config, Arc::clone(&self.robot), spec)?));
        let mut kept = lock(&self.kept);
        if kept.len() >= KEPT {
            kept.pop_front();
        }
        kept.push_back((key, built.clone()));
        Ok(built)
    }

    fn find(&self, key: Key) -> Option<Built> {
        let mut kept = lock(&self.kept);
        let found = kept.iter().position(|(other, _)| *other == key)?;
        let entry = kept.remove(found)?;
        let built = entry.1.clone();
        kept.push_back(entry);
        Some(built)
    }
}
