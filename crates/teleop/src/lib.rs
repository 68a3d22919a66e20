//! Teleoperation from a browser: a person drives the robot of a session, and records takes.
//!
//! ```text
//! keys, gamepad, headset -> page -> WebSocket -> Input -> Frame -> Pilot -> Command -> session -> bag
//!                           page <- WebSocket <- View  <- observation
//! ```
//!
//! [`Cockpit`] serves the page in `page/` to whoever has its token. Each input is a file in `src/inputs` and one in `page/`. A
//! [`Frame`] is what all inputs say; the pilot, which reads no clock, turns it into commands. [`takes::play`] opens a session for
//! each take, on a server of this process, which waits for its operator, or elsewhere, in real time. Its bag says that it is a
//! take.
#![allow(missing_docs)] // Used in this repository alone.
mod command;
mod frame;
mod gestures;
mod grip;
mod input;
mod inputs;
mod measures;
mod operator;
mod page;
mod pages;
mod pilot;
mod serve;
mod socket;
mod station;
mod studio;
pub mod takes;
mod tracked;
mod view;

/// Name of the policy in errors and in the record.
const NAME: &str = "teleop";

pub use command::{CommandError, PageArgs, RobotArgs, Secured};
pub use frame::{Bends, Fingers, Frame, Hand, Motion, Order};
pub use input::{Input, InputError, Reading};
pub use inputs::Inputs;
pub use measures::{Kind, Measure};
pub use pilot::{Driven, Pilot};
pub use serve::{Cockpit, Secure, ServeError};
pub use socket::Frames;
pub use station::{MAX_AGE, Phase, Station, Status};
pub use studio::{ServerElsewhere, TakeError};
pub use takes::{Kept, TakeOptions};
pub use view::{Document, Eye};
