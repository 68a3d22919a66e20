//! Opening sessions.

use std::net::TcpListener;
use std::time::{Duration, Instant};

use fiatlux_link::{Link, LinkArgs, LinkError, Role};
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
    let server = LinkArgs { listen: vec![endpoint.clone()], ..LinkArgs::default() }
        .open(Role::Server)
        .expect("listens")
        .session()
        .clone();
    let _alive = server.liveliness().declare_token("a/alive").wait().expect("declares");
    let _answers = answer(&server);
    let start = Instant::now();
    let client = LinkArgs { connect: vec![endpoint], ..LinkArgs::default() }
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
    let error = LinkArgs { connect: vec![endpoint.clone()], ..LinkArgs::default() }.open(Role::Client).err();
    assert!(matches!(&error, Some(LinkError::Connect { endpoints, .. }) if *endpoints == endpoint), "{error:?}");
    assert!(start.elapsed() < Duration::from_secs(8), "{:?}", start.elapsed());
}

#[test]
fn a_server_whose_port_is_taken_says_so() {
    let held = TcpListener::bind("127.0.0.1:0").expect("binds");
    let endpoint = format!("tcp/{}", held.local_addr().expect("is bound"));
    let error = LinkArgs { listen: vec![endpoint.clone()], ..LinkArgs::default() }.open(Role::Server).err();
    assert!(matches!(&error, Some(LinkError::Listen { endpoints, .. }) if *endpoints == endpoint), "{error:?}");
}

/// An encrypted endpoint without a certificate is refused with a remedy before anything opens, by flag and by config.
#[test]
fn an_endpoint_without_its_certificate_says_what_to_do() {
    let endpoint = "quic/127.0.0.1:0";
    let error = LinkArgs { listen: vec![endpoint.into()], ..LinkArgs::default() }.open(Role::Server).err();
    let message = error.expect("refused").to_string();
    assert!(message.starts_with(endpoint) && message.contains("transport/link/tls/listen_certificate"), "{message}");
    assert!(message.contains("fiatlux keys --out DIR"), "{message}");
    let path = std::env::temp_dir().join(format!("fiatlux-link-mtls-{}.json5", std::process::id()));
    std::fs::write(&path, "{transport: {link: {tls: {enable_mtls: true, connect_certificate_base64: 'QUJD'}}}}")
        .expect("writes");
    let connect = vec!["quic/127.0.0.1:1".to_owned()];
    let error = LinkArgs { config: Some(path.clone()), connect, ..LinkArgs::default() }.open(Role::Client).err();
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
    let listen = LinkArgs { config: Some(server), listen: vec![endpoint.clone()], ..LinkArgs::default() };
    let _server = listen.open(Role::Server).expect("listens").session().clone();
    let connect =
        |config| LinkArgs { config, connect: vec![endpoint.clone()], ..LinkArgs::default() }.open(Role::Client);
    connect(Some(right)).expect("connects");
    for config in [Some(wrong), None] {
        assert!(matches!(connect(config), Err(LinkError::Refused { .. })));
    }
    std::fs::remove_dir_all(folder).expect("removes");
}

#[test]
fn a_client_comes_back_to_a_server_that_was_restarted() {
    let endpoint = free_endpoint();
    let listen = LinkArgs { listen: vec![endpoint.clone()], ..LinkArgs::default() };
    let first = listen.open(Role::Server).expect("listens").session().clone();
    let client = LinkArgs { connect: vec![endpoint], ..LinkArgs::default() }
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
