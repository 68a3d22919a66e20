//! Policies `gear` and `sonic`: whole-body controllers of others, from the user's ONNX files.

use std::path::Path;

use fiatlux_foreign::{
    FixedToken, GainsRule, Gear as GearController, HEIGHT, Model, Plant, Reading, RecordedTokens,
    Sonic as SonicController, TokenSource,
};
use fiatlux_proto::v3::{Observation, SessionInfo};

use super::body::{self, Senses};
use crate::{Command, Policy, PolicyError};

/// Words of `gear`, and of `sonic`.
const GEAR_FIELDS: &str = "reading, gains, vx, vy, wz, height, roll, pitch, yaw";
const SONIC_FIELDS: &str = "token, gains";

/// GEAR's decoupled controller on one command: it moves legs and waist; arms and hands keep the staged posture.
pub struct Gear {
    networks: [Model; 2],
    plant: Plant,
    reading: Reading,
    rule: GainsRule,
    command: fiatlux_wbc::Command,
    episode: Option<Episode<GearController>>,
}

/// The decoder of GEAR-SONIC on tokens: it moves legs, waist and arms; hands keep the staged posture.
pub struct Sonic {
    decoder: Model,
    plant: Plant,
    rule: GainsRule,
    tokens: Box<dyn TokenSource>,
    episode: Option<Episode<SonicController>>,
}

struct Episode<T> {
    controller: T,
    senses: Senses,
    /// Of all joints, rad.
    targets: Vec<f64>,
}

impl Gear {
    /// Reads `DIR[,reading=nvidia|lerobot][,vx=0.4,...][,gains=own|any]`. Left out, it stands at 0.74 m with the makers' reading
    /// and refuses other gains of legs and waist than its own.
    ///
    /// # Errors
    /// [`PolicyError::Words`], or networks that cannot be loaded.
    pub fn new(text: &str) -> Result<Self, PolicyError> {
        let (folder, rest) = text.split_once(',').unwrap_or((text, ""));
        let mut command = fiatlux_wbc::Command { height: HEIGHT, ..fiatlux_wbc::Command::default() };
        let (mut reading, mut rule) = (Reading::default(), GainsRule::default());
        for word in body::words(rest, GEAR_FIELDS) {
            let (word, name, value) = word?;
            let read = match name {
                "reading" => value.parse().ok().map(|value| reading = value),
                "gains" => value.parse().ok().map(|value| rule = value),
                _ => body::set(&mut command, name, value),
            };
            read.ok_or_else(|| PolicyError::Words { word: word.into(), fields: GEAR_FIELDS })?;
        }
        let networks = GearController::read(Path::new(folder))?;
        for network in &networks {
            tracing::info!("gear: a network of SHA-256 {}", network.digest());
        }
        Ok(Self { networks, plant: Plant::gear(reading)?, reading, rule, command, episode: None })
    }
}

impl Policy for Gear {
    fn name(&self) -> String {
        match self.reading {
            Reading::Nvidia => "gear".into(),
            Reading::Lerobot => "gear-lerobot".into(),
        }
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        let targets = body::staged("gear", info, first)?;
        let q0 = fit("gear", &self.plant, info, self.rule)?;
        let controller = GearController::new(&self.networks, self.reading, &q0)?;
        self.episode = Some(Episode { controller, senses: Senses::new("gear"), targets });
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let Episode { controller, senses, targets } =
            self.episode.as_mut().ok_or_else(|| PolicyError::not_reset("gear"))?;
        controller.step(&senses.read(observation)?, &self.command, targets)?;
        Ok(Command::JointTarget(targets.clone()))
    }
}

impl Sonic {
    /// Reads `DIR[,token=FILE][,gains=own|any]`. Without a file of tokens the token is zeros.
    ///
    /// # Errors
    /// [`PolicyError::Words`], or a network or tokens that cannot be loaded.
    pub fn new(text: &str) -> Result<Self, PolicyError> {
        let (folder, rest) = text.split_once(',').unwrap_or((text, ""));
        let (mut tokens, mut rule): (Box<dyn TokenSource>, _) = (Box::new(FixedToken::default()), GainsRule::default());
        for word in body::words(rest, SONIC_FIELDS) {
            let (word, name, value) = word?;
            let wrong = || PolicyError::Words { word: word.into(), fields: SONIC_FIELDS };
            match name {
                "token" => tokens = Box::new(RecordedTokens::read(Path::new(value))?),
                "gains" => rule = value.parse().map_err(|_| wrong())?,
                _ => return Err(wrong()),
            }
        }
        let decoder = SonicController::read(Path::new(folder))?;
        tracing::info!("sonic: a network of SHA-256 {}", decoder.digest());
        Ok(Self { decoder, plant: Plant::sonic()?, rule, tokens, episode: None })
    }
}

impl Policy for Sonic {
    fn name(&self) -> String {
        "sonic".into()
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        let targets = body::staged("sonic", info, first)?;
        let q0 = fit("sonic", &self.plant, info, self.rule)?;
        let controller = SonicController::new(&self.decoder, &q0)?;
        self.episode = Some(Episode { controller, senses: Senses::new("sonic"), targets });
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let Episode { controller, senses, targets } =
            self.episode.as_mut().ok_or_else(|| PolicyError::not_reset("sonic"))?;
        let token = self.tokens.token(observation.step)?;
        controller.step(&senses.read(observation)?, &token, targets)?;
        Ok(Command::JointTarget(targets.clone()))
    }
}

/// Compares a session with what a controller was made for, warns of what is allowed to differ, and returns the posture that
/// its positions are relative to, rad.
fn fit(policy: &str, plant: &Plant, info: &SessionInfo, rule: GainsRule) -> Result<Vec<f64>, PolicyError> {
    let joints = body::joints(info);
    if let Some(differs) = plant.fits(&joints, info.control_dt, rule)? {
        tracing::warn!("{policy}: gains differ from its own ({}): {differs}", plant.gains());
    }
    Ok(joints.iter().map(|joint| joint.q0).collect())
}
