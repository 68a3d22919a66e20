//! Config of a session: Zenoh's defaults, then a file, then our defaults for keys that the file leaves out, then the
//! flags.

use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

use fiatlux_proto::keys::ServerKeys;
use serde_json::{Value, json};
use zenoh::Config;

use crate::endpoints::{
    CONNECT, LISTEN, advise, check_endpoint, endpoints, get, is_encrypted, is_silent, unknown_host,
};
use crate::error::reason_of;
use crate::honoured;
use crate::{CONNECT_TIMEOUT_S, CarrierArgs, DEFAULT_ENDPOINT, LinkError, LinkMode};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// Waits for others: listens, and keeps trying if it has to connect.
    Server,
    /// Needs a server: connects, and fails if nothing answers.
    Client,
}

/// Maximum size of a message that is assembled from parts, bytes: twice the limit of a message.
const MAX_MESSAGE: usize = 2 * fiatlux_proto::limits::MAX_SERVER_MESSAGE;

const MODE: &str = "mode";

const CONNECT_TIMEOUT: &str = "connect/timeout_ms";
const CONNECT_EXIT: &str = "connect/exit_on_failure";
const CONNECT_RETRY: &str = "connect/retry";

const MULTICAST: &str = "scouting/multicast/enabled";
const GOSSIP: &str = "scouting/gossip/enabled";
const MESSAGE_SIZE: &str = "transport/link/rx/max_message_size";
const TLS: &str = "transport/link/tls";
const DOWNSAMPLING: &str = "downsampling";

/// Config of a session that reaches nobody outside the process.
pub fn embedded() -> Result<Config, LinkError> {
    let mut config = Config::default();
    for (key, value) in [
        (MODE, json!("peer")),
        (LISTEN, json!([])),
        (CONNECT, json!([])),
        (MULTICAST, json!(false)),
        (GOSSIP, json!(false)),
    ] {
        set(&mut config, key, &value)?;
    }
    Ok(config)
}

const MAX_CONFIG_BYTES: u64 = 1 << 20;

/// Config for a program in this role with these options.
pub fn layered(args: &CarrierArgs, role: Role) -> Result<Config, LinkError> {
    let mut config = match &args.config {
        None => Config::default(),
        Some(path) => {
            let refuse = |reason: String| LinkError::ConfigFile { path: path.clone(), reason };
            let text =
                fiatlux_files::read_stream(path, MAX_CONFIG_BYTES).map_err(|source| refuse(source.to_string()))?;
            // Not by Zenoh's own reader of files, whose YAML nobody here can check.
            let config = Config::from_json5(&text).map_err(|source| refuse(reason_of(&source)))?;
            honoured::check_keys(&text, &config).map_err(&refuse)?;
            config
        }
    };
    for (flag, endpoints) in [("--connect", &args.connect), ("--listen", &args.listen)] {
        for endpoint in endpoints {
            let refuse =
                |reason: String| LinkError::Endpoint { flag, endpoint: endpoint.clone(), reason: advise(&reason) };
            check_endpoint(endpoint).map_err(refuse)?;
        }
    }

    if let Some(mode) = args.mode {
        let name = match mode {
            LinkMode::Peer => "peer",
            LinkMode::Client => "client",
            LinkMode::Router => "router",
        };
        set(&mut config, MODE, &json!(name))?;
    }
    // Gossip makes peers connect to each other at addresses that nobody configured.
    set_where_silent(&mut config, MULTICAST, json!(false))?;
    set_where_silent(&mut config, GOSSIP, json!(false))?;
    set_where_silent(&mut config, MESSAGE_SIZE, json!(MAX_MESSAGE))?;
    if args.no_multicast_scouting {
        set(&mut config, MULTICAST, &json!(false))?;
    }

    let scouts = get(&config, MULTICAST) == json!(true);
    let connects = !args.connect.is_empty() || !is_silent(&config, CONNECT);
    let listens = !args.listen.is_empty() || !is_silent(&config, LISTEN);
    // A router passes nothing on between peers that do not gossip, but it does between clients, and between a client
    // and a peer.
    let single = args.connect.len() < 2 && is_silent(&config, CONNECT);
    if (role == Role::Client || connects) && single && !scouts && !listens {
        set_where_silent(&mut config, MODE, json!("client"))?;
    }
    let only_connects = get(&config, MODE) == json!("client");
    if !args.connect.is_empty() {
        set(&mut config, CONNECT, &json!(args.connect))?;
    } else if !connects && !scouts && (role == Role::Client && !listens || only_connects) {
        set(&mut config, CONNECT, &json!([DEFAULT_ENDPOINT]))?;
    }
    if !args.listen.is_empty() {
        set(&mut config, LISTEN, &json!(args.listen))?;
    } else if !listens {
        // A server with an address to connect to is found there; Zenoh's own default would open a port to the world.
        let default = role == Role::Server && !connects && !only_connects;
        set(&mut config, LISTEN, &if default { json!([DEFAULT_ENDPOINT]) } else { json!([]) })?;
    }
    if role == Role::Client {
        set_where_silent(&mut config, CONNECT_TIMEOUT, json!((CONNECT_TIMEOUT_S * 1000.0) as i64))?;
        set_where_silent(&mut config, CONNECT_EXIT, json!(true))?;
        let retry = json!({ "period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2 });
        set_where_silent(&mut config, CONNECT_RETRY, retry)?;
    } else {
        set_where_silent(&mut config, CONNECT_TIMEOUT, json!(-1))?;
        set_where_silent(&mut config, CONNECT_EXIT, json!(false))?;
    }
    honoured::check(&config)?;
    check_certificates(&config)?;
    Ok(config)
}

/// Drops what others publish in the place of this server before it is passed on: on these topics nothing but its own messages
/// counts, which do not arrive over a link. A rate of 0 drops all, and unlike a rule of access control it meets keys with
/// wildcards, too.
pub fn drop_forged(config: &mut Config, server: &str) -> Result<(), LinkError> {
    let session = ServerKeys::new(server).session("*");
    let own = [session.observation(), session.notice(), session.truth_row()];
    let rules: Vec<Value> = own.iter().map(|key| json!({ "key_expr": key, "freq": 0.0 })).collect();
    let drop = json!({
        "id": format!("published by {server} alone"), "flows": ["ingress"], "messages": ["put", "delete"], "rules": rules,
    });
    let mut items = get(config, DOWNSAMPLING).as_array().cloned().unwrap_or_default();
    items.push(drop);
    set(config, DOWNSAMPLING, &Value::Array(items))
}

/// Refuses an encrypted endpoint without a certificate in the config. A server to connect to may have a certificate of
/// a public authority, so there only mutual TLS needs one in the config.
fn check_certificates(config: &Config) -> Result<(), LinkError> {
    let has = |key: &str| {
        [key.to_owned(), format!("{key}_base64")].iter().any(|key| !get(config, &format!("{TLS}/{key}")).is_null())
    };
    let mutual = get(config, &format!("{TLS}/enable_mtls")) == true;
    for (setting, side, is_needed) in [(LISTEN, "listen", true), (CONNECT, "connect", mutual)] {
        let encrypted = endpoints(&get(config, setting)).into_iter().find(|endpoint| is_encrypted(endpoint));
        let Some(endpoint) = encrypted.filter(|_| is_needed) else { continue };
        // An endpoint may carry its own: quic/HOST:PORT#listen_certificate_file=...
        let own = endpoint.split_once('#').map_or("", |(_, own)| own);
        for part in ["certificate", "private_key"] {
            let key = format!("{side}_{part}");
            if !has(&key) && !own.contains(&key) {
                return Err(LinkError::Certificate { endpoint, key: format!("{TLS}/{key}") });
            }
        }
    }
    Ok(())
}

/// The endpoints where a session with this config listens, or else connects.
pub fn place(config: &Config) -> String {
    let [listens, connects] = [LISTEN, CONNECT].map(|key| endpoints(&get(config, key)).join(", "));
    if listens.is_empty() { format!("connected to {connects}") } else { format!("listening on {listens}") }
}

/// Words in the messages of Zenoh and its TLS library that point to wrong certificates.
const TLS_FAILURES: &[&str] = &["certificate", "private key"];

/// Time limit of the check whether a port is open.
const PROBE: Duration = Duration::from_secs(1);

/// The endpoints of a config, to explain a failure.
#[derive(Debug)]
pub struct EndpointPlan {
    connect: String,
    listen: String,
    timeout_s: f64,
}

impl EndpointPlan {
    pub fn of(config: &Config) -> Self {
        let timeout_s = get(config, CONNECT_TIMEOUT).as_f64().unwrap_or(0.0) / 1000.0;
        let [connect, listen] = [CONNECT, LISTEN].map(|key| endpoints(&get(config, key)).join(", "));
        Self { connect, listen, timeout_s }
    }

    /// True if the session tries to connect for so long that it should be logged. A client soon gives up with an error.
    pub fn is_patient(&self) -> bool {
        !(0.0..=CONNECT_TIMEOUT_S).contains(&self.timeout_s)
    }

    /// The peers that the session waits for, for a line in the log.
    pub fn peers(&self) -> String {
        match self.is_answered() {
            true => {
                format!("{}, which answers, but opens no session; check user and password", self.connect)
            }
            false => format!("{}, which does not answer; check the address, and that its program runs", self.connect),
        }
    }

    /// True if a TCP port that the session should connect to is open.
    fn is_answered(&self) -> bool {
        let mut places = self.connect.split(", ").filter_map(|endpoint| endpoint.strip_prefix("tcp/"));
        places.any(|place| {
            let addresses = place.split(['?', '#']).next().unwrap_or(place).to_socket_addrs();
            addresses.is_ok_and(|mut all| all.any(|at| TcpStream::connect_timeout(&at, PROBE).is_ok()))
        })
    }

    /// The error of a program that is stopped while it waits.
    pub fn stopped(&self) -> LinkError {
        LinkError::Stopped { endpoints: self.connect.clone() }
    }

    /// Turns Zenoh's message into an error with a remedy.
    pub fn explain(&self, reason: &str) -> LinkError {
        let reason = reason_of(&reason);
        let text = reason.to_lowercase();
        if TLS_FAILURES.iter().any(|part| text.contains(part)) {
            return LinkError::Tls {
                endpoints: [self.listen.as_str(), self.connect.as_str()].join(" ").trim().to_owned(),
                reason,
            };
        }
        for (flag, endpoints) in [("--listen", &self.listen), ("--connect", &self.connect)] {
            if let Some((endpoint, host)) = unknown_host(endpoints) {
                let reason = format!("the host '{host}' is not known; check its name, or give its address");
                return LinkError::Endpoint { flag, endpoint: endpoint.into(), reason };
            }
        }
        if !self.listen.is_empty() && (text.contains("listener") || text.contains("address already in use")) {
            return LinkError::Listen { endpoints: self.listen.clone(), reason };
        }
        if !self.connect.is_empty() && (text.contains("connect") || text.contains("timeout")) {
            if self.is_answered() {
                return LinkError::Refused { endpoints: self.connect.clone() };
            }
            // Zenoh only logs the reason of a failed handshake, and reports a time-out.
            let tls = if self.connect.split(", ").any(is_encrypted) {
                "; or the certificates do not match or are expired: RUST_LOG=zenoh=warn shows more"
            } else {
                ""
            };
            let reason = reason + tls;
            return LinkError::Connect { endpoints: self.connect.clone(), timeout_s: self.timeout_s, reason };
        }
        LinkError::Open { reason }
    }
}

fn set_where_silent(config: &mut Config, key: &'static str, value: Value) -> Result<(), LinkError> {
    if is_silent(config, key) { set(config, key, &value) } else { Ok(()) }
}

fn set(config: &mut Config, key: &'static str, value: &Value) -> Result<(), LinkError> {
    let value = value.to_string();
    config.insert_json5(key, &value).map_err(|source| LinkError::Setting { key, value, reason: reason_of(&source) })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(args: &CarrierArgs, role: Role) -> [Value; 4] {
        let config = layered(args, role).expect("layers");
        [CONNECT, LISTEN, MULTICAST, GOSSIP].map(|key| get(&config, key))
    }

    #[test]
    fn nothing_leaves_the_loopback_interface_unless_asked() {
        let none = CarrierArgs::default();
        assert_eq!(settings(&none, Role::Server), [json!([]), json!([DEFAULT_ENDPOINT]), json!(false), json!(false)]);
        assert_eq!(settings(&none, Role::Client), [json!([DEFAULT_ENDPOINT]), json!([]), json!(false), json!(false)]);
        let client = CarrierArgs { mode: Some(LinkMode::Client), ..CarrierArgs::default() };
        assert_eq!(settings(&client, Role::Server)[..2], [json!([DEFAULT_ENDPOINT]), json!([])]);
    }

    #[test]
    fn a_config_is_json5_of_bounded_size() {
        let path = std::env::temp_dir().join(format!("fiatlux-link-{}.yaml", std::process::id()));
        let read = |text: &str| {
            std::fs::write(&path, text).expect("written");
            let args = CarrierArgs { config: Some(path.clone()), ..CarrierArgs::default() };
            layered(&args, Role::Client).map(|config| get(&config, MODE)).map_err(|error| error.to_string())
        };
        assert_eq!(read("// JSON5 whatever it is called\n{mode: 'client'}"), Ok(json!("client")));
        for (text, reason) in [
            ("mode: client", "write json5"),
            (&" ".repeat(MAX_CONFIG_BYTES as usize + 1), "it has more than 1048576 bytes"),
        ] {
            let message = read(text).expect_err(text);
            assert!(message.contains(reason), "{message}");
        }
        std::fs::remove_file(path).expect("removed");
        let absent = CarrierArgs { config: Some("absent.json5".into()), ..CarrierArgs::default() };
        assert!(layered(&absent, Role::Client).is_err());
    }

    /// With one server a client goes through the peer or router that it is connected to; several servers are reached only as a peer.
    #[test]
    fn the_mode_follows_from_the_endpoints() {
        let mode = |endpoints: &[&str], mode, role| {
            let connect = endpoints.iter().map(ToString::to_string).collect();
            get(&layered(&CarrierArgs { connect, mode, ..CarrierArgs::default() }, role).expect("layers"), MODE)
        };
        let (one, two) = (["tcp/10.0.0.1:1"], ["tcp/10.0.0.1:1", "tcp/10.0.0.2:1"]);
        assert_eq!([mode(&[], None, Role::Client), mode(&one, None, Role::Client)], [json!("client"), json!("client")]);
        assert_eq!([mode(&one, None, Role::Server), mode(&[], None, Role::Server)], [json!("client"), Value::Null]);
        assert_eq!(mode(&two, None, Role::Client), Value::Null);
        assert_eq!(mode(&one, Some(LinkMode::Peer), Role::Client), json!("peer"));
    }

    #[test]
    fn flags_go_before_the_file_and_the_file_before_the_defaults() {
        let path = std::env::temp_dir().join(format!("fiatlux-link-{}.json5", std::process::id()));
        let text = "{ listen: { endpoints: ['tcp/127.0.0.1:7001'] }, scouting: { multicast: { enabled: true } } }";
        std::fs::write(&path, text).expect("writes");
        let file = CarrierArgs { config: Some(path.clone()), ..CarrierArgs::default() };
        let listen = json!(["tcp/127.0.0.1:7001"]);
        assert_eq!(settings(&file, Role::Server), [json!([]), listen.clone(), json!(true), json!(false)]);
        let connect = vec!["tcp/10.0.0.1:7447".to_string()];
        let flags = CarrierArgs { connect: connect.clone(), no_multicast_scouting: true, ..file };
        assert_eq!(settings(&flags, Role::Server), [json!(connect), listen, json!(false), json!(false)]);
        std::fs::remove_file(path).expect("removes");
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (endpoint, part) in [
            ("tcp", "is not an endpoint"),
            ("ws/127.0.0.1:7447", "the protocol ws is not built in"),
            ("tls/lab:1", "quic/ is TLS 1.3"),
            ("tcp/lab", "lab has no port"),
            ("tcp/lab:99999", "the port '99999' is not a number from 0 to 65535"),
            ("quic/lab:x", "the port 'x' is not a number"),
            ("tcp/:7447", "the host is missing"),
            ("tcp/::1:7447", "the host '::1' needs brackets: [::1]:7447"),
            ("tcp/[::1x]:7447", "the host '[::1x]' is not an IPv6 address"),
        ] {
            let args = CarrierArgs { connect: vec![endpoint.to_string()], ..CarrierArgs::default() };
            let message = layered(&args, Role::Client).expect_err("refused").to_string();
            assert!(message.contains(endpoint) && message.contains(part), "{message}");
        }
        let plan = EndpointPlan { connect: String::new(), listen: "tcp/no.such.invalid:1".into(), timeout_s: 0.0 };
        let message = plan.explain("whatever").to_string();
        assert!(
            message.starts_with("--listen tcp/no.such.invalid:1: the host 'no.such.invalid' is not known"),
            "{message}"
        );
        for fit in ["tcp/[::1]:7447", "quic/lab:1#iface=lo", "tcp/0.0.0.0:0?rel=1", "unixsock-stream//tmp/x"] {
            check_endpoint(fit).expect(fit);
        }
        let args = CarrierArgs { config: Some("/nowhere/zenoh.json5".into()), ..CarrierArgs::default() };
        let message = layered(&args, Role::Client).expect_err("refused").to_string();
        assert!(message.starts_with("/nowhere/zenoh.json5: "), "{message}");
    }
}
