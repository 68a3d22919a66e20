//! The entry in a sensor's file.

use fiatlux_proto::v3::Observation;
use fiatlux_render::HEAD_PIXELS;
use fiatlux_rules::{Protocol, RobotLayout, Task};
use fiatlux_world::Scene;

use crate::devices::Devices;
use crate::out::Out;
use crate::{SenseError, View};

/// An entry of the registry.
pub(crate) struct Entry {
    /// As sessions ask for it.
    pub name: &'static str,
    pub class: Class,
    /// Large in a message: a bag has it only where the session asks for it.
    pub is_large: bool,
    /// Shared computations that it needs besides the row.
    pub needs: Needs,
    /// Its terms in order; their offsets are filled in later.
    pub terms: fn(&Setup) -> Vec<Term>,
    /// Writes the numbers of all its terms.
    pub compute: fn(&View<'_>, &mut Devices, &mut Out<'_>) -> Result<(), SenseError>,
    /// Fills its field of the message.
    pub encode: fn(&View<'_>, &mut Devices, &mut Observation) -> Result<(), SenseError>,
}

/// Computations made once a row for all sensors that need them.
pub(crate) struct Needs {
    pub scan: bool,
    /// Name of a camera in the robot's file.
    pub camera: Option<&'static str>,
    pub network: bool,
    /// Its numbers are labels: a session's description has their names.
    pub labels: bool,
}

impl Entry {
    /// The numbers of all its terms in a list of their own.
    pub fn numbers(&self, view: &View<'_>, devices: &mut Devices) -> Result<Vec<f32>, SenseError> {
        let mut numbers = Vec::new();
        (self.compute)(view, devices, &mut Out::list(&mut numbers))?;
        Ok(numbers)
    }
}

impl Needs {
    pub const ROW: Self = Self { scan: false, camera: None, network: false, labels: false };
}

/// Runs that a run with a sensor may be compared with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Class {
    /// The benchmark's: what a robot could sense as well.
    Standard,
    /// The benchmark's: what no robot could sense.
    Privileged,
    /// Not a part of the benchmark: the lamp's place, which a map could give. Runs with it rank apart, with observations of the kind
    /// `goal`.
    Goal,
    /// Not a part of the benchmark. Runs with it rank apart, with observations of the kind `other`.
    Optional,
}

/// Work that a sensor is: by the costliest thing that it needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Cost {
    /// Read off the row: a few microseconds.
    Body,
    /// A scan of the LiDAR.
    Scan,
    /// The image of one camera.
    Image,
    /// A network's answer to an image.
    Network,
}

/// Settings on which the shapes of terms depend.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Setup {
    /// The task whose episode is sensed.
    pub task: Task,
    /// Whose criteria a verdict lists.
    pub protocol: Protocol,
    /// Sizes of the robot's lists.
    pub layout: RobotLayout,
    /// Width and height of the cameras' images, pixels.
    pub image_size: [usize; 2],
}

impl Setup {
    /// Of a scene's robot in a task by protocol `strict`, with images of the published size.
    pub fn new(scene: &Scene, task: Task) -> Self {
        Self { task, protocol: Protocol::default(), layout: scene.robot_layout(), image_size: [HEAD_PIXELS; 2] }
    }
}

/// A run of numbers of a sensor. Each is (measured + noise) x scale.
#[derive(Debug, Clone, PartialEq)]
pub struct Term {
    /// Name, also of its stream of noise.
    pub name: &'static str,
    /// Path of its field in an observation.
    pub field: &'static str,
    /// Its first number in that field.
    pub offset: usize,
    /// Extents, the slowest first; none for a single number.
    pub shape: Vec<usize>,
    /// Unit before scaling; empty for pure numbers.
    pub unit: &'static str,
    /// Least and greatest value, before scaling.
    pub range: [f64; 2],
    /// Factor that the number is multiplied by, after noise.
    pub scale: f64,
    /// Half-width of its uniform noise, in its unit; 0 for none.
    pub noise: f64,
    /// Meaning of the numbers, in their order.
    pub meaning: &'static str,
}

impl Term {
    /// A term of any size of number, without scaling and noise.
    pub(crate) fn new(
        name: &'static str,
        field: &'static str,
        shape: &[usize],
        unit: &'static str,
        meaning: &'static str,
    ) -> Self {
        Self {
            name,
            field,
            offset: 0,
            shape: shape.into(),
            unit,
            range: [f64::NEG_INFINITY, f64::INFINITY],
            scale: 1.0,
            noise: 0.0,
            meaning,
        }
    }

    /// The same with all numbers between two bounds.
    pub(crate) fn within(mut self, low: f64, high: f64) -> Self {
        self.range = [low, high];
        self
    }

    /// Count of its numbers.
    pub fn length(&self) -> usize {
        self.shape.iter().product()
    }

    /// True if the numbers are the bytes of a picture, from 0 to 255: height x width x 3, or height x width labels.
    pub fn is_picture(&self) -> bool {
        matches!(self.shape[..], [_, _, 3] | [_, _]) && self.range == [0.0, 255.0] && self.scale == 1.0
    }

    /// Count of the words of 4 bytes that it takes in an observation: one for each number, or for four bytes of a picture.
    pub fn words(&self) -> usize {
        if self.is_picture() { self.length().div_ceil(WORD) } else { self.length() }
    }
}

/// Bytes of a picture in a word of an observation.
const WORD: usize = size_of::<f32>();
