//! What clients of raw messages share.

use std::sync::mpsc::{Receiver, channel};

use fiatlux_proto::Message;
use zenoh::sample::Sample;
use zenoh::{Session, Wait};

/// The messages that are published on a key from now on.
pub fn subscribe<M: Message + Default + 'static>(zenoh: &Session, key: String) -> Receiver<M> {
    let (send, receive) = channel();
    let callback = move |sample: Sample| {
        let _ = send.send(M::decode(&*sample.payload().to_bytes()).unwrap());
    };
    zenoh.declare_subscriber(key).callback(callback).background().wait().unwrap();
    receive
}
