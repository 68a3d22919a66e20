//! Clients that ask for something, and how the server greets them.

use std::sync::Arc;

use fiatlux_access::{Identity, RecorderKey, Secrets, SignedReply, Tokens, is_proof, welcome};
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{Hello, Refusal, Version, Welcome};
use fiatlux_proto::{Message, PROTOCOL};

/// A client that has identified itself, with its request.
pub(super) struct IdentifiedClient<'a> {
    hello: &'a Hello,
    request: &'a [u8],
    /// Identifies the client: by its token, or else by what it says itself.
    pub peer: String,
    /// Number of sessions that its token grants; `None` without tokens.
    pub limit: Option<usize>,
}

impl<'a> IdentifiedClient<'a> {
    /// The same client with another request.
    pub fn again(hello: &'a Hello, request: &'a [u8], peer: &str, limit: Option<usize>) -> Self {
        Self { hello, request, peer: peer.into(), limit }
    }

    /// The server's half of the exchange, for a reply with this content.
    pub fn welcome(
        &self,
        identity: &Identity,
        server: &str,
        id: &str,
        content: &[u8],
    ) -> Result<(Welcome, Secrets), Refusal> {
        let reply = SignedReply { request: self.request, server, id, content };
        welcome(identity, self.hello, reply).map_err(|error| Refusal::new(Code::Value, "hello", error.to_string()))
    }
}

/// The server's keys, and whom it knows.
pub(super) struct Credentials {
    pub identity: Arc<Identity>,
    /// The server's identity if one was given, so that it outlives the process: it signs results.
    pub signer: Option<Arc<Identity>>,
    /// Who may open sessions; `None` if everybody may.
    pub tokens: Option<Tokens>,
    /// Key shared with recorders in other processes, with which records are sealed.
    pub recorder_key: Option<RecorderKey>,
    /// Key by which recorders know the tokens of its sessions; `None` without a recorder.
    pub token_key: Option<RecorderKey>,
}

impl Credentials {
    /// Admits a client, or says why not. `proof` is the proof of its token.
    pub fn admit<'a>(
        &self,
        hello: Option<&'a Hello>,
        version: Option<&Version>,
        request: &'a [u8],
        proof: &[u8],
    ) -> Result<IdentifiedClient<'a>, Refusal> {
        let Some(hello) = hello else {
            let client = version.map_or_else(|| "no version".into(), ToString::to_string);
            let message = format!(
                "the client speaks {client} and says no hello; this server speaks {PROTOCOL}, which needs one; update the \
                 client"
            );
            return Err(Refusal::new(Code::Version, "hello", message));
        };
        fiatlux_access::check_hello(hello).map_err(|error| Refusal::new(Code::Value, "hello", error.to_string()))?;
        let Some(tokens) = &self.tokens else {
            return Ok(IdentifiedClient { hello, request, peer: format!("peer {}", hello.peer), limit: None });
        };
        let grant = tokens.of(&hello.token).filter(|grant| is_proof(grant.secret(), request, proof));
        let grant = grant.ok_or_else(|| {
            let message = match hello.token.is_empty() {
                true => "this server is for holders of its tokens; ask its owner for one, and start with --token FILE",
                false => {
                    "this server is for holders of its tokens and does not know this one; ask its owner for a valid one"
                }
            };
            Refusal::new(Code::Denied, "hello.token", message)
        })?;
        let limit = usize::try_from(grant.limit()).unwrap_or(usize::MAX);
        Ok(IdentifiedClient { hello, request, peer: format!("token {}", grant.id()), limit: Some(limit) })
    }

    /// Signs a refusal, so that nobody else can refuse in the server's place; only a request with a hello can be
    /// answered this way.
    pub fn sign(&self, server: &str, hello: Option<&Hello>, request: &[u8], refusal: &Refusal) -> Option<Welcome> {
        let content = refusal.encode_to_vec();
        let client = IdentifiedClient { hello: hello?, request, peer: String::new(), limit: None };
        client.welcome(&self.identity, server, "", &content).ok().map(|(welcome, _)| welcome)
    }
}
