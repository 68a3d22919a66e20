//! `fiatlux keys`: keys, certificates and configs for an installation, so that each program can do its part and nothing
//! else.
//!
//! One call creates everything in one folder, and never overwrites anything. Each config holds its own certificate and
//! key, so it is the only Zenoh file that its machine needs. `docs/access.md` explains who can do what.

mod certificates;
mod configs;
mod roles;

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::net::IpAddr;
use std::os::unix::fs::DirBuilderExt as _;
use std::path::{Path, PathBuf};

use data_encoding::HEXLOWER;
use fiatlux_access::{
    AccessError, Grant, Identity, KnownServers, RecorderKey, Token, Tokens, is_server_or_group, random, write_new,
};
use fiatlux_proto::keys::is_name;
use serde::Serialize;
use thiserror::Error;

use certificates::Authority;
pub use roles::Role;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Authentication {
    /// By certificates, over QUIC with mutual TLS: nobody reads the wire.
    Certificates,
    /// By user and password, without encryption: whoever reads the wire reads all messages, but no password.
    Passwords,
}

/// Which keys to make, where, and for whom.
#[derive(Debug, Clone)]
pub struct KeysOptions {
    /// A folder that does not exist yet, or is empty.
    pub out: PathBuf,
    /// Names or addresses of the router's machine, the one that others connect to first; empty for this machine alone.
    pub hosts: Vec<String>,
    pub port: u16,
    /// Names of the simulation servers, as in `sim-server --name`, all with one key; `NAME-*` stands for any number of them. The
    /// first one is in the commands.
    pub servers: Vec<String>,
    pub authentication: Authentication,
    /// Validity of certificates, days.
    pub days: u16,
    /// Sessions that the policy may have open at once.
    pub sessions: u32,
}

/// Why no keys were made.
#[derive(Debug, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum KeysError {
    #[error("{} exists and is not empty; keys are never overwritten: name another folder, or move this one", .0.display())]
    Exists(PathBuf),
    #[error("cannot make {}; check that its parent exists, its permissions, and the free space", .path.display())]
    Folder { path: PathBuf, source: io::Error },
    #[error("cannot make the keys")]
    Access(#[from] AccessError),
    #[error(
        "--host {0}: a certificate cannot name it; give an address such as 192.168.1.7 or a name such as lab.example.org"
    )]
    Host(String),
    /// Programs would look for the router at an IPv6 address, over QUIC.
    #[error(
        "--host {0}: Zenoh compares no certificate with an IPv6 address; give a name that stands for it first, such as \
         --host localhost --host {0}, or use --auth password"
    )]
    Ipv6(String),
    #[error(
        "--name {0}: a server's name has 1 to 64 letters, digits, - or _; name several with commas, such as lab,lab-2, where \
         NAME-* stands for all whose names begin with NAME-"
    )]
    Server(String),
    #[error("cannot make the certificates")]
    Certificate(#[from] rcgen::Error),
}

#[derive(Debug, Clone, Serialize)]
pub struct CreatedFile {
    pub path: PathBuf,
    /// Whose machine needs it, and what for.
    pub purpose: &'static str,
    /// Only its owner may read it.
    pub secret: bool,
}

/// The created files, and how to start each program with them.
#[derive(Debug, Clone, Serialize)]
pub struct CreatedKeys {
    /// All files, grouped by machine.
    pub files: Vec<CreatedFile>,
    pub authentication: Authentication,
    /// Last day on which the certificates are valid, `YYYY-MM-DD`; `None` without certificates.
    pub valid_until: Option<String>,
    /// Commands that start the programs: router, server, recorder, policy, and the verification of a bag.
    pub commands: Vec<String>,
}

/// Creates the folder with all its files. It appears whole, or not at all.
///
/// # Errors
/// [`KeysError`]; nothing is left behind, and nothing that existed has changed.
pub fn make(options: &KeysOptions) -> Result<CreatedKeys, KeysError> {
    let mut names = BTreeSet::new();
    for name in &options.servers {
        if !is_server_or_group(name) || !names.insert(name) {
            return Err(KeysError::Server(name.clone()));
        }
    }
    if !options.servers.first().is_some_and(|name| is_name(name)) {
        return Err(KeysError::Server(options.servers.join(",")));
    }
    if let Some(host) = options.hosts.iter().find(|host| !is_host(host)) {
        return Err(KeysError::Host(host.clone()));
    }
    // Zenoh 1.10 takes the address with its brackets for a server's name, which TLS refuses.
    if let (Authentication::Certificates, Some(host)) = (options.authentication, options.hosts.first())
        && host.parse::<std::net::Ipv6Addr>().is_ok()
    {
        return Err(KeysError::Ipv6(host.clone()));
    }
    let folder = |source| KeysError::Folder { path: options.out.clone(), source };
    let out = std::path::absolute(&options.out).map_err(folder)?;
    if fs::read_dir(&out).is_ok_and(|mut files| files.next().is_some()) || out.is_file() {
        return Err(KeysError::Exists(options.out.clone()));
    }
    let parent = out.parent().unwrap_or(&out);
    fs::create_dir_all(parent).map_err(folder)?;
    // Not the process's number: containers that share a folder have the same.
    let number = random().map(u64::from_le_bytes).map_err(|error| folder(io::Error::other(error)))?;
    let scratch = parent.join(format!(".fiatlux-keys-{number:016x}"));
    fs::DirBuilder::new().mode(0o700).create(&scratch).map_err(folder)?;
    let made = fill(options, &scratch, &out).and_then(|made| match fs::rename(&scratch, &out) {
        Ok(()) => Ok(made),
        // Another process was faster.
        Err(error) if error.kind() == io::ErrorKind::DirectoryNotEmpty => Err(KeysError::Exists(options.out.clone())),
        Err(source) => Err(folder(source)),
    });
    if made.is_err() {
        drop(fs::remove_dir_all(&scratch));
    }
    made
}

/// Writes all files into a folder that will be moved to `out`.
fn fill(options: &KeysOptions, scratch: &Path, out: &Path) -> Result<CreatedKeys, KeysError> {
    let mut files = Vec::new();
    let mut note = |name: &str, secret, purpose| {
        files.push(CreatedFile { path: options.out.join(name), purpose, secret });
        scratch.join(name)
    };
    let mut valid_until = None;
    let config = |role: Role| match role {
        Role::Router => ("router.json5", "the router: its Zenoh config"),
        Role::Server => ("server.json5", "the server: its Zenoh config"),
        Role::Recorder => ("recorder.json5", "recorder and scorer verify: their Zenoh config"),
        Role::Policy => ("policy.json5", "policies: their Zenoh config"),
    };
    match options.authentication {
        Authentication::Certificates => {
            let authority = Authority::new(&options.hosts, options.days)?;
            for role in Role::ALL {
                let (name, purpose) = config(role);
                let text = configs::with_certificates(role, options, &authority.certificate(role)?);
                write_new(&note(name, true, purpose), &text, 0o600)?;
            }
            write_new(&note("ca.pem", false, "anybody: the authority's certificate"), &authority.pem(), 0o644)?;
            let purpose = "keep offline: signs certificates for any role; move it off this machine, or delete it";
            write_new(&note("ca_key.pem", true, purpose), &authority.key_pem(), 0o600)?;
            valid_until = Some(authority.valid_until());
        }
        Authentication::Passwords => {
            let users = out.join("users");
            let mut list = String::new();
            for role in Role::ALL {
                let (name, purpose) = config(role);
                let password: String = HEXLOWER.encode(&random::<32>()?);
                if role != Role::Router {
                    list += &format!("{}:{password}\n", role.name());
                }
                let text = configs::with_passwords(role, options, &password, &users);
                write_new(&note(name, true, purpose), &text, 0o600)?;
            }
            write_new(
                &note("users", true, "the router: users and passwords; router.json5 has its path"),
                &list,
                0o600,
            )?;
        }
    }

    let identity = Identity::generate()?;
    identity.write(&note("server_identity", true, "the server: the key that proves who it is"))?;
    let known: String = options.servers.iter().map(|name| KnownServers::line(name, &identity.public())).collect();
    write_new(&note("known_servers", false, "policies, recorder: the server's public key"), &known, 0o644)?;
    let token = Token::generate("policy")?;
    let tokens: Tokens = [Grant::new(token.clone(), options.sessions)].into_iter().collect();
    tokens.write(&note("server_tokens", true, "the server: who may open sessions, and how many at once"))?;
    token.write(&note("policy_token", true, "a policy: lets it open sessions"))?;
    RecorderKey::generate()?.write(&note("recorder_key", true, "server and recorder: lets a recorder read rows"))?;

    let path = |name: &str| options.out.join(name).display().to_string();
    let [name, known] = [options.servers.first().cloned().unwrap_or_default(), path("known_servers")];
    let commands = vec![
        format!("fiatlux router -c {}", path("router.json5")),
        format!(
            "sim-server -c {} --name {name} --identity {} --tokens {} --recorder-key {}",
            path("server.json5"),
            path("server_identity"),
            path("server_tokens"),
            path("recorder_key"),
        ),
        format!("recorder -c {} --recorder-key {} --out bags", path("recorder.json5"), path("recorder_key")),
        format!(
            "policy-client run -c {} --server {name} --known-servers {known} --token {} --policy zero --task S08",
            path("policy.json5"),
            path("policy_token"),
        ),
        format!(
            "scorer verify BAG -c {} --server {name} --known-servers {known} --token {}",
            path("recorder.json5"),
            path("policy_token"),
        ),
    ];
    Ok(CreatedKeys { files, authentication: options.authentication, valid_until, commands })
}

/// True if a certificate and an endpoint can name this host: an address, or a name without a port.
fn is_host(host: &str) -> bool {
    let fits = |c: char| c.is_ascii_alphanumeric() || ".-_".contains(c);
    host.parse::<IpAddr>().is_ok() || !host.is_empty() && host.chars().all(fits)
}

#[cfg(test)]
mod tests;
