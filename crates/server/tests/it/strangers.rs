//! Peers of the same network that say and answer whatever they like, next to a session that is not theirs: it goes on
//! as if nobody were there.

use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::common::victim::{Victim, action, network, options, overhear, request};
use crate::common::{LONG, answer, open_session, replies};
use fiatlux_access::{Grant, Greeting, Identity, Token, Tokens, proof};
use fiatlux_proto::Message;
use fiatlux_proto::keys::ServerKeys;
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{
    Action, Notice, Observation, OpenReply, OpenRequest, Refusal, ResetReply, ResetRequest, notice, open_reply,
    reset_reply,
};
use fiatlux_server::ServerOptions;
use zenoh::Wait;

/// Guards a session against actions, resets, closes, looks, notices, observations and tokens that are not its own: its rows
/// are those that it has alone.
#[test]
fn a_session_goes_on_as_if_nobody_were_there() {
    let (server, link, stranger) = network(options());
    let alone = {
        let victim = Victim::open(&link);
        let end = victim.play(|_| ());
        victim.close();
        end
    };
    let victim = Victim::open(&link);
    let heard = overhear(&stranger);
    let keys = &victim.keys;
    let reset = ResetRequest { episode: 3 }.encode_to_vec();
    let disturbed = victim.play(|step| {
        for attachment in [Vec::new(), vec![7; 24]] {
            stranger.put(keys.action(), action(step + 1)).attachment(attachment.clone()).wait().unwrap();
            let mut other = Action::decode(&*action(step)).unwrap();
            other.action[0] += 0.5;
            stranger.put(keys.action(), other.encode_to_vec()).attachment(attachment.clone()).wait().unwrap();
            let lost = Notice { code: notice::Code::Lost.into(), message: "gone".into(), ..Notice::default() };
            stranger.put(keys.notice(), lost.encode_to_vec()).attachment(attachment.clone()).wait().unwrap();
            let ahead = Observation { step: step + 9, ..Observation::default() };
            stranger.put(keys.observation(), ahead.encode_to_vec()).attachment(attachment.clone()).wait().unwrap();
            if step % 10 == 0 {
                assert_eq!(replies(&stranger, &keys.reset(), reset.clone(), attachment.clone()), []);
                assert_eq!(replies(&stranger, &keys.close(), Vec::new(), attachment.clone()), []);
                assert_eq!(replies(&stranger, &keys.look(), Vec::new(), attachment.clone()), []);
                assert_eq!(replies(&stranger, &keys.observation(), Vec::new(), attachment), []);
            }
        }
        // Whatever it has heard, once more: the session's own actions among it.
        for (key, payload, attachment) in heard.try_iter().take(200) {
            if key.ends_with("/action") {
                stranger.put(key, payload).attachment(attachment).wait().unwrap();
            }
        }
        // A token that comes and goes.
        drop(stranger.liveliness().declare_token(keys.client()).wait().unwrap());
    });
    assert_eq!(disturbed, alone);
    assert!(victim.notices.try_recv().is_err(), "nothing of that is the client's fault");
    victim.close();
    drop(server);
}

/// Guards a client that thinks for longer than the grace time against tokens of the same key that come and go.
#[test]
fn nobody_withdraws_the_token_of_a_client_that_thinks() {
    let grace = Duration::from_secs(1);
    let (server, link, stranger) = network(ServerOptions { grace, ..options() });
    let victim = Victim::open(&link);
    victim.reset();
    for _ in 0..20 {
        drop(stranger.liveliness().declare_token(victim.keys.client()).wait().unwrap());
        std::thread::sleep(grace / 10);
    }
    victim.act(0);
    assert_eq!(answer(&victim.observations, 0, || drop(victim.act(0))).step, 1);
    victim.close();
    drop(server);
}

/// Guards queries against a stranger who sees them, sends them first, and answers them: the client gets the server's answer.
#[test]
fn a_query_that_somebody_else_sends_first_is_answered() {
    let (server, link, stranger) = network(options());
    let victim = Victim::open(&link);
    let relay = stranger.clone();
    let forged = stranger.declare_queryable(format!("{}/**", victim.keys.live().trim_end_matches("/live")));
    let _forged = forged
        .callback(move |query| {
            let payload = query.payload().map(|bytes| bytes.to_bytes().into_owned()).unwrap_or_default();
            let attachment = crate::common::bytes_of(query.attachment());
            let relay = relay.clone();
            std::thread::spawn(move || {
                let key = query.key_expr().clone();
                let forged = ResetReply { reply: Some(reset_reply::Reply::Refusal(Refusal::default())) };
                drop(query.reply(key.clone(), forged.encode_to_vec()).attachment(vec![1; 24]).wait());
                let asked = relay.get(key).payload(payload).attachment(attachment).timeout(Duration::from_millis(300));
                drop(asked.wait());
            });
        })
        .wait()
        .unwrap();
    std::thread::sleep(Duration::from_millis(300));
    victim.reset();
    victim.act(0);
    assert_eq!(answer(&victim.observations, 0, || drop(victim.act(0))).step, 1);
    victim.close();
    drop(server);
}

/// Guards a client that knows its server's key against whoever answers `open` in its place.
#[test]
fn nobody_opens_a_session_in_the_servers_place() {
    let identity = Arc::new(Identity::generate().unwrap());
    let (_server, link, _) = network(ServerOptions { identity: Some(Arc::clone(&identity)), ..options() });
    let greeting = Greeting::new("ab", None).unwrap();
    let request = OpenRequest { hello: Some(greeting.hello()), ..request() }.encode_to_vec();
    let mut answers = replies(&link, &ServerKeys::new("test").open(), request.clone(), Vec::new());
    let OpenReply { reply, welcome } = OpenReply::decode(&*answers.remove(0).unwrap().0).unwrap();
    let Some(open_reply::Reply::Session(info)) = reply else { panic!("{reply:?}") };
    let content = info.encode_to_vec();
    let said = fiatlux_access::SignedReply { request: &request, server: "test", id: &info.session, content: &content };
    let welcome = welcome.unwrap();
    assert!(greeting.verify(said, &welcome, Some(&identity.public())).is_ok());
    let stranger = Identity::generate().unwrap();
    let (forged, _) = fiatlux_access::welcome(&stranger, &greeting.hello(), said).unwrap();
    assert!(greeting.verify(said, &forged, Some(&identity.public())).is_err());
    // The same request once more is the same session.
    let again = replies(&link, &ServerKeys::new("test").open(), request, Vec::new()).remove(0).unwrap();
    let again = OpenReply::decode(&*again.0).unwrap();
    assert!(matches!(again.reply, Some(open_reply::Reply::Session(same)) if same.session == info.session));
}

/// Guards the places of a server: whoever opens many keeps nobody out, and what nobody claims is closed.
#[test]
fn a_flood_of_sessions_keeps_nobody_out() {
    let (server, link, stranger) = network(ServerOptions { capacity: 8, ..options() });
    let mut opened = 0;
    for _ in 0..40 {
        opened += usize::from(open_session(&stranger, "test", &request()).is_ok());
    }
    assert!(opened >= 4, "{opened}");
    let victim = Victim::open(&link);
    let end = victim.play(|_| drop(open_session(&stranger, "test", &request())));
    assert_eq!(end.cause, "fall");
    victim.close();
    let until = Instant::now() + LONG;
    while server.open_sessions() > 0 {
        assert!(Instant::now() < until, "{} are open", server.open_sessions());
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// Guards a server with tokens: without one, with a wrong one, or with another's request nobody gets in.
#[test]
fn only_holders_of_tokens_get_in() {
    let token = Token::generate("ada").unwrap();
    let tokens = Tokens::from_iter([Grant::new(token.clone(), 1)]);
    let (_server, link, _) = network(ServerOptions { tokens: Some(tokens), ..options() });
    let open = |token: Option<&Token>, prove: &dyn Fn(&[u8]) -> Vec<u8>| {
        let greeting = Greeting::new("ab", token).unwrap();
        let request = OpenRequest { hello: Some(greeting.hello()), ..request() }.encode_to_vec();
        let attachment = prove(&request);
        let answer = replies(&link, &ServerKeys::new("test").open(), request, attachment).remove(0).unwrap();
        match OpenReply::decode(&*answer.0).unwrap().reply.unwrap() {
            open_reply::Reply::Session(_) => Ok(()),
            open_reply::Reply::Refusal(refusal) => Err((refusal.code(), refusal.field)),
        }
    };
    let denied = Err((Code::Denied, "hello.token".to_owned()));
    let other = Token::generate("ada").unwrap();
    assert_eq!(open(None, &|_| Vec::new()), denied);
    assert_eq!(open(Some(&token), &|_| Vec::new()), denied);
    assert_eq!(open(Some(&token), &|_| proof(token.secret(), b"another").to_vec()), denied);
    assert_eq!(open(Some(&other), &|request| proof(other.secret(), request).to_vec()), denied);
    assert_eq!(open(Some(&token), &|request| proof(token.secret(), request).to_vec()), Ok(()));
}

/// Guards those who ask for a recording where there is none: they are told at once, with both remedies.
#[test]
fn a_recording_that_nobody_makes_is_refused() {
    let (_server, link, _) = network(options());
    let refusal = open_session(&link, "test", &OpenRequest { recorded: true, ..request() }).unwrap_err();
    assert_eq!((refusal.code(), refusal.field.as_str()), (Code::Value, "recorded"));
    assert!(refusal.message.contains("--record DIR") && refusal.message.contains("--recorder-key FILE"));
}
