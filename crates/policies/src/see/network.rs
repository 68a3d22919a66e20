//! The network of a policy that sees: an encoder for each camera, and a head that reads what they made of a few pictures, new and old.

use std::path::Path;

use data_encoding::HEXLOWER;
use fiatlux_nets::{Convolution, Dense, Finish, LANES, MAX_KERNEL, Plane, Rounding, elu, largest_difference};
use fiatlux_rules::Task;
use fiatlux_safetensors::{File, SafetensorsError};
use serde::Deserialize;
use sha2::{Digest, Sha256};
use thiserror::Error;

use super::finds::{IN_ROOM, ON_LADDER};

/// Name and version of the contract's layout.
const FORMAT: &str = "fiatlux-see/1";
/// Under which name a file carries the contract.
const CONTRACT: &str = "contract";
/// Largest file, bytes.
const MAX_FILE_BYTES: u64 = 64 << 20;
/// Largest difference from what the network gave when it was exported: sums are rounded otherwise there.
const TOLERANCE: f32 = 2e-3;
/// Cameras that it may have.
pub(super) const CAMERAS: [&str; 2] = ["camera", "chest_camera"];
/// Numbers of the pelvis that it reads beside pictures: turning, gravity and velocity in the pelvis frame, and height.
const PELVIS: usize = 10;
/// Numbers that say where the robot was when it took an old picture.
const MOVED: usize = 4;
/// Numbers that come out first: vx, vy, m/s, wz, rad/s, and above 0 where it rather stands.
pub(super) const WALKS: usize = 4;
/// Those of a network that has hands come next: height, m, roll, pitch and yaw, rad; then the targets of arms and hands, rad.
pub(super) const POSTURE: usize = 4;
/// Times up to which the time in a phase is read, control steps: each becomes a number from 0 to 1.
const CLOCKS: [f32; 4] = [25.0, 75.0, 200.0, 500.0];
/// Most joints of a robot, most bodies of its hands, and most phases.
const MAX_PARTS: usize = 128;
/// Largest number of products in the convolutions of a picture, and of numbers between them: some 0.1 s of a core, and 64 MB.
const MAX_PRODUCTS: usize = 2_000_000_000;
const MAX_NUMBERS: usize = 16 << 20;
/// A byte of a picture counts as `(byte - CENTRE) / SPREAD`.
const CENTRE: f32 = 127.5;
const SPREAD: f32 = 64.0;

/// Why a file is not such a network.
#[derive(Debug, Error)]
#[allow(missing_docs)] // The messages name the fields.
pub enum SeeError {
    #[error("cannot read {path}")]
    Read { path: String, source: std::io::Error },
    #[error(transparent)]
    Format(#[from] SafetensorsError),
    #[error("the file has no contract; export a checkpoint with python -m fiatlux.dagger export")]
    NoContract,
    #[error("the contract is not one of {FORMAT}")]
    Contract(#[source] serde_json::Error),
    #[error("the contract's {field} is {found}; it must be {expected}")]
    Field { field: &'static str, found: String, expected: &'static str },
    #[error("a number of tensor {0} is not finite")]
    Number(String),
    #[error("the network gives other numbers than when it was exported (difference {0:.1e}); export it again")]
    Check(f32),
}

/// A file, as it describes itself.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct Contract {
    format: String,
    /// Short ids of the tasks that it was trained in.
    pub tasks: Vec<String>,
    /// Sensors, of [`CAMERAS`].
    pub cameras: Vec<String>,
    /// Width and height of a picture, pixels.
    pub picture: [usize; 2],
    /// Control steps from one decision to the next.
    pub every: u64,
    /// Ages of the pictures that it sees, control steps; the first is 0.
    pub ages: Vec<u64>,
    /// Output channels, window and stride of each convolution.
    convolutions: Vec<[usize; 3]>,
    /// Numbers that an encoder makes of a picture.
    embedding: usize,
    /// Widths of the head's layers.
    hidden: Vec<usize>,
    /// Of a network that has hands: all joints of the robot, whose angles it reads in each control step. It moves arms and hands.
    #[serde(default)]
    pub joints: Vec<String>,
    /// Bodies of the hands whose force it feels.
    #[serde(default)]
    pub touched: usize,
    /// Of a network that keeps in mind what it does: names of the phases. One number comes out for each; the largest chooses the phase, and
    /// the next decision reads which it was, and for how long.
    #[serde(default)]
    pub phases: Vec<String>,
    /// Of a network that says where things are: names of the numbers. One without phases says nothing else; of one with phases they come
    /// out last, and it does what it is to do in its other tasks.
    #[serde(default)]
    pub finds: Vec<String>,
}

impl Contract {
    /// Refuses sizes that the network cannot have.
    fn check(&self) -> Result<(), SeeError> {
        let refuse = |field, found: &dyn std::fmt::Debug, expected| {
            Err(SeeError::Field { field, found: format!("{found:?}"), expected })
        };
        if self.format != FORMAT {
            return refuse("format", &self.format, FORMAT);
        }
        if self.tasks.is_empty() || self.tasks().len() != self.tasks.len() {
            return refuse("tasks", &self.tasks, "a list of short ids, such as S05");
        }
        let known = |name: &String| CAMERAS.contains(&name.as_str());
        if self.cameras.is_empty() || self.cameras.len() > CAMERAS.len() || !self.cameras.iter().all(known) {
            return refuse("cameras", &self.cameras, "camera, chest_camera or both");
        }
        if !self.picture.iter().all(|side| (16..=256).contains(side)) {
            return refuse("picture", &self.picture, "a width and a height of 16 to 256 pixels");
        }
        if !(1..=50).contains(&self.every) {
            return refuse("every", &self.every, "1 to 50 control steps");
        }
        let rises = self.ages.windows(2).all(|pair| pair[0] < pair[1]);
        if self.ages.first() != Some(&0) || !rises || self.ages.len() > 8 || self.ages.iter().any(|age| *age > 1000) {
            return refuse("ages", &self.ages, "at most 8 rising numbers from 0 to 1000, the first of them 0");
        }
        let fits = |[outputs, kernel, stride]: &[usize; 3]| {
            (1..=512).contains(outputs)
                && outputs.is_multiple_of(LANES)
                && (1..=MAX_KERNEL).contains(kernel)
                && kernel % 2 == 1
                && (1..=2).contains(stride)
        };
        if !(1..=8).contains(&self.convolutions.len()) || !self.convolutions.iter().all(fits) {
            return refuse("convolutions", &self.convolutions, "1 to 8 of at most 512 channels, a multiple of 16");
        }
        let [products, numbers] = self.cost();
        if products > MAX_PRODUCTS || numbers > MAX_NUMBERS {
            return refuse(
                "convolutions",
                &self.convolutions,
                "at most 2e9 products and 16 million numbers in a picture",
            );
        }
        if !(1..=1024).contains(&self.embedding) {
            return refuse("embedding", &self.embedding, "1 to 1024");
        }
        if self.hidden.len() > 4 || !self.hidden.iter().all(|width| (1..=2048).contains(width)) {
            return refuse("hidden", &self.hidden, "at most 4 widths of 1 to 2048");
        }
        if !self.joints.is_empty() && !(fiatlux_wbc::BODY + 1..=MAX_PARTS).contains(&self.joints.len()) {
            return refuse("joints", &self.joints.len(), "none, or those of a robot with hands");
        }
        if self.touched > if self.joints.is_empty() { 0 } else { MAX_PARTS } {
            return refuse("touched", &self.touched, "0 without joints, at most 128 with them");
        }
        if self.phases.len() > MAX_PARTS {
            return refuse("phases", &self.phases.len(), "at most 128");
        }
        let is_known = self.finds == ON_LADDER || self.finds == IN_ROOM && !self.acts();
        if self.finds_place() && !is_known {
            return refuse(
                "finds",
                &self.finds,
                "none, or those of python -m fiatlux.dagger, of the room without phases",
            );
        }
        if !self.acts() && self.ages.len() > 1 {
            return refuse("ages", &self.ages, "0 alone, of a network that finds and does not act");
        }
        Ok(())
    }

    /// Products in the convolutions of a picture, and numbers between them.
    fn cost(&self) -> [usize; 2] {
        let [mut width, mut height] = self.picture;
        let (mut channels, mut products, mut numbers) = (3, 0, 0);
        for &[outputs, kernel, stride] in &self.convolutions {
            (width, height) = (width.div_ceil(stride), height.div_ceil(stride));
            products += width * height * outputs * kernel * kernel * channels;
            numbers += width * height * outputs;
            channels = outputs;
        }
        [products, numbers]
    }

    /// The tasks that are known.
    pub fn tasks(&self) -> Vec<Task> {
        let task = |name: &String| Task::ALL.into_iter().find(|task| task.short_id() == name);
        self.tasks.iter().filter_map(task).collect()
    }

    /// Numbers that the head reads beside embeddings.
    fn state(&self) -> usize {
        let sensed = PELVIS + self.joints.len() + self.touched;
        if !self.acts() {
            return sensed;
        }
        let clocks = if self.phases.is_empty() { 0 } else { CLOCKS.len() };
        let moved = MOVED * (self.ages.len() - 1);
        sensed + moved + self.phases.len() + clocks + self.tasks.len()
    }

    /// The numbers that the head of a network that acts reads beside embeddings: what the body senses, where the robot was at old pictures, the
    /// phase that it is in with the control steps since that began, and which of its tasks this is.
    pub fn reads(
        &self,
        sensed: &[f32],
        moved: impl Iterator<Item = f32>,
        (phase, steps): (Option<usize>, u64),
        task: usize,
    ) -> Vec<f32> {
        let tasks = (0..self.tasks.len()).map(|index| f32::from(u8::from(index == task)));
        sensed.iter().copied().chain(moved).chain(self.phase(phase, steps)).chain(tasks).collect()
    }

    /// Its inputs for the phase that it is in, if any, and for the control steps since that began.
    pub fn phase(&self, phase: Option<usize>, steps: u64) -> impl Iterator<Item = f32> {
        let phases = (0..self.phases.len()).map(move |index| f32::from(u8::from(phase == Some(index))));
        let clocks = if self.phases.is_empty() { &[][..] } else { &CLOCKS };
        let steps = if phase.is_some() { steps } else { 0 };
        phases.chain(clocks.iter().map(move |most| (steps as f32 / most).min(1.0)))
    }

    /// True if it says what to do.
    pub fn acts(&self) -> bool {
        !self.finds_place() || !self.phases.is_empty()
    }

    /// True if it moves arms and hands, too.
    pub fn has_hands(&self) -> bool {
        !self.joints.is_empty()
    }

    /// True if it says where the robot is in the room.
    pub fn finds_room(&self) -> bool {
        self.finds == IN_ROOM
    }

    /// True if it says where the robot is.
    pub fn finds_place(&self) -> bool {
        !self.finds.is_empty()
    }

    /// Numbers that come out.
    fn outputs(&self) -> usize {
        if !self.acts() {
            return self.finds.len();
        }
        let hands = if self.has_hands() { POSTURE + self.joints.len() - fiatlux_wbc::MOVED } else { 0 };
        WALKS + hands + self.phases.len() + self.finds.len()
    }
}

/// The encoder of a camera, and room for its images in between.
#[derive(Debug, Clone)]
struct Eye {
    layers: Vec<Convolution>,
    planes: Vec<Plane>,
    flat: Vec<f32>,
    last: Dense,
}

/// A network, ready to run.
#[derive(Debug, Clone)]
pub(super) struct Network {
    contract: Contract,
    digest: String,
    eyes: Vec<Eye>,
    head: Vec<Dense>,
    rows: [Vec<f32>; 2],
}

impl Network {
    /// Reads a file.
    ///
    /// # Errors
    /// It cannot be read, or see [`Network::from_bytes`].
    pub fn read(path: &Path) -> Result<Self, SeeError> {
        let bytes = fiatlux_files::read(path, MAX_FILE_BYTES)
            .map_err(|source| SeeError::Read { path: path.display().to_string(), source })?;
        Self::from_bytes(&bytes)
    }

    /// Reads a file from memory, and runs the network once on the input that the file has.
    ///
    /// # Errors
    /// A damaged file, sizes that do not fit, or numbers that are not finite.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, SeeError> {
        let file = File::parse(bytes)?;
        let contract = file.metadata(CONTRACT).ok_or(SeeError::NoContract)?;
        let contract: Contract = serde_json::from_str(contract).map_err(SeeError::Contract)?;
        contract.check()?;
        let eyes = contract.cameras.iter().map(|camera| Eye::read(&file, camera, &contract));
        let eyes = eyes.collect::<Result<Vec<_>, _>>()?;
        let inputs = contract.embedding * contract.cameras.len() * contract.ages.len() + contract.state();
        let sizes: Vec<usize> =
            std::iter::once(inputs).chain(contract.hidden.iter().copied()).chain([contract.outputs()]).collect();
        let layer = |(index, pair): (usize, &[usize])| dense(&file, &format!("head.{index}"), pair[0], pair[1]);
        let head = sizes.windows(2).enumerate().map(layer).collect::<Result<Vec<_>, _>>()?;
        let widest = sizes.iter().max().copied().unwrap_or_default();
        let digest = HEXLOWER.encode(&Sha256::digest(bytes));
        let mut network = Self { contract, digest, eyes, head, rows: [(); 2].map(|()| vec![0.0; widest]) };
        network.check(&file)?;
        Ok(network)
    }

    /// Runs the network on what the file has: a picture of each camera, which stands for all ages, and the other numbers.
    fn check(&mut self, file: &File<'_>) -> Result<(), SeeError> {
        let [width, height] = self.contract.picture;
        let mut seen = Vec::new();
        for camera in 0..self.contract.cameras.len() {
            let name = format!("check.{}", self.contract.cameras[camera]);
            let numbers = finite(file, &name, &[height, width, 3])?;
            let rgb: Vec<u8> = numbers.iter().map(|number| number.clamp(0.0, 255.0) as u8).collect();
            seen.extend(self.encode(camera, &rgb));
        }
        let state = finite(file, "check.state", &[self.contract.state()])?;
        let expected = finite(file, "check.output", &[self.contract.outputs()])?;
        let ages = vec![seen.as_slice(); self.contract.ages.len()];
        let found = self.decide(&ages, &state);
        match largest_difference(found, &expected) {
            difference if difference <= TOLERANCE => Ok(()),
            difference => Err(SeeError::Check(difference)),
        }
    }

    pub fn contract(&self) -> &Contract {
        &self.contract
    }

    /// SHA-256 of the file, hexadecimal.
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// The embedding of a camera's picture, which has the contract's size.
    pub fn encode(&mut self, camera: usize, rgb: &[u8]) -> Vec<f32> {
        self.eyes[camera].run(rgb)
    }

    /// Numbers that are found in pictures of now alone, in a task.
    pub fn find(&mut self, seen: &[f32], sensed: &[f32], task: usize) -> &[f32] {
        let contract = &self.contract;
        let (ages, found) = (contract.ages.len(), contract.outputs() - contract.finds.len());
        // Nothing has moved since old pictures: they are the same.
        let still = [0.0, 0.0, 1.0, 0.0].repeat(ages - 1).into_iter();
        let state = if contract.acts() { contract.reads(sensed, still, (None, 0), task) } else { sensed.to_vec() };
        &self.decide(&vec![seen; ages], &state)[found..]
    }

    /// Velocity ahead, to the left and about the vertical, whether to stand, what a network that has hands does with them, a number for
    /// each phase, and what is found, from the embeddings of each age (cameras one after the other) and the other numbers.
    pub fn decide(&mut self, ages: &[&[f32]], state: &[f32]) -> &[f32] {
        let [from, to] = &mut self.rows;
        let numbers = ages.iter().copied().flatten().chain(state);
        from.iter_mut().zip(numbers).for_each(|(place, number)| *place = *number);
        let last = self.head.len() - 1;
        for (index, layer) in self.head.iter().enumerate() {
            layer.run(Rounding::Separate, [&from[..]], [&mut to[..]]);
            if index < last {
                to[..layer.outputs()].iter_mut().for_each(|number| *number = elu(*number));
            }
            std::mem::swap(from, to);
        }
        &self.rows[0][..self.contract.outputs()]
    }
}

impl Eye {
    fn read(file: &File<'_>, camera: &str, contract: &Contract) -> Result<Self, SeeError> {
        let [mut width, mut height] = contract.picture;
        let mut channels = 3;
        let (mut layers, mut planes) = (Vec::new(), Vec::new());
        for (index, &[outputs, kernel, stride]) in contract.convolutions.iter().enumerate() {
            let name = format!("{camera}.{index}");
            let weights = finite(file, &format!("{name}.weight"), &[outputs, channels, kernel, kernel])?;
            let bias = finite(file, &format!("{name}.bias"), &[outputs])?;
            let weight =
                |o: usize, i: usize, y: usize, x: usize| weights[((o * channels + i) * kernel + y) * kernel + x];
            layers.push(Convolution::new(channels, kernel, stride, weight, bias));
            planes.push(Plane::new(height, width, channels, kernel / 2));
            (width, height, channels) = (width.div_ceil(stride), height.div_ceil(stride), outputs);
        }
        planes.push(Plane::new(height, width, channels, 0));
        let inputs = height * width * channels;
        let last = dense(file, &format!("{camera}.embedding"), inputs, contract.embedding)?;
        Ok(Self { layers, planes, flat: vec![0.0; inputs], last })
    }

    fn run(&mut self, rgb: &[u8]) -> Vec<f32> {
        let input = &mut self.planes[0];
        for (y, row) in rgb.chunks_exact(3 * input.width).enumerate() {
            let at = input.at(y, 0);
            for (number, byte) in input.data[at..].iter_mut().zip(row) {
                *number = (f32::from(*byte) - CENTRE) / SPREAD;
            }
        }
        for (index, layer) in self.layers.iter().enumerate() {
            let (before, after) = self.planes.split_at_mut(index + 1);
            layer.run_here(&before[index], &mut after[0], Finish::Relu);
        }
        let image = &self.planes[self.layers.len()];
        let row = image.width * image.channels;
        for (y, flat) in self.flat.chunks_exact_mut(row).enumerate() {
            let at = image.at(y, 0);
            flat.copy_from_slice(&image.data[at..at + row]);
        }
        let mut embedding = vec![0.0; self.last.outputs()];
        self.last.run(Rounding::Separate, [&self.flat], [&mut embedding]);
        embedding.iter_mut().for_each(|number| *number = elu(*number));
        embedding
    }
}

/// A layer whose tensors are `NAME.weight` and `NAME.bias`.
fn dense(file: &File<'_>, name: &str, inputs: usize, outputs: usize) -> Result<Dense, SeeError> {
    let weights = finite(file, &format!("{name}.weight"), &[outputs, inputs])?;
    let bias = finite(file, &format!("{name}.bias"), &[outputs])?;
    Ok(Dense::new(inputs, outputs, |i, o| weights[o * inputs + i], |o| bias[o]))
}

fn finite(file: &File<'_>, name: &str, shape: &[usize]) -> Result<Vec<f32>, SeeError> {
    let numbers = file.tensor(name, shape)?;
    match numbers.iter().all(|number| number.is_finite()) {
        true => Ok(numbers),
        false => Err(SeeError::Number(name.into())),
    }
}
