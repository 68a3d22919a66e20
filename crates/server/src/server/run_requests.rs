//! Requests to runs: a client greets the server once, and proves later requests with the keys of that link.

use std::panic::{AssertUnwindSafe, catch_unwind};

use data_encoding::HEXLOWER;
use fiatlux_access::{Channel, PublicKey, SIGNATURE_BYTES, Side as End, registration};
use fiatlux_proto::Message;
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::run_request::Ask;
use fiatlux_proto::v3::{Refusal, RunFinish, RunReply, RunRequest, RunStatus, Welcome, run_reply};

use super::credentials::IdentifiedClient;
use super::gate::Gate;
use super::links::{Link, RunJob};
use super::opens::Begun;
use super::plan;
use super::state::ServerState;

type Answered = Result<(run_reply::Reply, Option<Welcome>), Refusal>;

impl ServerState {
    /// Serves requests to runs; the body of a thread.
    pub fn serve_runs(&self) {
        while let Some(job) = self.queues.runs.next() {
            let carry_out = || match &job {
                RunJob::Greeting(request, payload, attachment, _) => self.greet(request, payload, attachment),
                RunJob::Ask(request, payload, link, _) => self.run_request(request, payload, link),
            };
            let answer: Answered = catch_unwind(AssertUnwindSafe(carry_out)).unwrap_or_else(|_| {
                tracing::error!("a request to a run failed; please report this");
                Err(Refusal::new(Code::Busy, "", "the server failed in this request; see its log"))
            });
            if let Err(refusal) = &answer {
                tracing::info!(refusal.field, refusal.message, "request to a run refused");
            }
            match job {
                RunJob::Greeting(request, payload, _, digest) => {
                    let (reply, welcome) = answer.unwrap_or_else(|refusal| {
                        let welcome = self.credentials.sign(&self.name, request.hello.as_ref(), &payload, &refusal);
                        (run_reply::Reply::Refusal(refusal), welcome)
                    });
                    let bytes = RunReply { reply: Some(reply), welcome }.encode_to_vec().into();
                    let begun = Begun { message: "RunReply", bytes, attachment: None };
                    self.answer_all(digest, &self.keys.run(), begun);
                }
                RunJob::Ask(_, _, link, number) => {
                    let (reply, welcome) = answer.unwrap_or_else(|refusal| (run_reply::Reply::Refusal(refusal), None));
                    let bytes = RunReply { reply: Some(reply), welcome }.encode_to_vec().into();
                    self.answer_client(&link.gate, "run", number, "RunReply", bytes);
                }
            }
        }
    }

    /// Registers or resumes a run, for a client that holds its key.
    fn greet(&self, request: &RunRequest, payload: &[u8], attachment: &[u8]) -> Answered {
        plan::check_version(request.protocol.as_ref())?;
        let (signature, proof) = attachment.split_at(attachment.len().min(SIGNATURE_BYTES));
        let client = self.credentials.admit(request.hello.as_ref(), request.protocol.as_ref(), payload, proof)?;
        let runs = self.runs.as_ref().ok_or_else(|| {
            let message = "this server keeps no runs; start it with --record DIR, or use another one";
            Refusal::new(Code::Unknown, "run", message)
        })?;
        let key: PublicKey =
            request.key.parse().map_err(|error| Refusal::new(Code::Value, "key", format!("{error}")))?;
        if !key.verify(&registration(&self.name, payload), signature) {
            let message =
                "the request is not signed by the run's key; sign what is sent, for the server that it is sent to";
            return Err(Refusal::new(Code::Denied, "key", message));
        }
        let run = match &request.ask {
            Some(Ask::Register(spec)) => {
                // Without tokens clients name themselves, which identifies nobody.
                let holder = if client.limit.is_some() { client.peer.as_str() } else { "" };
                runs.register(&request.run, &request.key, spec.clone(), holder)?
            }
            Some(Ask::Status(RunStatus {})) => runs.find(&request.run, &request.key)?,
            Some(Ask::Open(_) | Ask::Finish(_)) => return Err(no_link()),
            None => return Err(asks_nothing()),
        };
        let random = fiatlux_access::random::<16>().map_err(|error| Refusal::new(Code::Busy, "", error.to_string()))?;
        let id: String = HEXLOWER.encode(&random);
        let mut info = run.info()?;
        info.link.clone_from(&id);
        let (welcome, secrets) = client.welcome(&self.credentials.identity, &self.name, &id, &info.encode_to_vec())?;
        let channel = Channel::new(&secrets, End::Server);
        let channel = channel.map_err(|error| Refusal::new(Code::Value, "hello", error.to_string()))?;
        let link = Link { run, peer: client.peer, limit: client.limit, gate: Gate::new(channel) };
        self.links.add(id, link);
        Ok((run_reply::Reply::Run(info), Some(welcome)))
    }

    fn run_request(&self, request: &RunRequest, payload: &[u8], link: &Link) -> Answered {
        match request.ask.as_ref().ok_or_else(asks_nothing)? {
            Ask::Open(index) => {
                let Some(hello) = &request.hello else {
                    return Err(Refusal::new(
                        Code::Value,
                        "hello",
                        "a session needs a hello; draw one for each request",
                    ));
                };
                let client = IdentifiedClient::again(hello, payload, &link.peer, link.limit);
                let (plan, episode) = link.run.plan(*index)?;
                let (info, welcome) = self.try_open(plan, Some(&episode), &client)?;
                return Ok((run_reply::Reply::Session(info), Some(welcome)));
            }
            Ask::Finish(RunFinish {}) => link.run.finish(self.credentials.signer.as_deref())?,
            Ask::Status(RunStatus {}) => {}
            Ask::Register(_) => {
                return Err(Refusal::new(Code::Value, "link", "a run is registered without a link; leave it out"));
            }
        }
        Ok((run_reply::Reply::Run(link.run.info()?), None))
    }
}

/// The refusal of a request whose link is missing or unknown.
pub(super) fn no_link() -> Refusal {
    Refusal::new(Code::Closed, "link", "there is no such link; register the run or ask for its status, which gives one")
}

fn asks_nothing() -> Refusal {
    Refusal::new(Code::Value, "ask", "the request asks for nothing; use register, status, open or finish")
}
