//! Sessions as they are opened.

use std::net::TcpListener;
use std::time::{Duration, Instant};

use fiatlux_link::{LinkArgs, LinkError, Role, embedded};
use zenoh::{Session, Wait};

#[test]
fn two_parts_of_one_process_talk_over_an_embedded_session() {
    let session = embedded().expect("opens");
    let _alive = session.liveliness().declare_token("a/alive").wait().expect("declares");
    let _answers = answer(&session);
    assert_eq!(ask(&session), 1);
    let tokens = session.liveliness().get("*/alive").wait().expect("asks");
    assert_eq!(tokens.iter().filter(|reply| reply.result().is_ok()).count(), 1);
}

#[test]
fn a_client_finds_the_server_that_listens() {
    let endpoint = free_endpoint();
    let server =
        LinkArgs { listen: vec![endpoint.clone()], ..LinkArgs::default() }.open(Role::Server).expect("listens");
    let _alive = server.liveliness().declare_token("a/alive").wait().expect("declares");
    let _answers = answer(&server);
    let start = Instant::now();
    let client = LinkArgs { connect: vec![endpoint], ..LinkArgs::default() }.open(Role::Client).expect("connects");
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

#[test]
fn a_client_comes_back_to_a_server_that_was_restarted() {
    let endpoint = free_endpoint();
    let listen = LinkArgs { listen: vec![endpoint.clone()], ..LinkArgs::default() };
    let first = listen.open(Role::Server).expect("listens");
    let client = LinkArgs { connect: vec![endpoint], ..LinkArgs::default() }.open(Role::Client).expect("connects");
    first.close().wait().expect("closes");
    let second = listen.open(Role::Server).expect("listens");
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

/// How many answer.
fn ask(session: &Session) -> usize {
    let replies = session.get("a/describe").timeout(Duration::from_secs(1)).wait().expect("asks");
    replies.iter().filter(|reply| reply.result().is_ok()).count()
}
