//! Bags: one MCAP file for each episode, written and read.
//!
//! The messages of a row stand on topics of their own (see [`topic`]); log time is step times 20 ms, sequence is the step.
//! The same episode gives the same bytes. The topics of a grade (`/state`, `/event`, `/result`) have chunks of their own, so
//! that a reader skips the rest without unpacking it. The chunk of the other topics comes first: a row whose state is
//! in a file is complete with all other topics, wherever the file was cut.
//!
//! Metadata `fiatlux` after the file's start is the header, `fiatlux.result` at its end the result. A bag that could not
//! be completed has `fiatlux.cut` instead. While it is written a bag is named `NAME.mcap.part`. Checksums cover the whole file:
//! each chunk's own is compared when the chunk is read, those of data section and summary by [`Bag::check`].
//!
//! A thin bag has no rows: they are simulated when they are read ([`simulate_with`]).
//!
//! ```
//! use fiatlux_bag::{Bag, BagError, BagWriter, Completeness, topic};
//! use fiatlux_proto::v3::{EpisodeHeader, EpisodeResult, State};
//! use fiatlux_proto::{Message, PROTOCOL};
//!
//! let folder = std::env::temp_dir().join(format!("fiatlux-bag-example-{}", std::process::id()));
//! std::fs::create_dir_all(&folder).expect("a folder for the bag");
//! let header = EpisodeHeader { protocol: Some(PROTOCOL), task: "S05".into(), ..EpisodeHeader::default() };
//! let mut writer = BagWriter::create(&folder.join("S05.mcap"), &header)?;
//! for step in 0..3 {
//!     writer.message(topic::STATE, step, &State { step, ..State::default() }.encode_to_vec())?;
//! }
//! let path = writer.finish(&EpisodeResult { total_reward: 0.5, ..EpisodeResult::default() })?;
//!
//! let bag = Bag::open(&path)?;
//! assert!(matches!(bag.completeness(), Completeness::Whole));
//! assert_eq!((bag.header().task.as_str(), bag.states().count()), ("S05", 3));
//! # std::fs::remove_dir_all(&folder).ok();
//! # Ok::<(), BagError>(())
//! ```
#![allow(missing_docs)] // Used in this repository alone.
mod bag;
mod channels;
mod check;
mod error;
mod find;
mod leftover;
mod lock;
mod metadata;
mod patience;
mod resume;
pub mod run;
mod scan;
mod stream;
mod take;
mod temporary;
mod thin;
pub mod topic;
mod writer;

pub use bag::{Bag, Completeness, Simulated, Simulator, Unsimulated, simulate_with};
pub use error::BagError;
pub use find::{BAGS, BagFiles, FindError, bag_name};
pub use leftover::is_leftover;
pub use lock::lock_folder;
pub use patience::Patience;
pub use resume::Resumed;
pub use stream::{Messages, ReadParts};
pub use temporary::Temporary;
pub use thin::convert;
pub use writer::{BagWriter, ROWS_PER_CHUNK, part_of};
