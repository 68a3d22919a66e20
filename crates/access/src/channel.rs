//! Numbers and authenticates the messages of a session with the session's keys.
//!
//! The payload stays as it is. Zenoh's attachment holds 8 bytes with the number of the message, little-endian, and the first
//! 16 bytes of HMAC-SHA256 over the label of the message, its number and its payload.

use ring::hmac;
use subtle::ConstantTimeEq as _;
use thiserror::Error;

use crate::handshake::{Secrets, Side};

/// Length of an attachment, bytes.
pub const SEAL_BYTES: usize = NUMBER_BYTES + MAC_BYTES;

/// Length of the authentication code, bytes; messages without a number have nothing else.
pub const MAC_BYTES: usize = 16;

const NUMBER_BYTES: usize = 8;

/// Maximum distance of a message behind the newest number: messages of another priority can overtake it.
const WINDOW: u64 = 64;

/// The kind of a message, which its authentication code covers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Label<'a> {
    /// A publication or query on the session's key that ends with this name.
    Message(&'a str),
    /// The reply to the query with this number on such a key.
    Reply(&'a str, u64),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum Refused {
    #[error("it has no attachment of {SEAL_BYTES} bytes; send the one made with the session's keys")]
    Form,
    #[error("its authentication code is wrong; someone else sent it, or it was changed on the way")]
    Forged,
    #[error("message {0} was received before")]
    Repeated(u64),
    #[error("message {0} is more than {WINDOW} messages late")]
    Late(u64),
}

pub struct Channel {
    sends: hmac::Key,
    receives: hmac::Key,
    next: u64,
    taken: Window,
    refused: u64,
}

#[derive(Debug, Default)]
struct Window {
    /// The largest number that was received, plus one.
    end: u64,
    /// Bit k says whether `end - 1 - k` was received.
    bits: u64,
}

impl Channel {
    pub fn new(secrets: &Secrets, side: Side) -> Result<Self, crate::HandshakeError> {
        let [sends, receives] = [secrets.mac_key(side)?, secrets.mac_key(side.other())?];
        Ok(Self { sends, receives, next: 0, taken: Window::default(), refused: 0 })
    }

    /// Makes the attachment of the next message.
    pub fn seal(&mut self, label: Label<'_>, payload: &[u8]) -> [u8; SEAL_BYTES] {
        let number = self.next;
        // It takes centuries to wrap around.
        self.next = self.next.wrapping_add(1);
        let mut attachment = [0; SEAL_BYTES];
        attachment[..NUMBER_BYTES].copy_from_slice(&number.to_le_bytes());
        attachment[NUMBER_BYTES..].copy_from_slice(&mac(&self.sends, label, number, payload));
        attachment
    }

    /// Checks a message of the peer, and returns its number. Replies may come in any order, since each query takes only one.
    ///
    /// # Errors
    /// [`Refused`]. Only messages that the peer itself has made can be [`Refused::Repeated`] or [`Refused::Late`].
    pub fn open(&mut self, label: Label<'_>, payload: &[u8], attachment: &[u8]) -> Result<u64, Refused> {
        let opened = self.check(label, payload, attachment);
        self.refused += u64::from(opened.is_err());
        opened
    }

    pub fn refused(&self) -> u64 {
        self.refused
    }

    fn check(&mut self, label: Label<'_>, payload: &[u8], attachment: &[u8]) -> Result<u64, Refused> {
        let (number, code) = attachment.split_first_chunk::<NUMBER_BYTES>().ok_or(Refused::Form)?;
        let code: &[u8; MAC_BYTES] = code.try_into().map_err(|_| Refused::Form)?;
        let number = u64::from_le_bytes(*number);
        if !bool::from(mac(&self.receives, label, number, payload).ct_eq(code)) {
            return Err(Refused::Forged);
        }
        match label {
            Label::Message(_) => self.taken.take(number)?,
            Label::Reply(..) => {}
        }
        Ok(number)
    }
}

impl Window {
    fn take(&mut self, number: u64) -> Result<(), Refused> {
        if number >= self.end {
            let ahead = number - self.end;
            self.bits = if ahead + 1 < WINDOW { (self.bits << (ahead + 1)) | 1 } else { 1 };
            self.end = number.checked_add(1).ok_or(Refused::Late(number))?;
            return Ok(());
        }
        let behind = self.end - 1 - number;
        if behind >= WINDOW {
            return Err(Refused::Late(number));
        }
        if self.bits >> behind & 1 == 1 {
            return Err(Refused::Repeated(number));
        }
        self.bits |= 1 << behind;
        Ok(())
    }
}

impl std::fmt::Debug for Channel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Channel").field("next", &self.next).field("refused", &self.refused).finish_non_exhaustive()
    }
}

fn mac(key: &hmac::Key, label: Label<'_>, number: u64, payload: &[u8]) -> [u8; MAC_BYTES] {
    let mut context = hmac::Context::with_key(key);
    match label {
        Label::Message(name) => context.update(name.as_bytes()),
        Label::Reply(name, _) => {
            context.update(b"reply to ");
            context.update(name.as_bytes());
        }
    }
    context.update(&[0]);
    context.update(&number.to_le_bytes());
    if let Label::Reply(_, asked) = label {
        context.update(&asked.to_le_bytes());
    }
    context.update(payload);
    shortened(&context.sign())
}

pub(crate) fn shortened(tag: &hmac::Tag) -> [u8; MAC_BYTES] {
    let mut code = [0; MAC_BYTES];
    code.copy_from_slice(&tag.as_ref()[..MAC_BYTES]);
    code
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    const ACTION: Label<'_> = Label::Message("action");

    fn pair() -> (Channel, Channel) {
        let secrets = Secrets::of_test(7);
        (Channel::new(&secrets, Side::Client).unwrap(), Channel::new(&secrets, Side::Server).unwrap())
    }

    #[test]
    fn what_was_sealed_is_taken_once() {
        let (mut client, mut server) = pair();
        for number in 0..3 {
            let attachment = client.seal(ACTION, b"payload");
            assert_eq!(server.open(ACTION, b"payload", &attachment), Ok(number));
            assert_eq!(server.open(ACTION, b"payload", &attachment), Err(Refused::Repeated(number)));
        }
        let answer = server.seal(Label::Message("observation"), b"");
        assert_eq!(client.open(Label::Message("observation"), b"", &answer), Ok(0));
        assert_eq!((server.refused(), client.refused()), (3, 0));
    }

    /// Guards that every change of a message is found: of a bit of payload or attachment, of its label, direction or
    /// session.
    #[test]
    fn every_change_is_found() {
        let (mut client, mut server) = pair();
        let payload: Vec<u8> = (0..=255).collect();
        let attachment = client.seal(ACTION, &payload);
        for bit in 0..8 * payload.len() {
            let mut changed = payload.clone();
            changed[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(server.open(ACTION, &changed, &attachment), Err(Refused::Forged), "bit {bit}");
        }
        for bit in 0..8 * SEAL_BYTES {
            let mut changed = attachment;
            changed[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(server.open(ACTION, &payload, &changed), Err(Refused::Forged), "bit {bit}");
        }
        for length in 0..payload.len() {
            assert_eq!(server.open(ACTION, &payload[..length], &attachment), Err(Refused::Forged));
        }
        for length in 0..SEAL_BYTES {
            assert_eq!(server.open(ACTION, &payload, &attachment[..length]), Err(Refused::Form));
        }
        let longer = [&attachment[..], &[0]].concat();
        assert_eq!(server.open(ACTION, &payload, &longer), Err(Refused::Form));
        for label in [Label::Message("reset"), Label::Message("actio"), Label::Reply("action", 0)] {
            assert_eq!(server.open(label, &payload, &attachment), Err(Refused::Forged), "{label:?}");
        }
        assert_eq!(client.open(ACTION, &payload, &attachment), Err(Refused::Forged), "sent back");
        let mut other = Channel::new(&Secrets::of_test(8), Side::Server).unwrap();
        assert_eq!(other.open(ACTION, &payload, &attachment), Err(Refused::Forged), "another session");
        assert_eq!(server.open(ACTION, &payload, &attachment), Ok(0), "no changed message took its number");
    }

    #[test]
    fn a_reply_fits_its_question_alone() {
        let (mut client, mut server) = pair();
        let reply = server.seal(Label::Reply("reset", 4), b"first");
        assert_eq!(client.open(Label::Reply("reset", 5), b"first", &reply), Err(Refused::Forged));
        assert_eq!(client.open(Label::Reply("close", 4), b"first", &reply), Err(Refused::Forged));
        assert_eq!(client.open(Label::Reply("reset", 4), b"first", &reply), Ok(0));
    }

    #[test]
    fn order_matters_beyond_the_window_alone() {
        let (mut client, mut server) = pair();
        let sealed: Vec<_> = (0..200).map(|_| client.seal(ACTION, b"")).collect();
        let mut open = |number: usize| server.open(ACTION, b"", &sealed[number]);
        assert_eq!(open(100), Ok(100));
        assert_eq!(open(36), Err(Refused::Late(36)));
        for number in (37..100).rev() {
            assert_eq!(open(number), Ok(number as u64));
        }
        for number in 37..=100 {
            assert_eq!(open(number), Err(Refused::Repeated(number as u64)));
        }
        assert_eq!(open(163), Ok(163));
        assert_eq!(open(100), Err(Refused::Repeated(100)), "the last one that is still known");
        assert_eq!(open(99), Err(Refused::Late(99)));
        assert_eq!((open(199), open(198), open(199)), (Ok(199), Ok(198), Err(Refused::Repeated(199))));
    }

    /// Random order with repetitions: no number is accepted twice, and every number that is not too far behind is accepted.
    #[test]
    fn a_number_is_never_taken_twice() {
        let (mut client, mut server) = pair();
        let mut random = Random(1);
        let mut sealed = Vec::new();
        let mut taken = Vec::new();
        for _ in 0..20_000 {
            if sealed.is_empty() || random.next().is_multiple_of(2) {
                sealed.push(client.seal(ACTION, b"x"));
                taken.push(false);
            }
            let back = random.next() as usize % 100;
            let number = sealed.len().saturating_sub(1 + back);
            match server.open(ACTION, b"x", &sealed[number]) {
                Ok(_) => assert!(!std::mem::replace(&mut taken[number], true), "{number} was taken twice"),
                Err(Refused::Repeated(_)) => assert!(taken[number], "{number} was never taken"),
                Err(Refused::Late(_)) => assert!(back >= 64, "{number} is only {back} behind"),
                Err(other) => panic!("{other}"),
            }
        }
    }

    #[test]
    fn random_messages_are_refused() {
        let (_, mut server) = pair();
        let mut random = Random(2);
        for count in 0..100_000_u64 {
            let [payload, attachment] = [40, 2 * SEAL_BYTES].map(|most| random.bytes(most));
            let attachment = if count % 2 == 0 { random.bytes_of(SEAL_BYTES) } else { attachment };
            assert!(server.open(ACTION, &payload, &attachment).is_err());
        }
        assert_eq!(server.refused(), 100_000);
    }

    /// The SplitMix64 generator, so that the test repeats exactly.
    struct Random(u64);

    impl Random {
        fn next(&mut self) -> u64 {
            self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut x = self.0;
            x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            x ^ (x >> 31)
        }

        fn bytes(&mut self, most: usize) -> Vec<u8> {
            let length = self.next() as usize % (most + 1);
            self.bytes_of(length)
        }

        fn bytes_of(&mut self, length: usize) -> Vec<u8> {
            (0..length).map(|_| (self.next() >> 56) as u8).collect()
        }
    }
}
