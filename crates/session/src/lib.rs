//! The session of a policy, a simulation and a recorder, as three state machines without I/O, clock or threads.
//!
//! [`ClientSession`], [`ServerSession`] and [`RecorderSession`] follow the rules of `proto/PROTOCOL.md` and have one
//! shape, [`Machine`]: inputs with their time go in, one queue comes out. Programs carry the messages, over Zenoh or in
//! memory. The simulation of a server is a [`Host`]; the one in this example counts:
//!
//! ```
//! use fiatlux_proto::v3::*;
//! use fiatlux_session::{ClientSession, Command, Host, Machine, ServerSession, client, server};
//!
//! #[derive(Default)]
//! struct Counter(Observation);
//!
//! impl Host for Counter {
//!     fn stage(&mut self, episode: u64) -> Result<&Observation, Refusal> {
//!         self.0 = Observation { episode, ..Observation::default() };
//!         Ok(&self.0)
//!     }
//!     fn step(&mut self, _: &Command) -> Result<&Observation, Refusal> {
//!         self.0.step += 1;
//!         self.0.end = (self.0.step == 2).then(EpisodeEnd::default);
//!         Ok(&self.0)
//!     }
//!     fn look(&mut self, _: &[String]) -> Result<Observation, Refusal> {
//!         Ok(self.0.clone())
//!     }
//!     fn record(&mut self, _: Option<ActionRecord>, _: bool) -> Result<StepRecord, Refusal> {
//!         Ok(StepRecord::default())
//!     }
//!     fn cut_short(&self, _: &str, _: &str) -> EpisodeResult {
//!         EpisodeResult::default()
//!     }
//! }
//!
//! let now = std::time::Duration::ZERO;
//! let info = SessionInfo { joints: vec![Joint::default(); 3], action_scale: 0.5, ..SessionInfo::default() };
//! let mut server = ServerSession::new(Counter::default(), info, false, server::Timeouts::default(), now);
//! let mut client = ClientSession::new(server.info());
//! let (mut shown, mut ended) = (Vec::new(), false);
//! client.handle(client::Input::Start(7), now);
//! while !ended {
//!     while let Some(output) = client.poll() {
//!         match output {
//!             client::Output::Reset(bytes) => server.handle(server::Input::Reset(bytes, "the client"), now),
//!             client::Output::Action(bytes) => server.handle(server::Input::Action(bytes), now),
//!             client::Output::Observation(observation) => {
//!                 shown.push(observation.step);
//!                 client.handle(client::Input::Command(Command::Action(vec![0.0; 3])), now);
//!             }
//!             client::Output::Done(_) => ended = true,
//!             _ => {}
//!         }
//!     }
//!     while let Some(output) = server.poll() {
//!         match output {
//!             server::Output::Reply("the client", _, mut replies) => {
//!                 client.handle(client::Input::Reset(replies.pop().map(Ok)), now);
//!             }
//!             server::Output::Observation(bytes) => client.handle(client::Input::Observation(bytes), now),
//!             _ => {} // Records, which go to a recorder.
//!         }
//!     }
//! }
//! assert_eq!(shown, [0, 1]);
//! ```
#![allow(missing_docs)] // Used in this repository alone.

mod command;
mod machine;

pub mod client;
pub mod recorder;
pub mod server;

pub use client::{ClientSession, SessionFailure};
pub use command::{Command, CommandError};
pub use machine::Machine;
pub use recorder::RecorderSession;
pub use server::{Host, ServerSession};
