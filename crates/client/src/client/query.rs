//! Queries that wait for an answer, and queries whose answer goes to the mailbox. Any program may reply to a query, so
//! only replies that the server has proved are accepted.

use std::cell::RefCell;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use fiatlux_access::{Channel, Greeting, Label, SEAL_BYTES, Secrets, SignedReply, proof};
use fiatlux_carrier::{Carrier, Question, Reply};
use fiatlux_proto::limits::MAX_SERVER_MESSAGE;
use fiatlux_proto::v3::{Hello, Refusal, Welcome};
use fiatlux_proto::{Bytes, Message, decode};
use fiatlux_session::client::{Answer, Input};

use super::mailbox::Mailbox;
use super::{Access, ClientError};

/// Time for which queries are repeated, s: just after connecting they reach nobody for a moment.
const PATIENCE_S: f64 = 3.0;

/// The keys of a session, shared by all threads that send in it.
#[derive(Debug, Clone)]
pub struct Sealing(Arc<Mutex<Channel>>);

impl Sealing {
    pub fn new(channel: Channel) -> Self {
        Self(Arc::new(Mutex::new(channel)))
    }

    pub fn lock(&self) -> MutexGuard<'_, Channel> {
        // The channel is intact even if a thread panicked while holding the lock.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The attachment for a message, and the number that identifies its answer.
    pub fn seal(&self, label: &str, payload: &[u8]) -> (Vec<u8>, u64) {
        let attachment = self.lock().seal(Label::Message(label), payload);
        let mut number = [0; 8];
        number.copy_from_slice(&attachment[..8]);
        debug_assert_eq!(attachment.len(), SEAL_BYTES);
        (attachment.to_vec(), u64::from_le_bytes(number))
    }

    /// The server's answer to the query of that number; `None` for replies of others.
    pub fn answer(&self, label: &str, number: u64, reply: &Reply) -> Option<Result<Bytes, Bytes>> {
        let message = reply.as_ref().ok()?;
        let opens =
            |label| self.lock().open(Label::Reply(label, number), &message.payload, &message.attachment).is_ok();
        if opens(label) {
            return Some(Ok(message.payload.clone()));
        }
        opens("refusal").then(|| Err(message.payload.clone()))
    }

    /// Sends a question on a key of a session, and waits for the server's answer.
    pub fn ask(
        &self,
        link: &Carrier,
        server: &str,
        key: &str,
        label: &str,
        message: &str,
        request: &impl Message,
        timeout_s: f64,
    ) -> Result<Bytes, ClientError> {
        let payload = Bytes::from(request.encode_to_vec());
        let (attachment, number) = self.seal(label, &payload);
        let question = question([key, message], payload, attachment, timeout_s);
        let refused = |bytes: Bytes| match decode::<Refusal>(&bytes, MAX_SERVER_MESSAGE) {
            Ok(refusal) => ClientError::refused(server, refusal),
            Err(source) => ClientError::Unreadable { server: server.into(), source },
        };
        ask(link, &question, |reply| Some(self.answer(label, number, reply)?.map_err(refused)), || false)
    }
}

/// A question in the form in which it is sent each time.
pub fn question([key, message]: [&str; 2], payload: Bytes, attachment: Vec<u8>, timeout_s: f64) -> Question {
    let timeout = Duration::from_secs_f64(timeout_s);
    Question { key: key.into(), message: message.into(), payload, attachment, timeout, ..Question::default() }
}

/// Repeats a question until `take` accepts an answer. A query that ends without one is sent again for a while, unless
/// the caller knows enough.
pub fn ask<T>(
    link: &Carrier,
    question: &Question,
    mut take: impl FnMut(&Reply) -> Option<Result<T, ClientError>>,
    knows_enough: impl Fn() -> bool,
) -> Result<T, ClientError> {
    let start = Instant::now();
    loop {
        if let Some(taken) = link.ask_all(question.clone())?.find_map(|reply| take(&reply)) {
            return taken;
        }
        let waited_s = start.elapsed().as_secs_f64();
        if waited_s > PATIENCE_S.min(question.timeout.as_secs_f64()) || knows_enough() {
            return Err(ClientError::Unanswered { key: question.key.clone(), waited_s: waited_s.round() });
        }
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// The content of a reply to a greeting.
pub struct GreetingReply<T> {
    pub content: Result<T, Refusal>,
    /// The reply came over a link, which nobody else can use.
    pub is_sealed: bool,
    pub welcome: Option<Welcome>,
}

/// A server's description of a session or a run in its answer to a greeting.
pub trait Content: Message {
    /// Id of the session or run.
    fn id(&self) -> &str;
}

/// Greets a server: sends a hello, and takes the first answer that the server has signed. `request` makes the request's
/// payload from the hello, `attach` what precedes the token's proof in its attachment, and `read` decodes an answer.
pub fn greet<T: Content>(
    link: &Carrier,
    server: &str,
    access: &Access,
    [key, message]: [&str; 2],
    timeout_s: f64,
    request: impl FnOnce(Hello) -> Vec<u8>,
    attach: impl FnOnce(&[u8]) -> Vec<u8>,
    mut read: impl FnMut(&Reply) -> Option<Result<GreetingReply<T>, ClientError>>,
) -> Result<(T, Secrets), ClientError> {
    let expected = access.key_of(server)?;
    let greeting = Greeting::new(&link.id(), access.token.as_ref()).map_err(ClientError::handshake(server))?;
    let payload = Bytes::from(request(greeting.hello()));
    let mut attachment = attach(&payload);
    if let Some(token) = &access.token {
        attachment.extend(proof(token.secret(), &payload));
    }
    // The last untrusted answer, for the case that no other arrives.
    let doubtful = RefCell::new(None);
    let doubt = |error| *doubtful.borrow_mut() = Some(error);
    let question = question([key, message], payload, attachment, timeout_s);
    let taken = ask(
        link,
        &question,
        |reply| {
            let greeted = match read(reply)? {
                Ok(greeted) => greeted,
                Err(error) => {
                    doubt(error);
                    return None;
                }
            };
            if greeted.is_sealed
                && let Err(refusal) = greeted.content
            {
                return Some(Err(ClientError::refused(server, refusal)));
            }
            let (id, content) = match &greeted.content {
                Ok(content) => (content.id(), content.encode_to_vec()),
                Err(refusal) => ("", refusal.encode_to_vec()),
            };
            let replied = SignedReply { request: &question.payload, server, id, content: &content };
            let welcome = greeted.welcome.as_ref();
            match (greeting.verify(replied, welcome.unwrap_or(&Welcome::default()), expected.as_ref()), greeted.content)
            {
                (Ok(verified), Ok(content)) => Some(Ok((content, verified))),
                (Ok(_), Err(refusal)) => Some(Err(ClientError::refused(server, refusal))),
                (Err(_), Err(refusal)) if welcome.is_none() => {
                    doubt(ClientError::refused(server, refusal));
                    None
                }
                (Err(error), _) => {
                    doubt(ClientError::handshake(server)(error));
                    None
                }
            }
        },
        || doubtful.borrow().is_some(),
    );
    let (content, verified) = match (taken, doubtful.take()) {
        (Err(ClientError::Unanswered { .. }), Some(error)) => return Err(error),
        (taken, _) => taken?,
    };
    if expected.is_none() && fiatlux_cli::is_news(&format!("key of {server}: {}", verified.server())) {
        tracing::info!(server, key = %verified.server(), "the server's key was not checked; --server-key would demand it");
    }
    Ok((content, greeting.agree(&verified).map_err(ClientError::handshake(server))?))
}

/// Sends a question; the server's first answer, or the lack of one, goes to the mailbox.
pub fn post(
    link: &Carrier,
    [key, label]: [&str; 2],
    request: Bytes,
    timeout: Duration,
    sealing: &Sealing,
    mailbox: &Arc<Mailbox>,
    input: fn(Answer) -> Input,
) -> Result<(), ClientError> {
    let (attachment, number) = sealing.seal(label, &request);
    let mut end = End { mailbox: Arc::clone(mailbox), input, answered: false };
    let (sealing, label) = (sealing.clone(), label.to_owned());
    let receive = move |reply: Reply| {
        if let Some(answer) = sealing.answer(&label, number, &reply) {
            end.answer(Some(answer));
        }
    };
    let question =
        Question { key: key.into(), payload: request, attachment, timeout, is_urgent: true, ..Question::default() };
    Ok(link.ask(question, receive)?)
}

/// The carrier drops this when the query has ended.
struct End {
    mailbox: Arc<Mailbox>,
    input: fn(Answer) -> Input,
    answered: bool,
}

impl End {
    fn answer(&mut self, answer: Answer) {
        if !std::mem::replace(&mut self.answered, true) {
            self.mailbox.put((self.input)(answer));
        }
    }
}

impl Drop for End {
    fn drop(&mut self) {
        self.answer(None);
    }
}
