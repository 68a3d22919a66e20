//! Who may send what to whom: the table of keys in `PROTOCOL.md`, as rules for Zenoh's access control.

use std::collections::BTreeMap;

use fiatlux_proto::keys::ServerKeys;
use serde_json::{Value, json};

/// A part in the network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Passes messages on, and enforces the rules for everybody.
    Router,
    /// Simulates: hands out sessions and judges them.
    Server,
    /// Records, and verifies what was recorded: reads rows, and opens sessions.
    Recorder,
    /// Opens sessions and plays in them.
    Policy,
}

use Role::{Policy, Recorder, Server};

impl Role {
    /// All parts, in the order in which they are started.
    pub const ALL: [Self; 4] = [Self::Router, Self::Server, Self::Recorder, Self::Policy];

    /// Common name in its certificate, and its user name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Router => "router",
            Self::Server => "server",
            Self::Recorder => "recorder",
            Self::Policy => "policy",
        }
    }
}

/// Use of a key.
enum Kind {
    /// The first roles publish on it for the second.
    Put(&'static [Role], &'static [Role]),
    /// The first roles query it, and the second answer.
    Query(&'static [Role], &'static [Role]),
    /// A liveliness token of the first roles, watched by the second.
    Token(&'static [Role], &'static [Role]),
}

const CLIENTS: &[Role] = &[Policy, Recorder];
const EVERYBODY: &[Role] = &[Server, Policy, Recorder];

/// All keys of the protocol, for servers and sessions of any name.
fn keys() -> Vec<(String, Kind)> {
    let (server, legacy) = (ServerKeys::new("*"), ServerKeys::legacy("*"));
    let session = server.session("*");
    let asked = |key| (key, Kind::Query(CLIENTS, &[Server]));
    vec![
        (server.alive(), Kind::Token(&[Server], EVERYBODY)),
        (legacy.alive(), Kind::Token(&[Server], EVERYBODY)),
        asked(server.describe()),
        asked(legacy.describe()),
        asked(server.open()),
        asked(legacy.open()),
        asked(server.run()),
        (session.client(), Kind::Token(CLIENTS, &[Server])),
        asked(session.reset()),
        (session.action(), Kind::Put(CLIENTS, &[Server])),
        (session.observation(), Kind::Put(&[Server], CLIENTS)),
        asked(session.observation()),
        asked(session.look()),
        (session.notice(), Kind::Put(&[Server], CLIENTS)),
        asked(session.close()),
        (session.live(), Kind::Token(&[Server], &[Server, Recorder])),
        (session.truth_live("*"), Kind::Token(&[Server], &[Recorder])),
        (session.truth_row(), Kind::Put(&[Server], &[Recorder])),
        (session.truth_rows(), Kind::Query(&[Recorder], &[Server])),
        (session.truth_ack(), Kind::Put(&[Recorder], &[Server])),
    ]
}

/// Keys that a part sends (`true`) and receives (`false`) on, by Zenoh's kinds of messages.
type Words = BTreeMap<(bool, &'static str), Vec<String>>;

fn words(role: Role) -> Words {
    let mut words = Words::new();
    for (key, kind) in keys() {
        let (first, second, sends, answers): (_, _, &[&str], &[&str]) = match kind {
            Kind::Put(from, to) => (from, to, &["put"], &["declare_subscriber"]),
            Kind::Query(from, to) => (from, to, &["query"], &["declare_queryable", "reply"]),
            Kind::Token(from, to) => {
                (from, to, &["liveliness_token"], &["liveliness_query", "declare_liveliness_subscriber"])
            }
        };
        // One side receives the other's messages.
        let mut add = |says: bool, messages: &[&'static str]| {
            for &message in messages {
                let keys: &mut Vec<String> = words.entry((says, message)).or_default();
                if !keys.contains(&key) {
                    keys.push(key.clone());
                }
            }
        };
        for (roles, is_first) in [(first, true), (second, false)] {
            if roles.contains(&role) {
                add(is_first, sends);
                add(!is_first, answers);
            }
        }
    }
    words
}

/// The section `access_control` of a part's config: it denies everything that the protocol does not need. The router
/// restricts each of the others to its part; they restrict the router to what they need from it.
///
/// `subject` is the property by which the router recognises a part, such as `cert_common_names`.
pub fn access_control(role: Role, subject: &str) -> Value {
    let held: &[Role] = if role == Role::Router { EVERYBODY } else { &[role] };
    let (mut rules, mut subjects, mut policies) = (Vec::new(), Vec::new(), Vec::new());
    for &other in held {
        let name = other.name();
        let mut ids = Vec::new();
        for ((says, message), keys) in words(other) {
            // A part's messages are ingress for the router and egress for the part itself.
            let flow = if says == (role == Role::Router) { "ingress" } else { "egress" };
            let id = format!("{name}: {message}, {flow}");
            rules.push(json!({
                "id": id, "permission": "allow", "flows": [flow], "messages": [message], "key_exprs": keys,
            }));
            ids.push(id);
        }
        let who = if role == Role::Router { name } else { Role::Router.name() };
        subjects.push(if role == Role::Router { json!({ "id": who, subject: [who] }) } else { json!({ "id": who }) });
        policies.push(json!({ "rules": ids, "subjects": [who] }));
    }
    json!({
        "enabled": true, "default_permission": "deny", "rules": rules, "subjects": subjects, "policies": policies,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn may(role: Role, says: bool, message: &str, key: &str) -> bool {
        words(role).iter().any(|((s, m), keys)| *s == says && *m == message && keys.iter().any(|own| own == key))
    }

    /// Checks the rows that decide who can cheat.
    #[test]
    fn a_policy_neither_serves_nor_sees_rows() {
        let session = ServerKeys::new("*").session("*");
        let words = words(Policy);
        assert!(!words.contains_key(&(true, "declare_queryable")) && !words.contains_key(&(true, "reply")));
        assert!(!words.keys().any(|(_, message)| *message == "delete"));
        let said: Vec<_> = words.iter().filter(|((says, _), _)| *says).flat_map(|(_, keys)| keys).collect();
        assert!(said.iter().all(|key| !key.contains("truth") && !key.contains("**")), "{said:?}");
        assert_eq!(words[&(true, "put")], [session.action()]);
        assert_eq!(words[&(true, "liveliness_token")], [session.client()]);
        assert!(may(Recorder, true, "declare_subscriber", &session.truth_row()));
        assert!(may(Recorder, true, "put", &session.truth_ack()) && may(Server, false, "put", &session.truth_ack()));
    }

    /// A message that nobody may send need not be received.
    #[test]
    fn whatever_is_heard_is_said_by_another_part() {
        for hearer in EVERYBODY {
            for ((says, message), keys) in words(*hearer) {
                for key in keys {
                    assert!(EVERYBODY.iter().any(|role| may(*role, !says, message, &key)), "{message} {key}");
                }
            }
        }
    }
}
