//! The policy `see` acts by what the robot senses itself. It walks, and works with its hands, with networks that learned from the expert
//! what to do where the cameras see this; and on the ladder it reckons where it is, and does there what the expert does.

mod bulb;
pub(crate) mod carry;
mod finds;
mod network;
mod on_ladder;
mod planar;
mod posture;
mod reckoning;
mod room;
mod shape;
#[cfg(test)]
mod tests;
mod tiles;

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;

use fiatlux_client::{Command, Policy, PolicyError};
use fiatlux_proto::v3::{Chunk, Image, Observation, Proprioception, Sensor, SessionInfo};
use fiatlux_rules::Task;
use fiatlux_wbc::{BodyCommand, CONTROL_DT};

use self::finds::Found;
use self::network::{CAMERAS, Contract, Network, POSTURE, WALKS};
use self::on_ladder::OnLadder;
use crate::body;
use crate::entry::Entry;
use crate::gait::{self, Gait};

/// As a program makes it.
pub(crate) const ENTRY: Entry = Entry {
    name: "see[:FILE]",
    does: "does all tasks but S01 by what the robot senses itself: cameras, LiDAR, hands and body; see:FILE acts with a network that \
           python -m fiatlux.dagger trained",
    make: |file| Ok(Box::new(See::new(file)?)),
};

/// The networks that come with this version, and what each plays; `weights/README.md` is their card.
const SHIPPED: [(&[u8], &[Task]); 4] = [
    (include_bytes!("../weights/walks.safetensors"), &[Task::S05, Task::S07]),
    (include_bytes!("../weights/ladder.safetensors"), &[Task::S09]),
    (include_bytes!("../weights/hands.safetensors"), &[Task::S06, Task::S08]),
    (include_bytes!("../weights/platform.safetensors"), &on_ladder::TASKS),
];
/// Scans of the LiDAR for tasks on the ladder, Hz: at 10 Hz one climb of three fell.
const SCANS_HZ: f64 = 25.0;
/// Ranges of the commanded velocity: ahead and to the left, m/s, and about the vertical, rad/s.
const RANGES: [[f64; 2]; 3] = [[-0.3, 0.6], [-0.35, 0.35], [-0.8, 0.8]];
/// A force on a body of a hand that counts as the largest, N.
const MAX_TOUCH_N: f32 = 20.0;
/// Tasks in which it walks alone, with arms and hands as they are.
const WALKED: [Task; 3] = [Task::S05, Task::S07, Task::S09];
/// Control steps of a second.
const HZ: f64 = 1.0 / CONTROL_DT;

/// Acts by pictures.
pub struct See {
    name: String,
    networks: Vec<Player>,
    /// Which of them plays.
    playing: usize,
    tasks: &'static [Task],
    body: Arc<fiatlux_wbc::Network>,
    episode: Option<Playing>,
}

/// The player of an episode.
enum Playing {
    /// A network says what to do.
    Acts(Box<Episode>),
    /// A network says where the robot is, in this one of its contract's tasks.
    OnLadder(Box<OnLadder>, usize),
}

/// A network, and the tasks that it plays.
struct Player {
    network: Network,
    tasks: Vec<Task>,
}

/// State of an episode.
struct Episode {
    gait: Gait,
    /// True if arms and hands stay as they are, and the network is asked where there are pictures alone.
    walks: bool,
    /// Which of the contract's tasks it is.
    task: usize,
    place: Place,
    /// Step of the last observation.
    last: Option<u64>,
    /// Frames that were seen, the newest last, as far back as the network looks.
    memory: VecDeque<Frame>,
    /// The last decision.
    command: BodyCommand,
    /// The phase that it chose last, and the step in which that began.
    phase: Option<usize>,
    since: u64,
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
    /// Reads its network from a file, or takes those that come with this version if the file's name is empty.
    ///
    /// # Errors
    /// A file that cannot be read, or that is not such a network.
    pub fn new(file: &str) -> Result<Self, PolicyError> {
        let shipped = file.is_empty();
        let of_version = |(bytes, tasks): (&[u8], &[Task])| {
            Network::from_bytes(bytes).map(|network| Player { network, tasks: tasks.to_vec() })
        };
        let networks: Result<Vec<_>, _> = match shipped {
            true => SHIPPED.into_iter().map(of_version).collect(),
            false => Network::read(Path::new(file)).map(|network| {
                let tasks = network.contract().tasks();
                vec![Player { network, tasks }]
            }),
        };
        let networks = networks.map_err(PolicyError::of("see"))?;
        if networks.iter().any(|player| player.network.contract().finds_room()) {
            let reason = format!("{file} finds the room, which carry:{file} plays by");
            return Err(PolicyError::Unfit { policy: "see", reason });
        }
        let (name, body) = body::network("see", "", "")?;
        let digests: Vec<&str> = networks.iter().map(|player| player.network.digest()).collect();
        let name = if shipped { name } else { body::label("see", file, &digests) };
        let is_known = |task: &Task| networks.iter().any(|player| player.tasks.contains(task));
        let tasks: Vec<Task> = Task::ALL.into_iter().filter(is_known).collect();
        // A policy's tasks are borrowed for as long as the program runs; a program makes few.
        let tasks = Box::leak(tasks.into_boxed_slice());
        Ok(Self { name, networks, playing: 0, tasks, body, episode: None })
    }

    /// Sensors and pictures are those of the first one: networks that come together have them in common.
    fn contract(&self) -> &Contract {
        self.networks[self.playing].network.contract()
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
        let rate_hz = HZ / self.contract().every as f64;
        let camera = |name: &String| Sensor { rate_hz, ..Sensor::from(name.as_str()) };
        let cameras = self.contract().cameras.iter().map(camera);
        let climbs = self.networks.iter().any(|player| player.network.contract().finds_place());
        let lidar = climbs.then(|| Sensor { rate_hz: SCANS_HZ, ..Sensor::from("lidar") });
        gait::SENSORS.into_iter().map(Sensor::from).chain(cameras).chain(lidar).collect()
    }

    fn image_size(&self) -> Option<[u32; 2]> {
        Some(self.contract().picture.map(|side| side as u32))
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        let task = info.task.as_ref().map(|task| task.task.as_str()).unwrap_or_default();
        let known = self.tasks.iter().copied().find(|known| known.short_id() == task);
        let plays = |task: Task| self.networks.iter().position(|player| player.tasks.contains(&task));
        let Some((playing, known)) = known.and_then(|known| Some((plays(known)?, known))) else {
            let known: Vec<&str> = self.tasks.iter().map(|task| task.short_id()).collect();
            let reason = format!("it learned {}, but this is {task}; use another policy", known.join(", "));
            return Err(PolicyError::Unfit { policy: "see", reason });
        };
        self.playing = playing;
        let contract = self.networks[playing].network.contract();
        for sensor in CAMERAS {
            let is_held = info.sensors.iter().any(|held| held.name == sensor);
            if contract.cameras.iter().any(|camera| camera == sensor) && !is_held {
                return Err(PolicyError::Sensor { policy: "see", sensor });
            }
        }
        let names = info.joints.iter().map(|joint| &joint.name);
        if contract.has_hands() && !names.eq(&contract.joints) {
            let reason = "it learned on a robot with other joints; use a network of this robot".into();
            return Err(PolicyError::Unfit { policy: "see", reason });
        }
        let of_network = contract.tasks.iter().position(|known| known == task).unwrap_or_default();
        if contract.finds_place() && (!contract.acts() || on_ladder::TASKS.contains(&known)) {
            self.episode = Some(Playing::OnLadder(Box::new(OnLadder::new(known, info, first)?), of_network));
            return Ok(());
        }
        let walks = !contract.has_hands() || WALKED.contains(&known);
        let gait = if walks { Gait::new } else { Gait::with_hands };
        self.episode = Some(Playing::Acts(Box::new(Episode {
            gait: gait("see", Arc::clone(&self.body), info, first)?,
            walks,
            task: of_network,
            place: Place::default(),
            last: None,
            memory: VecDeque::new(),
            command: BodyCommand::default(),
            phase: None,
            since: first.step,
        })));
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let playing = self.episode.as_mut().ok_or_else(|| PolicyError::not_reset("see"))?;
        let network = &mut self.networks[self.playing].network;
        let sensed = sensed(network.contract(), observation)?;
        let pictures = pictures(network.contract(), observation)?;
        let episode = match playing {
            Playing::Acts(episode) => episode,
            Playing::OnLadder(on_ladder, task) => {
                let find = || {
                    let seen = embedding(network, &pictures?);
                    Found::of(network.find(&seen, &sensed, *task))
                };
                return on_ladder.act(observation, find);
            }
        };
        episode.reckon(observation.step, &sensed);
        if let Some(pictures) = &pictures {
            episode.look(network, observation.step, pictures);
        }
        if pictures.is_some() || !episode.walks {
            episode.decide(network, observation.step, &sensed);
        }
        episode.gait.step(observation, episode.command)
    }

    fn source(&mut self) -> Option<Chunk> {
        match self.episode.as_mut()? {
            Playing::Acts(episode) => episode.gait.record(),
            Playing::OnLadder(on_ladder, _) => on_ladder.source(),
        }
    }
}

/// The senses of the body that the network reads: of the pelvis, in its frame, turning, rad/s, direction of gravity, velocity, m/s, and
/// height, m; and where it has hands, the angles of all joints, rad, and the forces on the bodies of its hands, N.
fn sensed(contract: &Contract, observation: &Observation) -> Result<Vec<f32>, PolicyError> {
    let missing = |sensor| PolicyError::Sensor { policy: "see", sensor };
    let body = observation.proprioception.as_ref().ok_or_else(|| missing("proprioception"))?;
    let Proprioception { base_angular_velocity, projected_gravity, base_linear_velocity, base_height, .. } = body;
    let vectors = [base_angular_velocity, projected_gravity, base_linear_velocity];
    if vectors.iter().any(|vector| vector.len() != 3) {
        return Err(missing("proprioception"));
    }
    let mut numbers: Vec<f32> = vectors.into_iter().flatten().copied().chain([*base_height]).collect();
    if contract.has_hands() {
        let forces = observation.hand_contact_force.as_chunks::<3>().0;
        if body.joint_position.len() != contract.joints.len() {
            return Err(missing("proprioception"));
        }
        let forces = if contract.touched == 0 { &[] } else { forces };
        if forces.len() != contract.touched {
            return Err(missing("hand_contact"));
        }
        let norm = |force: &[f32; 3]| force.iter().map(|part| part * part).sum::<f32>().sqrt().min(MAX_TOUCH_N);
        numbers.extend(body.joint_position.iter().copied().chain(forces.iter().map(norm)));
    }
    // Forces are clamped above, and a network need not read joints and forces.
    let rest = [&body.joint_position, &observation.last_action, &observation.hand_contact_force];
    if !numbers.iter().chain(rest.into_iter().flatten()).all(|number| number.is_finite()) {
        let reason = "the robot senses a number that is not finite".into();
        return Err(PolicyError::Unfit { policy: "see", reason });
    }
    Ok(numbers)
}

/// The numbers that encoders make of a picture of each camera.
fn embedding(network: &mut Network, pictures: &[&[u8]]) -> Vec<f32> {
    let seen = pictures.iter().enumerate();
    seen.flat_map(|(camera, rgb)| network.encode(camera, rgb)).collect()
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
    fn reckon(&mut self, step: u64, sensed: &[f32]) {
        let steps = step.saturating_sub(self.last.unwrap_or(step));
        let [turning, ahead, left] = [2, 6, 7].map(|index| f64::from(sensed[index]));
        self.place.step([ahead, left], turning, steps as f64 * CONTROL_DT);
        self.last = Some(step);
    }

    /// Keeps what the cameras see.
    fn look(&mut self, network: &mut Network, step: u64, pictures: &[&[u8]]) {
        let embedding = embedding(network, pictures);
        self.memory.push_back(Frame { step, place: self.place, embedding });
        let oldest = network.contract().ages.last().copied().unwrap_or_default();
        while self.memory.get(1).is_some_and(|frame| frame.step + oldest <= step) {
            self.memory.pop_front();
        }
    }

    /// Takes a decision; before the first picture, none.
    fn decide(&mut self, network: &mut Network, step: u64, sensed: &[f32]) {
        let newest_at = |age: u64| {
            let old = self.memory.iter().rev().find(|frame| frame.step + age <= step);
            old.or(self.memory.front())
        };
        let contract = network.contract();
        let frames: Vec<&Frame> = contract.ages.iter().filter_map(|age| newest_at(*age)).collect();
        if frames.is_empty() {
            return;
        }
        let moved = frames.iter().skip(1).flat_map(|frame| self.place.of(&frame.place));
        let state = contract.reads(sensed, moved, (self.phase, step.saturating_sub(self.since)), self.task);
        let ages: Vec<&[f32]> = frames.iter().map(|frame| frame.embedding.as_slice()).collect();
        let (has_hands, phases, found) = (contract.has_hands(), contract.phases.len(), contract.finds.len());
        let answer = network.decide(&ages, &state);
        let (moves, phases) = answer[..answer.len() - found].split_at(answer.len() - found - phases);
        let (walks, hands) = moves.split_at(WALKS);
        let within = |axis: usize| f64::from(walks[axis]).clamp(RANGES[axis][0], RANGES[axis][1]);
        self.command.velocity = if walks[WALKS - 1] > 0.0 { [0.0; 3] } else { [0, 1, 2].map(within) };
        // Its phases are those of its hands.
        if self.walks && has_hands {
            return;
        }
        let phase = phases.iter().enumerate().max_by(|one, other| one.1.total_cmp(other.1)).map(|(index, _)| index);
        if phase != self.phase {
            (self.phase, self.since) = (phase, step);
        }
        if let Some((&[height, roll, pitch, yaw], targets)) = hands.split_first_chunk::<POSTURE>() {
            self.command.height = f64::from(height);
            self.command.torso = [roll, pitch, yaw].map(f64::from);
            self.gait.moves(targets);
        }
    }
}
