//! The policy `see`: walks by what the cameras see, with a network that learned it from the expert.

mod network;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;

use fiatlux_client::{Command, Policy, PolicyError};
use fiatlux_proto::v3::{Chunk, Image, Observation, Proprioception, Sensor, SessionInfo};
use fiatlux_rules::Task;
use fiatlux_wbc::{BodyCommand, CONTROL_DT};

use self::network::{CAMERAS, Contract, Network};
use crate::body;
use crate::entry::Entry;
use crate::gait::{self, Gait};

/// As a program makes it.
pub(crate) const ENTRY: Entry = Entry {
    name: "see:FILE",
    does: "walks by what its cameras see, with a network that python -m fiatlux.dagger trained",
    make: |file| Ok(Box::new(See::new(file)?)),
};

/// Ranges of the commanded velocity: ahead and to the left, m/s, and about the vertical, rad/s.
const RANGES: [[f64; 2]; 3] = [[-0.3, 0.6], [-0.35, 0.35], [-0.8, 0.8]];
/// Control steps of a second.
const HZ: f64 = 1.0 / CONTROL_DT;

/// Walks to where its task ends, by pictures.
pub struct See {
    name: String,
    network: Network,
    tasks: &'static [Task],
    body: Arc<fiatlux_wbc::Network>,
    episode: Option<Episode>,
}

/// State of an episode.
struct Episode {
    gait: Gait,
    /// Which of the contract's tasks it is.
    task: usize,
    place: Place,
    /// Step of the last observation.
    last: Option<u64>,
    /// Frames that were seen, the newest last, as far back as the network looks.
    memory: VecDeque<Frame>,
    command: BodyCommand,
}

/// The pictures of a step, encoded, and where the robot was.
struct Frame {
    step: u64,
    place: Place,
    embedding: Vec<f32>,
}

/// Where the robot is by its own reckoning, from where it began: x, y, m, and heading, rad.
#[derive(Debug, Clone, Copy, Default)]
struct Place([f64; 3]);

impl Place {
    /// Goes on by a time in which the robot moved and turned at these rates in the pelvis frame.
    fn step(&mut self, velocity: [f64; 2], turning: f64, seconds: f64) {
        let (sin, cos) = (libm::sin(self.0[2]), libm::cos(self.0[2]));
        self.0[0] += (cos * velocity[0] - sin * velocity[1]) * seconds;
        self.0[1] += (sin * velocity[0] + cos * velocity[1]) * seconds;
        self.0[2] += turning * seconds;
    }

    /// Another place as seen from here: ahead and to the left, m, and the cosine and sine of its heading.
    fn of(&self, other: &Self) -> [f32; 4] {
        let (sin, cos) = (libm::sin(self.0[2]), libm::cos(self.0[2]));
        let [x, y, turn] = [0, 1, 2].map(|axis| other.0[axis] - self.0[axis]);
        [cos * x + sin * y, cos * y - sin * x, libm::cos(turn), libm::sin(turn)].map(|number| number as f32)
    }
}

impl See {
    /// Reads its network from a file.
    ///
    /// # Errors
    /// A file that cannot be read, or that is not such a network.
    pub fn new(file: &str) -> Result<Self, PolicyError> {
        let network = Network::read(Path::new(file)).map_err(PolicyError::of("see"))?;
        let (_, body) = body::network("see", "", "")?;
        let name = body::label("see", file, &[network.digest()]);
        // A policy's tasks are borrowed for as long as the program runs; a program makes few.
        let tasks = Box::leak(network.contract().tasks().into_boxed_slice());
        Ok(Self { name, network, tasks, body, episode: None })
    }
}

impl Policy for See {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn tasks(&self) -> &'static [Task] {
        self.tasks
    }

    fn sensors(&self) -> Vec<Sensor> {
        let rate_hz = HZ / self.network.contract().every as f64;
        let camera = |name: &String| Sensor { rate_hz, ..Sensor::from(name.as_str()) };
        let cameras = self.network.contract().cameras.iter().map(camera);
        gait::SENSORS.into_iter().map(Sensor::from).chain(cameras).collect()
    }

    fn image_size(&self) -> Option<[u32; 2]> {
        Some(self.network.contract().picture.map(|side| side as u32))
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        let contract = self.network.contract();
        for sensor in CAMERAS {
            let is_held = info.sensors.iter().any(|held| held.name == sensor);
            if contract.cameras.iter().any(|camera| camera == sensor) && !is_held {
                return Err(PolicyError::Sensor { policy: "see", sensor });
            }
        }
        let task = info.task.as_ref().map(|task| task.task.as_str()).unwrap_or_default();
        let Some(task) = contract.tasks.iter().position(|known| known == task) else {
            let reason = format!("it learned {}, but this is {task}; use another policy", contract.tasks.join(", "));
            return Err(PolicyError::Unfit { policy: "see", reason });
        };
        self.episode = Some(Episode {
            gait: Gait::new("see", Arc::clone(&self.body), info, first)?,
            task,
            place: Place::default(),
            last: None,
            memory: VecDeque::new(),
            command: BodyCommand::default(),
        });
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let episode = self.episode.as_mut().ok_or_else(|| PolicyError::not_reset("see"))?;
        let sensed = Sensed::read(observation)?;
        episode.reckon(observation.step, &sensed);
        if let Some(pictures) = pictures(self.network.contract(), observation)? {
            episode.decide(&mut self.network, observation.step, &pictures, &sensed);
        }
        episode.gait.step(observation, episode.command)
    }

    fn source(&mut self) -> Option<Chunk> {
        self.episode.as_mut()?.gait.record()
    }
}

/// The part of proprioception that the network reads, all in the pelvis frame: turning, rad/s, direction of gravity, velocity, m/s, and height, m.
struct Sensed([f32; 10]);

impl Sensed {
    fn read(observation: &Observation) -> Result<Self, PolicyError> {
        let missing = PolicyError::Sensor { policy: "see", sensor: "proprioception" };
        let Some(Proprioception {
            base_angular_velocity, projected_gravity, base_linear_velocity, base_height, ..
        }) = &observation.proprioception
        else {
            return Err(missing);
        };
        let vectors = [base_angular_velocity, projected_gravity, base_linear_velocity];
        let numbers: Vec<f32> = vectors.into_iter().flatten().copied().chain([*base_height]).collect();
        numbers.try_into().map(Self).map_err(|_| missing)
    }
}

/// Pictures of all cameras; `None` at a step that lacks one.
fn pictures<'a>(contract: &Contract, observation: &'a Observation) -> Result<Option<Vec<&'a [u8]>>, PolicyError> {
    let mut found = Vec::new();
    for camera in &contract.cameras {
        let image = if camera == CAMERAS[0] { &observation.camera } else { &observation.chest_camera };
        let Some(Image { width, height, rgb }) = image else { return Ok(None) };
        let [wide, high] = contract.picture;
        if [*width as usize, *height as usize] != [wide, high] || rgb.len() != 3 * wide * high {
            let reason = format!("a picture of {camera} has {width} x {height} pixels instead of {wide} x {high}");
            return Err(PolicyError::Unfit { policy: "see", reason });
        }
        found.push(rgb.as_ref());
    }
    Ok(Some(found))
}

impl Episode {
    /// Keeps count of where the robot is.
    fn reckon(&mut self, step: u64, Sensed(sensed): &Sensed) {
        let steps = step.saturating_sub(self.last.unwrap_or(step));
        let [_, _, turning, _, _, _, ahead, left, ..] = sensed.map(f64::from);
        self.place.step([ahead, left], turning, steps as f64 * CONTROL_DT);
        self.last = Some(step);
    }

    /// Takes a decision.
    fn decide(&mut self, network: &mut Network, step: u64, pictures: &[&[u8]], Sensed(sensed): &Sensed) {
        let seen = pictures.iter().enumerate();
        let embedding = seen.flat_map(|(camera, rgb)| network.encode(camera, rgb)).collect();
        self.memory.push_back(Frame { step, place: self.place, embedding });
        let contract = network.contract();
        let oldest = contract.ages.last().copied().unwrap_or_default();
        while self.memory.get(1).is_some_and(|frame| frame.step + oldest <= step) {
            self.memory.pop_front();
        }
        let newest_at = |age: u64| {
            let old = self.memory.iter().rev().find(|frame| frame.step + age <= step);
            old.or(self.memory.front())
        };
        let frames: Vec<&Frame> = contract.ages.iter().filter_map(|age| newest_at(*age)).collect();
        let moved = frames.iter().skip(1).flat_map(|frame| self.place.of(&frame.place));
        let tasks = (0..contract.tasks.len()).map(|task| f32::from(u8::from(task == self.task)));
        let state: Vec<f32> = sensed.iter().copied().chain(moved).chain(tasks).collect();
        let ages: Vec<&[f32]> = frames.iter().map(|frame| frame.embedding.as_slice()).collect();
        let [ahead, left, turning, stands] = network.decide(&ages, &state);
        let velocity = [ahead, left, turning].map(f64::from);
        let within = |axis: usize| velocity[axis].clamp(RANGES[axis][0], RANGES[axis][1]);
        self.command.velocity = if stands > 0.0 { [0.0; 3] } else { [0, 1, 2].map(within) };
    }
}
