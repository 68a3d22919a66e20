//! The page over TLS, for headsets on the network.

use std::fs;
use std::io::{Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use fiatlux_teleop::{Cockpit, Station};
use fiatlux_tls::{Certificate, Tls};
use rustls::crypto::ring::default_provider;
use rustls::pki_types::{CertificateDer, ServerName};
use rustls::{ClientConfig, ClientConnection, RootCertStore, StreamOwned};
use tungstenite::Message;

/// Longer than a handshake may take.
const AFTER_HANDSHAKE: Duration = Duration::from_secs(20);

struct Served {
    port: u16,
    token: String,
    trust: Arc<ClientConfig>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

type Stream = StreamOwned<ClientConnection, TcpStream>;

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("tls").join(name);
    let _ = fs::remove_dir_all(&folder);
    folder
}

fn open(folder: &Path, hosts: &[&str]) -> Result<Certificate, String> {
    let hosts: Vec<String> = hosts.iter().map(|host| (*host).to_owned()).collect();
    Certificate::open(folder, &hosts, &[]).map_err(|error| {
        let source = std::error::Error::source(&error).map(|source| format!(": {source}")).unwrap_or_default();
        format!("{error}{source}")
    })
}

impl Served {
    fn start(name: &str) -> Self {
        let certificate = open(&folder(name), &["127.0.0.1"]).expect("a certificate");
        let tls = Tls::new(&certificate);
        let any = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
        let cockpit = Cockpit::bind(any, &[], Arc::new(Station::default())).expect("a free port");
        let names = vec!["127.0.0.1".into(), "lab.local".into()];
        let cockpit = cockpit.over_tls(names, Box::new(move |stream| Box::pin(tls.clone().accept(stream))));
        let url = cockpit.url();
        let (port, token) =
            url.strip_prefix("https://127.0.0.1:").and_then(|url| url.split_once("/?token=")).expect("a url");
        let mut roots = RootCertStore::empty();
        roots.add(CertificateDer::from(certificate.der().to_vec())).expect("a certificate");
        let trust = ClientConfig::builder_with_provider(Arc::new(default_provider()))
            .with_safe_default_protocol_versions()
            .expect("versions")
            .with_root_certificates(roots)
            .with_no_client_auth();
        let stop = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&stop);
        let (port, token) = (port.parse().expect("a port"), token.to_owned());
        let thread = std::thread::spawn(move || cockpit.serve(&flag).expect("it serves"));
        Self { port, token, trust: Arc::new(trust), stop, thread: Some(thread) }
    }

    fn tcp(&self) -> TcpStream {
        let stream = TcpStream::connect((Ipv4Addr::LOCALHOST, self.port)).expect("it listens");
        stream.set_read_timeout(Some(AFTER_HANDSHAKE)).expect("set");
        stream
    }

    fn tls(&self) -> Stream {
        self.tls_over(self.tcp())
    }

    fn tls_over(&self, tcp: TcpStream) -> Stream {
        let name = ServerName::try_from("127.0.0.1").expect("a name");
        StreamOwned::new(ClientConnection::new(Arc::clone(&self.trust), name).expect("a client"), tcp)
    }

    fn get(&self, path: &str) -> (u16, String) {
        self.get_as(path, &format!("127.0.0.1:{}", self.port))
    }

    fn get_as(&self, path: &str, host: &str) -> (u16, String) {
        let mut stream = self.tls();
        let request = format!("GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
        stream.write_all(request.as_bytes()).expect("sent");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).expect("an answer that ends as TLS does");
        let code = answer.split(' ').nth(1).and_then(|code| code.parse().ok()).expect("a code");
        (code, answer)
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let ended = self.thread.take().map(JoinHandle::join);
        assert!(std::thread::panicking() || ended.is_none_or(|ended| ended.is_ok()), "the server panicked");
    }
}

/// The server has closed this connection.
fn is_closed(stream: &mut TcpStream) -> bool {
    let mut rest = Vec::new();
    match stream.read_to_end(&mut rest) {
        Ok(_) => true,
        Err(error) => error.kind() == std::io::ErrorKind::ConnectionReset,
    }
}

#[test]
fn the_page_and_its_socket_are_served_over_tls_to_whoever_has_the_token() {
    let served = Served::start("page");
    let with = format!("/?token={}", served.token);
    let (code, page) = served.get(&with);
    assert_eq!(code, 200);
    assert!(page.contains("<html"), "{page}");
    assert_eq!(served.get("/").0, 403);
    assert_eq!(served.get(&format!("/?token={}", "0".repeat(served.token.len()))).0, 403);
    // Larger than what TLS and the server hold between them.
    let (code, script) = served.get("/page/stage.js");
    assert_eq!(code, 200);
    assert!(!script.is_empty());
    let refused = tungstenite::client(format!("ws://127.0.0.1:{}/drive", served.port), served.tls());
    assert!(refused.is_err_and(|error| error.to_string().contains("403")));
    let url = format!("ws://127.0.0.1:{}/drive?token={}", served.port, served.token);
    let (mut socket, _) = tungstenite::client(url, served.tls()).expect("admitted");
    socket.send(Message::text(r#"{"input":"mouse","data":{}}"#)).expect("sent");
    loop {
        if let Message::Text(text) = socket.read().expect("a message")
            && text.contains("problem\":\"")
            && text.contains("keyboard")
        {
            break;
        }
    }
}

#[test]
fn plain_http_is_told_to_use_https() {
    let served = Served::start("plain");
    let mut stream = served.tcp();
    write!(stream, "GET /?token={} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n", served.token).expect("sent");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("an answer");
    assert!(answer.starts_with("HTTP/1.1 400 ") && answer.contains("https://"), "{answer}");
    assert!(!answer.contains("<html"));
}

/// Connections that say nothing, half a handshake, or garbage, and those that shake hands and then say nothing.
#[test]
fn half_handshakes_and_idle_connections_end_and_hold_nobody_up() {
    let served = Served::start("idle");
    let mut silent: Vec<TcpStream> = (0..6).map(|_| served.tcp()).collect();
    for round in 0..6_u8 {
        let mut stream = served.tcp();
        // A record of a handshake that is longer than what follows.
        stream.write_all(&[0x16, 3, 1, 2, 0, 1, round]).expect("sent");
        silent.push(stream);
    }
    let mut garbage = served.tcp();
    garbage.write_all(&[0x16; 64]).expect("sent");
    assert!(is_closed(&mut garbage));
    let mut idle = served.tls();
    while idle.conn.is_handshaking() {
        idle.conn.complete_io(&mut idle.sock).expect("a handshake");
    }
    let asked = Instant::now();
    assert_eq!(served.get("/").0, 403);
    assert!(asked.elapsed() < Duration::from_secs(4), "others wait for the silent ones: {:?}", asked.elapsed());
    for stream in &mut silent {
        assert!(is_closed(stream), "a half handshake is still open");
    }
    assert!(is_closed(&mut idle.sock), "an idle connection is still open");
}

/// Guards the network's page against other pages that lead their own name here.
#[test]
fn only_own_names_are_answered_on_the_network() {
    let served = Served::start("names");
    let path = format!("/?token={}", served.token);
    for (host, expected) in [("lab.local:8443", 200), ("192.168.1.9", 200), ("localhost:1", 200), ("evil.example", 421)]
    {
        assert_eq!(served.get_as(&path, host).0, expected, "{host}");
    }
}

#[test]
fn too_many_connections_push_out_the_oldest_and_let_the_newest_in() {
    let served = Served::start("many");
    let mut open: Vec<TcpStream> = (0..128).map(|_| served.tcp()).collect();
    let asked = Instant::now();
    assert_eq!(served.get(&format!("/?token={}", served.token)).0, 200);
    assert!(asked.elapsed() < Duration::from_secs(4), "it waits for the others: {:?}", asked.elapsed());
    assert!(is_closed(&mut open[0]) && asked.elapsed() < Duration::from_secs(4), "the oldest is still open");
}

/// A connection from another address of this machine.
fn tcp_from(last: u8, port: u16) -> std::io::Result<TcpStream> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let stream = runtime.block_on(async {
        let socket = tokio::net::TcpSocket::new_v4()?;
        socket.bind(SocketAddr::from(([127, 0, 1, last], 0)))?;
        socket.connect(SocketAddr::from((Ipv4Addr::LOCALHOST, port))).await
    })?;
    let stream = stream.into_std()?;
    stream.set_nonblocking(false)?;
    stream.set_read_timeout(Some(Duration::from_secs(2)))?;
    Ok(stream)
}

/// Guards the operator against a network whose machines ask without the token, over and over.
#[test]
fn refused_requests_of_many_addresses_keep_nobody_out() {
    let served = Served::start("flood");
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        for last in 1..=32 {
            let (served, stop) = (&served, &stop);
            scope.spawn(move || {
                while !stop.load(Ordering::Relaxed) {
                    let Ok(tcp) = tcp_from(last, served.port) else { continue };
                    let mut stream = served.tls_over(tcp);
                    drop(stream.write_all(b"GET /?token=0 HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"));
                    drop(stream.read_to_end(&mut Vec::new()));
                }
            });
        }
        std::thread::sleep(Duration::from_millis(500));
        let asked = Instant::now();
        let is_served = (0..5).map(|_| served.get(&format!("/?token={}", served.token)).0).all(|code| code == 200);
        let took = asked.elapsed();
        stop.store(true, Ordering::Relaxed);
        assert!(is_served && took < Duration::from_secs(10), "five pages took {took:?}");
        println!("five pages took {took:?}");
    });
}

#[test]
fn a_certificate_is_kept_and_a_bad_one_is_refused_by_name() {
    let place = folder("kept");
    let first = open(&place, &["192.168.1.7", "lab.local"]).expect("made");
    assert!(first.is_new());
    let again = open(&place, &["lab.local"]).expect("kept");
    assert!(!again.is_new());
    assert_eq!(first.fingerprint(), again.fingerprint());
    assert_eq!(first.fingerprint().len(), 32 * 3 - 1);
    let refused = |hosts: &[&str]| open(&place, hosts).err().expect("refused");

    let other = refused(&["192.168.1.8"]);
    assert!(other.contains("certificate.pem: the certificate does not name 192.168.1.8; move the folder"), "{other}");
    assert!(refused(&["not a name"]).contains("give an address"));

    let text = fs::read_to_string(place.join("certificate.pem")).expect("a certificate");
    let (certificate_path, key_path) = (place.join("certificate.pem"), place.join("key.pem"));
    let hosts = ["lab.local"];
    for broken in
        ["", "-----BEGIN CERTIFICATE-----\n", "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n"]
    {
        fs::write(&certificate_path, broken).expect("written");
        let said = refused(&hosts);
        assert!(said.contains("certificate.pem: ") && said.contains("move the folder"), "{said}");
    }
    fs::write(&certificate_path, &text).expect("written");

    fs::write(&key_path, "").expect("written");
    assert!(refused(&hosts).contains("key.pem: no private key"));
    let stranger = rcgen::KeyPair::generate().expect("a key");
    fs::write(&key_path, stranger.serialize_pem()).expect("written");
    let said = refused(&hosts);
    assert!(said.contains("key.pem: the key is not that of certificate.pem; move"), "{said}");
    fs::remove_file(&key_path).expect("removed");
    let said = refused(&hosts);
    assert!(said.contains("key.pem") && said.contains("move that folder away"), "{said}");

    let mut params = rcgen::CertificateParams::new(vec!["lab.local".to_owned()]).expect("a name");
    let now = time::OffsetDateTime::now_utc();
    for (from, until, problem) in [(-3, -1, "has expired"), (1, 3, "not valid yet")] {
        (params.not_before, params.not_after) = (now + time::Duration::days(from), now + time::Duration::days(until));
        fs::write(&certificate_path, params.self_signed(&stranger).expect("signed").pem()).expect("written");
        fs::write(&key_path, stranger.serialize_pem()).expect("written");
        make_private(&key_path);
        let said = refused(&hosts);
        assert!(said.contains(problem) && said.contains("move the folder"), "{said}");
    }
}

#[test]
fn a_key_that_others_can_read_is_refused() {
    use std::os::unix::fs::PermissionsExt as _;
    let place = folder("exposed");
    open(&place, &["localhost"]).expect("made");
    fs::set_permissions(place.join("key.pem"), fs::Permissions::from_mode(0o644)).expect("set");
    let said = open(&place, &["localhost"]).err().expect("refused");
    assert!(said.contains("key.pem") && said.contains("move that folder away"), "{said}");
}

fn make_private(path: &Path) {
    use std::os::unix::fs::PermissionsExt as _;
    fs::set_permissions(path, fs::Permissions::from_mode(0o600)).expect("set");
}
