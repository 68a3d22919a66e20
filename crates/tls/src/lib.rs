//! HTTPS on one's own network. [`Certificate`] is kept in a folder, and signed by itself: a browser asks once whether to trust it.
//! [`Tls`] turns a TCP connection into the stream of what it carries.
#![allow(missing_docs)] // Used in this repository alone.
mod certificate;
mod stream;

use std::future::Future;
use std::io;
use std::path::Path;
use std::pin::Pin;

use tokio::io::DuplexStream;
use tokio::net::TcpStream;

pub use certificate::{Certificate, CertificateError, own_hosts};
pub use stream::Tls;

/// Makes of an accepted connection the stream of what it carries.
pub type Accept =
    Box<dyn Fn(TcpStream) -> Pin<Box<dyn Future<Output = io::Result<DuplexStream>> + Send>> + Send + Sync>;

/// TLS with the certificate of a folder, made where there is none: this machine's names, those of `hosts` first; the function that
/// accepts connections; and a text for the user. Without hosts, the first of the machine's own names is used.
///
/// # Errors
/// [`CertificateError`]: it has expired, is broken, or does not name the hosts.
pub fn secure(folder: &Path, hosts: &[String]) -> Result<(Vec<String>, Accept, String), CertificateError> {
    let own = own_hosts();
    // Of its own names, only the one in the page's address must be in the certificate.
    let hosts = if hosts.is_empty() { &own[..1] } else { hosts };
    let certificate = Certificate::open(folder, hosts, &own)?;
    let names = hosts.iter().chain(&own).cloned().collect();
    let tls = Tls::new(&certificate);
    let accept = Box::new(move |stream| Box::pin(tls.clone().accept(stream)) as Pin<Box<_>>);
    let age = if certificate.is_new() { "made now" } else { "as before" };
    let said = format!(
        "The certificate in {}, {age}, has the SHA-256 fingerprint\n  {}\n\
         The headset's browser warns once that it does not know this certificate: choose Advanced, compare the fingerprint where \
         it shows one, and proceed.\n\
         It asks again when the certificate has expired after a year, or was made anew.",
        folder.display(),
        certificate.fingerprint()
    );
    Ok((names, accept, said))
}
