//! Devices that sensors share: each computes at most once a row.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use fiatlux_features::{FeatureError, ResNet18};
use fiatlux_render::{Camera, Image, Lighting, RenderError, Renderer, Visuals};
use fiatlux_rules::Row;
use fiatlux_world::{CameraVariation, Scene, SceneError};
use thiserror::Error;

use crate::noise::{Noise, NoiseSeed};
use crate::observer::sense;
use crate::out::Out;
use crate::{Lidar, Proprioception, Sight, View};

/// Why a sensor has nothing to say.
#[derive(Debug, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum SenseError {
    #[error("the scene's robot has no such sensor")]
    Mount(#[from] SceneError),
    #[error("the camera gives no image")]
    Camera(#[from] RenderError),
    #[error("the image has no features")]
    Features(#[from] FeatureError),
    #[error("the sensors were made without {0}")]
    Absent(&'static str),
    #[error("sensor '{sensor}' has {expected} numbers; the buffer has room for {found}")]
    Buffer { sensor: &'static str, expected: usize, found: usize },
}

/// A device and the step of the row that it last computed.
#[derive(Debug, Clone)]
struct Cached<T> {
    value: T,
    computed_at: Option<u64>,
}

impl<T> Cached<T> {
    fn new(value: T) -> Self {
        Self { value, computed_at: None }
    }

    /// True if it has to be computed for a row; from then on it counts as computed.
    fn is_due(&mut self, step: u64) -> bool {
        self.computed_at.replace(step) != Some(step)
    }
}

#[derive(Debug, Clone)]
struct CameraSet {
    visuals: Arc<Visuals>,
    lighting: Lighting,
    /// By the camera's name.
    cameras: Vec<(&'static str, Eye)>,
}

/// A camera's renderer, from when it is needed until it is given back. A picture needs its geometry too; depth and labels need that
/// alone.
#[derive(Debug, Clone, Default)]
struct Eye {
    renderer: Option<Renderer>,
    measured_at: Option<u64>,
    lit_at: Option<u64>,
}

/// A question to a camera.
enum Wanted<'a> {
    Geometry,
    Image,
    /// The bytes of the image, in the caller's memory alone.
    Bytes(&'a mut [u8]),
}

/// Renderers that nobody uses now, all of one size. A frame follows from its row alone, so it does not matter who used one before.
#[derive(Debug, Clone, Default)]
struct Renderers(Arc<Mutex<Vec<Renderer>>>);

impl Renderers {
    fn lend(&self, [width, height]: [usize; 2]) -> Renderer {
        let idle = self.0.lock().unwrap_or_else(PoisonError::into_inner).pop();
        idle.unwrap_or_else(|| Renderer::new(width, height))
    }

    fn take_back(&self, renderer: Option<Renderer>) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).extend(renderer);
    }
}

#[derive(Debug)]
pub(crate) struct Devices {
    /// Sight of the LiDAR where a sensor does not ask for the published one.
    pub sight: Sight,
    pub noise: Noise,
    image_size: [usize; 2],
    body: Option<Cached<Proprioception>>,
    lidars: Vec<(Sight, Cached<Lidar>)>,
    camera_set: Option<CameraSet>,
    renderers: Renderers,
    variation: Option<CameraVariation>,
    /// Rows that a delayed picture may still show, the oldest first.
    past: VecDeque<Row>,
    network: Option<Cached<ResNet18>>,
}

impl Clone for Devices {
    fn clone(&self) -> Self {
        // A network keeps the features of its own images alone.
        let network = self.network.as_ref().map(|network| Cached::new(network.value.twin()));
        let Self { sight, noise, image_size, body, lidars, camera_set, renderers, variation, past, network: _ } = self;
        Self {
            sight: *sight,
            noise: noise.clone(),
            image_size: *image_size,
            body: body.clone(),
            lidars: lidars.clone(),
            camera_set: camera_set.clone(),
            renderers: renderers.clone(),
            variation: variation.clone(),
            past: past.clone(),
            network,
        }
    }
}

impl Devices {
    pub fn new(sight: Sight, image_size: [usize; 2], network: Option<ResNet18>) -> Self {
        let network = network.map(Cached::new);
        Self {
            sight,
            noise: Noise::new(None),
            image_size,
            body: None,
            lidars: Vec::new(),
            camera_set: None,
            renderers: Renderers::default(),
            variation: None,
            past: VecDeque::new(),
            network,
        }
    }

    pub fn begin(
        &mut self,
        scans: bool,
        cameras: impl Iterator<Item = &'static str>,
        scene: &Scene,
        noise: Option<NoiseSeed>,
        visuals: impl FnOnce() -> Arc<Visuals>,
        lighting: Lighting,
    ) -> Result<(), SenseError> {
        self.noise.restart(noise);
        self.body = Some(Cached::new(Proprioception::zeros(scene.robot_layout().joints)));
        self.lidars.clear();
        if scans {
            self.lidars.push((Sight::Published, Cached::new(Lidar::new(scene, Sight::Published)?)));
            if self.sight != Sight::Published {
                self.lidars.push((self.sight, Cached::new(Lidar::new(scene, self.sight)?)));
            }
        }
        let mut cameras = cameras.peekable();
        if cameras.peek().is_some() {
            self.release();
            let mut eyes: Vec<(_, Eye)> = Vec::new();
            for name in cameras {
                if !eyes.iter().any(|(other, _)| *other == name) {
                    eyes.push((name, Eye::default()));
                }
            }
            self.camera_set = Some(CameraSet { visuals: visuals(), lighting, cameras: eyes });
        }
        if let Some(network) = &mut self.network {
            network.computed_at = None;
        }
        Ok(())
    }

    /// Another episode in the same scene.
    pub fn restart(&mut self, noise: Option<NoiseSeed>, lighting: Lighting) {
        self.noise.restart(noise);
        if let Some(body) = &mut self.body {
            body.computed_at = None;
        }
        self.lidars.iter_mut().for_each(|(_, lidar)| lidar.computed_at = None);
        if let Some(camera_set) = &mut self.camera_set {
            camera_set.lighting = lighting;
            camera_set.cameras.iter_mut().for_each(|(_, eye)| (eye.measured_at, eye.lit_at) = (None, None));
        }
        if let Some(network) = &mut self.network {
            network.computed_at = None;
        }
    }

    /// Pictures of the episode that begins differ from the benchmark's.
    pub fn vary_cameras(&mut self, variation: Option<CameraVariation>) {
        self.variation = variation;
        self.past.clear();
    }

    /// Keeps a row for pictures that come later, if they do.
    pub fn remember(&mut self, row: &Row) {
        let delay = self.variation.as_ref().map_or(0, |variation| variation.delay_steps);
        if delay > 0 {
            self.past.truncate(self.past.partition_point(|past| past.step < row.step));
            self.past.push_back(row.clone());
            while self.past.len() > delay + 1 {
                self.past.pop_front();
            }
        }
    }

    /// Rows that pictures may still show.
    pub fn past(&self) -> impl Iterator<Item = &Row> {
        self.past.iter()
    }

    /// Gives all renderers back, and with them what they show.
    pub fn release(&mut self) {
        for (_, eye) in self.camera_set.iter_mut().flat_map(|set| &mut set.cameras) {
            self.renderers.take_back(std::mem::take(eye).renderer);
        }
    }

    /// Proprioception of the row.
    pub fn body(&mut self, view: &View<'_>) -> Result<&Proprioception, SenseError> {
        let body = self.body.as_mut().ok_or(SenseError::Absent("an episode"))?;
        if body.is_due(view.row.step) {
            sense(view.row, view.scene.robot.q0(), &mut self.noise, &mut body.value);
        }
        Ok(&body.value)
    }

    /// The scan of the LiDAR at this row; cast once a row, then kept.
    pub fn scan(&mut self, view: &View<'_>, sight: Sight) -> Result<&Lidar, SenseError> {
        let found = self.lidars.iter_mut().find(|(of, _)| *of == sight);
        let (_, lidar) = found.ok_or(SenseError::Absent("LiDAR"))?;
        if lidar.is_due(view.row.step) {
            lidar.value.scan(view.row);
        }
        Ok(&lidar.value)
    }

    /// The image of a camera at this row; drawn once a row, then kept.
    pub fn picture(&mut self, view: &View<'_>, camera: &'static str) -> Result<&Image, SenseError> {
        Ok(self.look(view, camera, Wanted::Image)?.image())
    }

    /// Writes the image of a camera at this row: straight to its place, where there is room for bytes and nobody else needs the image.
    pub fn draw(&mut self, view: &View<'_>, camera: &'static str, out: &mut Out<'_>) -> Result<(), SenseError> {
        let [width, height] = self.image_size;
        let room = if self.network.is_none() { out.picture(3 * width * height) } else { None };
        match room {
            Some(rgb) => {
                self.look(view, camera, Wanted::Bytes(rgb))?;
            }
            None => out.extend_bytes(self.picture(view, camera)?.rgb()),
        }
        Ok(())
    }

    /// The camera's view of this row: owners and distances by pixel. Found once a row, then kept.
    pub fn geometry(&mut self, view: &View<'_>, camera: &'static str) -> Result<&Renderer, SenseError> {
        self.look(view, camera, Wanted::Geometry)
    }

    fn look(&mut self, view: &View<'_>, camera: &'static str, wanted: Wanted<'_>) -> Result<&Renderer, SenseError> {
        let CameraSet { visuals, lighting, cameras } = self.camera_set.as_mut().ok_or(SenseError::Absent("camera"))?;
        let found = cameras.iter_mut().find(|(name, _)| *name == camera);
        let (_, eye) = found.ok_or(SenseError::Absent("camera"))?;
        let step = Some(view.row.step);
        let renderer = eye.renderer.get_or_insert_with(|| self.renderers.lend(self.image_size));
        let [width, height] = self.image_size;
        let variation = self.variation.as_ref();
        let visuals = match variation {
            Some(CameraVariation { look: 2, .. }) => visuals.second_look(view.scene),
            _ => visuals,
        };
        // The row of a delayed picture; at the start of an episode its first one.
        let shown = variation.map_or(view.row.step, |by| view.row.step.saturating_sub(by.delay_steps as u64));
        let row = self.past.iter().rfind(|past| past.step <= shown).or(self.past.front()).unwrap_or(view.row);
        let mounted = || {
            let mounted = Camera::mounted(&view.scene.robot, camera, row)?;
            let varied = variation.map_or(mounted.clone(), |variation| mounted.varied(variation));
            Ok::<_, SenseError>(varied.fitted(width, height))
        };
        match wanted {
            Wanted::Geometry if eye.measured_at != step => renderer.measure(visuals, row, &mounted()?),
            Wanted::Image if eye.lit_at != step => {
                let seen = mounted()?;
                renderer.render(visuals, row, &seen, lighting);
                if let Some(variation) = variation {
                    renderer.vary_image(&seen, variation, camera, row.step);
                }
                eye.lit_at = step;
            }
            Wanted::Bytes(rgb) if eye.lit_at != step => {
                let seen = mounted()?;
                renderer.render_to(visuals, row, &seen, lighting, rgb);
                if let Some(variation) = variation {
                    renderer.vary(rgb, &seen, variation, camera, row.step);
                }
            }
            Wanted::Bytes(rgb) => rgb.copy_from_slice(renderer.image().rgb()),
            Wanted::Geometry | Wanted::Image => {}
        }
        eye.measured_at = step;
        Ok(renderer)
    }

    /// The network, with the features of a camera's image.
    pub fn recognise(&mut self, view: &View<'_>, camera: &'static str) -> Result<&ResNet18, SenseError> {
        let mut network = self.network.take().ok_or(SenseError::Absent("features"))?;
        let recognised = self.run(view, camera, &mut network);
        let network = self.network.insert(network);
        recognised.map(|()| &network.value)
    }

    fn run(&mut self, view: &View<'_>, camera: &'static str, network: &mut Cached<ResNet18>) -> Result<(), SenseError> {
        if network.computed_at != Some(view.row.step) {
            let image = self.picture(view, camera)?;
            network.value.features(image.rgb(), image.width(), image.height())?;
            network.computed_at = Some(view.row.step);
        }
        Ok(())
    }
}
