//! The version of the protocol.

use crate::v3::Version;

/// Protocol version of this build. The major number changes when an old client would be misunderstood.
pub const PROTOCOL: Version = Version { major: 3, minor: 14 };

/// True if this build understands a peer.
pub fn is_compatible(peer: &Version) -> bool {
    peer.major == PROTOCOL.major
}

impl std::fmt::Display for Version {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}.{}", self.major, self.minor)
    }
}
