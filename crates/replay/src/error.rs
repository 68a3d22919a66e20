//! Why there is no replay.

use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;

use fiatlux_bag::{BagError, FindError};
use fiatlux_wire::RebuildError;
use thiserror::Error;

/// Why there is no replay.
#[derive(Debug, Error)]
pub enum ReplayError {
    /// The bag cannot be opened.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// A file or folder cannot be looked at.
    #[error(transparent)]
    Find(#[from] FindError),
    /// The bag's header gives no scene.
    #[error("cannot show {}", bag.display())]
    Header {
        /// The bag.
        bag: PathBuf,
        /// Why.
        #[source]
        source: RebuildError,
    },
    /// No row of the bag can be drawn.
    #[error("there is nothing to show of {}: it has no row that can be drawn{details}; record the episode again", bag.display())]
    Empty {
        /// The bag.
        bag: PathBuf,
        /// What is wrong with its rows, each on a line of its own.
        details: String,
    },
    /// A folder without bags.
    #[error("there is no bag in {}; name an .mcap file, or a folder that has some", folder.display())]
    NoBags {
        /// The folder.
        folder: PathBuf,
    },
    /// A file or folder cannot be read or written.
    #[error("cannot {action} {}; check that it is there and its permissions", path.display())]
    Io {
        /// What was tried.
        action: &'static str,
        /// On what.
        path: PathBuf,
        /// Why.
        #[source]
        source: io::Error,
    },
    /// The server cannot listen.
    #[error("cannot listen on {address}; choose another port with --port, or 0 for a free one")]
    Listen {
        /// Where.
        address: SocketAddr,
        /// Why.
        #[source]
        source: io::Error,
    },
    /// The server stopped by itself.
    #[error("the server stopped")]
    Serve(#[source] io::Error),
}
