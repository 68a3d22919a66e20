//! The sensors of one robot.

use std::sync::Arc;

use fiatlux_features::ResNet18;
use fiatlux_proto::foxglove::{CompressedImage, PointCloud};
use fiatlux_proto::v3::Observation;
use fiatlux_render::{Lighting, Visuals};
use fiatlux_rules::Row;
use fiatlux_wire::{frame_of, point_cloud, time_of};
use fiatlux_world::{CameraVariation, Scene};

use crate::devices::Devices;
use crate::out::Out;
use crate::{NoiseSeed, SenseError, Sensor, Sensors, Setup, Sight, Term, View};

/// The sensors of one robot, episode after episode. What is computed in a row is kept until the next one.
#[derive(Debug, Clone)]
pub struct SensorSuite {
    sensors: Sensors,
    lengths: [usize; Sensor::ALL.len()],
    words: [usize; Sensor::ALL.len()],
    /// Sensors whose numbers are the bytes of a picture.
    pictures: Sensors,
    image_size: [usize; 2],
    devices: Devices,
}

impl SensorSuite {
    /// A suite that can be asked for these sensors.
    pub fn new(sensors: Sensors, setup: Setup) -> Self {
        Self {
            sensors,
            lengths: Sensor::ALL.map(|sensor| sensor.length(&setup)),
            words: Sensor::ALL.map(|sensor| sensor.terms(&setup).iter().map(Term::words).sum()),
            pictures: Sensor::ALL
                .into_iter()
                .filter(|sensor| sensor.terms(&setup).iter().all(Term::is_picture))
                .fold(Sensors::NONE, Sensors::with),
            image_size: setup.image_size,
            devices: Devices::new(Sight::Published, setup.image_size, None),
        }
    }

    /// With a network, which features and the flat vector need, and which needs images of sides that
    /// [`ResNet18::features`] takes.
    #[must_use]
    pub fn with_network(self, network: Option<ResNet18>) -> Self {
        Self { devices: Devices::new(self.devices.sight, self.image_size, network), ..self }
    }

    /// With a LiDAR that sees more than the published one. The flat vector keeps the published one's ranges.
    #[must_use]
    pub fn with_sight(mut self, sight: Sight) -> Self {
        self.devices.sight = sight;
        self
    }

    /// An episode begins in a scene. `visuals` are asked for where a camera needs them.
    ///
    /// # Errors
    /// [`SenseError::Mount`] for a robot without LiDAR where that is among the sensors.
    pub fn begin(
        &mut self,
        scene: &Scene,
        noise: Option<NoiseSeed>,
        visuals: impl FnOnce() -> Arc<Visuals>,
        lighting: Lighting,
    ) -> Result<(), SenseError> {
        let cameras = self.sensors.iter().filter_map(Sensor::camera);
        self.devices.begin(self.sensors.meets(Sensors::WITH_SCAN), cameras, scene, noise, visuals, lighting)
    }

    /// Another episode begins in the same scene. Allocates nothing.
    pub fn restart(&mut self, noise: Option<NoiseSeed>, lighting: Lighting) {
        self.devices.restart(noise, lighting);
    }

    /// Varies the pictures of the episode that [`SensorSuite::begin`] or [`SensorSuite::restart`] begins next; `None` for the benchmark's.
    pub fn vary_cameras(&mut self, variation: Option<CameraVariation>) {
        self.devices.vary_cameras(variation);
    }

    /// Keeps a row for pictures that are delayed; to be called for each row of an episode, in order.
    pub fn remember(&mut self, row: &Row) {
        self.devices.remember(row);
    }

    /// Rows that delayed pictures may still show, the oldest first: with the variation, the state of the cameras.
    pub fn past(&self) -> impl Iterator<Item = &Row> {
        self.devices.past()
    }

    /// Multiplies the half-width of all noise, also of the episodes that follow. The published noise has 1.
    pub fn scale_noise(&mut self, factor: f64) {
        self.devices.noise.scale = factor;
    }

    /// Count of a sensor's numbers.
    pub fn length(&self, sensor: Sensor) -> usize {
        self.lengths[sensor as usize]
    }

    /// Writes a sensor's numbers of a row, in the order of its terms. Sensors of cost [`crate::Cost::Body`] and
    /// [`crate::Cost::Scan`] allocate nothing.
    ///
    /// # Errors
    /// [`SenseError`]; a buffer of another length than [`SensorSuite::length`] among them.
    pub fn compute(&mut self, sensor: Sensor, view: &View<'_>, out: &mut [f32]) -> Result<(), SenseError> {
        let expected = self.length(sensor);
        if out.len() != expected {
            return Err(SenseError::Buffer { sensor: sensor.name(), expected, found: out.len() });
        }
        (sensor.entry().compute)(view, &mut self.devices, &mut Out::slice(out))
    }

    /// Count of the words of 4 bytes that [`SensorSuite::fill`] writes for a sensor.
    pub fn words(&self, sensor: Sensor) -> usize {
        self.words[sensor as usize]
    }

    /// Writes a sensor's part of an observation: its numbers, as [`SensorSuite::compute`] does, or the bytes of its picture, four
    /// to a number of the buffer, as they lie in memory. A picture is drawn there and nowhere else.
    ///
    /// # Errors
    /// [`SenseError`]; a buffer of another length than [`SensorSuite::words`] among them.
    pub fn fill(&mut self, sensor: Sensor, view: &View<'_>, out: &mut [f32]) -> Result<(), SenseError> {
        if !self.pictures.contains(sensor) {
            return self.compute(sensor, view, out);
        }
        let expected = self.words(sensor);
        if out.len() != expected {
            return Err(SenseError::Buffer { sensor: sensor.name(), expected, found: out.len() });
        }
        let bytes = &mut bytemuck::cast_slice_mut(out)[..self.lengths[sensor as usize]];
        (sensor.entry().compute)(view, &mut self.devices, &mut Out::bytes(bytes))
    }

    /// Gives up what cameras keep of the present row, and lends their renderers to the copies of this suite: worlds that take turns
    /// need no renderer each. Another question about the row draws it again.
    pub fn release(&mut self) {
        self.devices.release();
    }

    /// A message with these sensors of a row and no others.
    ///
    /// # Errors
    /// [`SenseError`]; sensors that it was not made for among them.
    pub fn observe(&mut self, view: &View<'_>, asked: Sensors) -> Result<Observation, SenseError> {
        let mut observation = Observation { episode: view.episode, step: view.row.step, ..Observation::default() };
        for sensor in asked.iter() {
            (sensor.entry().encode)(view, &mut self.devices, &mut observation)?;
        }
        Ok(observation)
    }

    /// A camera's image of a row, for a viewer.
    ///
    /// # Errors
    /// [`SenseError`]: a sensor that has no camera, or that the suite was not made for.
    pub fn compressed_image(&mut self, sensor: Sensor, view: &View<'_>) -> Result<CompressedImage, SenseError> {
        let camera = sensor.camera().ok_or(SenseError::Absent("camera"))?;
        let robot = &view.scene.robot;
        let frame_id = frame_of(robot, robot.camera(camera).map(|mount| mount.link));
        let data = self.devices.picture(view, camera)?.to_png_fast()?;
        Ok(CompressedImage { timestamp: Some(time_of(view.row.step)), frame_id, data, format: "png".into() })
    }

    /// Hits of the LiDAR in a row, in its own frame, for a viewer.
    ///
    /// # Errors
    /// [`SenseError`]: no LiDAR.
    pub fn point_cloud(&mut self, view: &View<'_>) -> Result<PointCloud, SenseError> {
        let robot = &view.scene.robot;
        let points = self.devices.scan(view, self.devices.sight)?.points();
        Ok(point_cloud(time_of(view.row.step), frame_of(robot, robot.lidar()), points))
    }
}

#[cfg(test)]
mod tests;
