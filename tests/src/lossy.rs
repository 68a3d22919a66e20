//! A proxy between a server's network and a client's that loses messages.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use fiatlux_proto::keys::ROOT;
use zenoh::bytes::ZBytes;
use zenoh::key_expr::KeyExpr;
use zenoh::liveliness::LivelinessToken;
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::SampleKind;
use zenoh::{Config, Session, Wait};

/// Passes messages between two networks, and loses some of them: each message, query and reply is lost with the same
/// probability, drawn from a seeded sequence. Liveliness is passed on without loss.
pub struct LossyProxy {
    _sessions: [Session; 2],
    counts: Arc<Counts>,
}

#[derive(Default)]
struct Counts {
    passed: AtomicU64,
    lost: AtomicU64,
    draw: AtomicU64,
    loss_per_mille: u64,
}

impl Counts {
    /// SplitMix64 over a counter.
    fn loses(&self) -> bool {
        let mut x = self.draw.fetch_add(1, Ordering::Relaxed).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        let lost = (x ^ (x >> 31)) % 1000 < self.loss_per_mille;
        if lost { &self.lost } else { &self.passed }.fetch_add(1, Ordering::Relaxed);
        lost
    }
}

impl LossyProxy {
    /// Connects to a server at one port and listens for clients at another.
    pub fn start(server_port: u16, client_port: u16, loss_per_mille: u64) -> Self {
        let server_side = open(None, Some(server_port));
        let client_side = open(Some(client_port), None);
        let counts = Arc::new(Counts { loss_per_mille, ..Counts::default() });
        pass_tokens(&server_side, &client_side, &["*/alive", "*/s/*/live", "*/s/*/truth/live/*"]);
        pass_tokens(&client_side, &server_side, &["*/s/*/client"]);
        pass_messages(&server_side, &client_side, &["*/s/*/observation", "*/s/*/notice", "*/s/*/truth/row"], &counts);
        pass_messages(&client_side, &server_side, &["*/s/*/action", "*/s/*/truth/ack"], &counts);
        pass_queries(&client_side, &server_side, &counts);
        Self { _sessions: [server_side, client_side], counts }
    }

    /// Messages passed on and messages lost so far.
    pub fn counts(&self) -> (u64, u64) {
        (self.counts.passed.load(Ordering::Relaxed), self.counts.lost.load(Ordering::Relaxed))
    }
}

/// A bare peer on the loopback interface.
pub fn open(listen: Option<u16>, connect: Option<u16>) -> Session {
    let mut config = Config::default();
    let endpoints = |port: Option<u16>| port.map_or("[]".into(), |port| format!("[\"tcp/127.0.0.1:{port}\"]"));
    for (key, value) in [
        ("mode", "\"peer\"".into()),
        ("scouting/multicast/enabled", "false".into()),
        ("scouting/gossip/enabled", "false".into()),
        ("listen/endpoints", endpoints(listen)),
        ("connect/endpoints", endpoints(connect)),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    zenoh::open(config).wait().unwrap()
}

fn pass_tokens(from: &Session, to: &Session, keys: &[&str]) {
    for key in keys {
        let to = to.clone();
        let held = Mutex::new(Vec::<(KeyExpr<'static>, LivelinessToken)>::new());
        let subscriber = from.liveliness().declare_subscriber(format!("{ROOT}/{key}")).history(true);
        let declared = subscriber.callback(move |sample| {
            let key = sample.key_expr().clone().into_owned();
            let mut held = held.lock().unwrap_or_else(PoisonError::into_inner);
            held.retain(|(other, _)| *other != key);
            if sample.kind() == SampleKind::Put {
                let token = to.liveliness().declare_token(key.clone()).wait().unwrap();
                held.push((key, token));
            }
        });
        declared.background().wait().unwrap();
    }
}

fn pass_messages(from: &Session, to: &Session, keys: &[&str], counts: &Arc<Counts>) {
    for key in keys {
        let (to, counts) = (to.clone(), Arc::clone(counts));
        let subscriber = from.declare_subscriber(format!("{ROOT}/{key}")).callback(move |sample| {
            if !counts.loses() {
                let put =
                    to.put(sample.key_expr().clone(), sample.payload().clone()).encoding(sample.encoding().clone());
                drop(put.attachment(sample.attachment().cloned()).express(true).wait());
            }
        });
        subscriber.background().wait().unwrap();
    }
}

/// A query that is lost, or whose reply is, ends without a reply.
fn pass_queries(from: &Session, to: &Session, counts: &Arc<Counts>) {
    let (to, counts) = (to.clone(), Arc::clone(counts));
    let queryable = from.declare_queryable(format!("{ROOT}/**")).callback(move |query| {
        if counts.loses() {
            return;
        }
        let (to, counts) = (to.clone(), Arc::clone(&counts));
        std::thread::spawn(move || {
            let payload = query.payload().cloned().unwrap_or_else(ZBytes::new);
            let ask = to
                .get(query.selector())
                .payload(payload)
                .attachment(query.attachment().cloned())
                .timeout(Duration::from_secs(20));
            // Some answers are several replies of one key.
            let ask = ask.target(QueryTarget::All).consolidation(ConsolidationMode::None);
            let Ok(replies) = ask.wait() else { return };
            while let Ok(reply) = replies.recv() {
                if counts.loses() {
                    continue;
                }
                match reply.into_result() {
                    Ok(sample) => {
                        let reply = query.reply(sample.key_expr().clone(), sample.payload().clone());
                        drop(reply.attachment(sample.attachment().cloned()).wait());
                    }
                    Err(error) => drop(query.reply_err(error.payload().clone()).wait()),
                }
            }
        });
    });
    queryable.background().wait().unwrap();
}
