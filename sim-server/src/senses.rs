//! What a policy senses in a row, as messages: each sensor is computed when it is asked for, once a row, and nothing else.

mod sensor;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use fiatlux_features::{FeatureError, ResNet18};
use fiatlux_proto::foxglove::{CompressedImage, PointCloud};
use fiatlux_proto::v3::{self, FlatObservation, Observation};
use fiatlux_render::{Camera, Image, Lighting, RenderError, Renderer, Visuals};
use fiatlux_rules::{Row, Task};
use fiatlux_wire::{frame_of, point_cloud, pose_message, time_of};
use fiatlux_world::{
    ClimbPrivileged, Episode, Lidar, Privileged, Proprioception, Scene, SceneError, StandardTerms, flat_standard,
    hand_force, limb_force,
};
use nalgebra::{Isometry3, Vector3};
use thiserror::Error;

pub use sensor::{Sensor, Sensors};

/// Why a sensor has nothing to say.
#[derive(Debug, Error)]
pub enum SenseError {
    /// The robot lacks the sensor's mount.
    #[error("the scene's robot has no such sensor")]
    Mount(#[from] SceneError),
    /// No camera, or no picture.
    #[error("the head camera gives no image")]
    Camera(#[from] RenderError),
    /// The network refuses, or its numbers overflow.
    #[error("the image has no features")]
    Features(#[from] FeatureError),
    /// It was not among those that the senses were made for.
    #[error("the senses were made without {0}")]
    Absent(&'static str),
}

/// The senses of one robot, episode after episode. What is computed in a row is kept until the next one.
#[derive(Debug)]
pub struct Senses {
    sensors: Sensors,
    image_size: [usize; 2],
    network: Option<ResNet18>,
    scanner: Option<Scanner>,
    eye: Option<Eye>,
    /// Row whose features the network last gave.
    features_step: Option<u64>,
}

#[derive(Debug)]
struct Scanner {
    lidar: Lidar,
    step: Option<u64>,
}

#[derive(Debug)]
struct Eye {
    renderer: Renderer,
    visuals: Arc<Visuals>,
    lighting: Lighting,
    step: Option<u64>,
}

impl Senses {
    /// Senses that can be asked for these sensors. `image_size` is width and height of the camera's image, pixels;
    /// `network` is needed for features alone, which need sides that [`ResNet18::features`] takes.
    pub fn new(sensors: Sensors, image_size: [usize; 2], network: Option<ResNet18>) -> Self {
        Self { sensors, image_size, network, scanner: None, eye: None, features_step: None }
    }

    /// An episode begins in a scene. `visuals` are asked for where the camera needs them.
    ///
    /// # Errors
    /// [`SenseError::Mount`] for a robot without LiDAR where that is among the sensors.
    pub fn begin(
        &mut self,
        scene: &Scene,
        visuals: impl FnOnce() -> Arc<Visuals>,
        lighting: Lighting,
    ) -> Result<(), SenseError> {
        self.features_step = None;
        if self.sensors.meets(Sensors::WITH_SCAN) {
            self.scanner = Some(Scanner { lidar: Lidar::new(scene)?, step: None });
        }
        if self.sensors.meets(Sensors::WITH_IMAGE) {
            let [width, height] = self.image_size;
            let renderer = self.eye.take().map_or_else(|| Renderer::new(width, height), |eye| eye.renderer);
            self.eye = Some(Eye { renderer, visuals: visuals(), lighting, step: None });
        }
        Ok(())
    }

    /// The observation of an episode's last row with the terms of these sensors and no others.
    ///
    /// # Errors
    /// [`SenseError`]; sensors that it was not made for among them.
    pub fn observe(&mut self, episode: &Episode, asked: Sensors) -> Result<Observation, SenseError> {
        let (row, task) = (episode.row(), episode.spec().task);
        let robot = &episode.scene().robot;
        let has = |sensor| asked.contains(sensor);
        let mut observation = Observation { episode: episode.spec().episode, step: row.step, ..Observation::default() };
        observation.proprioception = has(Sensor::Proprioception).then(|| proprioception(episode.observation()));
        if has(Sensor::HandContact) {
            observation.hand_contact_force = flat_forces(&hand_force(row));
        }
        if has(Sensor::LimbContact) {
            observation.limb_contact_force = flat_forces(&limb_force(robot, row));
        }
        if has(Sensor::LastAction) {
            observation.last_action = singles(&row.action);
        }
        if has(Sensor::Lidar) {
            observation.lidar = self.scan(row)?.ranges().to_vec();
        }
        if has(Sensor::Camera) {
            observation.camera = Some(image(self.look(episode)?));
        }
        if has(Sensor::Features) {
            let network = self.recognise(episode)?;
            observation.features =
                Some(v3::Features { values: network.last().to_vec(), weights: network.label().into() });
        }
        if has(Sensor::Flat) {
            observation.flat = Some(self.flatten(episode, task)?);
        }
        observation.privileged = has(Sensor::Privileged).then(|| privileged(episode, task));
        observation.verdict = has(Sensor::Verdict).then(|| v3::Verdict {
            criteria: episode.verdict().criteria.as_slice().to_vec(),
            gate_progress: episode.verdict().progress,
            reward: episode.reward(),
        });
        Ok(observation)
    }

    /// The camera's image of an episode's last row, for a viewer.
    ///
    /// # Errors
    /// [`SenseError`]: no camera.
    pub fn compressed_image(&mut self, episode: &Episode) -> Result<CompressedImage, SenseError> {
        let camera = episode.scene().robot.camera();
        let frame_id = frame_of(&episode.scene().robot, camera);
        let data = self.look(episode)?.to_png_fast()?;
        Ok(CompressedImage { timestamp: Some(time_of(episode.row().step)), frame_id, data, format: "png".into() })
    }

    /// What the LiDAR hits in an episode's last row, in its own frame, for a viewer.
    ///
    /// # Errors
    /// [`SenseError`]: no LiDAR.
    pub fn point_cloud(&mut self, episode: &Episode) -> Result<PointCloud, SenseError> {
        let mount = episode.scene().robot.lidar();
        let frame_id = frame_of(&episode.scene().robot, mount);
        let points = self.scan(episode.row())?.points();
        Ok(point_cloud(time_of(episode.row().step), frame_id, points))
    }

    fn scan(&mut self, row: &Row) -> Result<&Lidar, SenseError> {
        let Scanner { lidar, step } = self.scanner.as_mut().ok_or(SenseError::Absent("LiDAR"))?;
        if step.replace(row.step) != Some(row.step) {
            lidar.scan(row);
        }
        Ok(lidar)
    }

    fn look(&mut self, episode: &Episode) -> Result<&Image, SenseError> {
        let Eye { renderer, visuals, lighting, step } = self.eye.as_mut().ok_or(SenseError::Absent("camera"))?;
        let row = episode.row();
        if *step != Some(row.step) {
            let [width, height] = self.image_size;
            let camera = Camera::head(&episode.scene().robot, row)?.fitted(width, height);
            renderer.render(visuals, row, &camera, lighting);
            *step = Some(row.step);
        }
        Ok(renderer.image())
    }

    /// The network, with the features of the present image.
    fn recognise(&mut self, episode: &Episode) -> Result<&ResNet18, SenseError> {
        let step = episode.row().step;
        if self.features_step != Some(step) {
            self.look(episode)?;
            let image = self.eye.as_ref().map(|eye| eye.renderer.image()).ok_or(SenseError::Absent("camera"))?;
            let network = self.network.as_mut().ok_or(SenseError::Absent("features"))?;
            network.features(image.rgb(), image.width(), image.height())?;
            self.features_step = Some(step);
        }
        self.network.as_ref().ok_or(SenseError::Absent("features"))
    }

    fn flatten(&mut self, episode: &Episode, task: Task) -> Result<FlatObservation, SenseError> {
        let row = episode.row();
        self.scan(row)?;
        self.recognise(episode)?;
        let lidar = self.scanner.as_ref().ok_or(SenseError::Absent("LiDAR"))?.lidar.ranges();
        let network = self.network.as_ref().ok_or(SenseError::Absent("features"))?;
        let terms = StandardTerms {
            proprioception: episode.observation(),
            hand_force: &hand_force(row),
            limb_force: limb_force(&episode.scene().robot, row),
            features: network.last(),
            lidar,
            last_action: &row.action,
        };
        Ok(FlatObservation { values: flat_standard(&terms, task), weights: network.label().into() })
    }
}

fn singles(numbers: &[f64]) -> Vec<f32> {
    numbers.iter().map(|number| *number as f32).collect()
}

fn flat_forces(forces: &[Vector3<f64>]) -> Vec<f32> {
    forces.iter().flat_map(|force| <[f64; 3]>::from(*force)).map(|number| number as f32).collect()
}

fn proprioception(sensed: &Proprioception) -> v3::Proprioception {
    v3::Proprioception {
        base_angular_velocity: singles(&sensed.base_angular_velocity),
        projected_gravity: singles(&sensed.projected_gravity),
        base_linear_velocity: singles(&sensed.base_linear_velocity),
        base_height: sensed.base_height as f32,
        joint_position: singles(&sensed.joint_position),
        joint_velocity: singles(&sensed.joint_velocity),
    }
}

fn image(image: &Image) -> v3::Image {
    v3::Image { width: image.width() as u32, height: image.height() as u32, rgb: image.rgb().to_vec() }
}

fn privileged(episode: &Episode, task: Task) -> v3::Privileged {
    let row = episode.row();
    let pose = |pose: &Isometry3<f64>| Some(pose_message(pose));
    if task == Task::Climb {
        let exact = ClimbPrivileged::measure(row);
        return v3::Privileged {
            robot: pose(&exact.robot),
            ladder: pose(&exact.ladder),
            linear_velocity: exact.linear_velocity.as_slice().to_vec(),
            flat: singles(&exact.flat()),
            ..v3::Privileged::default()
        };
    }
    let exact = Privileged::measure(episode.judge().geometry(), row);
    v3::Privileged {
        robot: pose(&exact.robot),
        ladder: pose(&exact.ladder),
        socket: pose(&exact.socket),
        fresh_bulb: pose(&exact.fresh_bulb),
        old_bulb: pose(&exact.old_bulb),
        crate_: pose(&exact.crate_),
        distances: exact.distances.into(),
        seated: exact.seated.into(),
        linear_velocity: Vec::new(),
        flat: singles(&exact.flat()),
    }
}
