//! Policies `gear` and `sonic`: foreign whole-body controllers from the user's ONNX files.

use std::path::Path;
use std::sync::LazyLock;

use fiatlux_foreign::{
    FixedToken, GainsRule, Gear as GearController, Model, Plant, Reading, RecordedTokens, Sonic as SonicController,
    Token, TokenSource,
};
use fiatlux_proto::v3::{Chunk, Observation, Sensor, SessionInfo};

use super::body::{self, Senses};
use super::body_motion::TrackedBody;
use super::whole_body::{UPRIGHT, WholeBody};
use fiatlux_client::{Command, Policy, PolicyError};

use crate::entry::Entry;

/// As a program makes it.
pub(crate) const GEAR: Entry = Entry {
    name: "gear:DIR",
    does: "GEAR's decoupled whole-body controller from the ONNX files in DIR, on one command: gear:DIR,vx=0.4; \
           reading=lerobot for the other reading of its sources, gains=any to play on other gains",
    make: |text| Ok(Box::new(Gear::new(text)?)),
};

/// As a program makes it.
pub(crate) const SONIC: Entry = Entry {
    name: "sonic:DIR",
    does: "the decoder of GEAR-SONIC from the ONNX file in DIR, on a recorded sequence of tokens: sonic:DIR,token=FILE; \
           or on a tracked body: sonic:DIR,stream=tcp://HOST:5556",
    make: |text| Ok(Box::new(Sonic::new(text)?)),
};

/// Words that each of `gear`, a carrier of a model's commands, and `sonic` accepts.
static GEAR_FIELDS: LazyLock<String> =
    LazyLock::new(|| format!("reading, gains, {}", fiatlux_wbc::BodyCommand::NAME_LIST));
const GEAR_FILE_FIELDS: &str = "reading, gains";
const SONIC_FIELDS: &str = "token, stream, gains";
const SONIC_FILE_FIELDS: &str = "gains";

/// GEAR's networks and how to read them, for any number of episodes.
#[derive(Debug)]
pub(super) struct GearFiles {
    networks: [Model; 2],
    plant: Plant,
    reading: Reading,
    rule: GainsRule,
}

impl GearFiles {
    /// Reads `DIR[,reading=nvidia|lerobot][,gains=own|any]`.
    ///
    /// # Errors
    /// [`PolicyError::Words`], or networks that cannot be loaded.
    pub fn open(text: &str) -> Result<Self, PolicyError> {
        Self::open_with(text, GEAR_FILE_FIELDS, |_, _| None)
    }

    /// As [`GearFiles::open`]; `other` takes further words, and returns whether it knows them.
    fn open_with(
        text: &str,
        fields: &'static str,
        mut other: impl FnMut(&str, &str) -> Option<()>,
    ) -> Result<Self, PolicyError> {
        let (folder, rest) = text.split_once(',').unwrap_or((text, ""));
        let (mut reading, mut rule) = (Reading::default(), GainsRule::default());
        for word in body::words(rest, fields) {
            let (word, name, value) = word?;
            let read = match name {
                "reading" => value.parse().ok().map(|value| reading = value),
                "gains" => value.parse().ok().map(|value| rule = value),
                _ => other(name, value),
            };
            read.ok_or_else(|| PolicyError::Words { word: word.into(), fields })?;
        }
        let networks = GearController::read(Path::new(folder)).map_err(PolicyError::of("gear"))?;
        for network in &networks {
            tracing::info!("gear: loaded a network with SHA-256 {}", network.digest());
        }
        Ok(Self { networks, plant: Plant::gear(reading).map_err(PolicyError::of("gear"))?, reading, rule })
    }

    /// Name of the controller in the record.
    pub fn name(&self) -> &'static str {
        match self.reading {
            Reading::Nvidia => "gear",
            Reading::Lerobot => "gear-lerobot",
        }
    }

    /// Makes the controller for an episode.
    ///
    /// # Errors
    /// The session does not fit, or a network cannot be prepared.
    pub fn controller(&self, policy: &'static str, info: &SessionInfo) -> Result<GearController, PolicyError> {
        let q0 = fit(policy, &self.plant, info, self.rule)?;
        GearController::new(&self.networks, self.reading, &q0).map_err(PolicyError::of("gear"))
    }
}

/// The decoder of GEAR-SONIC, for any number of episodes.
#[derive(Debug)]
pub(super) struct SonicFiles {
    decoder: Model,
    plant: Plant,
    rule: GainsRule,
}

impl SonicFiles {
    /// Name of the controller in the record.
    pub const NAME: &str = "sonic";

    /// Reads `DIR[,gains=own|any]`.
    ///
    /// # Errors
    /// [`PolicyError::Words`], or a network that cannot be loaded.
    pub fn open(text: &str) -> Result<Self, PolicyError> {
        Self::open_with(text, SONIC_FILE_FIELDS, |_, _| Ok(None))
    }

    /// As [`SonicFiles::open`]; `other` takes further words, and returns whether it knows them.
    fn open_with(
        text: &str,
        fields: &'static str,
        mut other: impl FnMut(&str, &str) -> Result<Option<()>, PolicyError>,
    ) -> Result<Self, PolicyError> {
        let (folder, rest) = text.split_once(',').unwrap_or((text, ""));
        let mut rule = GainsRule::default();
        for word in body::words(rest, fields) {
            let (word, name, value) = word?;
            let read = match name {
                "gains" => value.parse().ok().map(|value| rule = value),
                _ => other(name, value)?,
            };
            read.ok_or_else(|| PolicyError::Words { word: word.into(), fields })?;
        }
        let decoder = SonicController::read(Path::new(folder)).map_err(PolicyError::of("sonic"))?;
        tracing::info!("sonic: loaded a network with SHA-256 {}", decoder.digest());
        Ok(Self { decoder, plant: Plant::sonic().map_err(PolicyError::of("sonic"))?, rule })
    }

    /// Starts an episode with this decoder.
    ///
    /// # Errors
    /// The session does not fit or lacks a term, or a network cannot be prepared.
    pub fn begin(
        &self,
        policy: &'static str,
        info: &SessionInfo,
        first: &Observation,
    ) -> Result<SonicBody, PolicyError> {
        let targets = body::staged(policy, info, first)?;
        let q0 = fit(policy, &self.plant, info, self.rule)?;
        Ok(SonicBody {
            controller: SonicController::new(&self.decoder, &q0).map_err(PolicyError::of("sonic"))?,
            senses: Senses::new(policy),
            targets,
        })
    }
}

/// Legs, waist and arms follow the decoder; hands keep their targets.
pub(super) struct SonicBody {
    controller: SonicController,
    senses: Senses,
    /// Targets of all joints, rad.
    pub targets: Vec<f64>,
}

impl SonicBody {
    /// Answers an observation with the next command.
    ///
    /// # Errors
    /// The observation lacks a term or is not finite, the token is over its limit, or a network fails.
    pub fn step(&mut self, observation: &Observation, token: &Token) -> Result<Command, PolicyError> {
        self.controller
            .step(&self.senses.read(observation)?, token, &mut self.targets)
            .map_err(PolicyError::of("sonic"))?;
        Ok(Command::JointTarget(self.targets.clone()))
    }
}

/// GEAR's decoupled controller under a fixed command: it moves legs and waist; arms and hands keep the staged posture.
pub struct Gear {
    name: String,
    files: GearFiles,
    command: fiatlux_wbc::BodyCommand,
    body: Option<WholeBody>,
}

/// The decoder of GEAR-SONIC with a sequence of tokens or a tracked body: it moves legs, waist and arms; hands keep the staged
/// posture.
pub struct Sonic {
    name: String,
    files: SonicFiles,
    motion: Motion,
    body: Option<SonicBody>,
}

/// Where tokens come from.
enum Motion {
    Tokens(Box<dyn TokenSource>),
    Body(Box<TrackedBody>),
}

impl Gear {
    /// Parses `DIR[,reading=nvidia|lerobot][,vx=0.4,...][,gains=own|any]`. By default it stands at 0.74 m in the
    /// makers' reading, and refuses sessions with other gains of legs and waist.
    ///
    /// # Errors
    /// [`PolicyError::Words`], or networks that cannot be loaded.
    pub fn new(text: &str) -> Result<Self, PolicyError> {
        let mut command = UPRIGHT;
        let files = GearFiles::open_with(text, &GEAR_FIELDS, |name, value| body::set(&mut command, name, value))?;
        let [stands, walks] = &files.networks;
        let name = body::label("gear", text, &[stands.digest(), walks.digest()]);
        Ok(Self { name, files, command, body: None })
    }
}

impl Policy for Gear {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        self.body = Some(WholeBody::gear("gear", self.files.controller("gear", info)?, info, first)?);
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        self.body.as_mut().ok_or_else(|| PolicyError::not_reset("gear"))?.step(observation, &self.command)
    }

    fn source(&mut self) -> Option<Chunk> {
        self.body.as_mut()?.record()
    }
}

impl Sonic {
    /// Parses `DIR[,token=FILE|,stream=tcp://HOST:PORT][,gains=own|any]`. Without either every token is zeros. A stream is waited
    /// for.
    ///
    /// # Errors
    /// [`PolicyError::Words`], a network or tokens that cannot be loaded, or a stream that does not come.
    pub fn new(text: &str) -> Result<Self, PolicyError> {
        let mut motion = Motion::Tokens(Box::new(FixedToken::default()));
        let mut stream = None;
        let files = SonicFiles::open_with(text, SONIC_FIELDS, |name, value| {
            match name {
                "token" => {
                    let tokens = RecordedTokens::read(Path::new(value)).map_err(PolicyError::of("sonic"))?;
                    motion = Motion::Tokens(Box::new(tokens));
                }
                "stream" => stream = Some(value.to_owned()),
                _ => return Ok(None),
            }
            Ok(Some(()))
        })?;
        let mut digests = vec![files.decoder.digest().to_owned()];
        // Where the person sits is nobody else's business, and changes nothing.
        let mut shown = text.to_owned();
        if let Some(address) = stream {
            shown = shown.replacen(&format!("stream={address}"), "stream", 1);
            let folder = text.split_once(',').map_or(text, |(folder, _)| folder);
            let body = TrackedBody::open(&address, Path::new(folder))?;
            digests.extend(body.digest().map(str::to_owned));
            motion = Motion::Body(Box::new(body));
        }
        let digests: Vec<&str> = digests.iter().map(String::as_str).collect();
        Ok(Self { name: body::label("sonic", &shown, &digests), files, motion, body: None })
    }
}

impl Policy for Sonic {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn sensors(&self) -> Vec<Sensor> {
        match &self.motion {
            Motion::Tokens(_) => Vec::new(),
            Motion::Body(body) => body.sensors(),
        }
    }

    fn is_person(&self) -> bool {
        matches!(self.motion, Motion::Body(_))
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        if let Motion::Body(body) = &mut self.motion {
            body.reset();
        }
        self.body = Some(self.files.begin("sonic", info, first)?);
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let body = self.body.as_mut().ok_or_else(|| PolicyError::not_reset("sonic"))?;
        let token = match &mut self.motion {
            Motion::Tokens(tokens) => tokens.token(observation.step).map_err(PolicyError::of("sonic"))?,
            Motion::Body(tracked) => tracked.token(observation)?,
        };
        body.step(observation, &token)
    }
}

/// Compares a session with what a controller was made for, and warns of allowed differences. Returns the posture that
/// the session's positions are relative to, rad.
fn fit(policy: &'static str, plant: &Plant, info: &SessionInfo, rule: GainsRule) -> Result<Vec<f64>, PolicyError> {
    let joints = body::joints(info);
    if let Some(differs) = plant.fits(&joints, info.control_dt, rule).map_err(PolicyError::of(policy))? {
        let warning = format!("{policy}: gains differ from its own ({}): {differs}", plant.gains());
        if fiatlux_cli::is_news(&warning) {
            tracing::warn!("{warning}");
        }
    }
    Ok(joints.iter().map(|joint| joint.q0).collect())
}
