//! Queries: those that are waited for, and those whose end comes by mail.

use std::sync::Arc;
use std::time::{Duration, Instant};

use fiatlux_proto::keys::server_of;
use fiatlux_proto::limits::MAX_SERVER_MESSAGE;
use fiatlux_proto::v3::Refusal;
use fiatlux_proto::{Bytes, Message, decode, encoding};
use fiatlux_session::client::{Answer, Input};
use zenoh::qos::Priority;
use zenoh::query::Reply;
use zenoh::{Session, Wait};

use super::ClientError;
use super::mailbox::Mailbox;

/// Just after a connection, queries find nobody for a moment. For so long they are sent again, s.
const PATIENCE_S: f64 = 3.0;

/// Asks and waits for the answer.
pub fn ask(
    link: &Session,
    key: &str,
    name: &str,
    request: &impl Message,
    timeout_s: f64,
) -> Result<Bytes, ClientError> {
    let start = Instant::now();
    loop {
        let query = link.get(key).payload(request.encode_to_vec()).encoding(encoding(name));
        let replies = query.timeout(Duration::from_secs_f64(timeout_s)).wait().map_err(ClientError::zenoh)?;
        let unanswered = |waited_s: f64| ClientError::Unanswered { key: key.into(), waited_s: waited_s.round() };
        let waited_s = start.elapsed().as_secs_f64();
        if let Ok(reply) = replies.recv() {
            return answer(&reply).map_err(|bytes| match decode::<Refusal>(&bytes, MAX_SERVER_MESSAGE) {
                Ok(refusal) => ClientError::refused(server_of(key).unwrap_or_default(), refusal),
                // Zenoh's own word for a time-out is an error reply too.
                Err(_) => unanswered(waited_s.max(timeout_s)),
            });
        }
        if waited_s > PATIENCE_S.min(timeout_s) {
            return Err(unanswered(waited_s));
        }
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// Asks; the first answer, or that there is none, is put into the mailbox.
pub fn post(
    link: &Session,
    key: &str,
    request: Bytes,
    timeout: Duration,
    mailbox: &Arc<Mailbox>,
    input: fn(Answer) -> Input,
) -> Result<(), ClientError> {
    let mut end = End { mailbox: Arc::clone(mailbox), input, answered: false };
    let receive = move |reply: Reply| end.answer(Some(answer(&reply)));
    let query = link.get(key).payload(request).timeout(timeout);
    // As actions: what is sent first arrives first.
    query.priority(Priority::RealTime).express(true).callback_mut(receive).wait().map_err(ClientError::zenoh)
}

/// Zenoh drops it when the query has ended.
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

fn answer(reply: &Reply) -> Result<Bytes, Bytes> {
    match reply.result() {
        Ok(sample) => Ok(sample.payload().to_bytes().into_owned().into()),
        Err(error) => Err(error.payload().to_bytes().into_owned().into()),
    }
}
