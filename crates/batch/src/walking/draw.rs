//! Draws of commands for a learner's robot.

use fiatlux_rules::CONTROL_DT;
use fiatlux_wbc::{BodyCommand, NOMINAL_HEIGHT};
use fiatlux_world::Random;

use super::WalkingOptions;

/// Time from one command to the next, s.
const COMMAND_S: [f64; 2] = [3.0, 8.0];
/// Part of the commands that ask to stand, and of those that ask for one axis of velocity alone.
const STAND: f64 = 0.18;
const ONE_AXIS: f64 = 0.34;
/// Part of the commands that leave height and torso as they are by default.
const UPRIGHT: f64 = 0.35;

/// A command, and for how many control steps it holds.
pub(super) fn draw_command(options: &WalkingOptions, random: &mut Random) -> (BodyCommand, u32) {
    let within = |[low, high]: [f64; 2], random: &mut Random| random.uniform(low, high);
    let kind = random.unit();
    let mut velocity = options.command.map(|range| within(range, random));
    let axis = random.index(3);
    let stands = kind < STAND;
    for (index, velocity) in velocity.iter_mut().enumerate() {
        if stands || (kind < STAND + ONE_AXIS && index != axis) {
            *velocity = 0.0;
        }
    }
    let range = if stands { options.stand_height } else { options.height };
    let is_upright = random.unit() < UPRIGHT;
    let height = within(range, random);
    let torso = options.torso.map(|range| within(range, random));
    let command = match is_upright {
        true => BodyCommand { velocity, height: NOMINAL_HEIGHT.clamp(range[0], range[1]), torso: [0.0; 3] },
        false => BodyCommand { velocity, height, torso },
    };
    (command, (within(COMMAND_S, random) / CONTROL_DT) as u32)
}
