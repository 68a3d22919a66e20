//! HTTPS on one's own network. [`Certificate`] is kept in a folder, and signed by itself: a browser asks once whether to trust it.
//! [`Tls`] turns a TCP connection into the stream of what it carries.
#![allow(missing_docs)] // Used in this repository alone.
mod certificate;
mod stream;

pub use certificate::{Certificate, CertificateError, own_hosts};
pub use stream::Tls;
