//! The inputs, one in each file.

mod gamepad;
mod keyboard;
mod webxr;

pub use gamepad::Gamepad;
pub use keyboard::Keyboard;
pub use webxr::WebXr;

use serde_json::Value;

use crate::input::{Input, InputError, Reading};

/// All inputs of one page.
pub struct Inputs(Vec<Box<dyn Input>>);

impl Default for Inputs {
    fn default() -> Self {
        Self(vec![Box::<Keyboard>::default(), Box::<Gamepad>::default(), Box::<WebXr>::default()])
    }
}

impl Inputs {
    /// Reads a message of the input of that name.
    ///
    /// # Errors
    /// [`InputError`]: there is no such input, or the message is not one of it.
    pub fn read(&mut self, name: &str, message: &Value) -> Result<Reading, InputError> {
        match self.0.iter_mut().find(|input| input.name() == name) {
            Some(input) => input.read(message),
            None => {
                let known = self.0.iter().map(|input| input.name()).collect::<Vec<_>>().join(", ");
                Err(InputError::Unknown { name: name.chars().take(40).collect(), known })
            }
        }
    }
}
