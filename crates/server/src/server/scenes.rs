//! Scenes, built once and shared by the sessions that play in them.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::{Arc, Mutex, OnceLock};

use fiatlux_proto::Message;
use fiatlux_render::{MeshError, RobotMeshes, Visuals};
use fiatlux_robot::{Robot, RobotError};
use fiatlux_world::{EpisodeSpec, Scene, SceneConfig, SceneError, SceneSpec, Varied};

use super::lock;

/// Number of scenes to keep; each takes some hundreds of kB.
const KEPT: usize = 32;

/// A scene, and what is made from it once.
#[derive(Debug, Clone)]
pub(super) struct Built {
    pub scene: Arc<Scene>,
    /// Its shapes for a viewer, as an encoded `foxglove.SceneUpdate`.
    pub shapes: Arc<[u8]>,
    /// Its meshes, made when a camera first needs them.
    visuals: Arc<OnceLock<Arc<Visuals>>>,
    /// The user's own meshes of the robot.
    meshes: Option<Arc<RobotMeshes>>,
}

impl Built {
    fn new(scene: Arc<Scene>, meshes: Option<Arc<RobotMeshes>>) -> Self {
        let shapes = fiatlux_wire::scene_update(&scene).encode_to_vec().into();
        Self { scene, shapes, visuals: Arc::default(), meshes }
    }

    /// The meshes of the scene, made when they are first needed.
    pub fn visuals(&self) -> Arc<Visuals> {
        let make = || Arc::new(Visuals::with_robot(&self.scene, self.meshes.as_deref()));
        Arc::clone(self.visuals.get_or_init(make))
    }

    /// Label of the user's own meshes; empty without them.
    pub fn meshes(&self) -> &str {
        self.meshes.as_ref().map_or("", |meshes| meshes.label())
    }

    /// The same scene with what an episode draws of it, none of which is visible: friction, masses and gravity.
    pub fn for_episode(&self, episode: &EpisodeSpec) -> Result<Arc<Scene>, SceneError> {
        let spec = episode.scene(self.scene.spec.gains.clone());
        if spec == self.scene.spec {
            return Ok(Arc::clone(&self.scene));
        }
        Scene::build(&self.scene.config, Arc::clone(&self.scene.robot), spec).map(Arc::new)
    }
}

/// Every robot that comes with the library, in the order of `Robot::NAMES`.
#[derive(Debug)]
pub(super) struct Robots([Arc<Robot>; Robot::NAMES.len()]);

impl Robots {
    pub fn load() -> Result<Self, RobotError> {
        let mut robots = Vec::new();
        for name in Robot::NAMES {
            robots.push(Arc::new(Robot::by_name(name)?));
        }
        Ok(Self(robots.try_into().expect("one for each name")))
    }

    /// The user's own meshes of each robot, in the same order: links that robots share have other indices in each.
    pub fn meshes(&self, folder: &Path) -> Result<Vec<Arc<RobotMeshes>>, MeshError> {
        self.0.iter().map(|robot| RobotMeshes::open(folder, robot).map(Arc::new)).collect()
    }

    /// The one of that name, which is one of `Robot::NAMES`.
    pub fn get(&self, name: &'static str) -> &Arc<Robot> {
        self.0.iter().find(|robot| robot.name() == name).expect("every known robot was loaded")
    }
}

/// Builds scenes from one config and keeps those last used.
#[derive(Debug)]
pub(super) struct Scenes {
    config: SceneConfig,
    robots: Robots,
    /// The user's own, of each robot; empty without them.
    meshes: Vec<Arc<RobotMeshes>>,
    /// Scenes, last used at the end.
    kept: Mutex<VecDeque<Built>>,
}

impl Scenes {
    pub fn new(config: SceneConfig, robots: Robots, meshes: Vec<Arc<RobotMeshes>>) -> Self {
        Self { config, robots, meshes, kept: Mutex::default() }
    }

    /// The robot of that name, which is one of `Robot::NAMES`.
    pub fn robot(&self, name: &'static str) -> &Arc<Robot> {
        self.robots.get(name)
    }

    /// A scene with the hands' nominal friction, in which nothing varies.
    pub fn get(&self, robot: &'static str, spec: SceneSpec) -> Result<Built, SceneError> {
        let spec = SceneSpec { hand_friction: None, varied: Varied::new(), ..spec };
        if let Some(built) = self.find(robot, &spec) {
            return Ok(built);
        }
        // Two sessions may build the same scene at once; that only costs time.
        let scene = Arc::new(Scene::build(&self.config, Arc::clone(self.robot(robot)), spec)?);
        let meshes = Robot::NAMES.iter().zip(&self.meshes).find(|(name, _)| **name == robot);
        let built = Built::new(scene, meshes.map(|(_, meshes)| Arc::clone(meshes)));
        let mut kept = lock(&self.kept);
        if kept.len() >= KEPT {
            kept.pop_front();
        }
        kept.push_back(built.clone());
        Ok(built)
    }

    fn find(&self, robot: &str, spec: &SceneSpec) -> Option<Built> {
        let mut kept = lock(&self.kept);
        let is_same = |scene: &Scene| scene.robot.name() == robot && scene.spec == *spec;
        let found = kept.iter().position(|built| is_same(&built.scene))?;
        let built = kept.remove(found)?;
        kept.push_back(built.clone());
        Some(built)
    }
}
