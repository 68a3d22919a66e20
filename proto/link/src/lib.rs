//! The Zenoh session.
