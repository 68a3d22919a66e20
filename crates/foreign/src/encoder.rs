//! The encoder of GEAR-SONIC: turns the motion of a tracked body into tokens for its decoder.

use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::model::Runner;
use crate::{ForeignError, Model, ModelFile, TOKEN, Token, token};

const NAME: &str = "sonic";
/// The code of the encoder's mode for bodies in the skeleton of `SMPL`.
const MODE: f32 = 2.0;
/// Numbers of a frame: places of 24 joints, the root's orientation, wrists.
const JOINTS: usize = 72;
const ORIENTATION: usize = 6;
const WRISTS: usize = 6;

/// Inputs of an encoder of one release, told apart by its number of inputs.
#[derive(Debug, Clone, Copy)]
struct Layout {
    inputs: usize,
    /// Where the body's part begins. What lies before it is for other modes, and zero.
    from: usize,
    frames: usize,
    /// Orientations are relative to the heading of the robot, not to its whole orientation.
    by_heading: bool,
}

/// The makers' releases: the first one, the one of low latency, and 1.1.
const LAYOUTS: [Layout; 3] = [
    Layout { inputs: 1762, from: 922, frames: 10, by_heading: false },
    Layout { inputs: 1247, from: 911, frames: 4, by_heading: false },
    Layout { inputs: 1751, from: 911, frames: 10, by_heading: true },
];

impl Layout {
    fn file(&self) -> ModelFile {
        ModelFile {
            names: &["model_encoder.onnx", "encoder.onnx"],
            inputs: self.inputs,
            outputs: TOKEN,
            source: "huggingface.co/nvidia/GEAR-SONIC (model_encoder.onnx)",
        }
    }
}

/// A moment of a tracked body.
#[derive(Debug, Clone, Copy)]
pub struct Pose<'a> {
    /// Places of the 24 joints from the root, in its axes, m.
    pub joints: &'a [f32; JOINTS],
    /// Orientation of the root in the world: w, x, y, z.
    pub root: [f64; 4],
    /// Angles of the robot's wrists, in Isaac Lab's order, rad.
    pub wrists: &'a [f32; WRISTS],
}

/// Runs the encoder; call it once every control step of 20 ms.
#[derive(Debug)]
pub struct Encoder {
    model: Model,
    runner: Runner,
    layout: Layout,
    input: Vec<f32>,
    /// The turn about the vertical from where the operator looked at the start to where the robot did.
    robot_from_operator: Option<UnitQuaternion<f64>>,
}

impl Encoder {
    /// Reads `model_encoder.onnx` in a folder, of any release.
    ///
    /// # Errors
    /// [`ForeignError`]: the file is missing, or is no encoder.
    pub fn read(folder: &Path) -> Result<Self, ForeignError> {
        let mut shape = None;
        for layout in LAYOUTS {
            match layout.file().read(folder) {
                Ok(model) => {
                    let (runner, input) = (model.runner(), vec![0.0; layout.inputs]);
                    return Ok(Self { model, runner, layout, input, robot_from_operator: None });
                }
                Err(ForeignError::Shape { path, side: side @ "input", found, .. }) => {
                    let expected = "f32 [1, 1762], [1, 1247] or [1, 1751]".into();
                    shape = Some(ForeignError::Shape { path, side, expected, found });
                }
                Err(error) => return Err(error),
            }
        }
        Err(shape.unwrap_or(ForeignError::Width { found: 0 }))
    }

    /// SHA-256 of the file, hexadecimal.
    pub fn digest(&self) -> &str {
        self.model.digest()
    }

    /// Starts an episode: the operator's heading in the next step is the robot's.
    pub fn reset(&mut self) {
        self.robot_from_operator = None;
    }

    /// The token of the last poses, oldest first; where there are fewer than the encoder reads, the oldest stands for those before.
    /// `robot` is the orientation of the pelvis in the world: w, x, y, z.
    ///
    /// # Errors
    /// There is no pose, a quaternion has no direction, or the network gives no token.
    pub fn token(&mut self, poses: &[Pose<'_>], robot: [f64; 4]) -> Result<Token, ForeignError> {
        let lacks = |term, problem| ForeignError::Sensed { controller: NAME, term, problem };
        let newest = poses.last().ok_or_else(|| lacks("poses of a body", "are missing"))?;
        let robot = unit(robot).ok_or_else(|| lacks("the robot's orientation", "is no rotation"))?;
        let no_turn = || lacks("the body's orientation", "is no rotation");
        let operator = unit(newest.root).ok_or_else(no_turn)?;
        let turned = *self.robot_from_operator.get_or_insert_with(|| heading(&robot) * heading(&operator).inverse());
        let base = if self.layout.by_heading { heading(&robot) } else { robot };
        let Layout { from, frames, .. } = self.layout;
        self.input[0] = MODE;
        for frame in 0..frames {
            let pose = &poses[(poses.len() + frame).saturating_sub(frames).min(poses.len() - 1)];
            let root = unit(pose.root).ok_or_else(no_turn)?;
            let relative = (base.inverse() * turned * root).to_rotation_matrix();
            // The first two columns, row by row.
            let orientation: [f32; ORIENTATION] =
                std::array::from_fn(|index| relative.matrix()[(index / 2, index % 2)] as f32);
            let mut put = |from: usize, numbers: &[f32]| {
                let from = from + frame * numbers.len();
                self.input[from..from + numbers.len()].copy_from_slice(numbers);
            };
            put(from, pose.joints);
            put(from + frames * JOINTS, &orientation);
            put(from + frames * (JOINTS + ORIENTATION), pose.wrists);
        }
        let mut meant = [0.0; TOKEN];
        let ran = self.runner.run(&self.input, &mut meant);
        ran.map_err(|problem| ForeignError::Run { controller: NAME, problem })?;
        token::check(&meant).map(|()| meant)
    }
}

fn unit([w, x, y, z]: [f64; 4]) -> Option<UnitQuaternion<f64>> {
    let turn = Quaternion::new(w, x, y, z);
    (turn.norm() > 0.1 && turn.coords.iter().all(|part| part.is_finite())).then(|| UnitQuaternion::new_normalize(turn))
}

/// The turn about the vertical.
fn heading(turn: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    let ahead = turn * Vector3::x();
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), libm::atan2(ahead.y, ahead.x))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_fill_the_inputs() {
        for layout in LAYOUTS {
            assert_eq!(layout.from + layout.frames * (JOINTS + ORIENTATION + WRISTS), layout.inputs);
        }
    }
}
