//! Tests each rule of the exchange, and a whole episode over a channel that loses messages.

mod fake;
mod lossy;

use fiatlux_proto::v3::notice::Code;
use fiatlux_proto::v3::{Action, EpisodeEnd, Notice, Observation, Refusal, ResetReply, reset_reply};
use fiatlux_proto::{Bytes, Message, decode};

use super::*;
use fake::{info, observation};

fn secs(secs: f64) -> Duration {
    Duration::from_secs_f64(secs)
}

fn reset_replied(observation: Observation) -> Input {
    reset_reply(reset_reply::Reply::Observation(observation))
}

fn reset_reply(reply: reset_reply::Reply) -> Input {
    Input::Reset(Some(Ok(ResetReply { reply: Some(reply) }.encode_to_vec().into())))
}

/// Gives the machine one input at a time, and returns what comes out.
fn give(session: &mut ClientSession, input: Input, now_s: f64) -> Vec<Output> {
    session.handle(input, secs(now_s));
    std::iter::from_fn(|| session.poll()).collect()
}

fn publish(session: &mut ClientSession, observation: &Observation, now_s: f64) -> Vec<Output> {
    give(session, Input::Observation(observation.encode_to_vec().into()), now_s)
}

/// Step of the last observation, which has to be answered.
fn to_answer(outputs: &[Output]) -> Option<u64> {
    match outputs {
        [.., Output::Observation(observation)] => Some(observation.step),
        _ => None,
    }
}

fn step_of(output: &Output) -> Option<u64> {
    match output {
        Output::Action(bytes) => Some(decode::<Action>(bytes, 1 << 16).expect("an action").step),
        _ => None,
    }
}

/// A session of two joints that has waited for observation 1 of episode 3 since time 0.
fn waiting(real_time: bool) -> ClientSession {
    let mut session = ClientSession::new(&info(2, real_time));
    assert!(matches!(give(&mut session, Input::Start(3), 0.0)[..], [Output::Reset(_)]));
    let first = give(&mut session, reset_replied(observation(3, 0)), 0.0);
    answer(&mut session, &first, 0, 0.0);
    session
}

/// Answers the observation of this step, which has just come out.
fn answer(session: &mut ClientSession, outputs: &[Output], step: u64, now_s: f64) {
    assert_eq!(to_answer(outputs), Some(step));
    let outputs = give(session, Input::Command(Command::Action(vec![0.0; 2])), now_s);
    assert_eq!(outputs.iter().filter_map(step_of).collect::<Vec<_>>(), [step]);
}

/// Guards that a chunk goes with the next command only, that a 3.4 server gets none, that one before 3.13 gets no phase, and that an
/// invalid one is left out.
#[test]
fn a_chunk_goes_with_one_command() {
    for (minor, latency_s, is_sent) in
        [(5, 0.1, true), (12, 0.1, true), (13, 0.1, true), (4, 0.1, false), (13, f64::NAN, false)]
    {
        let protocol = Some(fiatlux_proto::v3::Version { major: 3, minor });
        let mut session = ClientSession::new(&SessionInfo { protocol, ..info(2, false) });
        give(&mut session, Input::Start(3), 0.0);
        give(&mut session, reset_replied(observation(3, 0)), 0.0);
        let plain = Chunk { index: 7, latency_s, ..Chunk::default() };
        let chunk = Chunk { phase: "Lean".into(), is_over: Some(false), ..plain.clone() };
        give(&mut session, Input::Chunk(Box::new(chunk.clone())), 0.0);
        let mut sent = |now_s| {
            let outputs = give(&mut session, Input::Command(Command::Action(vec![0.0; 2])), now_s);
            let Some(Output::Action(bytes)) = outputs.first() else { panic!("{outputs:?}") };
            decode::<Action>(bytes, 1 << 16).expect("an action").chunk
        };
        assert_eq!(sent(0.0), is_sent.then_some(if minor < 13 { plain } else { chunk }));
        publish(&mut session, &observation(3, 1), 0.02);
        let outputs = give(&mut session, Input::Command(Command::Action(vec![0.0; 2])), 0.03);
        let Some(Output::Action(bytes)) = outputs.first() else { panic!("{outputs:?}") };
        assert_eq!(decode::<Action>(bytes, 1 << 16).expect("an action").chunk, None);
    }
}

#[test]
fn each_observation_is_answered_once_whatever_comes_twice_or_late() {
    let mut session = waiting(false);
    for old in [observation(3, 0), observation(2, 1), observation(4, 1)] {
        assert_eq!(publish(&mut session, &old, 0.01), [], "{old:?}");
    }
    let new = publish(&mut session, &observation(3, 1), 0.02);
    assert_eq!(new[0], Output::RoundTrip(secs(0.02)));
    assert_eq!(publish(&mut session, &observation(3, 1), 0.03), []);
    answer(&mut session, &new, 1, 0.03);
    assert_eq!(publish(&mut session, &observation(3, 1), 0.04), []);
}

#[test]
fn an_unanswered_action_is_sent_again_less_and_less_often_and_at_last_given_up() {
    let mut session = waiting(false);
    let (mut times, mut asked) = (Vec::new(), 0);
    let failure = loop {
        let now_s = session.wake_at().expect("there is always something to wait for").as_secs_f64();
        match give(&mut session, Input::Tick, now_s).as_slice() {
            [Output::Failed(failure)] => break failure.clone(),
            [Output::Action(_), rest @ ..] => {
                times.push(now_s);
                asked += rest.iter().filter(|output| **output == Output::AskObservation).count();
                if !rest.is_empty() {
                    assert_eq!(give(&mut session, Input::LastObservation(None), now_s), []);
                }
            }
            other => panic!("{other:?}"),
        }
    };
    let waits: Vec<f64> = times.windows(2).map(|pair| ((pair[1] - pair[0]) * 1e3).round() / 1e3).collect();
    assert!((times[0] - 0.2).abs() < 1e-9 && waits.is_sorted() && waits.last() == Some(&1.0), "{times:?}");
    assert!(asked >= 3, "the observation was asked for {asked} times");
    assert!(*times.last().expect("some") > 18.0 && *times.last().expect("some") < 20.0);
    let message = failure.to_string();
    assert!(message.contains("server lab has not answered action 0 of episode 3 within 20 s"), "{message}");
}

/// A server of the same process is busy, not gone, however long it is silent: only its token says that it is gone.
#[test]
fn a_patient_client_waits_until_the_servers_token_is_away() {
    let mut session = waiting(false).patient();
    let failed = |outputs: &[Output]| outputs.iter().any(|output| matches!(output, Output::Failed(_)));
    let mut now_s = 0.0;
    while now_s < 600.0 {
        now_s = session.wake_at().expect("there is always something to wait for").as_secs_f64();
        assert!(!failed(&give(&mut session, Input::Tick, now_s)), "given up after {now_s} s");
    }
    assert!(!failed(&give(&mut session, Input::ServerSeen(false), now_s)));
    assert!(failed(&give(&mut session, Input::Tick, now_s + 5.1)), "its token has been away for 5 s");
}

#[test]
fn an_action_that_is_refused_again_and_again_ends_the_run_with_the_servers_words() {
    let notice = |episode| {
        let (field, message, remedy) = ("action".into(), "NaN".into(), "send numbers".into());
        let notice = Notice { code: Code::Value.into(), episode, field, message, remedy, ..Notice::default() };
        Input::Notice(notice.encode_to_vec().into())
    };
    let mut session = waiting(false);
    // Refusals from an earlier episode, and single ones between steps, are for old copies.
    (0..9).for_each(|_| assert_eq!(give(&mut session, notice(2), 0.1), []));
    for step in 1..5 {
        (1..MAX_REFUSALS).for_each(|_| assert_eq!(give(&mut session, notice(3), 0.1), []));
        let new = publish(&mut session, &observation(3, step), 0.1);
        answer(&mut session, &new, step, 0.1);
    }
    let found: Vec<Output> = (0..MAX_REFUSALS).flat_map(|_| give(&mut session, notice(3), 0.1)).collect();
    let [Output::Failed(failure)] = &found[..] else { panic!("no failure") };
    let message = failure.to_string();
    assert!(message.contains("step 4") && message.contains("NaN (field 'action'); send numbers"), "{message}");
}

/// Guards that a busy machine ends no episode in real time: answers that come too late are refused one by one, before what the server
/// saw meanwhile arrives.
#[test]
fn late_actions_end_nothing_however_many_are_refused() {
    // In lockstep it is the observation that was lost.
    for (real_time, present) in [(false, 1), (true, 7)] {
        let mut session = waiting(real_time);
        let late =
            |episode| Notice { code: Code::Step.into(), episode, step: present, ..Notice::default() }.encode_to_vec();
        let mut found = Vec::new();
        for _ in 0..3 * MAX_REFUSALS {
            found.extend(give(&mut session, Input::Notice(late(3).into()), 0.1));
        }
        assert_eq!(found, [Output::AskObservation], "once, as long as there is no answer");
        let new = publish(&mut session, &observation(3, present), 0.2);
        answer(&mut session, &new, present, 0.2);
        // At its own step a refusal is about the action itself; in real time about an earlier one, whose notice comes after the observation.
        let found: Vec<Output> =
            (0..MAX_REFUSALS).flat_map(|_| give(&mut session, Input::Notice(late(3).into()), 0.3)).collect();
        match found[..] {
            [Output::Failed(SessionFailure::Action { step, .. })] => assert!(!real_time && step == present),
            _ => assert!(real_time && !found.iter().any(|output| matches!(output, Output::Failed(_))), "{found:?}"),
        }
    }
}

/// Guards which notices a user reads: actions that arrive when their episode is over are nobody's fault.
#[test]
fn actions_left_over_from_an_episode_are_no_news() {
    let mut session = waiting(false);
    let notice = |code: Code, episode| Notice { code: code.into(), episode, step: 1, ..Notice::default() };
    assert!(!session.is_left_over(&notice(Code::Step, 3)), "the only action of this step is refused");
    assert!(session.is_left_over(&notice(Code::Step, 2)), "of an earlier episode");
    let end = Observation { end: Some(EpisodeEnd::default()), ..observation(3, 1) };
    assert!(matches!(publish(&mut session, &end, 0.1)[..], [.., Output::Done(_)]));
    assert!(session.is_left_over(&notice(Code::Step, 3)));
    assert!(!session.is_left_over(&notice(Code::Lost, 3)) && !session.is_left_over(&notice(Code::Value, 3)));
    // The next episode is being staged.
    give(&mut session, Input::Start(4), 0.2);
    assert!(session.is_left_over(&notice(Code::Step, 3)));
}

/// Guards how many actions are sent ahead: as many as may wait in a session, and none in real time.
#[test]
fn actions_are_sent_ahead_up_to_a_bound() {
    let mut session = waiting(false);
    let mut sent = Vec::new();
    while let Some(step) = session.next_step() {
        let outputs = give(&mut session, Input::Command(Command::Action(vec![0.0; 2])), 0.0);
        assert_eq!(outputs.iter().filter_map(step_of).collect::<Vec<_>>(), [step]);
        sent.push(step);
    }
    assert_eq!(sent, (1..MAX_AHEAD as u64).collect::<Vec<_>>());
    // An observation answers its action and those before; refusing an early action ends nothing.
    assert_eq!(publish(&mut session, &observation(3, 5), 0.01), []);
    let early = Notice { code: Code::Step.into(), episode: 3, ..Notice::default() }.encode_to_vec();
    (0..9).for_each(|_| assert_eq!(give(&mut session, Input::Notice(early.clone().into()), 0.01), []));
    assert_eq!(session.next_step(), Some(MAX_AHEAD as u64));
    let again = give(&mut session, Input::Tick, 1.0);
    assert_eq!(again.iter().filter_map(step_of).collect::<Vec<_>>(), (5..MAX_AHEAD as u64).collect::<Vec<_>>());
    assert!(again.contains(&Output::AskObservation));
    let found = publish(&mut session, &observation(3, MAX_AHEAD as u64 + 1), 1.0);
    assert!(matches!(found[..], [Output::Failed(SessionFailure::Order { .. })]), "{found:?}");
    assert_eq!(waiting(true).next_step(), None);
}

/// Guards that a lost message is noticed early if round trips are short.
#[test]
fn an_action_is_sent_again_after_a_few_round_trips() {
    let mut session = waiting(false);
    let mut now_s = 0.0;
    for step in 1..20 {
        now_s += 0.01;
        let new = publish(&mut session, &observation(3, step), now_s);
        answer(&mut session, &new, step, now_s);
    }
    let again = session.wake_at().expect("a time").as_secs_f64() - now_s;
    assert!((again - 0.04).abs() < 1e-6, "{again} s");
}

/// Guards that a missing token is noticed early, and that a server that answers counts as alive without it.
#[test]
fn a_server_without_its_token_is_given_up_early() {
    for answers in [false, true] {
        let mut session = waiting(false);
        assert_eq!(give(&mut session, Input::ServerSeen(false), 1.0), give(&mut waiting(false), Input::Tick, 1.0));
        let failure = loop {
            let now_s = session.wake_at().expect("a time").as_secs_f64();
            let outputs = give(&mut session, Input::Tick, now_s);
            if answers {
                publish(&mut session, &observation(3, 0), now_s);
            }
            if let [Output::Failed(failure)] = &outputs[..] {
                break (now_s, failure.to_string());
            }
        };
        assert_eq!(failure.0.round(), if answers { 20.0 } else { 6.0 }, "{}", failure.1);
        assert_eq!(failure.1.contains("server lab is gone"), !answers);
    }
}

#[test]
fn a_lost_session_is_told_from_a_lost_recording() {
    let lost = Notice { code: Code::Lost.into(), message: "gone".into(), ..Notice::default() };
    let lost = Input::Notice(lost.encode_to_vec().into());
    // Only the recording is lost: the server answers the query.
    let mut session = waiting(false);
    assert_eq!(give(&mut session, lost.clone(), 0.1), [Output::AskObservation]);
    let last = Input::LastObservation(Some(Ok(observation(3, 0).encode_to_vec().into())));
    assert_eq!(give(&mut session, last, 0.1), []);
    let new = publish(&mut session, &observation(3, 1), 0.1);
    answer(&mut session, &new, 1, 0.1);
    // The session is lost: no answer, or a refusal.
    let refusal = Refusal { message: "no episode runs".into(), ..Refusal::default() }.encode_to_vec();
    for error in [None, Some(Err(Bytes::from(refusal)))] {
        let mut session = waiting(false);
        let mut found = give(&mut session, lost.clone(), 0.1);
        found.extend(give(&mut session, Input::LastObservation(error), 0.1));
        assert!(matches!(&found[..], [_, Output::Failed(SessionFailure::Lost { message, .. })] if message == "gone"));
    }
}

#[test]
fn a_reset_is_asked_again_only_when_the_last_one_has_ended() {
    let mut session = ClientSession::new(&info(2, false));
    give(&mut session, Input::Start(0), 0.0);
    assert_eq!(give(&mut session, Input::Tick, QUERY_TIMEOUT.as_secs_f64() - 0.1), [], "one is under way");
    assert_eq!(give(&mut session, Input::Reset(None), 1.0), []);
    assert!(matches!(give(&mut session, Input::Tick, 1.25)[..], [Output::Reset(_)]));
    let refusal = Refusal { message: "the hand does not close".into(), ..Refusal::default() };
    let found = give(&mut session, reset_reply(reset_reply::Reply::Refusal(refusal)), 1.3);
    let [Output::Failed(failure)] = &found[..] else { panic!("no failure") };
    assert_eq!(failure.to_string(), "the server refuses to start episode 0: the hand does not close");
}

#[test]
fn the_last_observation_ends_the_episode() {
    let mut session = waiting(false);
    let end = EpisodeEnd { cause: "fall".into(), steps: 1, ..EpisodeEnd::default() };
    let found = publish(&mut session, &Observation { end: Some(end.clone()), ..observation(3, 1) }, 0.1);
    assert_eq!(found, [Output::RoundTrip(secs(0.1)), Output::Done(end)]);
    assert!(session.wake_at().is_none());
}

#[test]
fn a_server_that_is_ahead_is_an_error_in_lockstep_and_the_rule_in_real_time() {
    let mut session = waiting(false);
    let found = publish(&mut session, &observation(3, 2), 0.1);
    assert!(matches!(found[..], [Output::Failed(SessionFailure::Order { expected: 1, found: 2 })]));
    let mut session = waiting(true);
    let new: Vec<Output> =
        [4, 5, 3].into_iter().flat_map(|step| publish(&mut session, &observation(3, step), 0.1)).collect();
    answer(&mut session, &new, 5, 0.1);
    // The clock runs: the client asks the server instead of repeating the action.
    assert_eq!(give(&mut session, Input::Tick, 0.4), [Output::AskObservation]);
}

#[test]
fn messages_that_cannot_be_read_are_passed_over_and_many_of_them_are_an_error() {
    let mut session = waiting(false);
    let short = Observation { last_action: vec![0.0; 7], ..observation(3, 1) };
    assert_eq!(give(&mut session, Input::Observation(vec![0xff; 30].into()), 0.1), []);
    assert_eq!(publish(&mut session, &short, 0.1), []);
    let new = publish(&mut session, &observation(3, 1), 0.1);
    answer(&mut session, &new, 1, 0.1);
    let found: Vec<Output> = (0..MAX_REFUSALS).flat_map(|_| publish(&mut session, &short, 0.1)).collect();
    let [Output::Failed(failure)] = &found[..] else { panic!("no failure") };
    assert!(failure.to_string().contains("last_action has 7 numbers, not 2"), "{failure}");
}

#[test]
fn a_command_that_no_server_takes_is_an_error_of_the_policy() {
    let commands = [
        (Command::Action(vec![0.0; 3]), "action of 3 numbers, not 2, in step 0"),
        (Command::JointTarget(vec![0.0, f64::NAN]), "joint_target NaN for joint 1 in step 0"),
        (Command::Action(vec![1e155, 0.0]), "action 1e155 for joint 0, not from -1000 to 1000, in step 0"),
    ];
    for (command, part) in commands {
        let mut session = ClientSession::new(&info(2, false));
        give(&mut session, Input::Start(0), 0.0);
        give(&mut session, reset_replied(observation(0, 0)), 0.0);
        let found = give(&mut session, Input::Command(command), 0.0);
        let [Output::Failed(failure @ SessionFailure::Command { .. })] = &found[..] else { panic!("{found:?}") };
        assert!(failure.to_string().contains(part), "{failure}");
    }
}

/// Guards that no input causes a panic.
#[test]
fn random_bytes_do_no_harm() {
    let mut random = fake::Dice::new(5);
    for round in 0..300 {
        let mut session = waiting(round % 2 == 0);
        for _ in 0..20 {
            let bytes: Vec<u8> = (0..random.below(60)).map(|_| random.below(256) as u8).collect();
            let bytes = Bytes::from(bytes);
            let input = match random.below(4) {
                0 => Input::Observation(bytes),
                1 => Input::Notice(bytes),
                2 => Input::Reset(Some(Ok(bytes))),
                _ => Input::LastObservation(Some(Err(bytes))),
            };
            give(&mut session, input, 0.0);
        }
    }
}
