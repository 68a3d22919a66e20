//! The policy `vla`, which plays the chunks of a model server.

mod args;
mod asking;
mod probe;

use std::sync::Arc;
use std::time::Duration;

use fiatlux_bridge::{
    BridgeError, Frames, Mapping, ModelChunk, ModelObservation, ModelOptions, Picture, Play, PlayedRow, Player, Row,
    Sensed, check_contract,
};
use fiatlux_foreign::{BODY, token_of};
use fiatlux_proto::limits::{MAX_CHUNK_KEYS, MAX_CHUNK_NUMBERS, MAX_CHUNK_PROBLEM};
use fiatlux_proto::v3::{Chunk, Image, Mode, Observation, Sensor, SessionInfo};
use fiatlux_robot::Robot;
use fiatlux_wbc::{CONTROL_DT, MOVED, Network};

use self::asking::{ModelClient, TimedChunk};
use super::body;
use super::foreign::{GearFiles, SonicBody, SonicFiles};
use super::whole_body::WholeBody;
pub use args::VlaArgs;
use fiatlux_client::{Command, Policy, PolicyError};

use crate::entry::Entry;
pub use probe::{Answer, ProbeReport};

/// As a program makes it.
pub(crate) const ENTRY: Entry = Entry {
    name: "vla",
    does: "plays the chunks of a model server: --dialect and --model say which, --map what its keys are on this robot",
    make: |_| {
        let reason = "it needs a model server; give --dialect and --model".into();
        Err(PolicyError::Unfit { policy: "vla", reason })
    },
};

/// Rate of cameras and LiDAR in a real-time session's observations, Hz; a look would come too late there.
const REAL_TIME_HZ: f64 = 10.0;

/// A model server with its mapping, checked against each other once; makes a policy for each episode.
#[derive(Debug, Clone)]
pub struct VlaSource(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    options: ModelOptions,
    mapping: Mapping,
    play: Play,
    robot: Robot,
    /// Controller that moves the body; `None` if the model does it alone, or outputs tokens and no decoder is given.
    carrier: Option<Carrier>,
    /// Time for which a server that is gone is tried again.
    patience: Duration,
    /// Longest wait for the answer to the first question; zero if none is asked.
    warm_up: Duration,
    is_real_time: bool,
}

/// The controller that carries out the model's commands or tokens.
#[derive(Debug)]
enum Carrier {
    /// Our own controller, which follows commands.
    Own(Arc<Network>),
    /// GEAR's controller, which follows commands.
    Gear(GearFiles),
    /// GEAR-SONIC's decoder, which follows motion tokens.
    Sonic(SonicFiles),
}

impl Shared {
    /// Refuses motion tokens without a decoder.
    fn check_decoder(&self) -> Result<(), BridgeError> {
        match (self.mapping.token(), &self.carrier) {
            (Some((key, width)), None) => {
                Err(BridgeError::NoDecoder { mapping: self.mapping.name.clone(), key: key.into(), width })
            }
            _ => Ok(()),
        }
    }

    /// Refuses a session without the pictures, forces or scans that the model gets, or with a LiDAR of another sight.
    fn check_senses(&self, info: &SessionInfo) -> Result<(), PolicyError> {
        let mapping = &self.mapping;
        let seen = |camera: &'static str| (camera, mapping.sensors().contains(&camera));
        let needs = [
            seen("camera"),
            seen("chest_camera"),
            ("hand_contact", mapping.has_contact()),
            ("lidar", mapping.has_lidar()),
        ];
        for (sensor, _) in needs.into_iter().filter(|(_, needed)| *needed) {
            let held = info.sensors.iter().find(|held| held.name == sensor);
            let held = held.ok_or(PolicyError::Sensor { policy: "vla", sensor })?;
            if sensor == "lidar" && held.see_room != mapping.lidar_sees_room {
                let sight = if mapping.lidar_sees_room { "lidar+room" } else { "lidar" };
                let reason = format!("the mapping needs {sight}; leave --sensors out, or name {sight} there");
                return Err(PolicyError::Unfit { policy: "vla", reason });
            }
        }
        Ok(())
    }

    /// A body as the mapping wants it.
    fn body(&self, body: WholeBody, info: &SessionInfo) -> Result<Driven, PolicyError> {
        let body = if self.mapping.hold_arms { body.holding_arms(info)? } else { body };
        let body = if self.mapping.bend_low { body.bending_low() } else { body };
        Ok(Driven::Body(Box::new(body)))
    }

    /// The rows of a chunk, with all tokens within their limits. `q` are the joint angles at the question, rad.
    fn rows(&self, q: &[f64], chunk: &ModelChunk) -> Result<Vec<Row>, BridgeError> {
        let rows = self.mapping.rows(&self.robot, q, chunk)?;
        if let Some((key, _)) = self.mapping.token() {
            for (at, row) in rows.iter().enumerate() {
                token_of(&row.token).map_err(|error| BridgeError::Malformed {
                    what: format!("the action '{key}'"),
                    problem: format!("row {at}: {error}"),
                })?;
            }
        }
        Ok(rows)
    }
}

impl VlaSource {
    /// Requests the server's contract and compares it with the mapping; then asks a first question, so that no episode
    /// waits for a server that compiles.
    ///
    /// # Errors
    /// [`BridgeError`]: nobody answers, contract or answer do not fit, or motion tokens have no decoder.
    fn check(&self) -> Result<(), BridgeError> {
        let shared = &self.0;
        shared.check_decoder()?;
        let contract = shared.options.model()?.contract()?;
        check_contract(&shared.mapping, &contract)?;
        if !shared.warm_up.is_zero() {
            let (chunk, _) = self.warm_up(&self.example()?)?;
            shared.rows(shared.robot.q0(), &chunk)?;
        }
        Ok(())
    }

    /// A policy for one episode; it connects when the episode begins.
    pub fn policy(&self) -> Vla {
        Vla { shared: Arc::clone(&self.0), episode: None }
    }
}

/// Plays a model's chunks in one episode.
pub struct Vla {
    shared: Arc<Shared>,
    episode: Option<Episode>,
}

struct Episode {
    client: ModelClient,
    player: Player,
    frames: Frames,
    /// The newest scan of the LiDAR, m; empty before the first.
    lidar: Vec<f32>,
    q0: Vec<f64>,
    instruction: String,
    session: String,
    is_real_time: bool,
    robot: Driven,
    /// Notes for the record of the next action.
    note: Note,
    /// Why the policy fails at the next step; the record states it first.
    end: Option<BridgeError>,
}

/// The joints that the model moves, directly or through a controller.
enum Driven {
    /// Arms and hands directly, legs and waist by commands.
    Body(Box<WholeBody>),
    /// Hands directly, the rest by motion tokens.
    Tokens(Box<SonicBody>),
    /// Every joint directly; holds their targets, rad.
    Joints(Vec<f64>),
}

/// Notes for the record.
#[derive(Debug, Default)]
struct Note {
    /// A chunk that has just arrived.
    chunk: Option<ModelChunk>,
    latency_s: f64,
    server_s: Option<f64>,
    problem: String,
    played: Option<(u64, usize, u64)>,
}

impl Policy for Vla {
    fn name(&self) -> String {
        let name = format!("vla:{}:{}", self.shared.options.dialect.name(), self.shared.mapping.label());
        match &self.shared.carrier {
            None | Some(Carrier::Own(_)) => name,
            Some(Carrier::Gear(files)) => format!("{name}:{}", files.name()),
            Some(Carrier::Sonic(_)) => format!("{name}:{}", SonicFiles::NAME),
        }
    }

    fn sensors(&self) -> Vec<Sensor> {
        let own = ["proprioception", "hand_contact", "last_action"].map(Sensor::from);
        let mapping = &self.shared.mapping;
        let large = |name: &str| match self.shared.is_real_time {
            true => Sensor { rate_hz: REAL_TIME_HZ, ..Sensor::from(name) },
            false => Sensor { on_request: true, ..Sensor::from(name) },
        };
        let lidar = mapping.has_lidar().then(|| Sensor { see_room: mapping.lidar_sees_room, ..large("lidar") });
        own.into_iter().chain(mapping.sensors().into_iter().map(large)).chain(lidar).collect()
    }

    fn image_size(&self) -> Option<[u32; 2]> {
        (!self.shared.mapping.sensors().is_empty()).then_some(self.shared.mapping.picture)
    }

    fn look(&mut self, observation: &Observation) -> Vec<&'static str> {
        let (Some(episode), mapping) = (&self.episode, &self.shared.mapping) else { return Vec::new() };
        if episode.is_real_time || episode.end.is_some() {
            return Vec::new();
        }
        let is_seen = episode.needs_picture(mapping, observation.step);
        let scan = (mapping.has_lidar() && episode.player.wants(observation.step)).then_some("lidar");
        let has = |name: &&str| is_seen && mapping.sensors().contains(name);
        ["camera", "chest_camera"].into_iter().filter(has).chain(scan).collect()
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        let shared = &self.shared;
        let unfit = |reason: String| PolicyError::Unfit { policy: "vla", reason };
        let names = info.joints.iter().map(|joint| joint.name.as_str());
        if !names.eq(shared.robot.joints().iter().map(|joint| joint.name.as_str())) {
            return Err(unfit(format!(
                "the mapping was read for {0}, but the session has another robot; open it with --robot {0}",
                shared.robot.name()
            )));
        }
        shared.check_senses(info)?;
        shared.check_decoder().map_err(PolicyError::of("vla"))?;
        let robot = match &shared.carrier {
            None => Driven::Joints(body::staged("vla", info, first)?),
            Some(Carrier::Own(network)) => {
                shared.body(WholeBody::own("vla", Arc::clone(network), info, first)?, info)?
            }
            Some(Carrier::Gear(files)) => {
                let controller = files.controller("vla", info)?;
                shared.body(WholeBody::gear("vla", controller, info, first)?, info)?
            }
            Some(Carrier::Sonic(files)) => Driven::Tokens(Box::new(files.begin("vla", info, first)?)),
        };
        let client = ModelClient::new(shared.options.model().map_err(PolicyError::of("vla"))?, shared.patience);
        let mut episode = Episode {
            client,
            player: Player::new(shared.play),
            frames: Frames::default(),
            lidar: Vec::new(),
            robot,
            q0: info.joints.iter().map(|joint| joint.q0).collect(),
            instruction: info.task.as_ref().map(|task| task.instruction.clone()).unwrap_or_default(),
            session: format!("{}-{}", info.session, first.episode),
            is_real_time: info.mode() == Mode::RealTime,
            note: Note::default(),
            end: None,
        };
        episode.client.reset().map_err(PolicyError::of("vla"))?;
        self.episode = Some(episode);
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let episode = self.episode.as_mut().ok_or_else(|| PolicyError::not_reset("vla"))?;
        if let Some(error) = episode.end.take() {
            return Err(PolicyError::of("vla")(error));
        }
        episode.note = Note::default();
        episode.see(&self.shared.mapping, observation).map_err(PolicyError::of("vla"))?;
        let step = observation.step;
        let asked = match episode.is_real_time {
            true => episode.ask_meanwhile(&self.shared, observation),
            false => episode.ask_now(&self.shared, observation),
        };
        match asked {
            Ok(()) => {}
            // Nothing has moved, so there is nothing to record.
            Err(error) if episode.player.row(step).is_none() => return Err(PolicyError::of("vla")(error)),
            Err(error) => {
                episode.note.problem = format!("the policy cannot go on: {error}");
                episode.end = Some(error);
            }
        }
        let played = episode.player.row(step);
        episode.play(observation, played)
    }

    fn source(&mut self) -> Option<Chunk> {
        self.episode.as_mut()?.note.record()
    }
}

impl Episode {
    /// True if a question is asked at this step, or a later question needs this step's picture.
    fn needs_picture(&self, mapping: &Mapping, step: u64) -> bool {
        mapping.lookbacks().iter().any(|back| self.player.asks_after(step, *back))
    }

    /// Keeps the pictures and the scan of an observation.
    fn see(&mut self, mapping: &Mapping, observation: &Observation) -> Result<(), BridgeError> {
        if mapping.has_lidar() && !observation.lidar.is_empty() {
            self.lidar.clone_from(&observation.lidar);
        }
        let images = [("camera", &observation.camera), ("chest_camera", &observation.chest_camera)];
        for (sensor, image) in images {
            if let Some(Image { width, height, rgb }) = image {
                self.frames.push(mapping, observation.step, sensor, Picture::new(*width, *height, rgb.clone())?);
            }
        }
        Ok(())
    }

    /// The observation for the model, and the joint angles in it, rad.
    fn observe(&self, shared: &Shared, seen: &Observation) -> Result<(ModelObservation, Vec<f64>), BridgeError> {
        let remedy = "leave --sensors out, or name proprioception there";
        let missing = || BridgeError::Sensed { what: "proprioception".into(), remedy };
        let body = seen.proprioception.as_ref().ok_or_else(missing)?;
        let q: Vec<f64> =
            self.q0.iter().zip(&body.joint_position).map(|(q0, turned)| q0 + f64::from(*turned)).collect();
        let velocity: Vec<f64> = body.joint_velocity.iter().map(|velocity| f64::from(*velocity)).collect();
        let vector = |term: &[f32]| <[f32; 3]>::try_from(term).map(|term| term.map(f64::from)).map_err(|_| missing());
        let sensed = Sensed {
            joint_position: &q,
            joint_velocity: &velocity,
            base_angular_velocity: vector(&body.base_angular_velocity)?,
            base_linear_velocity: vector(&body.base_linear_velocity)?,
            projected_gravity: vector(&body.projected_gravity)?,
            base_height: f64::from(body.base_height),
            hand_contact_force: &seen.hand_contact_force,
            lidar: &self.lidar,
        };
        let (instruction, session) = (&self.instruction, &self.session);
        let observation =
            shared.mapping.observe(&shared.robot, &sensed, &self.frames, seen.step, instruction, session)?;
        Ok((observation, q))
    }

    /// In lockstep: when the prefix has been played, the simulation waits for the next chunk.
    fn ask_now(&mut self, shared: &Shared, seen: &Observation) -> Result<(), BridgeError> {
        if !self.player.wants(seen.step) {
            return Ok(());
        }
        let (observation, q) = self.observe(shared, seen)?;
        let answer = self.client.ask(&observation);
        self.note.problem = self.client.problem().unwrap_or_default();
        self.take(shared, answer?, &q, seen.step, seen.step)
    }

    /// In real time: a thread asks the server, and the current chunk continues until the answer arrives.
    fn ask_meanwhile(&mut self, shared: &Shared, seen: &Observation) -> Result<(), BridgeError> {
        if let Some((asked_at, q, answer)) = self.client.answer() {
            self.note.problem = self.client.problem().unwrap_or_default();
            self.take(shared, answer?, &q, asked_at, seen.step)?;
        }
        if self.player.wants_by(seen.step, self.client.usual_steps()) && !self.client.is_asking() {
            let (observation, q) = self.observe(shared, seen)?;
            self.client.ask_meanwhile(observation, seen.step, q);
        }
        Ok(())
    }

    fn take(
        &mut self,
        shared: &Shared,
        answer: TimedChunk,
        q: &[f64],
        asked: u64,
        now: u64,
    ) -> Result<(), BridgeError> {
        let rows = shared.rows(q, &answer.chunk)?;
        self.player.take(rows, asked, now)?;
        self.note.latency_s = answer.latency.as_secs_f64();
        self.note.server_s = answer.chunk.server_s;
        self.note.chunk = Some(answer.chunk);
        Ok(())
    }

    /// The command of a step. Before the first chunk, and after the last row of a chunk, the body stands and the arms
    /// hold their targets. The last token is kept; before the first one, the posture is.
    fn play(&mut self, seen: &Observation, played: Option<PlayedRow>) -> Result<Command, PolicyError> {
        if let Some(played) = &played {
            self.note.played = Some((played.chunk, played.at, played.age));
        }
        let held = Row::default();
        let (row, is_over) = played.as_ref().map_or((&held, true), |played| (&played.row, played.is_over));
        match &mut self.robot {
            Driven::Body(body) => {
                let mut command = body.upright();
                if let Some(velocity) = row.velocity.filter(|_| !is_over) {
                    command.velocity = velocity;
                }
                command.height = row.height.unwrap_or(command.height);
                command.torso = row.torso.unwrap_or(command.torso);
                put(&mut body.targets, row, MOVED);
                body.step(seen, &command)
            }
            Driven::Tokens(body) => {
                put(&mut body.targets, row, BODY);
                match row.token.is_empty() {
                    true => Ok(Command::JointTarget(body.targets.clone())),
                    false => body.step(seen, &token_of(&row.token).map_err(PolicyError::of("vla"))?),
                }
            }
            Driven::Joints(targets) => {
                put(targets, row, 0);
                Ok(Command::JointTarget(targets.clone()))
            }
        }
    }
}

/// Copies a row's targets for joints from `from` on; a controller moves those before it.
fn put(targets: &mut [f64], row: &Row, from: usize) {
    let own = row.targets.iter().filter(|(joint, _)| *joint >= from);
    own.for_each(|(joint, target)| targets[*joint] = *target);
}

impl Note {
    /// The message for the record. A chunk that is too large is recorded without its numbers.
    fn record(&mut self) -> Option<Chunk> {
        let Self { chunk, latency_s, server_s, problem, played } = std::mem::take(self);
        if played.is_none() && problem.is_empty() {
            return None;
        }
        let (index, row, age) = played.unwrap_or_default();
        let mut record = Chunk {
            index,
            row: u32::try_from(row).unwrap_or(u32::MAX),
            age_s: age as f64 * CONTROL_DT,
            latency_s,
            server_s,
            problem: cut(&problem, MAX_CHUNK_PROBLEM),
            ..Chunk::default()
        };
        let Some(ModelChunk { rows, parts, .. }) = chunk else { return Some(record) };
        let width: usize = parts.iter().map(|(_, width, _)| width).sum();
        let [most_keys, longest_key] = MAX_CHUNK_KEYS;
        if rows * width <= MAX_CHUNK_NUMBERS && parts.len() <= most_keys {
            let row_of =
                |row: usize| parts.iter().flat_map(move |(_, width, all)| &all[row * width..(row + 1) * width]);
            record.values = (0..rows).flat_map(row_of).map(|number| *number as f32).collect();
            record.width = u32::try_from(width).unwrap_or(0);
            record.keys = parts.iter().map(|(key, width, _)| cut(&format!("{key}:{width}"), longest_key)).collect();
        }
        // Some f64 values are out of range for f32.
        if record.values.iter().any(|number| !number.is_finite()) {
            (record.values, record.width, record.keys) = (Vec::new(), 0, Vec::new());
        }
        Some(record)
    }
}

/// The beginning of a text, at most `most` bytes.
fn cut(text: &str, most: usize) -> String {
    let end = (0..=most.min(text.len())).rev().find(|end| text.is_char_boundary(*end)).unwrap_or(0);
    text[..end].into()
}

#[cfg(test)]
mod tests;
