//! A certificate and its key, as files.

use std::fs;
use std::io;
use std::net::{Ipv4Addr, UdpSocket};
use std::os::unix::fs::DirBuilderExt as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use data_encoding::HEXUPPER;
use fiatlux_access::{AccessError, read_public, read_secret, write_new};
use rcgen::{CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, KeyPair, KeyUsagePurpose};
use rustls::client::WebPkiServerVerifier;
use rustls::client::danger::ServerCertVerifier as _;
use rustls::crypto::ring::default_provider;
use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName, UnixTime};
use rustls::{CertificateError as Fault, RootCertStore, ServerConfig};
use thiserror::Error;
use time::{Duration, OffsetDateTime};

/// Validity, days. Browsers refuse what is valid for much longer.
const DAYS: i64 = 365;
/// Tolerance for the clocks of two machines.
const CLOCK_MARGIN: Duration = Duration::hours(1);
/// Names in every certificate.
const OWN: [&str; 3] = ["localhost", "127.0.0.1", "::1"];
const CERTIFICATE: &str = "certificate.pem";
const KEY: &str = "key.pem";

/// Why there is no certificate.
#[derive(Debug, Error)]
pub enum CertificateError {
    #[error("{0}: a certificate cannot name it; give an address such as 192.168.1.7 or a name such as lab.local")]
    Host(String),
    #[error("cannot make the folder {} of the certificate; check its parent and permissions", .path.display())]
    Folder { path: PathBuf, source: io::Error },
    #[error("cannot use the certificate in {}; move that folder away, and a new one is made", .folder.display())]
    Access { folder: PathBuf, source: AccessError },
    #[error(
        "{}: {problem}; move the folder away, and a new certificate is made, for which the browser asks again", .path.display()
    )]
    Refused { path: PathBuf, problem: String },
    #[error("cannot make a certificate")]
    Make(#[from] rcgen::Error),
    #[error("cannot start TLS")]
    Tls(#[from] rustls::Error),
}

/// A certificate that its machine signed itself.
pub struct Certificate {
    pub(crate) config: Arc<ServerConfig>,
    der: CertificateDer<'static>,
    is_new: bool,
}

impl Certificate {
    /// The certificate in a folder, which must name all `hosts`. Where there is none, one is made, which names `others` too.
    ///
    /// # Errors
    /// [`CertificateError`]: files that cannot be read or written, or that are not valid today for these hosts.
    pub fn open(folder: &Path, hosts: &[String], others: &[String]) -> Result<Self, CertificateError> {
        if let Some(host) = hosts.iter().find(|host| ServerName::try_from(host.as_str()).is_err()) {
            return Err(CertificateError::Host(host.clone()));
        }
        let (certificate, key) = (folder.join(CERTIFICATE), folder.join(KEY));
        let is_new = !certificate.exists() && !key.exists();
        if is_new {
            let others = others.iter().filter(|host| ServerName::try_from(host.as_str()).is_ok());
            make(folder, hosts.iter().chain(others).cloned())?;
        }
        let access = |source| CertificateError::Access { folder: folder.to_owned(), source };
        let refused = |path: &Path, problem: String| CertificateError::Refused { path: path.to_owned(), problem };
        let text = read_public(&certificate).map_err(access)?;
        let der = CertificateDer::from_pem_slice(text.as_bytes())
            .map_err(|_| refused(&certificate, "no certificate is in the file".into()))?;
        let secret = read_secret(&key, |text| Ok(text.to_owned())).map_err(access)?;
        let secret = PrivateKeyDer::from_pem_slice(secret.as_bytes())
            .map_err(|_| refused(&key, "no private key is in the file".into()))?;
        check(&der, hosts).map_err(|problem| refused(&certificate, problem))?;
        let mut config = ServerConfig::builder_with_provider(Arc::new(default_provider()))
            .with_safe_default_protocol_versions()?
            .with_no_client_auth()
            .with_single_cert(vec![der.clone()], secret)
            .map_err(|_| refused(&key, format!("the key is not that of {CERTIFICATE}")))?;
        config.alpn_protocols = vec![b"http/1.1".to_vec()];
        Ok(Self { config: Arc::new(config), der, is_new })
    }

    /// SHA-256 of the certificate, as browsers show it.
    pub fn fingerprint(&self) -> String {
        let digest = ring::digest::digest(&ring::digest::SHA256, &self.der);
        let bytes: Vec<String> = digest.as_ref().iter().map(|byte| HEXUPPER.encode(&[*byte])).collect();
        bytes.join(":")
    }

    /// It was made just now, so no browser knows it.
    pub fn is_new(&self) -> bool {
        self.is_new
    }

    pub fn der(&self) -> &[u8] {
        &self.der
    }
}

/// This machine on its network: its address first, where it has one, then its names. No packet is sent.
pub fn own_hosts() -> Vec<String> {
    // An address for documentation: connecting a datagram socket only looks up the route.
    let outside = (Ipv4Addr::new(192, 0, 2, 1), 9);
    let address = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).and_then(|socket| {
        socket.connect(outside)?;
        socket.local_addr()
    });
    let mut hosts: Vec<String> = address.map(|address| address.ip().to_string()).into_iter().collect();
    let name = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let name = name.trim();
    if !name.is_empty() {
        hosts.push(name.to_owned());
        if !name.contains('.') {
            hosts.push(format!("{name}.local"));
        }
    }
    if hosts.is_empty() {
        hosts.push("localhost".into());
    }
    hosts
}

/// The problem of a certificate, if these hosts cannot use it today.
fn check(der: &CertificateDer<'_>, hosts: &[String]) -> Result<(), String> {
    let broken = |error: &dyn std::fmt::Display| format!("the certificate is broken: {error}");
    let mut roots = RootCertStore::empty();
    roots.add(der.clone().into_owned()).map_err(|error| broken(&error))?;
    let verifier = WebPkiServerVerifier::builder_with_provider(Arc::new(roots), Arc::new(default_provider()))
        .build()
        .map_err(|error| broken(&error))?;
    for host in hosts {
        let name = ServerName::try_from(host.as_str()).map_err(|error| broken(&error))?;
        match verifier.verify_server_cert(der, &[], &name, &[], UnixTime::now()) {
            Ok(_) => {}
            Err(rustls::Error::InvalidCertificate(Fault::Expired | Fault::ExpiredContext { .. })) => {
                return Err("the certificate has expired".into());
            }
            Err(rustls::Error::InvalidCertificate(Fault::NotValidYet | Fault::NotValidYetContext { .. })) => {
                return Err("the certificate is not valid yet; compare this machine's clock".into());
            }
            Err(rustls::Error::InvalidCertificate(Fault::NotValidForName | Fault::NotValidForNameContext { .. })) => {
                return Err(format!("the certificate does not name {host}"));
            }
            Err(error) => return Err(broken(&error)),
        }
    }
    Ok(())
}

/// Makes a certificate and its key in a folder.
fn make(folder: &Path, hosts: impl Iterator<Item = String>) -> Result<(), CertificateError> {
    let mut names: Vec<String> = Vec::new();
    for host in hosts.chain(OWN.map(String::from)) {
        if !names.contains(&host) {
            names.push(host);
        }
    }
    let mut params = CertificateParams::new(names)?;
    params.distinguished_name = DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, "fiatlux teleop");
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth];
    let now = OffsetDateTime::now_utc();
    (params.not_before, params.not_after) = (now - CLOCK_MARGIN, now + Duration::days(DAYS));
    let key = KeyPair::generate()?;
    let certificate = params.self_signed(&key)?;
    let failed = |source| CertificateError::Folder { path: folder.to_owned(), source };
    fs::DirBuilder::new().recursive(true).mode(0o700).create(folder).map_err(failed)?;
    let access = |source| CertificateError::Access { folder: folder.to_owned(), source };
    write_new(&folder.join(KEY), &key.serialize_pem(), 0o600).map_err(access)?;
    write_new(&folder.join(CERTIFICATE), &certificate.pem(), 0o644).map_err(access)
}
