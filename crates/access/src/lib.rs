//! Identities on a shared network: keys and tokens, and the files that hold them.
//!
//! | file | who has it | what it does |
//! |---|---|---|
//! | identity | the server | proves that it is the server of that key, signs results and journals: [`Identity`] |
//! | known servers | clients | pins the keys of servers by name: [`KnownServers`] |
//! | token | a client | opens sessions: [`Token`] |
//! | tokens | the server | lists the tokens it accepts, and how many sessions each may have open: [`Tokens`] |
//! | recorder key | server and recorder | lets only this recorder read rows: [`RecorderKey`] |
//!
//! The protocol uses them like this: [`Greeting`] and [`welcome`] agree on the keys of a session, a [`Channel`] numbers and
//! authenticates its messages, and a [`RowsKey`] encrypts its records for their recorder.
//!
//! A file with a secret is created with mode 0600, and refused if others can read it. No file is ever overwritten.
//!
//! ```
//! use fiatlux_access::{Identity, PublicKey};
//!
//! let server = Identity::generate()?;
//! let pasted = server.public().to_string();
//! let known: PublicKey = pasted.parse().expect("reads back");
//! assert!(known.verify(b"session 7", &server.sign(b"session 7")));
//! # Ok::<(), fiatlux_access::AccessError>(())
//! ```
#![allow(missing_docs)] // Used in this repository alone.
mod channel;
mod error;
mod file;
mod handshake;
mod identity;
mod journal;
mod known;
mod recorder_key;
mod result;
mod rows;
mod tokens;

pub use channel::{Channel, Label, MAC_BYTES, Refused, SEAL_BYTES};
pub use error::{AccessError, FormatError};
pub use file::{check_private, read_public, read_secret, write_new};
pub use handshake::{
    Greeting, HandshakeError, PROOF_BYTES, Secrets, Side, SignedReply, VerifiedReply, check_hello, hash, is_proof,
    proof, registration, run_identity, welcome,
};
pub use identity::{Identity, PublicKey, SIGNATURE_BYTES};
pub use journal::{journal_signer, sign_journal};
pub use known::{KnownServers, SERVER_OR_GROUP, is_server_or_group};
pub use recorder_key::RecorderKey;
pub use result::{Signer, sign_result, signer_of};
pub use rows::{RowsKey, sealed_seq};
pub use tokens::{Grant, MAX_LIMIT, SECRET_BYTES, Token, Tokens};

pub fn random<const N: usize>() -> Result<[u8; N], AccessError> {
    let mut bytes = [0; N];
    getrandom::fill(&mut bytes).map_err(AccessError::Random)?;
    Ok(bytes)
}
