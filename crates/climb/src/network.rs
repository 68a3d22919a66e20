//! The network of a policy that follows a plan, and its contract.

use std::path::{Path, PathBuf};

use data_encoding::HEXLOWER;
use fiatlux_nets::{Dense, Rounding, elu, largest_difference};
use fiatlux_robot::{MOVED, Robot};
use fiatlux_safetensors::{File, SafetensorsError};
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use thiserror::Error;

use crate::LADDER;
use crate::tracker::{OBSERVATION, OBSERVED, Tracker};

/// Name and version of the contract's layout.
const FORMAT: &str = "fiatlux-climb/1";
/// Robots that a policy plays: the same legs, waist and arms, and hands that weigh the same.
const ROBOTS: [&str; 2] = ["g1_bare", Robot::NAMES[0]];
/// Largest difference from what the network gave when it was exported.
const TOLERANCE: f32 = 1e-4;
/// Largest file, bytes.
const MAX_FILE_BYTES: u64 = 128 << 20;
/// Largest layer.
const MAX_WIDTH: usize = 1 << 12;

/// Why a policy's file is refused.
#[derive(Debug, Error)]
pub enum NetworkError {
    /// The file cannot be read.
    #[error("cannot read the policy {}", path.display())]
    Read {
        /// As it was given.
        path: PathBuf,
        /// The system's error.
        #[source]
        source: std::io::Error,
    },
    /// The file is not a safetensors file, or lacks a tensor of its contract.
    #[error("the policy's file is damaged; export it again")]
    File(#[from] SafetensorsError),
    /// The file has no contract that can be read.
    #[error("the policy's file has no contract of this version; export it with this version")]
    Contract(#[source] Option<serde_json::Error>),
    /// It was made for something else.
    #[error("the policy was made for {what} {found}, and this is {expected}; train or export one for it")]
    Unfit {
        /// Which property differs.
        what: &'static str,
        /// The value in the contract.
        found: String,
        /// The value in this program.
        expected: String,
    },
    /// A tensor holds NaN or infinity.
    #[error("tensor '{0}' is not finite; the training has failed, choose another checkpoint")]
    Weights(String),
    /// The network does not give what it gave when it was exported.
    #[error("the network differs from its export by {0:.2e}; export it again with this version")]
    Check(f32),
    /// A robot of this program cannot be read.
    #[error(transparent)]
    Robot(#[from] fiatlux_robot::RobotError),
}

/// The version, robots and plan that a policy was made for; it stands in its file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Contract {
    /// Name and version of this layout.
    pub format: String,
    /// The benchmark version whose engine it was trained in.
    pub engine: String,
    /// Name and digest of the robots that it fits.
    pub robots: Vec<(String, String)>,
    /// SHA-256 of the plan, hexadecimal.
    pub plan: String,
    /// End of the part of the plan that it follows, s.
    pub until: f64,
    /// Parts of the observation: name, count.
    pub observation: Vec<(String, usize)>,
    /// Numbers into each layer of the network, and out of the last one.
    pub layers: Vec<usize>,
    /// Seed of networks and worlds.
    pub seed: u64,
    /// Control steps of all worlds together.
    pub samples: u64,
    /// Wall-clock time of the training, minutes.
    pub minutes: f64,
    /// Hardware of the training.
    pub hardware: String,
}

impl Contract {
    /// Of a policy trained with this version.
    ///
    /// # Errors
    /// A robot of this program that cannot be read.
    pub fn of_this_version(
        hidden: &[usize],
        until: f64,
        [seed, samples]: [u64; 2],
        minutes: f64,
        hardware: String,
    ) -> Result<Self, NetworkError> {
        let robots = ROBOTS.map(Robot::by_name).into_iter().collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            format: FORMAT.into(),
            engine: engine(),
            robots: robots.iter().map(|robot| (robot.name().into(), robot.digest().into())).collect(),
            plan: HEXLOWER.encode(&Sha256::digest(LADDER)),
            until,
            observation: OBSERVATION.map(|(name, count)| (name.to_owned(), count)).into(),
            layers: [OBSERVED].into_iter().chain(hidden.iter().copied()).chain([MOVED]).collect(),
            seed,
            samples,
            minutes,
            hardware,
        })
    }

    /// As JSON, as it is stored in the file.
    pub fn to_json(&self) -> String {
        serde_json::json!(self).to_string()
    }

    fn check(&self) -> Result<(), NetworkError> {
        let hidden = self.layers.get(1..self.layers.len().saturating_sub(1)).unwrap_or_default();
        let own = Self::of_this_version(hidden, self.until, [0; 2], 0.0, String::new())?;
        let unfit = |what, found: String, expected: String| match found == expected {
            true => Ok(()),
            false => Err(NetworkError::Unfit { what, found, expected }),
        };
        unfit("a contract of layout", self.format.clone(), own.format)?;
        unfit("engine", self.engine.clone(), own.engine)?;
        unfit("plan", self.plan.clone(), own.plan)?;
        unfit("robots", format!("{:?}", self.robots), format!("{:?}", own.robots))?;
        unfit("observations of", format!("{:?}", self.observation), format!("{:?}", own.observation))?;
        unfit("a network of", format!("{:?}", self.layers), format!("{:?}", own.layers))?;
        match hidden.iter().find(|size| !(1..=MAX_WIDTH).contains(*size)) {
            Some(size) => unfit("a hidden layer of", size.to_string(), format!("of 1 to {MAX_WIDTH}")),
            None => Ok(()),
        }
    }
}

/// This version's engine.
fn engine() -> String {
    format!("benchmark {}", fiatlux_rules::pins::ENGINE_VERSION)
}

/// A policy's network, ready to run.
#[derive(Debug, Clone)]
pub struct Network {
    contract: Contract,
    digest: String,
    layers: Vec<Dense>,
}

impl Network {
    /// Reads a policy's file.
    ///
    /// # Errors
    /// A file that cannot be read, or see [`Network::from_bytes`].
    pub fn read(path: &Path) -> Result<Self, NetworkError> {
        let bytes = fiatlux_files::read(path, MAX_FILE_BYTES)
            .map_err(|source| NetworkError::Read { path: path.into(), source })?;
        Self::from_bytes(&bytes)
    }

    /// Reads a policy's file from memory, and runs the network on the observation that the file has for a check.
    ///
    /// # Errors
    /// [`NetworkError`]: a damaged file, one of another engine or plan, or numbers that are not finite.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, NetworkError> {
        let file = File::parse(bytes)?;
        let text = file.metadata("contract").ok_or(NetworkError::Contract(None))?;
        let contract: Contract = serde_json::from_str(text).map_err(|error| NetworkError::Contract(Some(error)))?;
        contract.check()?;
        let mut layers = Vec::new();
        for (index, pair) in contract.layers.windows(2).enumerate() {
            let (inputs, outputs) = (pair[0], pair[1]);
            let weights = finite(&file, &format!("layer{index}.weight"), &[outputs, inputs])?;
            let biases = finite(&file, &format!("layer{index}.bias"), &[outputs])?;
            layers.push(Dense::new(inputs, outputs, |i, o| weights[o * inputs + i], |o| biases[o]));
        }
        let example = finite(&file, "check.observation", &[OBSERVED])?;
        let expected = finite(&file, "check.action", &[MOVED])?;
        let network = Self { contract, digest: HEXLOWER.encode(&Sha256::digest(bytes)), layers };
        let found = network.run(&example, &mut network.scratch());
        let difference = largest_difference(&found, &expected);
        match difference <= TOLERANCE {
            true => Ok(network),
            false => Err(NetworkError::Check(difference)),
        }
    }

    /// Its contract.
    pub fn contract(&self) -> &Contract {
        &self.contract
    }

    /// SHA-256 of the file, hexadecimal.
    pub fn digest(&self) -> &str {
        &self.digest
    }

    fn scratch(&self) -> [Vec<f32>; 2] {
        let widest = self.contract.layers.iter().max().copied().unwrap_or_default();
        [(); 2].map(|()| vec![0.0; widest])
    }

    fn run(&self, observation: &[f32], [from, to]: &mut [Vec<f32>; 2]) -> [f32; MOVED] {
        from[..observation.len()].copy_from_slice(observation);
        for (index, layer) in self.layers.iter().enumerate() {
            layer.run(Rounding::Separate, [from.as_slice()], [to.as_mut_slice()]);
            if index + 1 < self.layers.len() {
                to[..layer.outputs()].iter_mut().for_each(|number| *number = elu(*number));
            }
            std::mem::swap(from, to);
        }
        std::array::from_fn(|index| from[index])
    }
}

/// The numbers of a tensor, all finite.
fn finite(file: &File<'_>, name: &str, shape: &[usize]) -> Result<Vec<f32>, NetworkError> {
    let numbers = file.tensor(name, shape)?;
    match numbers.iter().all(|number| number.is_finite()) {
        true => Ok(numbers),
        false => Err(NetworkError::Weights(name.into())),
    }
}

/// Plays a network along its plan.
#[derive(Debug, Clone)]
pub struct Follower {
    network: std::sync::Arc<Network>,
    /// Place and speed on the plan.
    pub tracker: Tracker,
    observation: Vec<f32>,
    scratch: [Vec<f32>; 2],
}

impl Follower {
    /// At the start of the plan.
    pub fn new(network: std::sync::Arc<Network>, tracker: Tracker) -> Self {
        let scratch = network.scratch();
        Self { network, tracker, observation: vec![0.0; OBSERVED], scratch }
    }

    /// Writes the targets of legs, waist and arms, rad, which may lie beyond the joints' limits, from the pose of the pelvis in the
    /// plan's frame and from angles (rad) and speeds (rad/s) of all joints.
    pub fn step(&mut self, pelvis: &Isometry3<f64>, angles: &[f64], speeds: &[f64], targets: &mut [f64]) {
        self.tracker.see(pelvis, angles, speeds);
        self.tracker.observe(&mut self.observation);
        let action = self.network.run(&self.observation, &mut self.scratch);
        self.tracker.act(&action.map(f64::from), targets);
    }
}
