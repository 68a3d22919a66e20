//! Access control over real processes: what `fiatlux keys` makes lets each part do its work through a real router, and lets
//! nobody else do any.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use fiatlux_access::{Greeting, KnownServers, SignedReply, Token, proof};
use fiatlux_proto::keys::{ROOT, ServerKeys};
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{Notice, Observation, OpenReply, OpenRequest, SessionInfo, StepRecordAck, open_reply};
use fiatlux_proto::{Message, PROTOCOL};
use fiatlux_tests::programs::{PATIENCE, Running, Scratch, free_port, played, wait_until};
use zenoh::query::Query;
use zenoh::sample::{Locality, Sample};
use zenoh::{Config, Session, Wait};

/// Task S08 lasts two minutes of simulated time: long enough to be interfered with.
const EPISODE: [&str; 4] = ["--json", "--recorded", "--seed", "0"];

fn set(args: &mut [String], option: &str, name: &str, value: &str) {
    let at = args.iter().position(|arg| arg == option).unwrap_or_else(|| panic!("no {option} in {args:?}"));
    (args[at], args[at + 1]) = (name.into(), value.into());
}

/// A router with the keys that one command made, and a server behind it; with certificates the server records, with passwords
/// a recorder does. All are started by the command lines that the command writes.
struct Installation {
    _others: Vec<Running>,
    keys: PathBuf,
    commands: Vec<Vec<String>>,
    port: u16,
    /// Declared last, so that it is dropped after its users.
    folder: Scratch,
}

/// Places in the list of commands.
const ROUTER: usize = 0;
const SERVER: usize = 1;
const RECORDER: usize = 2;
const POLICY: usize = 3;
const VERIFY: usize = 4;

impl Installation {
    fn start(name: &str, auth: &str) -> Self {
        let folder = Scratch::new(name);
        let port = free_port();
        let keys = folder.path().join("keys");
        let (out, port_arg) = (keys.display().to_string(), port.to_string());
        let args = ["keys", "--out", &out, "--name", "test", "--port", &port_arg, "--auth", auth, "--json"];
        let mut command = Running::start("fiatlux", &args, &folder);
        let (status, text) = command.finish(PATIENCE);
        assert!(status.success(), "{}", command.log());
        let made: serde_json::Value = serde_json::from_str(&text).unwrap();
        let commands = made["commands"].as_array().unwrap().iter().map(|line| {
            let words = line.as_str().unwrap().split(' ').map(str::to_owned);
            words.collect::<Vec<_>>()
        });
        let mut installation = Self { _others: Vec::new(), keys, commands: commands.collect(), port, folder };
        assert_eq!(installation.commands.len(), 5);
        let mut router = installation.run(ROUTER, |_| ());
        router.wait_for("listening on");
        let bags = installation.folder.path().join("bags").display().to_string();
        let mut server = installation.run(SERVER, |args| {
            if auth == "mtls" {
                set(args, "--recorder-key", "--record", &bags);
            }
        });
        server.wait_for("as test");
        installation._others = vec![server, router];
        if auth != "mtls" {
            installation._others.push(installation.run(RECORDER, |args| set(args, "--out", "--out", &bags)));
        }
        installation
    }

    /// Starts a program by its command line, after a change to the options.
    fn run(&self, command: usize, change: impl FnOnce(&mut Vec<String>)) -> Running {
        let (program, options) = self.commands[command].split_first().unwrap();
        let mut options = options.to_vec();
        change(&mut options);
        let options: Vec<&str> = options.iter().map(String::as_str).collect();
        Running::start(program, &options, &self.folder)
    }

    fn client(&self) -> Running {
        self.run(POLICY, |args| args.extend(EPISODE.map(str::to_owned)))
    }

    fn token(&self) -> Token {
        Token::read(&self.keys.join("policy_token")).unwrap()
    }

    fn known(&self) -> KnownServers {
        KnownServers::read(&self.keys.join("known_servers")).unwrap()
    }

    /// A peer that has a part's config, without the rules that it would hold itself to.
    fn stranger_with(&self, name: &str) -> Session {
        let mut config = Config::from_file(self.keys.join(name)).unwrap();
        let open = r#"{enabled: false, default_permission: "allow", rules: null, subjects: null, policies: null}"#;
        config.insert_json5("access_control", open).unwrap();
        config.insert_json5("connect/timeout_ms", "5000").unwrap();
        zenoh::open(config).wait().unwrap()
    }

    fn connects(&self, config: &str) -> bool {
        let mut config = Config::from_json5(config).unwrap();
        for (key, value) in [
            ("mode", "\"client\""),
            ("scouting/multicast/enabled", "false"),
            ("connect/timeout_ms", "1500"),
            ("connect/exit_on_failure", "true"),
        ] {
            config.insert_json5(key, value).unwrap();
        }
        zenoh::open(config).wait().is_ok()
    }
}

/// All that arrives on a key.
fn subscribe(link: &Session, key: &str) -> Receiver<String> {
    let (sender, receiver) = channel();
    let callback = move |sample: Sample| drop(sender.send(sample.key_expr().to_string()));
    let subscriber = link.declare_subscriber(key.to_owned()).allowed_origin(Locality::Remote);
    subscriber.callback(callback).background().wait().unwrap();
    receiver
}

/// A policy that means harm: it may play, and get nothing else. What it does must not change what another policy sees.
fn cheats_in_vain(installation: &Installation) {
    let undisturbed = played(&mut installation.client());
    let stranger = installation.stranger_with("policy.json5");
    let keys = ServerKeys::new("test");
    let any = ServerKeys::new("*").session("*");

    let everything = subscribe(&stranger, "**");
    let rows = subscribe(&stranger, &any.truth_row());
    let below = subscribe(&stranger, &format!("{ROOT}/test/s/*/**"));
    // Another link: what arrives on one goes to all that it subscribes to.
    let watcher = installation.stranger_with("policy.json5");
    let observations = subscribe(&watcher, &any.observation());
    let (caught, queries) = channel();
    for key in [keys.open(), keys.describe(), any.reset(), any.look(), any.truth_rows(), "**".into()] {
        let caught = caught.clone();
        let callback = move |query: Query| {
            drop(caught.send(query.key_expr().to_string()));
            drop(query.reply(query.key_expr().clone(), "forged").wait());
        };
        let queryable = stranger.declare_queryable(key).complete(true).allowed_origin(Locality::Remote);
        queryable.callback(callback).background().wait().unwrap();
    }
    let _alive = stranger.liveliness().declare_token(ServerKeys::new("forged").alive()).wait().unwrap();

    let mut client = installation.client();
    let first =
        observations.recv_timeout(PATIENCE).expect("a policy may see observations: they are told apart by session");
    let (session, _, name) = fiatlux_proto::keys::SessionKeys::of(&first).unwrap();
    assert_eq!(ServerKeys::new("test").session(name), session);
    let forged = Notice { message: "forged".into(), ..Notice::default() }.encode_to_vec();
    let ack = StepRecordAck { recorder: "liar".into(), next_seq: 1 << 32, ..StepRecordAck::default() }.encode_to_vec();
    let observation = Observation { episode: 0, step: 5, ..Observation::default() }.encode_to_vec();
    while client.is_running() {
        stranger.put(session.notice(), forged.clone()).wait().unwrap();
        stranger.put(session.observation(), observation.clone()).wait().unwrap();
        stranger.put(session.truth_row(), vec![0; 100]).wait().unwrap();
        stranger.put(session.truth_ack(), ack.clone()).wait().unwrap();
        stranger.delete(session.observation()).wait().unwrap();
        std::thread::sleep(Duration::from_millis(20));
    }
    let disturbed = played(&mut client);
    assert_eq!(disturbed, undisturbed, "the same episode");
    assert!(!client.log().contains("forged"), "{}", client.log());
    for (what, heard) in [("**", &everything), ("rows", &rows), ("all of a session", &below)] {
        assert_eq!(heard.try_iter().count(), 0, "a policy hears {what}");
    }
    assert_eq!(queries.try_iter().collect::<Vec<_>>(), [""; 0], "no query goes to a policy");
    let rows = stranger.get(session.truth_rows()).timeout(Duration::from_secs(1)).wait().unwrap();
    assert_eq!(rows.iter().filter(|reply| reply.result().is_ok()).count(), 0, "rows are not for policies");
    let servers = stranger.liveliness().get(fiatlux_proto::keys::any_alive()).wait().unwrap();
    let servers: Vec<_> =
        servers.iter().filter_map(|reply| Some(reply.result().ok()?.key_expr().to_string())).collect();
    let others = installation.stranger_with("recorder.json5");
    let seen = others.liveliness().get(fiatlux_proto::keys::any_alive()).wait().unwrap();
    let seen: Vec<_> = seen.iter().filter_map(|reply| Some(reply.result().ok()?.key_expr().to_string())).collect();
    assert_eq!(seen, [keys.alive()], "nobody else passes for a server; to itself it is {servers:?}");

    // It may open a session of its own, as any policy: with a token, and no more of them than that grants.
    assert_eq!(open(&others, None).unwrap_err().0, Code::Denied);
    let guess = Token::generate("policy").unwrap();
    assert_eq!(open(&others, Some(&guess)).unwrap_err().0, Code::Denied);
    open(&others, Some(&installation.token())).unwrap();

    wait_until("both episodes are recorded", PATIENCE, || installation.folder.files(".mcap").len() >= 2);
    for bag in installation.folder.files(".mcap") {
        let mut scorer = installation.run(VERIFY, |args| {
            let place = args.iter_mut().find(|arg| *arg == "BAG").unwrap();
            *place = bag.display().to_string();
            args.extend(["--signers".into(), installation.keys.join("known_servers").display().to_string()]);
        });
        let (status, text) = scorer.finish(PATIENCE);
        let is_signed = text.lines().last().is_some_and(|line| line.starts_with("signed by test, ed25519:"));
        assert!(status.success() && text.starts_with("equal: ") && is_signed, "{text}\n{}", scorer.log());
    }
    keys_are_looked_at(installation);
}

/// A server of another key, a client without a token or with a guessed one, and a recorder of another key: each is told so.
fn keys_are_looked_at(installation: &Installation) {
    let other = installation.folder.path().join("strangers").display().to_string();
    let mut made = Running::start("fiatlux", &["keys", "--out", &other, "--name", "test"], &installation.folder);
    assert!(made.finish(PATIENCE).0.success());
    type Change = Box<dyn Fn(&mut Vec<String>)>;
    let drop_token = |args: &mut Vec<String>| {
        let at = args.iter().position(|arg| arg == "--token").unwrap();
        args.drain(at..at + 2);
    };
    let (known, token) = (format!("{other}/known_servers"), format!("{other}/policy_token"));
    let key = installation.known().key_of("test").unwrap().to_string();
    let foreign = KnownServers::read(Path::new(&known)).unwrap().key_of("test").unwrap().to_string();
    let cases: [(Change, Option<&str>); 5] = [
        (Box::new(move |args| set(args, "--known-servers", "--known-servers", &known)), Some("the server's key is")),
        (Box::new(move |args| set(args, "--known-servers", "--server-key", &foreign)), Some("the server's key is")),
        (Box::new(move |args| set(args, "--known-servers", "--server-key", &key)), None),
        (Box::new(move |args| set(args, "--token", "--token", &token)), Some("holders of its tokens")),
        (Box::new(drop_token), Some("holders of its tokens")),
    ];
    for (change, refusal) in cases {
        let mut client = installation.run(POLICY, |args| {
            set(args, "--task", "--task", "S07");
            change(args);
        });
        let (status, _) = client.finish(PATIENCE);
        assert_eq!(status.success(), refusal.is_none(), "{}", client.log());
        assert!(refusal.is_none_or(|words| client.log().contains(words)), "{}", client.log());
    }
    if installation.commands[SERVER].iter().any(|arg| arg == "--recorder-key") {
        let (key, out) = (format!("{other}/recorder_key"), format!("{other}/bags"));
        let recorder = installation.run(RECORDER, |args| {
            set(args, "--recorder-key", "--recorder-key", &key);
            set(args, "--out", "--out", &out);
        });
        played(&mut installation.client());
        let made = fs::read_dir(&out).unwrap().map(|entry| entry.unwrap().file_name());
        assert_eq!(made.collect::<Vec<_>>(), ["recorder.lock"], "it can read no record");
        assert!(recorder.log().contains("ignoring sessions announced as server test's"), "{}", recorder.log());
    }
}

/// Tries to get round the rights of an installation from another language. `FIATLUX_PYTHON` names a Python with the packages of
/// `docs/client.requirements.txt`.
fn python_cheats_in_vain(installation: &Installation) {
    let python = std::env::var_os("FIATLUX_PYTHON").expect("FIATLUX_PYTHON names a Python; tests/run makes one");
    let checks = Path::new(env!("CARGO_MANIFEST_DIR")).join("oracle/access.py");
    let done = Command::new(python).arg(checks).arg(&installation.keys).arg("test").output().unwrap();
    let [said, log] = [&done.stdout, &done.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
    assert!(done.status.success() && said.lines().count() == 8, "{said}{log}");
}

/// Opens a session; the answer's signature is checked.
fn open(link: &Session, token: Option<&Token>) -> Result<SessionInfo, (Code, String)> {
    let greeting = Greeting::new("stranger", token).unwrap();
    let request = OpenRequest { protocol: Some(PROTOCOL), task: "S08".into(), ..OpenRequest::default() };
    let request = OpenRequest { hello: Some(greeting.hello()), ..request }.encode_to_vec();
    let attachment = token.map(|token| proof(token.secret(), &request).to_vec());
    let query = link.get(ServerKeys::new("test").open()).payload(request.clone()).attachment(attachment);
    let replies: Vec<_> = query.timeout(PATIENCE).wait().unwrap().into_iter().collect();
    assert_eq!(replies.len(), 1, "one answer, the server's");
    let OpenReply { reply, welcome } = OpenReply::decode(&*replies[0].result().unwrap().payload().to_bytes()).unwrap();
    let (id, content) = match reply.as_ref().unwrap() {
        open_reply::Reply::Session(info) => (info.session.clone(), info.encode_to_vec()),
        open_reply::Reply::Refusal(refusal) => (String::new(), refusal.encode_to_vec()),
    };
    let said = SignedReply { request: &request, server: "test", id: &id, content: &content };
    greeting.verify(said, &welcome.unwrap(), None).unwrap();
    match reply.unwrap() {
        open_reply::Reply::Session(info) => Ok(info),
        open_reply::Reply::Refusal(refusal) => Err((refusal.code(), refusal.message)),
    }
}

/// Guards mutual TLS: a stranger does not even connect, and a policy does no more than a policy may.
#[test]
fn with_certificates() {
    let installation = Installation::start("access-mtls", "mtls");
    let endpoint = format!("quic/127.0.0.1:{}", installation.port);
    let ca = installation.keys.join("ca.pem").display().to_string();
    let tls = |rest: &str| {
        format!(
            "{{connect: {{endpoints: ['{endpoint}']}}, transport: {{link: {{tls: {{root_ca_certificate: '{ca}'{rest}}}}}}}}}"
        )
    };
    assert!(!installation.connects(&tls("")), "no certificate");
    assert!(!installation.connects(&tls("").replace("quic/", "tcp/")), "no TLS");
    // Certificates of another authority.
    let other = installation.folder.path().join("other").display().to_string();
    let mut made = Running::start("fiatlux", &["keys", "--out", &other], &installation.folder);
    assert!(made.finish(PATIENCE).0.success());
    let foreign = fs::read_to_string(format!("{other}/policy.json5")).unwrap();
    let foreign = foreign.replace("quic/127.0.0.1:7447", &endpoint);
    assert!(!installation.connects(&foreign), "a certificate of another authority");
    let mut again = Running::start("fiatlux", &["keys", "--out", &other], &installation.folder);
    assert_eq!(again.finish(PATIENCE).0.code(), Some(1));
    assert!(again.log().contains("keys are never overwritten"), "{}", again.log());
    cheats_in_vain(&installation);
}

/// Guards the same over user and password, without TLS.
#[test]
fn with_passwords() {
    let installation = Installation::start("access-password", "password");
    let endpoint = format!("tcp/127.0.0.1:{}", installation.port);
    let with = |rest: &str| format!("{{connect: {{endpoints: ['{endpoint}']}}, transport: {{auth: {{{rest}}}}}}}");
    assert!(!installation.connects(&with("")), "no user");
    assert!(!installation.connects(&with("usrpwd: {user: 'policy', password: 'guess'}")), "another password");
    assert!(!installation.connects(&with("usrpwd: {user: 'root', password: 'guess'}")), "another user");
    cheats_in_vain(&installation);
}

#[test]
#[ignore = "needs Python's libraries: tests/run"]
fn with_certificates_in_another_language() {
    python_cheats_in_vain(&Installation::start("access-mtls-python", "mtls"));
}

#[test]
#[ignore = "needs Python's libraries: tests/run"]
fn with_passwords_in_another_language() {
    python_cheats_in_vain(&Installation::start("access-password-python", "password"));
}

/// Guards a router against Zenoh's own limit of 1,000 programs: each of more clients is admitted, and reaches the server.
#[test]
fn a_router_admits_more_clients_than_zenoh_itself() {
    let clients = if std::env::var_os("FIATLUX_ALL_ROOMS").is_some() { 1_200 } else { 20 };
    let installation = Installation::start("access-crowd", "mtls");
    let config = Config::from_file(installation.keys.join("policy.json5")).unwrap();
    let router = &installation._others[1];
    let before = router.memory_mb();
    let sessions: Vec<Session> = (0..clients).map(|_| zenoh::open(config.clone()).wait().unwrap()).collect();
    let describe = ServerKeys::new("test").describe();
    for session in &sessions {
        let replies = session.get(&describe).wait().unwrap();
        assert!(replies.into_iter().any(|reply| reply.result().is_ok()));
    }
    println!("{clients} clients: {before:.0} MB of the router without them, {:.0} MB with them", router.memory_mb());
}
