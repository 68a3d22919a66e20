//! Replays of bags in a browser: robot, ladder and bulbs in 3D with a time bar, conditions that light up as they hold, and
//! contact forces as arrows.
//!
//! ```text
//! Bag -> Replay                document, shapes and rows as bytes, for a page that shows them
//! Bags -> Viewer::serve        a server on the loopback interface: a list of episodes, a page for each
//! Replay -> standalone         the page and its data in one file
//! Poster                       a still and a short clip of an episode
//! ReplayCache, site            the same in pages of another server, one replay or two side by side
//! ```
//!
//! Any page can use the documents. Ours is in `page/`: small JavaScript modules without a build step. What it imports
//! from three.js is in `vendor/three`: files of the npm package `three` 0.180.0, minified, with the same bytes as
//! published, so that anybody can compare them (a test pins their digests). Everything is compiled in: neither the
//! build nor the page fetches anything from another host, and the page's Content-Security-Policy forbids it.
//!
//! ```no_run
//! use fiatlux_replay::{Bags, Replay, Viewer};
//!
//! let replay = Replay::open("results/stand/bags/S05-s0-e0.mcap")?;
//! println!("{} rows, {} bytes", replay.document().track.rows, replay.track().len());
//!
//! let viewer = Viewer::bind(Bags::find("results/stand".as_ref())?, 0)?;
//! println!("http://{}/", viewer.address());
//! viewer.serve(&std::sync::atomic::AtomicBool::new(false))?;
//! # Ok::<(), fiatlux_replay::ReplayError>(())
//! ```
#![allow(missing_docs)] // Used in this repository alone.
mod answers;
mod bags;
mod cache;
mod conditions;
mod connections;
mod download;
mod error;
mod events;
mod hosts;
mod packed;
mod page;
mod pictures;
mod planes;
mod poster;
mod replay;
mod rows;
mod scene;
mod serve;
mod served;
pub mod site;
mod standalone;
mod text;
mod track;

pub use bags::{BagEntry, Bags, Listing, RecordedRuling};
pub use cache::{PackedReplay, ReplayCache};
pub use conditions::{Conditions, CriterionName, Ruling, flag};
pub use error::ReplayError;
pub use events::RecordedEvent;
pub use packed::Packed;
pub use pictures::SensorPictures;
pub use poster::Poster;
pub use replay::{Document, EpisodeInfo, REPLAY_VERSION, Replay, TrackInfo, differences};
pub use rows::{Faults, Rows};
pub use scene::{Block, Frame, Group, Light, Material, Mesh, Stage};
pub use serve::Viewer;
pub use standalone::standalone;
pub use track::{ForceName, GRID, Grid, JointName, LinkInfo, MAGIC, MAX_KEPT_ROWS, POSE, TRACK_VERSION};
