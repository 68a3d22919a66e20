//! The stances that are compared, and bounds of the search for one: `[lean]` of a file of parameters.

use fiatlux_wbc::BodyCommand;
use serde::Deserialize;

/// On the way back from the work: gap that the arm keeps where there is room, m, and time in which the robot stands up, s.
const WIDE_MARGIN: f64 = 0.025;
const UNHURRIED: f64 = 1.5;

/// Stances that are compared: all combinations, then steps from the best.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Lean {
    heights: Vec<f64>,
    rolls: Vec<f64>,
    pitches: Vec<f64>,
    yaws: Vec<f64>,
    pub step: f64,
    pub tries: usize,
    pub reached: f64,
    pub changes: u32,
    pub searches: u32,
    #[serde(default)]
    pub bend: f64,
    pub settle: f64,
    pub clear: f64,
    pub margin: f64,
    pub rate: f64,
}

impl Lean {
    /// Of height, roll, pitch and yaw: the smallest and the largest that are compared.
    pub fn range(&self, axis: usize) -> [f64; 2] {
        let values = [&self.heights, &self.rolls, &self.pitches, &self.yaws][axis];
        let low = values.iter().copied().fold(f64::INFINITY, f64::min);
        [low, values.iter().copied().fold(low, f64::max)]
    }

    pub fn commands(&self) -> Vec<BodyCommand> {
        let mut all = Vec::new();
        for &height in &self.heights {
            for &roll in &self.rolls {
                for &pitch in &self.pitches {
                    for &yaw in &self.yaws {
                        all.push(BodyCommand { velocity: [0.0; 3], height, torso: [roll, pitch, yaw] });
                    }
                }
            }
        }
        all
    }

    /// The same for one command alone, with wide gaps and in no hurry.
    pub fn only(&self, command: &BodyCommand) -> Self {
        let [rolls, pitches, yaws] = command.torso.map(|angle| vec![angle]);
        Self {
            heights: vec![command.height],
            rolls,
            pitches,
            yaws,
            margin: WIDE_MARGIN,
            bend: UNHURRIED,
            ..self.clone()
        }
    }

    /// No other combination is nearer to a command.
    pub fn is_near(&self, command: &BodyCommand, combination: &BodyCommand) -> bool {
        let (of_command, of_combination) = (command.numbers(), combination.numbers());
        [&self.heights, &self.rolls, &self.pitches, &self.yaws].into_iter().enumerate().all(|(axis, values)| {
            let off = |value: f64| (of_command[3 + axis] - value).abs();
            values.iter().all(|value| off(of_combination[3 + axis]) <= off(*value))
        })
    }
}

/// Height of the pelvis below which a robot leans, m, and turn of the torso from which on, rad.
const LEANS: (f64, f64) = (0.70, 0.12);

/// The robot leans already by a command.
pub(super) fn leans(command: &BodyCommand) -> bool {
    command.height < LEANS.0 || command.torso.iter().any(|angle| angle.abs() > LEANS.1)
}
