//! Agrees on the keys of a session between a client and a server, while others listen.
//!
//! The client sends a [`Hello`] with its request. The server replies with a [`Welcome`], whose signature covers
//! everything that both sides sent. Each side has an ephemeral X25519 key; only the two know the shared secret, and the
//! signature proves who replied.

use fiatlux_proto::v3::{Hello, Welcome};
use ring::agreement::{self, EphemeralPrivateKey, UnparsedPublicKey, X25519};
use ring::hkdf::{self, HKDF_SHA256, Prk};
use ring::rand::SystemRandom;
use ring::{aead, digest, hmac};
use thiserror::Error;

use crate::{AccessError, Identity, PublicKey, Token, random};

/// Labels of hashes and signatures, with the version of the protocol that defined this exchange.
const LABEL: &[u8] = b"fiatlux handshake 3.4";
const TOKEN_LABEL: &[u8] = b"fiatlux token 3.4";
const RUN_LABEL: &[u8] = b"fiatlux run 3.4";

pub const PROOF_BYTES: usize = 32;

/// Maximum length of a Zenoh id in a hello, bytes.
const MAX_PEER: usize = 64;

#[derive(Debug, Error)]
pub enum HandshakeError {
    #[error("hello.{field} {problem}")]
    Hello { field: &'static str, problem: &'static str },
    #[error("the reply is not signed by the key that it names; someone else answered, or it was changed on the way")]
    Signature,
    #[error(
        "the reply is signed by {found}, but the server's key is {expected}; someone else answered, or the server has a new key"
    )]
    Server { expected: PublicKey, found: PublicKey },
    #[error("the two keys of the exchange give no shared secret; draw new ones")]
    Agreement,
    #[error(transparent)]
    Random(#[from] AccessError),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    Client,
    Server,
}

impl Side {
    pub(crate) fn other(self) -> Self {
        match self {
            Self::Client => Self::Server,
            Self::Server => Self::Client,
        }
    }
}

/// The parts of a reply that its signature covers.
#[derive(Debug, Clone, Copy)]
pub struct SignedReply<'a> {
    /// The request it answers, byte for byte as it was sent.
    pub request: &'a [u8],
    pub server: &'a str,
    /// Id of the session or the link; empty if the request is refused.
    pub id: &'a str,
    /// The encoded content of the reply: a `SessionInfo`, `RunInfo` or `Refusal`.
    pub content: &'a [u8],
}

/// A client's half of an exchange.
pub struct Greeting {
    private: EphemeralPrivateKey,
    hello: Hello,
}

/// A reply whose signature the client has checked.
pub struct VerifiedReply {
    transcript: [u8; 32],
    server: PublicKey,
    key: Vec<u8>,
}

/// The secret that only the two sides of a session know; all keys of the session are derived from it.
pub struct Secrets(Prk);

impl Greeting {
    /// Draws the random parts of a request. `peer` is the client's Zenoh id.
    pub fn new(peer: &str, token: Option<&Token>) -> Result<Self, HandshakeError> {
        let private = private_key()?;
        let hello = Hello {
            key: public_key(&private)?,
            random: random::<32>()?.to_vec(),
            token: token.map(|token| token.id().to_owned()).unwrap_or_default(),
            peer: peer.into(),
        };
        Ok(Self { private, hello })
    }

    /// The message that goes with the request.
    pub fn hello(&self) -> Hello {
        self.hello.clone()
    }

    /// Checks a reply. The greeting can check more than one, since others may answer too.
    ///
    /// # Errors
    /// [`HandshakeError::Signature`]; [`HandshakeError::Server`] if `expected` is another key.
    pub fn verify(
        &self,
        reply: SignedReply<'_>,
        welcome: &Welcome,
        expected: Option<&PublicKey>,
    ) -> Result<VerifiedReply, HandshakeError> {
        let identity: [u8; 32] = welcome.identity[..].try_into().map_err(|_| HandshakeError::Signature)?;
        let server = PublicKey::from_bytes(identity);
        let transcript = transcript(&self.hello, &welcome.key, reply);
        if welcome.key.len() != 32 || !server.verify(&signed(&transcript), &welcome.signature) {
            return Err(HandshakeError::Signature);
        }
        match expected {
            Some(expected) if *expected != server => Err(HandshakeError::Server { expected: *expected, found: server }),
            _ => Ok(VerifiedReply { transcript, server, key: welcome.key.clone() }),
        }
    }

    /// The secrets of the session that the reply opens.
    pub fn agree(self, verified: &VerifiedReply) -> Result<Secrets, HandshakeError> {
        agree(self.private, &verified.key, &verified.transcript)
    }
}

impl VerifiedReply {
    pub fn server(&self) -> &PublicKey {
        &self.server
    }
}

/// Checks whether a request's hello can be answered.
pub fn check_hello(hello: &Hello) -> Result<(), HandshakeError> {
    let wrong = |field, problem| Err(HandshakeError::Hello { field, problem });
    if hello.key.len() != 32 {
        return wrong("key", "is not an X25519 public key of 32 bytes; draw one for each request");
    }
    if hello.random.len() != 32 {
        return wrong("random", "does not have 32 bytes; draw them for each request");
    }
    if hello.peer.len() > MAX_PEER || !hello.peer.bytes().all(|byte| byte.is_ascii_graphic()) {
        return wrong("peer", "is not a Zenoh id of at most 64 visible characters; send the session's own, or none");
    }
    Ok(())
}

/// The server's half: the message for its reply, and the secrets of the session.
pub fn welcome(
    identity: &Identity,
    hello: &Hello,
    reply: SignedReply<'_>,
) -> Result<(Welcome, Secrets), HandshakeError> {
    check_hello(hello)?;
    let private = private_key()?;
    let key = public_key(&private)?;
    let transcript = transcript(hello, &key, reply);
    let secrets = agree(private, &hello.key, &transcript)?;
    let signature = identity.sign(&signed(&transcript)).to_vec();
    Ok((Welcome { key, identity: identity.public().as_bytes().to_vec(), signature }, secrets))
}

/// Proves that the sender of a request has the token; goes into the request's attachment.
pub fn proof(secret: &[u8; 32], request: &[u8]) -> [u8; PROOF_BYTES] {
    let mut proof = [0; PROOF_BYTES];
    proof.copy_from_slice(proof_context(secret, request).sign().as_ref());
    proof
}

/// Checks, in constant time, that the proof was made with this token for this request.
#[must_use]
pub fn is_proof(secret: &[u8; 32], request: &[u8], proof: &[u8]) -> bool {
    use subtle::ConstantTimeEq as _;
    bool::from(proof_context(secret, request).sign().as_ref().ct_eq(proof))
}

fn proof_context(secret: &[u8; 32], request: &[u8]) -> hmac::Context {
    let mut context = hmac::Context::with_key(&hmac::Key::new(hmac::HMAC_SHA256, secret));
    context.update(TOKEN_LABEL);
    context.update(&[0]);
    context.update(request);
    context
}

/// The key pair of a run, derived from the run's secret.
pub fn run_identity(secret: &str) -> Result<Identity, HandshakeError> {
    let mut seed = [0; 32];
    seed.copy_from_slice(hash(&[RUN_LABEL, b" key\0", secret.as_bytes()]).as_ref());
    Identity::from_seed(seed).ok_or(HandshakeError::Agreement)
}

/// The bytes that the key of a run signs to register with a server: the name of the server, and the request.
pub fn registration(server: &str, request: &[u8]) -> Vec<u8> {
    [RUN_LABEL, b" register\0", server.as_bytes(), b"\0", request].concat()
}

impl Secrets {
    /// Key of the authentication codes of all messages that this side sends.
    pub fn mac_key(&self, sender: Side) -> Result<hmac::Key, HandshakeError> {
        let info: &[u8] = match sender {
            Side::Client => b"client to server",
            Side::Server => b"server to client",
        };
        expand_mac(&self.0, info)
    }

    /// The root key, from which [`crate::RowsKey`] derives the keys of records for the session's opener.
    pub(crate) fn prk(&self) -> &Prk {
        &self.0
    }

    #[cfg(test)]
    pub(crate) fn of_test(seed: u8) -> Self {
        Self(hkdf::Salt::new(HKDF_SHA256, b"test").extract(&[seed; 32]))
    }
}

impl std::fmt::Debug for Secrets {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Secrets(..)")
    }
}

pub(crate) fn expand_mac(secret: &Prk, info: &[u8]) -> Result<hmac::Key, HandshakeError> {
    let info = [info];
    Ok(secret.expand(&info, hmac::HMAC_SHA256).map_err(|_| HandshakeError::Agreement)?.into())
}

pub(crate) fn expand_aead(secret: &Prk, info: &[u8]) -> Result<aead::LessSafeKey, HandshakeError> {
    let info = [info];
    let key = secret.expand(&info, &aead::CHACHA20_POLY1305).map_err(|_| HandshakeError::Agreement)?;
    Ok(aead::LessSafeKey::new(key.into()))
}

pub fn hash(parts: &[&[u8]]) -> digest::Digest {
    let mut context = digest::Context::new(&digest::SHA256);
    parts.iter().for_each(|part| context.update(part));
    context.finish()
}

fn transcript(hello: &Hello, server_key: &[u8], reply: SignedReply<'_>) -> [u8; 32] {
    let SignedReply { request, server, id, content } = reply;
    let [request, content] = [request, content].map(|bytes| hash(&[bytes]));
    let parts: [&[u8]; 10] = [
        LABEL,
        b"\0",
        &hello.key,
        server_key,
        &hello.random,
        server.as_bytes(),
        b"\0",
        id.as_bytes(),
        b"\0",
        request.as_ref(),
    ];
    let mut transcript = [0; 32];
    transcript.copy_from_slice(hash(&[&parts.concat(), content.as_ref()]).as_ref());
    transcript
}

/// The bytes that the server signs; no other signature of an identity covers bytes that begin like this.
fn signed(transcript: &[u8; 32]) -> Vec<u8> {
    [LABEL, b" signature\0", transcript].concat()
}

fn private_key() -> Result<EphemeralPrivateKey, HandshakeError> {
    EphemeralPrivateKey::generate(&X25519, &SystemRandom::new()).map_err(|_| HandshakeError::Agreement)
}

fn public_key(private: &EphemeralPrivateKey) -> Result<Vec<u8>, HandshakeError> {
    Ok(private.compute_public_key().map_err(|_| HandshakeError::Agreement)?.as_ref().to_vec())
}

fn agree(private: EphemeralPrivateKey, peer: &[u8], transcript: &[u8; 32]) -> Result<Secrets, HandshakeError> {
    let extract = |shared: &[u8]| Secrets(hkdf::Salt::new(HKDF_SHA256, transcript).extract(shared));
    agreement::agree_ephemeral(private, &UnparsedPublicKey::new(&X25519, peer), extract)
        .map_err(|_| HandshakeError::Agreement)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::{Channel, Label};

    const REPLY: SignedReply<'static> = SignedReply { request: b"request", server: "lab", id: "7", content: b"info" };

    #[test]
    fn both_sides_have_the_same_keys() {
        let (identity, greeting) = (Identity::generate().unwrap(), Greeting::new("ab12", None).unwrap());
        let (welcome, secrets) = welcome(&identity, &greeting.hello(), REPLY).unwrap();
        let verified = greeting.verify(REPLY, &welcome, Some(&identity.public())).unwrap();
        assert_eq!(*verified.server(), identity.public());
        let mut client = Channel::new(&greeting.agree(&verified).unwrap(), Side::Client).unwrap();
        let mut server = Channel::new(&secrets, Side::Server).unwrap();
        let label = Label::Message("reset");
        assert_eq!(server.open(label, b"x", &client.seal(label, b"x")), Ok(0));
    }

    /// Guards that a relay can neither change an exchange nor answer in the server's place.
    #[test]
    fn a_reply_that_was_changed_is_found() {
        let (identity, greeting) = (Identity::generate().unwrap(), Greeting::new("", None).unwrap());
        let hello = greeting.hello();
        let (good, _) = welcome(&identity, &hello, REPLY).unwrap();
        let is_taken = |reply, welcome: &Welcome| greeting.verify(reply, welcome, Some(&identity.public())).is_ok();
        assert!(is_taken(REPLY, &good));
        for other in [
            SignedReply { request: b"requesu", ..REPLY },
            SignedReply { server: "la", ..REPLY },
            SignedReply { id: "8", ..REPLY },
            SignedReply { content: b"", ..REPLY },
            SignedReply { server: "lab7", id: "", ..REPLY },
        ] {
            assert!(!is_taken(other, &good), "{other:?}");
        }
        for part in 0..3 {
            for bit in 0..8 * 32 {
                let mut changed = good.clone();
                let bytes = [&mut changed.key, &mut changed.identity, &mut changed.signature];
                let [key, identity, signature] = bytes;
                [key, identity, signature][part][bit / 8] ^= 1 << (bit % 8);
                assert!(!is_taken(REPLY, &changed), "part {part} bit {bit}");
            }
        }
        for wrong in [Welcome::default(), Welcome { key: vec![0; 31], ..good.clone() }] {
            assert!(!is_taken(REPLY, &wrong));
        }
        let other = Identity::generate().unwrap();
        let (other, _) = welcome(&other, &hello, REPLY).unwrap();
        let refused = greeting.verify(REPLY, &other, Some(&identity.public()));
        assert!(matches!(refused, Err(HandshakeError::Server { .. })));
        assert!(greeting.verify(REPLY, &other, None).is_ok(), "without an expected key any signer is accepted");
        let (other, _) = welcome(&identity, &Greeting::new("", None).unwrap().hello(), REPLY).unwrap();
        assert!(!is_taken(REPLY, &other), "the answer to another hello");
    }

    #[test]
    fn a_hello_that_gives_no_secret_is_refused() {
        let identity = Identity::generate().unwrap();
        let good = Greeting::new("ab", None).unwrap().hello();
        for (hello, field) in [
            (Hello { key: vec![1; 31], ..good.clone() }, "hello.key"),
            (Hello { random: Vec::new(), ..good.clone() }, "hello.random"),
            (Hello { peer: "a b".into(), ..good.clone() }, "hello.peer"),
            (Hello { peer: "x".repeat(65), ..good.clone() }, "hello.peer"),
        ] {
            let error = welcome(&identity, &hello, REPLY).unwrap_err().to_string();
            assert!(error.starts_with(field), "{error}");
        }
        // A point of small order, with which everybody would get the same secret.
        let hello = Hello { key: vec![0; 32], ..good };
        assert!(matches!(welcome(&identity, &hello, REPLY), Err(HandshakeError::Agreement)));
    }

    #[test]
    fn a_proof_is_of_one_token_and_one_request() {
        let made = proof(&[1; 32], b"request");
        assert!(is_proof(&[1; 32], b"request", &made));
        assert!(!is_proof(&[2; 32], b"request", &made) && !is_proof(&[1; 32], b"requesu", &made));
        assert!(!is_proof(&[1; 32], b"request", &made[..31]) && !is_proof(&[1; 32], b"request", &[]));
    }

    #[test]
    fn the_secret_of_a_run_gives_one_key() {
        let [one, again, other] = ["00ff", "00ff", "00fe"].map(|secret| run_identity(secret).unwrap().public());
        assert!(one == again && one != other);
    }
}
