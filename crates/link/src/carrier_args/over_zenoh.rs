//! The carrier over a Zenoh session.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use fiatlux_carrier::{
    CarrierError, Declaration, Message, Publish, Quality, Query, Question, Reach, Reply, Respond, Transport,
};
use fiatlux_proto::{Bytes, encoding};
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::{Locality, Sample, SampleKind};
use zenoh::{Config, Session, Wait};

use super::config::EndpointPlan;
use crate::{LinkError, WaitLog};

pub struct ZenohTransport(pub Session);

/// Time between two checks for a signal while the session opens.
const POLL: Duration = Duration::from_millis(20);

/// Opens a session. It says who it waits for, and ends with an error once `stop` is set.
pub fn open(config: Config, stop: &AtomicBool) -> Result<Session, LinkError> {
    let plan = EndpointPlan::of(&config);
    // Zenoh tries without end if a server has to connect, so another thread does it.
    let (opened, session) = mpsc::channel();
    let open = move || opened.send(zenoh::open(config).wait());
    let thread = std::thread::Builder::new().name("open".into()).spawn(open);
    thread.map_err(|source| LinkError::Open { reason: source.to_string() })?;
    let mut waiting = WaitLog::default();
    loop {
        match session.recv_timeout(POLL) {
            Ok(session) => return session.map_err(|source| plan.explain(&source.to_string())),
            Err(RecvTimeoutError::Disconnected) => {
                return Err(LinkError::Open { reason: "a thread panicked".into() });
            }
            Err(RecvTimeoutError::Timeout) if stop.load(Ordering::Relaxed) => return Err(plan.stopped()),
            Err(RecvTimeoutError::Timeout) if plan.is_patient() => waiting.say(|| plan.peers()),
            Err(RecvTimeoutError::Timeout) => {}
        }
    }
}

fn failed(error: zenoh::Error) -> CarrierError {
    CarrierError(error.to_string())
}

fn locality(reach: Reach) -> Locality {
    match reach {
        Reach::ThisProcess => Locality::SessionLocal,
        Reach::OtherProcesses => Locality::Remote,
        Reach::Everywhere => Locality::Any,
    }
}

fn own(bytes: &ZBytes) -> Bytes {
    bytes.to_bytes().into_owned().into()
}

fn own_or_empty(bytes: Option<&ZBytes>) -> Bytes {
    bytes.map(own).unwrap_or_default()
}

fn message(sample: &Sample) -> Message {
    Message {
        key: sample.key_expr().as_str().into(),
        payload: own(sample.payload()),
        attachment: own_or_empty(sample.attachment()),
    }
}

fn some(attachment: Vec<u8>) -> Option<Vec<u8>> {
    (!attachment.is_empty()).then_some(attachment)
}

impl Transport for ZenohTransport {
    fn id(&self) -> String {
        self.0.zid().to_string()
    }

    fn publisher(
        &self,
        key: &str,
        message: &str,
        quality: Quality,
        reach: Reach,
    ) -> Result<Box<dyn Publish>, CarrierError> {
        let priority = match quality.priority {
            fiatlux_carrier::Priority::RealTime => Priority::RealTime,
            fiatlux_carrier::Priority::Interactive => Priority::InteractiveHigh,
            fiatlux_carrier::Priority::Data => Priority::Data,
        };
        let congestion = if quality.blocking { CongestionControl::Block } else { CongestionControl::Drop };
        let publisher = self.0.declare_publisher(key.to_owned()).encoding(Encoding::from(encoding(message)));
        let publisher = publisher.priority(priority).express(quality.express).congestion_control(congestion);
        let publisher = publisher.allowed_destination(locality(reach)).wait().map_err(failed)?;
        Ok(Box::new(ZenohPublisher(publisher)))
    }

    fn subscribe(
        &self,
        key: &str,
        from: Reach,
        on_message: Box<dyn Fn(Message) + Send + Sync>,
    ) -> Result<Declaration, CarrierError> {
        let subscriber = self.0.declare_subscriber(key.to_owned()).allowed_origin(locality(from));
        let subscriber = subscriber.callback(move |sample| on_message(message(&sample)));
        subscriber.wait().map(Declaration::new).map_err(failed)
    }

    fn serve(
        &self,
        key: &str,
        from: Reach,
        on_query: Box<dyn Fn(Query) + Send + Sync>,
    ) -> Result<Declaration, CarrierError> {
        let queryable = self.0.declare_queryable(key.to_owned()).allowed_origin(locality(from));
        let queryable = queryable.callback(move |query| {
            let key = query.key_expr().as_str().to_owned();
            let (payload, attachment) = (own_or_empty(query.payload()), own_or_empty(query.attachment()));
            on_query(Query::new(key, payload, attachment, ZenohQuery(query)));
        });
        queryable.wait().map(Declaration::new).map_err(failed)
    }

    fn ask(&self, question: Question, on_reply: Box<dyn FnMut(Reply) + Send>) -> Result<(), CarrierError> {
        let Question { key, message: name, payload, attachment, timeout, is_urgent, reach } = question;
        // All servers of a key are asked, and each of their replies counts.
        let query = self.0.get(key).target(QueryTarget::All).consolidation(ConsolidationMode::None).timeout(timeout);
        let query = query.payload(payload).attachment(some(attachment)).allowed_destination(locality(reach));
        let query = if name.is_empty() { query } else { query.encoding(Encoding::from(encoding(&name))) };
        let query = if is_urgent { query.priority(Priority::RealTime).express(true) } else { query };
        let on_reply = Mutex::new(on_reply);
        let receive = move |reply: zenoh::query::Reply| {
            (on_reply.lock().unwrap_or_else(PoisonError::into_inner))(match reply.result() {
                Ok(sample) => Ok(message(sample)),
                Err(error) => Err(own(error.payload())),
            });
        };
        query.callback(receive).wait().map_err(failed)
    }

    fn token(&self, key: &str) -> Result<Declaration, CarrierError> {
        self.0.liveliness().declare_token(key.to_owned()).wait().map(Declaration::new).map_err(failed)
    }

    fn watch_tokens(
        &self,
        key: &str,
        on_token: Box<dyn Fn(&str, bool) + Send + Sync>,
    ) -> Result<Declaration, CarrierError> {
        let watcher = self.0.liveliness().declare_subscriber(key.to_owned()).history(true);
        let watcher = watcher.callback(move |sample| {
            on_token(sample.key_expr().as_str(), sample.kind() == SampleKind::Put);
        });
        watcher.wait().map(Declaration::new).map_err(failed)
    }

    fn tokens(&self, key: &str, timeout: Duration) -> Result<Vec<String>, CarrierError> {
        let replies = self.0.liveliness().get(key.to_owned()).timeout(timeout).wait().map_err(failed)?;
        let key = |reply: zenoh::query::Reply| Some(reply.result().ok()?.key_expr().as_str().to_owned());
        Ok(replies.into_iter().filter_map(key).collect())
    }
}

struct ZenohPublisher(Publisher<'static>);

impl Publish for ZenohPublisher {
    fn put(&self, payload: Bytes, attachment: Vec<u8>) -> Result<(), CarrierError> {
        self.0.put(payload).attachment(some(attachment)).wait().map_err(failed)
    }

    fn has_subscribers(&self) -> bool {
        self.0.matching_status().wait().is_ok_and(|status| status.matching())
    }
}

struct ZenohQuery(zenoh::query::Query);

impl Respond for ZenohQuery {
    fn reply(&self, key: &str, message: &str, payload: Bytes, attachment: Vec<u8>) -> Result<(), CarrierError> {
        let reply = self.0.reply(key, payload).encoding(Encoding::from(encoding(message)));
        reply.attachment(some(attachment)).wait().map_err(failed)
    }

    fn refuse(&self, message: &str, payload: Bytes) -> Result<(), CarrierError> {
        self.0.reply_err(payload).encoding(Encoding::from(encoding(message))).wait().map_err(failed)
    }
}
