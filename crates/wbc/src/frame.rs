//! Observations of the controller.

use fiatlux_proto::Proprioception;
use fiatlux_robot::{ARMS, MOVED, mirrored};
use serde::{Deserialize, Serialize};

use crate::BodyCommand;

/// Terms of one frame: name, count.
pub const FRAME: [(&str, usize); 10] = [
    ("base_angular_velocity", 3),
    ("projected_gravity", 3),
    ("base_linear_velocity", 3),
    ("base_height", 1),
    ("command", 7),
    ("clock", 4),
    ("joint_position", MOVED),
    ("joint_velocity", MOVED),
    ("last_action", MOVED),
    ("arm_position", ARMS),
];
/// Numbers of one frame.
pub const FRAME_LENGTH: usize = 80;

/// Proprioception as a controller reads it: positions of legs, waist and arms at least, velocities of legs and waist.
pub type Sensed<'a> = Proprioception<&'a [f64]>;

/// The first of some terms of an observation that has fewer numbers than are needed, or one among these that is not finite;
/// with what is wrong with it.
pub fn first_unsound(terms: &[(&'static str, &[f64], usize)]) -> Option<(&'static str, &'static str)> {
    terms.iter().find_map(|(term, numbers, least)| match numbers.get(..*least) {
        None => Some((*term, "the observation lacks")),
        Some(numbers) if !numbers.iter().all(|number| number.is_finite()) => Some((*term, "is not finite")),
        Some(_) => None,
    })
}

/// The last frames, the newest last.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct History {
    numbers: Vec<f32>,
}

impl History {
    /// An empty history of that many frames.
    pub fn new(frames: usize) -> Self {
        Self { numbers: vec![0.0; frames * FRAME_LENGTH] }
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.numbers.len() / FRAME_LENGTH
    }

    /// Forgets all frames, as before the first one of an episode.
    pub fn clear(&mut self) {
        self.numbers.fill(0.0);
    }

    /// Adds a frame and drops the oldest. The first frame of an episode stands for those that were before it.
    pub fn push(
        &mut self,
        sensed: &Sensed<'_>,
        command: &BodyCommand,
        clock: [f64; 4],
        last_action: &[f64; MOVED],
        is_first: bool,
    ) {
        self.numbers.copy_within(FRAME_LENGTH.., 0);
        let newest = self.numbers.len() - FRAME_LENGTH;
        let numbers = (sensed.base_angular_velocity.into_iter())
            .chain(sensed.projected_gravity)
            .chain(sensed.base_linear_velocity)
            .chain([sensed.base_height])
            .chain(command.numbers())
            .chain(clock)
            .chain(sensed.joint_position.iter().take(MOVED).copied())
            .chain(sensed.joint_velocity.iter().take(MOVED).copied())
            .chain(last_action.iter().copied())
            .chain(sensed.joint_position.iter().skip(MOVED).take(ARMS).copied());
        self.numbers[newest..].iter_mut().zip(numbers).for_each(|(place, number)| *place = number as f32);
        if is_first {
            (0..newest).step_by(FRAME_LENGTH).for_each(|at| self.numbers.copy_within(newest.., at));
        }
    }

    /// Writes field after field, each with all its frames, the newest last; returns how many numbers it wrote.
    pub fn write(&self, observation: &mut [f32]) -> usize {
        let mut places = observation.iter_mut();
        let mut start = 0;
        for (_, count) in FRAME {
            for frame in self.numbers.chunks_exact(FRAME_LENGTH) {
                places.by_ref().zip(&frame[start..start + count]).for_each(|(place, number)| *place = *number);
            }
            start += count;
        }
        self.numbers.len()
    }
}

/// Where number `index` of a mirrored action comes from, and its sign.
pub fn mirrored_action(index: usize) -> (usize, f32) {
    let (from, sign) = mirrored(index);
    (from, sign as f32)
}

/// Where number `index` of a mirrored frame comes from, and its sign.
pub fn mirrored_frame(index: usize) -> (usize, f32) {
    /// A vector's signs, and an axial vector's.
    const POLAR: [f32; 3] = [1.0, -1.0, 1.0];
    const AXIAL: [f32; 3] = [-1.0, 1.0, -1.0];
    const COMMAND: [f32; 7] = [1.0, -1.0, -1.0, 1.0, -1.0, 1.0, -1.0];
    let mut start = 0;
    for (field, (_, count)) in FRAME.iter().enumerate() {
        let at = index - start;
        if at < *count {
            let (from, sign) = match field {
                0 => (at, AXIAL[at]),
                1 | 2 => (at, POLAR[at]),
                3 => (at, 1.0),
                4 => (at, COMMAND[at]),
                5 => ((at + 2) % 4, 1.0),
                6..=8 => mirrored_action(at),
                _ => {
                    let (from, sign) = mirrored(MOVED + at);
                    (from - MOVED, sign as f32)
                }
            };
            return (start + from, sign);
        }
        start += count;
    }
    (index, 1.0)
}

#[cfg(test)]
mod tests {
    use fiatlux_robot::{LEGS, MOVED};

    use super::{FRAME, FRAME_LENGTH, mirrored_action, mirrored_frame};

    #[test]
    fn two_reflections_are_none() {
        assert_eq!(FRAME.iter().map(|(_, count)| count).sum::<usize>(), FRAME_LENGTH);
        let check = |length: usize, mirrored: fn(usize) -> (usize, f32)| {
            for index in 0..length {
                let (from, sign) = mirrored(index);
                let (back, other) = mirrored(from);
                assert_eq!((back, sign * other), (index, 1.0), "{index}");
            }
        };
        check(MOVED, mirrored_action);
        check(FRAME_LENGTH, mirrored_frame);
        assert_eq!(mirrored_action(1), (LEGS / 2 + 1, -1.0));
    }
}
