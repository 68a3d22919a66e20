//! The time from an action's arrival to its effect.

use serde::{Deserialize, Serialize};

/// Actions that have arrived and not acted yet, for a number of control steps that does not change.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Delay {
    /// One action after the other, the oldest first.
    numbers: Vec<f64>,
}

impl Delay {
    /// A delay in control steps, in which this action goes on; 0 for none.
    pub fn new(action: &[f64], steps: usize) -> Self {
        let mut delay = Self::default();
        delay.restart(action, steps);
        delay
    }

    /// Becomes that of another episode.
    pub fn restart(&mut self, action: &[f64], steps: usize) {
        self.numbers.clear();
        (0..steps).for_each(|_| self.numbers.extend_from_slice(action));
    }

    /// True if an action acts in the step in which it arrives.
    pub fn is_none(&self) -> bool {
        self.numbers.is_empty()
    }

    /// Its control steps, for actions of so many numbers; `None` if it was made for actions of another length.
    pub fn steps(&self, numbers: usize) -> Option<usize> {
        (numbers > 0 && self.numbers.len().is_multiple_of(numbers)).then(|| self.numbers.len() / numbers)
    }

    /// Takes in the action that arrives, in action units, and puts the one that acts in its place.
    pub fn swap(&mut self, action: &mut [f64]) {
        if !self.is_none() {
            self.numbers[..action.len()].swap_with_slice(action);
            self.numbers.rotate_left(action.len());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_action_acts_after_the_delay_and_the_first_one_holds_until_then() {
        let mut delay = Delay::new(&[0.5, -0.5], 2);
        assert_eq!((delay.steps(2), delay.steps(3), delay.steps(0)), (Some(2), None, None));
        let acted: Vec<[f64; 2]> = (0..4)
            .map(|step| {
                let mut action = [f64::from(step); 2];
                delay.swap(&mut action);
                action
            })
            .collect();
        assert_eq!(acted, [[0.5, -0.5], [0.5, -0.5], [0.0; 2], [1.0; 2]]);

        delay.restart(&[0.5, -0.5], 0);
        let mut action = [7.0; 2];
        delay.swap(&mut action);
        assert!(delay.is_none() && action == [7.0; 2]);
    }
}
