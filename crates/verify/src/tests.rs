//! Whose fault a failed verification is, and what makes two runs differ.

use fiatlux_proto::v3::RunTicket;

use super::*;

/// Guards a good bag against a server that is away or overloaded: only a server's own refusal is the bag's.
#[test]
fn a_server_that_falls_silent_says_nothing_about_the_bag() {
    let of_server = |failure: SessionFailure| VerifyError::Client(failure.into()).is_of_server();
    let text = String::from;
    let silent = SessionFailure::Silent {
        server: text("lab"),
        waited_for: text("action 3"),
        silence_s: 60.0,
        tries: 4,
        problem: String::new(),
    };
    assert!(of_server(silent));
    assert!(of_server(SessionFailure::Lost { message: text("the session is over"), remedy: text("start again") }));
    assert!(of_server(SessionFailure::Unreadable { what: "observation", reason: text("cut") }));
    assert!(of_server(SessionFailure::Order { expected: 3, found: 5 }));
    assert!(!of_server(SessionFailure::Reset { episode: 0, message: text("its start is not possible") }));
    assert!(!of_server(SessionFailure::Command { field: "action", problem: text("7"), step: 1 }));
    let action = SessionFailure::Action { step: 1, field: text("action"), message: text("7"), remedy: String::new() };
    assert!(!of_server(action));
}

#[test]
fn a_name_cannot_write_a_line() {
    let end = EpisodeEnd { cause: "fall\u{1b}[2K".into(), ..EpisodeEnd::default() };
    let verification = Verification {
        episode: "S05 seed 1, episode 0, policy a\nequal: b".into(),
        recorded: end.clone(),
        header_digest: String::new(),
        signer: None,
        simulated: Some(end),
        header: None,
        row: Some((3, Difference { field: "x".into(), found: "1".into(), recorded: "2".into() })),
        result: None,
    };
    let text = verification.to_string();
    assert!(!text.contains("\nequal") && !text.contains('\u{1b}'), "{text}");
    assert!(text.starts_with(r"different: S05 seed 1, episode 0, policy a\u000aequal: b"), "{text}");
}

/// Guards that the fields of a registered run are not compared, since a second run belongs to none; a delay is
/// requested again.
#[test]
fn the_header_of_an_episode_of_a_run_is_no_difference() {
    let request = OpenRequest { action_delay_ms: 40, policy: "zero".into(), ..OpenRequest::default() };
    let ticket = RunTicket { run: "first".into(), episode: 3, attempt: 2, hosted: true, ..RunTicket::default() };
    let recorded = EpisodeHeader { seed: 1 << 40, request: Some(request), ..EpisodeHeader::default() };
    let recorded = EpisodeHeader { run: Some(ticket), ..recorded };
    let simulated = EpisodeHeader { run: None, session: "other".into(), ..recorded.clone() };
    assert_eq!(first_difference(&comparable(simulated.clone(), &recorded), &recorded), None);
    let other = EpisodeHeader { seed: 1, ..simulated };
    let difference = first_difference(&comparable(other, &recorded), &recorded);
    assert_eq!(difference.map(|difference| difference.field), Some("seed".into()));
}

/// Guards that an episode in real time can be verified at all: the second run is in lockstep.
#[test]
fn real_time_is_no_difference() {
    let mode = Mode::RealTime.into();
    let recorded = EpisodeHeader { mode, command_timeout_s: 0.5, ..EpisodeHeader::default() };
    let simulated = EpisodeHeader { mode: Mode::Lockstep.into(), ..EpisodeHeader::default() };
    assert_eq!(first_difference(&comparable(simulated, &recorded), &recorded), None);
}
