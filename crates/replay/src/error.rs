//! Errors of opening and serving replays.

use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;

use fiatlux_bag::{BagError, FindError};
use fiatlux_wire::RebuildError;
use thiserror::Error;

/// Why a replay cannot be shown.
#[derive(Debug, Error)]
pub enum ReplayError {
    /// The bag's file cannot be opened as a bag.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// A path does not exist, or a folder cannot be listed.
    #[error(transparent)]
    Find(#[from] FindError),
    /// No scene can be built from the bag's header.
    #[error("cannot show {}", bag.display())]
    Header {
        bag: PathBuf,
        /// What in the header prevents it.
        #[source]
        source: RebuildError,
    },
    /// No row of the bag can be drawn.
    #[error("cannot show {}: it has no row that can be drawn{details}; record the episode again", bag.display())]
    Empty {
        bag: PathBuf,
        /// What is wrong with its rows, each fault on its own line.
        details: String,
    },
    /// Drawing was stopped before there was a picture.
    #[error("drawing {} took longer than it may", bag.display())]
    Stopped { bag: PathBuf },
    /// A picture cannot be drawn.
    #[error("cannot draw {}", bag.display())]
    Picture {
        bag: PathBuf,
        /// Why not.
        #[source]
        source: fiatlux_render::RenderError,
    },
    /// The folder holds no bag.
    #[error("there is no bag in {}; name an .mcap file, or a folder with some", folder.display())]
    NoBags { folder: PathBuf },
    /// A file or folder cannot be read or written.
    #[error("cannot {action} {}; check that it exists, and its permissions", path.display())]
    Io {
        /// The attempted action: `read` or `write`, to follow "cannot".
        action: &'static str,
        path: PathBuf,
        /// The system's error, which says why.
        #[source]
        source: io::Error,
    },
    /// The server cannot listen on its port.
    #[error("cannot listen on {address}; choose another port with --port, or 0 for a free one")]
    Listen {
        address: SocketAddr,
        /// The system's error, which says why.
        #[source]
        source: io::Error,
    },
    /// The server stopped by itself.
    #[error("the server stopped")]
    Serve(#[source] io::Error),
}
