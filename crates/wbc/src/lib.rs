//! The whole-body controller: it owns legs and waist, and walks, stands, bends and turns on command whatever the arms do.
//!
//! Training and use share what stands here, so that a controller meets what it was trained on: the [`BodyCommand`] and how it
//! sets in, the rhythm of the feet ([`Clock`]), and what is observed ([`History`]). A [`Network`] comes from a file with its
//! [`Contract`] inside, which says what robot and engine it fits; a [`Controller`] plays it, and
//! stands by [`balance`] where nothing asks for steps. [`Arms`] adds
//! to the targets of the arms what their weight takes away; [`Swing`] swings free arms with the legs.
mod arms;
pub mod balance;
mod clock;
mod contract;
mod controller;
mod error;
mod frame;
mod network;
mod setpoint;
mod standing;
mod swing;

pub use arms::Arms;
pub use balance::{Balance, BalanceError};
pub use clock::Clock;
pub use contract::{Contract, Joint, Training};
pub use controller::Controller;
pub use error::WbcError;
pub use fiatlux_proto::{BodyCommand, NOMINAL_HEIGHT, Proprioception};
pub use fiatlux_robot::{ARMS, BODY, LEGS, MOVED};
pub use frame::{FRAME, FRAME_LENGTH, History, Sensed, first_unsound, mirrored_action, mirrored_frame};
pub use network::Network;
pub use setpoint::Setpoint;
pub use swing::Swing;

/// Length of a control step, s.
pub const CONTROL_DT: f64 = fiatlux_rules::CONTROL_DT;
/// Radians of joint target per unit of action, of the legs and of the waist.
pub const SCALES: [f64; 2] = [0.5, 0.25];
/// Actions beyond it count as it.
pub const ACTION_CLAMP: f64 = 5.0;

/// Radians of joint target per unit of action of a joint, in the public joint order.
pub fn scale(joint: usize) -> f64 {
    SCALES[usize::from(joint >= LEGS)]
}
