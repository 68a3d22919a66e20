//! An authority for a single installation, and the certificates that it signs.

use rcgen::{
    BasicConstraints, Certificate, CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer,
    KeyPair, KeyUsagePurpose,
};
use time::{Duration, OffsetDateTime};

use super::Role;

/// Tolerance for the clocks of two machines.
const CLOCK_MARGIN: Duration = Duration::hours(1);

/// Signs the certificates of all parts.
pub struct Authority {
    certificate: Certificate,
    issuer: Issuer<'static, KeyPair>,
    /// Names and addresses of the router's machine.
    hosts: Vec<String>,
    from: OffsetDateTime,
    until: OffsetDateTime,
}

/// A part's certificate and its key, PEM.
pub struct Credentials {
    pub authority: String,
    pub certificate: String,
    pub key: String,
}

impl Authority {
    /// Makes an authority whose certificates are valid from now on, for this number of days.
    pub fn new(hosts: &[String], days: u16) -> Result<Self, rcgen::Error> {
        let now = OffsetDateTime::now_utc();
        let (from, until) = (now - CLOCK_MARGIN, now + Duration::days(days.into()));
        let mut params = CertificateParams::default();
        params.distinguished_name = common_name("fiatlux authority");
        params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
        (params.not_before, params.not_after) = (from, until);
        let key = KeyPair::generate()?;
        let certificate = params.self_signed(&key)?;
        let mut hosts = hosts.to_vec();
        for own in ["localhost", "127.0.0.1", "::1"] {
            if !hosts.iter().any(|host| host == own) {
                hosts.push(own.into());
            }
        }
        Ok(Self { certificate, issuer: Issuer::new(params, key), hosts, from, until })
    }

    /// The certificate of a part, with a new key. Only the router's names its addresses: nothing else accepts
    /// connections.
    pub fn certificate(&self, role: Role) -> Result<Credentials, rcgen::Error> {
        let (hosts, usage) = match role {
            Role::Router => (self.hosts.clone(), ExtendedKeyUsagePurpose::ServerAuth),
            _ => (Vec::new(), ExtendedKeyUsagePurpose::ClientAuth),
        };
        let mut params = CertificateParams::new(hosts)?;
        params.distinguished_name = common_name(role.name());
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        params.extended_key_usages = vec![usage];
        params.use_authority_key_identifier_extension = true;
        (params.not_before, params.not_after) = (self.from, self.until);
        let key = KeyPair::generate()?;
        let certificate = params.signed_by(&key, &self.issuer)?;
        Ok(Credentials { authority: self.pem(), certificate: certificate.pem(), key: key.serialize_pem() })
    }

    /// The authority's own certificate as PEM, with which others check theirs.
    pub fn pem(&self) -> String {
        self.certificate.pem()
    }

    /// The authority's key as PEM: whoever has it can make certificates for any part.
    pub fn key_pem(&self) -> String {
        self.issuer.key().serialize_pem()
    }

    /// Last day on which its certificates are valid, as `YYYY-MM-DD`.
    pub fn valid_until(&self) -> String {
        self.until.date().to_string()
    }
}

fn common_name(name: &str) -> DistinguishedName {
    let mut full = DistinguishedName::new();
    full.push(DnType::CommonName, name);
    full
}
