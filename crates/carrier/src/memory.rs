//! Carries messages between the threads of one process.

use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock, Weak};
use std::time::Duration;

use fiatlux_proto::Bytes;

use crate::{
    Carrier, CarrierError, Declaration, Message, OnMessage, OnQuery, OnReply, OnToken, Publish, Quality, Query,
    Question, Reach, Reply, Respond, Transport,
};

/// A carrier for one process. Messages are delivered in the thread that sends them, in order, and none is lost. A query
/// ends when it is answered or dropped; nothing else ends it.
pub fn memory() -> Carrier {
    Carrier::new(Memory::default())
}

/// The transport of [`memory`].
#[derive(Default)]
pub struct Memory(Arc<Hub>);

#[derive(Default)]
struct Hub {
    subscribers: Entries<OnMessage>,
    queryables: Entries<OnQuery>,
    /// Increases whenever a subscriber comes or goes.
    changes: AtomicU64,
    /// Held while watchers are called, so that they see tokens come and go in order.
    tokens: Mutex<Tokens>,
}

#[derive(Default)]
struct Tokens {
    present: Vec<Arc<str>>,
    watchers: Vec<Arc<Entry<OnToken>>>,
}

/// Declarations, in order.
type Entries<F> = RwLock<Vec<Arc<Entry<F>>>>;

struct Entry<F> {
    key: String,
    callback: F,
}

impl fmt::Debug for Memory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Memory")
    }
}

impl Hub {
    fn tokens(&self) -> MutexGuard<'_, Tokens> {
        self.tokens.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn matching<F>(entries: &Entries<F>, key: &str) -> Vec<Arc<Entry<F>>> {
    let entries = entries.read().unwrap_or_else(PoisonError::into_inner);
    entries.iter().filter(|entry| intersects(&entry.key, key)).cloned().collect()
}

/// True if some key matches both expressions.
fn intersects(one: &str, other: &str) -> bool {
    fn parts(one: &[&str], other: &[&str]) -> bool {
        match (one, other) {
            ([], []) => true,
            (["**", rest @ ..], _) => parts(rest, other) || !other.is_empty() && parts(one, &other[1..]),
            (_, ["**", rest @ ..]) => parts(one, rest) || !one.is_empty() && parts(&one[1..], other),
            ([a, one @ ..], [b, other @ ..]) => (a == b || *a == "*" || *b == "*") && parts(one, other),
            _ => false,
        }
    }
    one == other
        || (one.contains('*') || other.contains('*')) && {
            let [one, other] = [one, other].map(|key| key.split('/').collect::<Vec<_>>());
            parts(&one, &other)
        }
}

/// Refuses a key with an empty part, which would match nothing.
fn check(key: &str) -> Result<(), CarrierError> {
    match key.split('/').any(str::is_empty) {
        true => Err(CarrierError(format!("'{key}' is not a key; write parts separated by single slashes"))),
        false => Ok(()),
    }
}

struct Withdraw<F: Fn(&Hub)>(Weak<Hub>, F);

impl<F: Fn(&Hub)> Drop for Withdraw<F> {
    fn drop(&mut self) {
        if let Some(hub) = self.0.upgrade() {
            (self.1)(&hub);
        }
    }
}

impl Memory {
    fn withdraw(&self, how: impl Fn(&Hub) + Send + Sync + 'static) -> Declaration {
        Declaration::new(Withdraw(Arc::downgrade(&self.0), how))
    }

    fn declare<F: Send + Sync + 'static>(
        &self,
        list: fn(&Hub) -> &Entries<F>,
        key: &str,
        from: Reach,
        callback: F,
    ) -> Result<Declaration, CarrierError> {
        check(key)?;
        if from == Reach::OtherProcesses {
            return Ok(Declaration::new(()));
        }
        let entry = Arc::new(Entry { key: key.into(), callback });
        list(&self.0).write().unwrap_or_else(PoisonError::into_inner).push(Arc::clone(&entry));
        self.0.changes.fetch_add(1, Ordering::Release);
        Ok(self.withdraw(move |hub| {
            let mut entries = list(hub).write().unwrap_or_else(PoisonError::into_inner);
            entries.retain(|other| !Arc::ptr_eq(other, &entry));
            hub.changes.fetch_add(1, Ordering::Release);
        }))
    }
}

impl Transport for Memory {
    fn id(&self) -> String {
        "memory".into()
    }

    fn delivers_in_place(&self) -> bool {
        true
    }

    fn publisher(&self, key: &str, _: &str, _: Quality, reach: Reach) -> Result<Box<dyn Publish>, CarrierError> {
        check(key)?;
        let hub = (reach != Reach::OtherProcesses).then(|| Arc::clone(&self.0));
        Ok(Box::new(MemoryPublisher { hub, key: key.into(), known: Mutex::default() }))
    }

    fn subscribe(&self, key: &str, from: Reach, on_message: OnMessage) -> Result<Declaration, CarrierError> {
        self.declare(|hub| &hub.subscribers, key, from, on_message)
    }

    fn serve(&self, key: &str, from: Reach, on_query: OnQuery) -> Result<Declaration, CarrierError> {
        self.declare(|hub| &hub.queryables, key, from, on_query)
    }

    fn ask(&self, question: Question, on_reply: OnReply) -> Result<(), CarrierError> {
        let Question { key, payload, attachment, reach, .. } = question;
        check(&key)?;
        if reach == Reach::OtherProcesses {
            return Ok(());
        }
        let query = Query::new(key, payload, attachment.into(), MemoryResponder(Mutex::new(on_reply)));
        for queryable in matching(&self.0.queryables, &query.key) {
            (queryable.callback)(query.clone());
        }
        Ok(())
    }

    fn token(&self, key: &str) -> Result<Declaration, CarrierError> {
        check(key)?;
        let key: Arc<str> = key.into();
        let mut tokens = self.0.tokens();
        tokens.present.push(Arc::clone(&key));
        tokens.tell(&key, true);
        drop(tokens);
        Ok(self.withdraw(move |hub| {
            let mut tokens = hub.tokens();
            tokens.present.retain(|present| !Arc::ptr_eq(present, &key));
            if !tokens.present.contains(&key) {
                tokens.tell(&key, false);
            }
        }))
    }

    fn watch_tokens(&self, key: &str, on_token: OnToken) -> Result<Declaration, CarrierError> {
        check(key)?;
        let watcher = Arc::new(Entry { key: key.into(), callback: on_token });
        let mut tokens = self.0.tokens();
        for present in tokens.present.iter().filter(|present| intersects(key, present)) {
            (watcher.callback)(present, true);
        }
        tokens.watchers.push(Arc::clone(&watcher));
        drop(tokens);
        Ok(self.withdraw(move |hub| hub.tokens().watchers.retain(|other| !Arc::ptr_eq(other, &watcher))))
    }

    fn tokens(&self, key: &str, _: Duration) -> Result<Vec<String>, CarrierError> {
        check(key)?;
        let tokens = self.0.tokens();
        Ok(tokens.present.iter().filter(|present| intersects(key, present)).map(|key| (**key).into()).collect())
    }
}

impl Tokens {
    fn tell(&self, key: &str, is_there: bool) {
        for watcher in self.watchers.iter().filter(|watcher| intersects(&watcher.key, key)) {
            (watcher.callback)(key, is_there);
        }
    }
}

type Subscribers = Arc<[Arc<Entry<OnMessage>>]>;

struct MemoryPublisher {
    /// `None` if messages are for other processes, of which there are none.
    hub: Option<Arc<Hub>>,
    key: String,
    /// Its subscribers, and the number of changes at which they were looked up, plus one.
    known: Mutex<(u64, Subscribers)>,
}

impl MemoryPublisher {
    fn subscribers(&self) -> Subscribers {
        let Some(hub) = &self.hub else { return Subscribers::default() };
        let changes = hub.changes.load(Ordering::Acquire) + 1;
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if known.0 != changes {
            *known = (changes, matching(&hub.subscribers, &self.key).into());
        }
        Arc::clone(&known.1)
    }
}

impl Publish for MemoryPublisher {
    fn put(&self, payload: Bytes, attachment: Vec<u8>) -> Result<(), CarrierError> {
        let attachment = Bytes::from(attachment);
        for subscriber in self.subscribers().iter() {
            let (key, payload, attachment) = (self.key.clone(), payload.clone(), attachment.clone());
            (subscriber.callback)(Message { key, payload, attachment });
        }
        Ok(())
    }

    fn has_subscribers(&self) -> bool {
        !self.subscribers().is_empty()
    }
}

struct MemoryResponder(Mutex<OnReply>);

impl MemoryResponder {
    fn send(&self, reply: Reply) {
        (self.0.lock().unwrap_or_else(PoisonError::into_inner))(reply);
    }
}

impl Respond for MemoryResponder {
    fn reply(&self, key: &str, _: &str, payload: Bytes, attachment: Vec<u8>) -> Result<(), CarrierError> {
        self.send(Ok(Message { key: key.into(), payload, attachment: attachment.into() }));
        Ok(())
    }

    fn refuse(&self, _: &str, payload: Bytes) -> Result<(), CarrierError> {
        self.send(Err(payload));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use super::*;

    #[test]
    fn stars_stand_for_one_part_or_any_number() {
        for (one, other, expected) in [
            ("a/b", "a/b", true),
            ("a/b", "a/c", false),
            ("a/*/c", "a/b/c", true),
            ("a/*", "a/b/c", false),
            ("a/*", "a", false),
            ("a/**", "a", true),
            ("a/**/d", "a/b/c/d", true),
            ("**/x", "a/b", false),
            ("a/*/c", "*/b/*", true),
            ("a/**", "**/z", true),
        ] {
            assert_eq!((intersects(one, other), intersects(other, one)), (expected, expected), "{one} {other}");
        }
    }

    #[test]
    fn a_subscriber_gets_messages_until_it_is_dropped() {
        let carrier = memory();
        let publisher = carrier.publisher("s/7/action", "Action", Quality::default(), Reach::Everywhere).expect("key");
        assert!(!publisher.has_subscribers());
        let (sender, inbox) = mpsc::channel();
        let all = carrier.subscribe("s/*/action", Reach::ThisProcess, move |message| drop(sender.send(message)));
        let _elsewhere = carrier.subscribe("s/7/action", Reach::OtherProcesses, |_| panic!("not from elsewhere"));
        assert!(publisher.has_subscribers());
        publisher.put("one".into(), vec![1]).expect("sent");
        drop(all);
        publisher.put("two".into(), vec![]).expect("sent");
        let received: Vec<_> = inbox.try_iter().collect();
        let expected = Message { key: "s/7/action".into(), payload: "one".into(), attachment: vec![1].into() };
        assert_eq!((received, publisher.has_subscribers()), (vec![expected], false));
    }

    #[test]
    fn a_query_ends_when_all_who_have_it_are_done() {
        let carrier = memory();
        let kept = Arc::new(Mutex::new(Vec::new()));
        let keep = Arc::clone(&kept);
        let _one =
            carrier.serve("lab/describe", Reach::Everywhere, move |query| keep.lock().expect("lock").push(query));
        let _two = carrier.serve("mill/describe", Reach::Everywhere, |query| {
            query.reply("mill/describe", "ServerInfo", "mill".into(), vec![]).expect("replied");
        });
        let question = Question { key: "*/describe".into(), timeout: Duration::from_secs(60), ..Question::default() };
        let mut replies = carrier.ask_all(question.clone()).expect("asked");
        assert_eq!(replies.next().expect("one").expect("no error").payload, "mill");
        let query = kept.lock().expect("lock").pop().expect("the other");
        query.refuse("Refusal", "busy".into()).expect("refused");
        assert_eq!(replies.next(), Some(Err("busy".into())));
        drop(query);
        assert_eq!(replies.next(), None);
        // Nobody serves the key, or somebody keeps the query for too long.
        let nobody = Question { key: "nobody".into(), ..question.clone() };
        assert_eq!(carrier.ask_all(nobody).expect("asked").next(), None);
        let late = Question { key: "lab/describe".into(), timeout: Duration::from_millis(1), ..question };
        assert_eq!(carrier.ask_all(late).expect("asked").next(), None);
    }

    #[test]
    fn tokens_are_seen_as_they_come_and_go() {
        let carrier = memory();
        let first = carrier.token("lab/alive").expect("token");
        let (sender, events) = mpsc::channel();
        let watch = carrier.watch_tokens("*/alive", move |key, is_there| drop(sender.send((key.to_owned(), is_there))));
        let second = carrier.token("lab/alive").expect("token");
        drop(first);
        assert_eq!(carrier.tokens("lab/*", Duration::ZERO).expect("keys"), ["lab/alive"]);
        drop(second);
        drop(watch);
        drop(carrier.token("lab/alive"));
        let lab = |is_there| ("lab/alive".to_owned(), is_there);
        assert_eq!(events.try_iter().collect::<Vec<_>>(), [lab(true), lab(true), lab(false)]);
    }

    #[test]
    fn what_is_not_a_key_is_refused() {
        let carrier = memory();
        for key in ["", "/a", "a//b", "a/"] {
            let error = carrier.token(key).expect_err("refused").to_string();
            assert!(error.contains("is not a key"), "{error}");
        }
    }
}
