//! Opens sessions, for clients that the server admits.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use fiatlux_access::{Channel, RowsKey, Side as End};
use fiatlux_carrier::{CarrierError, Query};
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{OpenReply, OpenRequest, Refusal, ServerInfo, SessionInfo, Welcome, open_reply};
use fiatlux_proto::{Message, decode, limits};
use fiatlux_sensing::Sensors;
use fiatlux_session::server::Input;

use super::actor::{Actor, Session, Side, Wire};
use super::credentials::IdentifiedClient;
use super::gate::Gate;
use super::host::Simulation;
use super::opens::{Begun, Digest};
use super::places::NoPlace;
use super::plan::{self, Plan};
use super::pool::AnswerKind;
use super::runs::AssignedEpisode;
use super::state::ServerState;

/// Number of sessions that may wait for their recorder, for each one that may be open.
const DRAINING_PER_OPEN: usize = 3;

impl ServerState {
    pub fn describe(&self, query: &Query) {
        let open_sessions = u32::try_from(self.sessions.places.count()).unwrap_or(u32::MAX);
        let info = ServerInfo { open_sessions, ..self.info.clone() };
        self.answer(
            query.clone(),
            AnswerKind::Own(self.keys.describe(), "ServerInfo", info.encode_to_vec().into(), None),
        );
    }

    pub fn open(&self, payload: &[u8], attachment: &[u8], digest: Digest) {
        let request = decode::<OpenRequest>(payload, limits::MAX_CLIENT_MESSAGE).map_err(|error| Refusal::from(&error));
        let hello = request.as_ref().ok().and_then(|request| request.hello.clone());
        let opened = request.and_then(|request| {
            plan::check_version(request.protocol.as_ref())?;
            let client = self.credentials.admit(hello.as_ref(), request.protocol.as_ref(), payload, attachment)?;
            self.try_open(plan::check(&OpenRequest { hello: None, ..request })?, None, &client)
        });
        let answer = match opened {
            Ok((info, welcome)) => OpenReply { reply: Some(open_reply::Reply::Session(info)), welcome: Some(welcome) },
            Err(refusal) => {
                tracing::info!(refusal.message, "open refused");
                let welcome = self.credentials.sign(&self.name, hello.as_ref(), payload, &refusal);
                OpenReply { reply: Some(open_reply::Reply::Refusal(refusal)), welcome }
            }
        };
        let bytes = answer.encode_to_vec().into();
        self.answer_all(digest, &self.keys.open(), Begun { message: "OpenReply", bytes, attachment: None });
    }

    /// Answers a request that starts something, and all copies of it.
    pub fn answer_all(&self, digest: Digest, key: &str, begun: Begun) {
        for query in self.opens.answer(digest, begun.clone()) {
            let Begun { message, bytes, attachment } = begun.clone();
            self.answer(query, AnswerKind::Own(key.into(), message, bytes, attachment));
        }
    }

    /// Opens a session for a client, and returns the welcome for it.
    pub fn try_open(
        &self,
        mut plan: Plan,
        episode: Option<&AssignedEpisode>,
        client: &IdentifiedClient<'_>,
    ) -> Result<(SessionInfo, Welcome), Refusal> {
        if plan.request.replay {
            plan.recorded = false;
        } else if self.runs.is_some() {
            plan.recorded = true;
        } else if plan.recorded && self.credentials.token_key.is_none() {
            let message = "this server has no recorder; start it with --record DIR, or with --recorder-key FILE and a \
                           recorder that has the same key, or leave `recorded` out";
            return Err(Refusal::new(Code::Value, "recorded", message));
        }
        if self.closing.load(Ordering::Relaxed) {
            return Err(Refusal::new(Code::Closed, "", "the server shuts down; open a session on another one"));
        }
        if self.sessions.count() > self.sessions.capacity * DRAINING_PER_OPEN {
            let message =
                "the server is busy: too many closed sessions still wait for their recorder; try again in 10 s";
            return Err(Refusal::new(Code::Busy, "", message));
        }
        let id = self.sessions.new_id();
        let is_claimed = |id: &str| self.sessions.find(id).is_some_and(|actor| actor.gate.is_claimed());
        let place = self.sessions.places.take(&id, &client.peer, client.limit, is_claimed, self.now());
        let leaves = place.map_err(|why| Refusal::new(Code::Busy, "", no_place(why, self.sessions.capacity)))?;
        if let Some(actor) = leaves.and_then(|id| self.sessions.find(&id)) {
            self.send(
                &actor,
                Side::Server,
                Input::Terminate("nobody has claimed it, and another session needs its place"),
            );
        }
        let opened = self.open_reserved(plan, episode, client, &id);
        if opened.is_err() {
            self.sessions.places.leave(&id);
        }
        opened
    }

    fn open_reserved(
        &self,
        plan: Plan,
        episode: Option<&AssignedEpisode>,
        client: &IdentifiedClient<'_>,
        id: &str,
    ) -> Result<(SessionInfo, Welcome), Refusal> {
        let gains = self.scenes.robot(plan.robot).gains(plan.gains);
        let built = self.scenes.get(plan.robot, plan.episode(0).scene(gains));
        let built = built.map_err(|error| plan.does_not_start("seed", &error))?;
        let network =
            plan.sensors.all().meets(Sensors::WITH_FEATURES).then(|| self.networks.get(&plan.request.weights));
        let network = network.transpose()?;
        let is_replay = plan.request.replay;
        let (task, seed, policy) = (plan.task, plan.seed, plan.request.policy.clone());
        let now = self.now();
        let recorded = plan.recorded;
        let attempt =
            episode.zip(plan.ticket.as_ref()).map(|(episode, ticket)| episode.begin(id, ticket)).transpose()?;
        let simulation = Simulation::new(&self.name, id, plan, built, network);
        let simulation = simulation.of_run(attempt.clone()).signed_by(self.credentials.signer.clone());
        let info = simulation.info();
        let session = Session::new(simulation, info, recorded, self.timeouts, now);
        let info = session.info().clone();
        let (welcome, secrets) = client.welcome(&self.credentials.identity, &self.name, id, &info.encode_to_vec())?;
        let rows = match &self.credentials.recorder_key {
            _ if is_replay => Some(RowsKey::of_opener(&secrets)),
            Some(key) => Some(RowsKey::of_recorder(key, &self.name, id)),
            None => None,
        };
        let rows = rows.transpose().map_err(|error| Refusal::new(Code::Value, "hello", error.to_string()))?;
        let channel = Channel::new(&secrets, End::Server);
        let channel = channel.map_err(|error| Refusal::new(Code::Value, "hello", error.to_string()))?;
        let mut actor = Actor::new(id.into(), session, Gate::new(channel), self.now() + self.timeouts.claim);
        (actor.attempt, actor.rows, actor.is_replay) = (attempt, rows, is_replay);
        let actor = Arc::new(actor);
        self.sessions.add(&actor);
        self.tally.sessions.fetch_add(1, Ordering::Relaxed);
        // The first check of a session sets its timer.
        let ends = !self.sessions.places.has(id);
        self.send(
            &actor,
            Side::Server,
            if ends { Input::Terminate("another session needs its place") } else { Input::Tick },
        );
        tracing::info!(session = id, %task, seed, policy, "opened a session");
        Ok((info, welcome))
    }
}

impl ServerState {
    /// Declares what a session sends on, and the tokens by which its client and recorders know that it is there.
    pub fn declare(&self, actor: &Actor) -> Result<Wire, CarrierError> {
        let keys = self.keys.session(&actor.id);
        // A replay has no token, so no recorder follows it.
        let mut tokens = if actor.is_replay { Vec::new() } else { vec![keys.live()] };
        if let Some(key) = self.credentials.token_key.as_ref().filter(|_| !actor.is_replay) {
            let rows = RowsKey::of_recorder(key, &self.name, &actor.id);
            tokens.push(keys.truth_live(&rows.map_err(|error| CarrierError(error.to_string()))?.token()));
        }
        Wire::declare(&self.carrier, &keys, actor.rows.is_some(), &tokens)
    }
}

fn no_place(why: NoPlace, capacity: usize) -> String {
    match why {
        NoPlace::Full => format!(
            "the server is busy: its places, {capacity}, are all taken; close a session, try again later, or \
             start it with a larger --capacity"
        ),
        NoPlace::Kept => format!(
            "the server is busy: half of its {capacity} places are reserved for clients that have none; close a session, try \
             again later, or start it with a larger --capacity"
        ),
        NoPlace::Limit(limit) => format!(
            "the token allows {limit} sessions, and that many are open; close one, or ask the server's owner for more"
        ),
    }
}
