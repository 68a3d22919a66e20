//! Opening sessions.

use std::net::TcpListener;
use std::time::{Duration, Instant};

use fiatlux_link::{CarrierArgs, Link, LinkError, LinkMode, Role};
use zenoh::{Session, Wait};

#[test]
fn two_parts_of_one_process_talk_over_an_embedded_session() {
    let session = Link::embedded().expect("opens").session().clone();
    let _alive = session.liveliness().declare_token("a/alive").wait().expect("declares");
    let _answers = answer(&session);
    assert_eq!(ask(&session), 1);
    let tokens = session.liveliness().get("*/alive").wait().expect("asks");
    assert_eq!(tokens.iter().filter(|reply| reply.result().is_ok()).count(), 1);
}

#[test]
fn a_client_finds_the_server_that_listens() {
    let endpoint = free_endpoint();
    let server = CarrierArgs { listen: vec![endpoint.clone()], ..CarrierArgs::default() }
        .open(Role::Server)
        .expect("listens")
        .session()
        .clone();
    let _alive = server.liveliness().declare_token("a/alive").wait().expect("declares");
    let _answers = answer(&server);
    let start = Instant::now();
    let client = CarrierArgs { connect: vec![endpoint], ..CarrierArgs::default() }
        .open(Role::Client)
        .expect("connects")
        .session()
        .clone();
    assert!(start.elapsed() < Duration::from_secs(2), "opening took {:?}", start.elapsed());
    assert_eq!(ask(&client), 1);
    let tokens = client.liveliness().get("*/alive").wait().expect("asks");
    assert_eq!(tokens.iter().filter(|reply| reply.result().is_ok()).count(), 1);
}

#[test]
fn a_client_without_a_server_is_told_where_it_looked() {
    let endpoint = free_endpoint();
    let start = Instant::now();
    let error = CarrierArgs { connect: vec![endpoint.clone()], ..CarrierArgs::default() }.open(Role::Client).err();
    assert!(matches!(&error, Some(LinkError::Connect { endpoints, .. }) if *endpoints == endpoint), "{error:?}");
    assert!(start.elapsed() < Duration::from_secs(8), "{:?}", start.elapsed());
}

#[test]
fn a_server_whose_port_is_taken_says_so() {
    let held = TcpListener::bind("127.0.0.1:0").expect("binds");
    let endpoint = format!("tcp/{}", held.local_addr().expect("is bound"));
    let error = CarrierArgs { listen: vec![endpoint.clone()], ..CarrierArgs::default() }.open(Role::Server).err();
    assert!(matches!(&error, Some(LinkError::Listen { endpoints, .. }) if *endpoints == endpoint), "{error:?}");
}

/// An encrypted endpoint without a certificate is refused with a remedy before anything opens, by flag and by config.
#[test]
fn an_endpoint_without_its_certificate_says_what_to_do() {
    let endpoint = "quic/127.0.0.1:0";
    let error = CarrierArgs { listen: vec![endpoint.into()], ..CarrierArgs::default() }.open(Role::Server).err();
    let message = error.expect("refused").to_string();
    assert!(message.starts_with(endpoint) && message.contains("transport/link/tls/listen_certificate"), "{message}");
    assert!(message.contains("fiatlux keys --out DIR"), "{message}");
    let path = std::env::temp_dir().join(format!("fiatlux-link-mtls-{}.json5", std::process::id()));
    std::fs::write(&path, "{transport: {link: {tls: {enable_mtls: true, connect_certificate_base64: 'QUJD'}}}}")
        .expect("writes");
    let connect = vec!["quic/127.0.0.1:1".to_owned()];
    let error = CarrierArgs { config: Some(path.clone()), connect, ..CarrierArgs::default() }.open(Role::Client).err();
    let message = error.expect("refused").to_string();
    assert!(message.contains("the config has no transport/link/tls/connect_private_key"), "{message}");
    std::fs::remove_file(path).expect("removes");
}

#[test]
fn a_listener_with_a_list_of_users_asks_for_them() {
    let folder = std::env::temp_dir().join(format!("fiatlux-link-users-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let write = |name: &str, text: String| {
        let path = folder.join(name);
        std::fs::write(&path, text).expect("writes");
        path
    };
    let users = write("users", "policy:secret\n".into());
    let usrpwd =
        |text: String| format!("{{transport: {{auth: {{usrpwd: {{{text}}}}}}}, connect: {{timeout_ms: 1500}}}}");
    let server = write("server.json5", usrpwd(format!("dictionary_file: '{}'", users.display())));
    let right = write("right.json5", usrpwd("user: 'policy', password: 'secret'".into()));
    let wrong = write("wrong.json5", usrpwd("user: 'policy', password: 'guess'".into()));
    let endpoint = free_endpoint();
    let listen = CarrierArgs { config: Some(server), listen: vec![endpoint.clone()], ..CarrierArgs::default() };
    let _server = listen.open(Role::Server).expect("listens").session().clone();
    let connect =
        |config| CarrierArgs { config, connect: vec![endpoint.clone()], ..CarrierArgs::default() }.open(Role::Client);
    connect(Some(right)).expect("connects");
    for config in [Some(wrong), None] {
        assert!(matches!(connect(config), Err(LinkError::Refused { .. })));
    }
    std::fs::remove_dir_all(folder).expect("removes");
}

#[test]
fn a_client_comes_back_to_a_server_that_was_restarted() {
    let endpoint = free_endpoint();
    let listen = CarrierArgs { listen: vec![endpoint.clone()], ..CarrierArgs::default() };
    let first = listen.open(Role::Server).expect("listens").session().clone();
    let client = CarrierArgs { connect: vec![endpoint], ..CarrierArgs::default() }
        .open(Role::Client)
        .expect("connects")
        .session()
        .clone();
    first.close().wait().expect("closes");
    let second = listen.open(Role::Server).expect("listens").session().clone();
    let _answers = answer(&second);
    let until = Instant::now() + Duration::from_secs(20);
    while ask(&client) == 0 {
        assert!(Instant::now() < until, "the client stays away");
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// Guards clients behind a server's link against what others publish in its place, under keys with wildcards, too. Its own
/// messages and those of other servers get through.
#[test]
fn what_a_server_alone_publishes_comes_from_nobody_else() {
    for mode in [LinkMode::Client, LinkMode::Peer] {
        let endpoint = free_endpoint();
        let serves = Some("lab".to_owned());
        let server = CarrierArgs { listen: vec![endpoint.clone()], serves, ..CarrierArgs::default() };
        let server = server.open(Role::Server).expect("listens").session().clone();
        let client = joins(&endpoint, Role::Client, LinkMode::Client);
        let (sender, heard) = std::sync::mpsc::channel();
        let hear = move |sample: zenoh::sample::Sample| drop(sender.send(sample.key_expr().to_string()));
        let _heard = client.declare_subscriber("fiatlux/v3/**").callback(hear).wait().expect("subscribes");
        let stranger = joins(&endpoint, Role::Client, mode);
        let others = "fiatlux/v3/lab-2/s/7/observation";
        // Once this arrives, the stranger knows of the subscriber.
        let until = Instant::now() + Duration::from_secs(10);
        while heard.recv_timeout(Duration::from_millis(50)).is_err() {
            assert!(Instant::now() < until, "nothing arrives");
            stranger.put(others, "another server's").wait().expect("sent");
        }
        for forged in
            ["lab/s/7/observation", "lab/s/7/notice", "lab/s/7/truth/row", "*/s/7/observation", "lab/**", "**"]
        {
            stranger.put(format!("fiatlux/v3/{forged}"), "forged").wait().expect("sent");
            stranger.delete(format!("fiatlux/v3/{forged}")).wait().expect("sent");
        }
        stranger.put("fiatlux/v3/lab/s/7/action", "a client's").wait().expect("sent");
        let own = "fiatlux/v3/lab/s/7/observation";
        let mut keys = Vec::new();
        while keys.last().is_none_or(|key| key != "fiatlux/v3/lab/s/7/action") {
            keys.push(heard.recv_timeout(Duration::from_secs(10)).expect("it arrives"));
        }
        server.put(own, "its own").wait().expect("sent");
        keys.push(heard.recv_timeout(Duration::from_secs(10)).expect("it arrives"));
        keys.retain(|key| key != others);
        assert_eq!(keys, ["fiatlux/v3/lab/s/7/action", own], "{mode:?}");
    }
}

fn free_endpoint() -> String {
    let socket = TcpListener::bind("127.0.0.1:0").expect("binds");
    format!("tcp/{}", socket.local_addr().expect("is bound"))
}

fn answer(session: &Session) -> zenoh::query::Queryable<()> {
    let reply = |query: zenoh::query::Query| {
        let _ = query.reply("a/describe", "here").wait();
    };
    session.declare_queryable("a/describe").callback(reply).wait().expect("declares")
}

/// Number of peers that answer a query.
fn ask(session: &Session) -> usize {
    let replies = session.get("a/describe").timeout(Duration::from_secs(1)).wait().expect("asks");
    replies.iter().filter(|reply| reply.result().is_ok()).count()
}

/// A link of this mode to an endpoint.
fn joins(endpoint: &str, role: Role, mode: LinkMode) -> Session {
    let args = CarrierArgs { connect: vec![endpoint.to_owned()], mode: Some(mode), ..CarrierArgs::default() };
    args.open(role).expect("connects").session().clone()
}

/// Guards those who watch tokens: whoever declares another's token once more and withdraws that copy, directly or through a
/// router, withdraws the copy alone. Anybody on a network can see the key of a token.
#[test]
fn a_copy_of_a_token_that_goes_away_takes_the_first_with_it_nowhere() {
    use LinkMode::{Client, Peer, Router};
    // The mode of what listens, and of the one who watches; `None` if it listens itself.
    let hubs = [(Peer, None), (Router, None), (Router, Some(Client)), (Router, Some(Peer))];
    for (hub, watcher) in hubs {
        for [owner, stranger] in [[Client, Client], [Client, Peer], [Peer, Client], [Peer, Peer]] {
            // A router passes nothing on between peers that do not gossip.
            if watcher == Some(Peer) && (owner == Peer || stranger == Peer) {
                continue;
            }
            let endpoint = free_endpoint();
            let listens = CarrierArgs { listen: vec![endpoint.clone()], mode: Some(hub), ..CarrierArgs::default() };
            let listens = listens.open(Role::Server).expect("listens").session().clone();
            let watches = watcher.map_or_else(|| listens.clone(), |mode| joins(&endpoint, Role::Server, mode));
            let (sender, seen) = std::sync::mpsc::channel();
            let watched = fiatlux_link::carrier(&watches).watch_tokens("a/*", move |_, is_there| {
                sender.send(is_there).expect("the test listens");
            });
            let _watched = watched.expect("watches");
            let owner_link = joins(&endpoint, Role::Client, owner);
            let stranger_link = joins(&endpoint, Role::Client, stranger);
            let case = format!("{hub:?} {watcher:?} {owner:?} {stranger:?}");
            let token = owner_link.liveliness().declare_token("a/token").wait().expect("declares");
            assert_eq!(seen.recv_timeout(Duration::from_secs(5)), Ok(true), "{case}");
            for _ in 0..5 {
                drop(stranger_link.liveliness().declare_token("a/token").wait().expect("declares"));
                std::thread::sleep(Duration::from_millis(20));
            }
            let gone: Vec<bool> = seen.try_iter().filter(|is_there| !is_there).collect();
            assert!(gone.is_empty(), "{case}: the copy took the token with it");
            drop(token);
            let until_gone = std::iter::from_fn(|| seen.recv_timeout(Duration::from_secs(5)).ok());
            assert!(until_gone.into_iter().any(|is_there| !is_there), "{case}: its own end is seen");
        }
    }
}

/// Guards a session's token against a peer that connects under the session's own Zenoh id, which others can see.
#[test]
fn a_link_with_an_id_in_use_takes_no_token_away() {
    let endpoint = free_endpoint();
    let listens = CarrierArgs { listen: vec![endpoint.clone()], ..CarrierArgs::default() };
    let listens = listens.open(Role::Server).expect("listens").session().clone();
    let (sender, seen) = std::sync::mpsc::channel();
    let watched = fiatlux_link::carrier(&listens).watch_tokens("a/*", move |_, is_there| {
        sender.send(is_there).expect("the test listens");
    });
    let _watched = watched.expect("watches");
    let owner = joins(&endpoint, Role::Client, LinkMode::Client);
    let _token = owner.liveliness().declare_token("a/token").wait().expect("declares");
    assert_eq!(seen.recv_timeout(Duration::from_secs(5)), Ok(true));
    for mode in ["client", "peer"] {
        let mut config = zenoh::Config::default();
        let id = format!("\"{}\"", owner.zid());
        let connect = format!("[\"{endpoint}\"]");
        for (key, value) in [("id", &*id), ("mode", &format!("\"{mode}\"")), ("connect/endpoints", &*connect)] {
            config.insert_json5(key, value).expect("a setting");
        }
        config.insert_json5("connect/timeout_ms", "1000").expect("a setting");
        config.insert_json5("scouting/multicast/enabled", "false").expect("a setting");
        if let Ok(stranger) = zenoh::open(config).wait() {
            let _ = stranger.liveliness().declare_token("a/token").wait();
            std::thread::sleep(Duration::from_millis(300));
            let _ = stranger.close().wait();
        }
        std::thread::sleep(Duration::from_millis(300));
        assert!(seen.try_iter().all(|is_there| is_there), "{mode}: the other link took the token with it");
    }
    let answers = answer(&listens);
    assert_eq!(ask(&owner), 1, "the session's own link is there");
    drop(answers);
}
