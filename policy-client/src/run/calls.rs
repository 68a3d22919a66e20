//! The queries of a run.

use std::time::Duration;

use fiatlux_proto::keys::ServerKeys;
use fiatlux_proto::limits::MAX_SERVER_MESSAGE;
use fiatlux_proto::v3::run_request::Ask;
use fiatlux_proto::v3::{
    RunFinish, RunInfo, RunReply, RunRequest, RunSpec, RunStatus, ServerInfo, SessionInfo, run_reply,
};
use fiatlux_proto::{PROTOCOL, decode};
use zenoh::{Session, Wait};

use crate::ClientError;
use crate::client::OPEN_TIMEOUT_S;
use crate::client::query::ask;

/// The time that a server has for anything but opening a session, s.
const TIMEOUT_S: f64 = 5.0;

/// The time that a server has to describe itself.
const DESCRIBE_TIMEOUT: Duration = Duration::from_secs(2);

/// A run as its servers know it.
#[derive(Clone, Copy)]
pub(super) struct Calls<'a> {
    pub link: &'a Session,
    pub run: &'a str,
    pub key: &'a str,
}

impl Calls<'_> {
    /// Registers the run, or takes it up.
    pub(super) fn register(&self, server: &str, spec: &RunSpec) -> Result<RunInfo, ClientError> {
        self.info(server, Ask::Register(spec.clone()))
    }

    /// Where the run stands on that server.
    pub(super) fn status(&self, server: &str) -> Result<RunInfo, ClientError> {
        self.info(server, Ask::Status(RunStatus {}))
    }

    /// Ends the run on that server.
    pub(super) fn finish(&self, server: &str) -> Result<RunInfo, ClientError> {
        self.info(server, Ask::Finish(RunFinish {}))
    }

    /// Opens the session of an episode.
    pub(super) fn open(&self, server: &str, episode: usize) -> Result<SessionInfo, ClientError> {
        let index = u32::try_from(episode).unwrap_or(u32::MAX);
        match self.ask(server, Ask::Open(index), OPEN_TIMEOUT_S)? {
            run_reply::Reply::Session(info) => Ok(info),
            _ => Err(ClientError::Session { reason: "the reply is of another kind".into() }),
        }
    }

    /// What the server says of itself.
    pub(super) fn describe(&self, server: &str) -> Result<ServerInfo, ClientError> {
        let key = ServerKeys::new(server).describe();
        let replies = self.link.get(&key).timeout(DESCRIBE_TIMEOUT).wait().map_err(ClientError::zenoh)?;
        let sample = replies.into_iter().find_map(|reply| reply.into_result().ok());
        let unanswered = || ClientError::Unanswered { key, waited_s: DESCRIBE_TIMEOUT.as_secs_f64() };
        let bytes = sample.ok_or_else(unanswered)?.payload().to_bytes().into_owned();
        decode(&bytes, MAX_SERVER_MESSAGE).map_err(ClientError::unreadable(server))
    }

    fn info(&self, server: &str, what: Ask) -> Result<RunInfo, ClientError> {
        match self.ask(server, what, TIMEOUT_S)? {
            run_reply::Reply::Run(info) => Ok(info),
            _ => Err(ClientError::Session { reason: "the reply is of another kind".into() }),
        }
    }

    fn ask(&self, server: &str, what: Ask, timeout_s: f64) -> Result<run_reply::Reply, ClientError> {
        let request =
            RunRequest { protocol: Some(PROTOCOL), run: self.run.into(), key: self.key.into(), ask: Some(what) };
        let bytes = ask(self.link, &ServerKeys::new(server).run(), "RunRequest", &request, timeout_s)?;
        let reply = decode::<RunReply>(&bytes, MAX_SERVER_MESSAGE).map_err(ClientError::unreadable(server))?;
        match reply.reply {
            Some(run_reply::Reply::Refusal(refusal)) => Err(ClientError::refused(server, refusal)),
            Some(reply) => Ok(reply),
            None => Err(ClientError::Session { reason: "the reply is empty".into() }),
        }
    }
}
