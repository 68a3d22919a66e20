//! Writes the messages of which every control step has some.

use prost::Message;
use prost_types::Timestamp;

use crate::foxglove::{CompressedImage, PointCloud};
use crate::v3::{Action, ActionRecord, Event, Observation, Reward, State, StepRecord};

/// A message as bytes, those of [`Message::encode_to_vec`]. That appends number by number to a vector, and each time looks whether
/// it has to grow; this writes into a buffer that has the length from the start, in a fraction of the time.
pub fn encode(message: &impl Encode) -> Vec<u8> {
    message.to_bytes()
}

/// Messages that [`encode`] takes. Their code stands in this crate, which is optimised in every profile.
pub trait Encode {
    /// See [`encode`].
    fn to_bytes(&self) -> Vec<u8>;
}

macro_rules! impl_encode {
    ($($message:ty),* $(,)?) => {$(
        impl Encode for $message {
            fn to_bytes(&self) -> Vec<u8> {
                let mut bytes = vec![0; self.encoded_len()];
                self.encode_raw(&mut bytes.as_mut_slice());
                bytes
            }
        }
    )*};
}

impl_encode!(
    Action,
    ActionRecord,
    CompressedImage,
    Event,
    Observation,
    PointCloud,
    Reward,
    State,
    StepRecord,
    Timestamp
);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::v3::Proprioception;

    #[test]
    fn the_bytes_are_those_of_the_library() {
        let own = Proprioception { base_height: 0.7, joint_position: vec![0.1; 53], ..Proprioception::default() };
        let observation =
            Observation { step: 300, lidar: vec![2.5; 5760], proprioception: Some(own), ..Observation::default() };
        assert_eq!(encode(&observation), observation.encode_to_vec());
        let state = State { step: u64::MAX, joint_position: vec![-0.0, f64::NAN, 1e300], ..State::default() };
        assert_eq!(encode(&state), state.encode_to_vec());
        assert_eq!(encode(&Action::default()), Vec::<u8>::new());
    }
}
