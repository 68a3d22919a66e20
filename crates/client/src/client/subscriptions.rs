//! Messages on the keys of a session, and whether its server is there.

use std::sync::Arc;

use fiatlux_access::Label;
use fiatlux_carrier::{Carrier, Declaration, Reach};
use fiatlux_proto::Bytes;
use fiatlux_session::client::Input;

use super::ClientError;
use super::mailbox::Mailbox;
use super::query::Sealing;

/// Puts messages of a key into a mailbox, those alone that the channel opens.
pub(super) fn subscribe(
    link: &Carrier,
    key: String,
    label: &'static str,
    sealing: &Sealing,
    mailbox: &Arc<Mailbox>,
    input: fn(Bytes) -> Input,
) -> Result<Declaration, ClientError> {
    let (mailbox, sealing) = (Arc::clone(mailbox), sealing.clone());
    let subscription = link.subscribe(&key, Reach::Everywhere, move |message| {
        // Messages of others on the server's keys are ignored; the channel counts them.
        if sealing.lock().open(Label::Message(label), &message.payload, &message.attachment).is_ok() {
            mailbox.put(input(message.payload));
        }
    });
    Ok(subscription?)
}

/// Watches the server's liveliness token for the session.
pub(super) fn watch(link: &Carrier, key: String, mailbox: &Arc<Mailbox>) -> Result<Declaration, ClientError> {
    let mailbox = Arc::clone(mailbox);
    Ok(link.watch_tokens(&key, move |_, is_there| mailbox.put(Input::ServerSeen(is_there)))?)
}
