use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;

use fiatlux_bag::{BagError, FindError};
use fiatlux_wire::RebuildError;
use thiserror::Error;

#[derive(Debug, Error)]
pub enum ReplayError {
    #[error(transparent)]
    Bag(#[from] BagError),
    #[error(transparent)]
    Find(#[from] FindError),
    #[error("cannot show {}", bag.display())]
    Header { bag: PathBuf, source: RebuildError },
    #[error("cannot show {}: it has no row that can be drawn{details}; record the episode again", bag.display())]
    Empty { bag: PathBuf, details: String },
    #[error("drawing {} took longer than the limit", bag.display())]
    Stopped { bag: PathBuf },
    #[error("cannot draw {}", bag.display())]
    Picture { bag: PathBuf, source: fiatlux_render::RenderError },
    #[error("there is no bag in {}; name an .mcap file, or a folder with some", folder.display())]
    NoBags { folder: PathBuf },
    #[error("cannot {action} {}; check that it exists, and its permissions", path.display())]
    Io { action: &'static str, path: PathBuf, source: io::Error },
    #[error("cannot listen on {address}; choose another port with --port, or 0 for a free one")]
    Listen { address: SocketAddr, source: io::Error },
    #[error("the server stopped")]
    Serve(#[source] io::Error),
}
