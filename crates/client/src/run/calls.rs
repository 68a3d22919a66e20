//! The queries of a run.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use fiatlux_access::{Channel, Secrets, Side, registration, run_identity};
use fiatlux_carrier::{Carrier, Question, Reply};
use fiatlux_proto::keys::ServerKeys;
use fiatlux_proto::limits::MAX_SERVER_MESSAGE;
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::run_request::Ask;
use fiatlux_proto::v3::{
    RunFinish, RunInfo, RunReply, RunRequest, RunSpec, RunStatus, SeedRange, ServerInfo, SessionInfo, run_reply,
};
use fiatlux_proto::{Bytes, Message, PROTOCOL, decode};

use crate::client::OPEN_TIMEOUT_S;
use crate::client::query::{Content, GreetingReply, Sealing, ask, greet, question};
use crate::{Access, ClientError};

/// Longest wait for an answer to anything but opening a session, s.
const TIMEOUT_S: f64 = 5.0;

/// Longest wait for a server's description.
const DESCRIBE_TIMEOUT: Duration = Duration::from_secs(2);

/// The links to servers that this client has greeted, by server name.
pub(super) type Links = Mutex<BTreeMap<String, Link>>;

/// Keys that prove later requests.
#[derive(Clone)]
pub(super) struct Link {
    id: String,
    sealing: Sealing,
}

/// A run as its servers know it.
#[derive(Clone, Copy)]
pub(super) struct Calls<'a> {
    pub link: &'a Carrier,
    pub run: &'a str,
    /// The run's secret. It is never sent: requests are signed with it.
    pub key: &'a str,
    pub access: &'a Access,
    pub links: &'a Links,
}

impl Content for RunInfo {
    fn id(&self) -> &str {
        &self.link
    }
}

impl Calls<'_> {
    pub(super) fn register(&self, server: &str, spec: &RunSpec) -> Result<RunInfo, ClientError> {
        self.greet(server, Ask::Register(in_ranges(spec)))
    }

    /// The state of the run on that server.
    pub(super) fn status(&self, server: &str) -> Result<RunInfo, ClientError> {
        self.info(server, Ask::Status(RunStatus {}))
    }

    /// Closes the run on that server.
    pub(super) fn finish(&self, server: &str) -> Result<RunInfo, ClientError> {
        self.info(server, Ask::Finish(RunFinish {}))
    }

    pub(super) fn open(&self, server: &str, episode: usize) -> Result<(SessionInfo, Secrets), ClientError> {
        let index = u32::try_from(episode).unwrap_or(u32::MAX);
        for _ in 0..2 {
            let link = self.link_to(server)?;
            let mut no_link = false;
            let number = std::cell::Cell::new(0);
            let key = ServerKeys::new(server).run();
            let opened = greet(
                self.link,
                server,
                // The link has the rights of the token.
                &Access { token: None, ..self.access.clone() },
                [&key, "RunRequest"],
                OPEN_TIMEOUT_S,
                |hello| RunRequest { hello: Some(hello), ..self.request(Ask::Open(index), &link.id) }.encode_to_vec(),
                |payload| {
                    let (attachment, asked) = link.sealing.seal("run", payload);
                    number.set(asked);
                    attachment
                },
                |reply| {
                    let Some(Ok(bytes)) = link.sealing.answer("run", number.get(), reply) else {
                        no_link |= says_no_link(reply);
                        return if no_link { Some(Err(unknown_link(server))) } else { None };
                    };
                    let (content, welcome) = match read(server, &bytes) {
                        Ok((run_reply::Reply::Session(info), welcome)) => (Ok(info), welcome),
                        Ok((run_reply::Reply::Refusal(refusal), welcome)) => (Err(refusal), welcome),
                        Ok(_) => return Some(Err(other_kind())),
                        Err(error) => return Some(Err(error)),
                    };
                    Some(Ok(GreetingReply { content, is_sealed: true, welcome }))
                },
            );
            if !no_link || opened.is_ok() {
                return opened;
            }
            self.forget(server);
        }
        Err(unknown_link(server))
    }

    /// The server's description of itself.
    pub(super) fn describe(&self, server: &str) -> Result<ServerInfo, ClientError> {
        let key = ServerKeys::new(server).describe();
        let question = Question { key: key.clone(), timeout: DESCRIBE_TIMEOUT, ..Question::default() };
        let message = self.link.ask_all(question)?.find_map(Result::ok);
        let unanswered = || ClientError::Unanswered { key, waited_s: DESCRIBE_TIMEOUT.as_secs_f64() };
        decode(&message.ok_or_else(unanswered)?.payload, MAX_SERVER_MESSAGE).map_err(ClientError::unreadable(server))
    }

    fn info(&self, server: &str, what: Ask) -> Result<RunInfo, ClientError> {
        for _ in 0..2 {
            let link = self.link_to(server)?;
            let key = ServerKeys::new(server).run();
            let payload = Bytes::from(self.request(what.clone(), &link.id).encode_to_vec());
            let (attachment, number) = link.sealing.seal("run", &payload);
            let question = question([&key, "RunRequest"], payload, attachment, TIMEOUT_S);
            let no_link = std::cell::Cell::new(false);
            let reply = ask(
                self.link,
                &question,
                |reply| match link.sealing.answer("run", number, reply) {
                    Some(Ok(bytes)) => Some(read(server, &bytes)),
                    _ if says_no_link(reply) => {
                        no_link.set(true);
                        None
                    }
                    _ => None,
                },
                || no_link.get(),
            );
            match reply {
                // The server's own answer takes precedence over what others say.
                Err(ClientError::Unanswered { .. }) if no_link.get() => self.forget(server),
                reply => {
                    return match reply?.0 {
                        run_reply::Reply::Run(info) => Ok(info),
                        run_reply::Reply::Refusal(refusal) => Err(ClientError::refused(server, refusal)),
                        run_reply::Reply::Session(_) => Err(other_kind()),
                    };
                }
            }
        }
        Err(unknown_link(server))
    }

    fn request(&self, what: Ask, link: &str) -> RunRequest {
        RunRequest {
            protocol: Some(PROTOCOL),
            run: self.run.into(),
            ask: Some(what),
            link: link.into(),
            ..RunRequest::default()
        }
    }

    fn link_to(&self, server: &str) -> Result<Link, ClientError> {
        let known = self.links.lock().unwrap_or_else(PoisonError::into_inner).get(server).cloned();
        if let Some(link) = known {
            return Ok(link);
        }
        self.greet(server, Ask::Status(RunStatus {}))?;
        let known = self.links.lock().unwrap_or_else(PoisonError::into_inner).get(server).cloned();
        known.ok_or_else(|| unknown_link(server))
    }

    fn forget(&self, server: &str) {
        self.links.lock().unwrap_or_else(PoisonError::into_inner).remove(server);
    }

    /// Proves to a server that this client has the run's key, and keeps the keys for later requests.
    fn greet(&self, server: &str, what: Ask) -> Result<RunInfo, ClientError> {
        let identity = run_identity(self.key).map_err(ClientError::handshake(server))?;
        let key = ServerKeys::new(server).run();
        let (info, secrets) = greet(
            self.link,
            server,
            self.access,
            [&key, "RunRequest"],
            TIMEOUT_S,
            |hello| {
                let key = identity.public().to_string();
                RunRequest { key, hello: Some(hello), ..self.request(what, "") }.encode_to_vec()
            },
            |payload| identity.sign(&registration(server, payload)).to_vec(),
            |reply: &Reply| {
                Some(read(server, &reply.as_ref().ok()?.payload).and_then(|(reply, welcome)| match reply {
                    run_reply::Reply::Run(info) => Ok(GreetingReply { content: Ok(info), is_sealed: false, welcome }),
                    run_reply::Reply::Refusal(refusal) => {
                        Ok(GreetingReply { content: Err(refusal), is_sealed: false, welcome })
                    }
                    run_reply::Reply::Session(_) => Err(other_kind()),
                }))
            },
        )?;
        let channel = Channel::new(&secrets, Side::Client).map_err(ClientError::handshake(server))?;
        let link = Link { id: info.link.clone(), sealing: Sealing::new(channel) };
        self.links.lock().unwrap_or_else(PoisonError::into_inner).insert(server.into(), link);
        Ok(info)
    }
}

/// Runs with more seeds than this name them in ranges, which servers before 3.11 refuse.
const MAX_LISTED: usize = 1000;

/// The same spec with many seeds in ranges, where that is shorter: seeds that were drawn have no neighbours.
fn in_ranges(spec: &RunSpec) -> RunSpec {
    let mut ranged = spec.clone();
    for seed in std::mem::take(&mut ranged.seeds) {
        match ranged.seed_ranges.last_mut() {
            Some(range) if range.last.checked_add(1) == Some(seed) => range.last = seed,
            _ => ranged.seed_ranges.push(SeedRange { first: seed, last: seed }),
        }
    }
    if spec.seeds.len() > MAX_LISTED && ranged.encoded_len() < spec.encoded_len() { ranged } else { spec.clone() }
}

type Read = (run_reply::Reply, Option<fiatlux_proto::v3::Welcome>);

fn read(server: &str, bytes: &[u8]) -> Result<Read, ClientError> {
    let RunReply { reply, welcome } = decode(bytes, MAX_SERVER_MESSAGE).map_err(ClientError::unreadable(server))?;
    let reply = reply.ok_or_else(|| ClientError::Session { reason: "the reply is empty".into() })?;
    Ok((reply, welcome))
}

/// A server that has restarted knows no links. Somebody who claims so in its place only makes the client greet it
/// again.
fn says_no_link(reply: &Reply) -> bool {
    let Ok(message) = reply else { return false };
    let reply = decode::<RunReply>(&message.payload, MAX_SERVER_MESSAGE);
    let is_of_link = |refusal: &fiatlux_proto::v3::Refusal| refusal.code() == Code::Closed && refusal.field == "link";
    reply.is_ok_and(|reply| matches!(&reply.reply, Some(run_reply::Reply::Refusal(refusal)) if is_of_link(refusal)))
}

fn other_kind() -> ClientError {
    ClientError::Session { reason: "the reply has an unexpected type".into() }
}

fn unknown_link(server: &str) -> ClientError {
    ClientError::Unanswered { key: ServerKeys::new(server).run(), waited_s: TIMEOUT_S }
}

#[cfg(test)]
mod tests {
    use fiatlux_proto::limits::MAX_RUN_REQUEST;

    use super::*;

    /// Guards the documented limit of a run, 10,000 episodes, against the limit of a message, whatever the seeds; the order in which
    /// they were named stays.
    #[test]
    fn ten_thousand_seeds_fit_into_a_request() {
        let spec = |seeds: Vec<u64>| RunSpec { policy: "walk".into(), seeds, ..RunSpec::default() };
        let many = in_ranges(&spec((1000..11_000).collect()));
        assert_eq!((many.seeds.len(), &*many.seed_ranges), (0, &[SeedRange { first: 1000, last: 10_999 }][..]));
        assert!(many.encoded_len() < 100);
        let named: Vec<u64> = (5000..6000).chain([u64::MAX, 0, 1]).chain(7..10).collect();
        let ranges = in_ranges(&spec(named.clone())).seed_ranges;
        assert_eq!(ranges.iter().flat_map(|range| range.first..=range.last).collect::<Vec<_>>(), named);
        assert_eq!(ranges.len(), 4);
        for scattered in
            [1000, 1 << 31, u64::MAX / 20_001].map(|apart| (1..=10_000).map(|n| n * apart).collect::<Vec<_>>())
        {
            let listed = in_ranges(&spec(scattered.clone()));
            assert_eq!((&listed.seeds, listed.seed_ranges.len()), (&scattered, 0));
            let text = |length: usize| "x".repeat(length);
            let long = RunSpec { policy: text(128), policy_version: text(128), ..listed };
            assert!(long.encoded_len() + 2048 < MAX_RUN_REQUEST, "with its link and its proof");
        }
        let few = spec(vec![3, 4, 5]);
        assert_eq!(in_ranges(&few), few, "older servers read them");
    }
}
