//! The rules of the exchange, one by one, and a whole episode over a channel that loses messages.

mod fake;
mod lossy;

use fiatlux_proto::v3::notice::Code;
use fiatlux_proto::v3::{EpisodeEnd, Notice, Observation, Refusal, ResetReply, reset_reply};
use fiatlux_proto::{Message, decode};

use super::*;
use fake::{info, observation};

fn reset_replied(observation: Observation) -> Vec<u8> {
    ResetReply { reply: Some(reset_reply::Reply::Observation(observation)) }.encode_to_vec()
}

fn outputs(session: &mut ClientSession) -> Vec<Output> {
    std::iter::from_fn(|| session.poll()).collect()
}

fn step_of(output: &Output) -> Option<u64> {
    match output {
        Output::Action(bytes) => Some(decode::<Action>(bytes, 1 << 16).expect("an action").step),
        _ => None,
    }
}

/// A session of two joints that waits for observation 1 of episode 3, since time 0.
fn waiting(real_time: bool) -> ClientSession {
    let mut session = ClientSession::new(&info(2, real_time));
    session.start(3, 0.0);
    assert!(matches!(outputs(&mut session)[..], [Output::Reset(_)]));
    session.reset_reply(&reset_replied(observation(3, 0)), 0.0);
    answer(&mut session, 0, 0.0);
    session
}

/// Answers the observation of that step.
fn answer(session: &mut ClientSession, step: u64, now_s: f64) {
    assert_eq!(session.to_answer().map(|observation| observation.step), Some(step));
    session.act("test", Command::Action(vec![0.0; 2]), now_s).expect("a good command");
    assert_eq!(outputs(session).iter().filter_map(step_of).collect::<Vec<_>>(), [step]);
}

#[test]
fn each_observation_is_answered_once_whatever_comes_twice_or_late() {
    let mut session = waiting(false);
    for old in [observation(3, 0), observation(2, 1), observation(4, 1)] {
        session.observation(&old.encode_to_vec(), 0.01);
        assert!(session.to_answer().is_none(), "{old:?}");
    }
    session.observation(&observation(3, 1).encode_to_vec(), 0.02);
    assert_eq!(session.take_round_trip_s(), Some(0.02));
    session.observation(&observation(3, 1).encode_to_vec(), 0.03);
    answer(&mut session, 1, 0.03);
    session.observation(&observation(3, 1).encode_to_vec(), 0.04);
    assert!(session.to_answer().is_none() && session.poll().is_none());
}

#[test]
fn an_unanswered_action_is_sent_again_less_and_less_often_and_at_last_given_up() {
    let mut session = waiting(false);
    let (mut times, mut asked) = (Vec::new(), 0);
    let failure = loop {
        let now_s = session.wake_s().expect("there is always something to wait for");
        session.tick(now_s);
        match outputs(&mut session).as_slice() {
            [Output::Failed(failure)] => break failure.clone(),
            [Output::Action(_), rest @ ..] => {
                times.push(now_s);
                asked += rest.iter().filter(|output| **output == Output::AskObservation).count();
                if !rest.is_empty() {
                    session.observation_refused(None);
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

#[test]
fn an_action_that_is_refused_again_and_again_ends_the_run_with_the_servers_words() {
    let notice = |episode| {
        let (field, message, remedy) = ("action".into(), "NaN".into(), "send numbers".into());
        Notice { code: Code::Value.into(), episode, field, message, remedy, ..Notice::default() }.encode_to_vec()
    };
    let mut session = waiting(false);
    // Refusals of an earlier episode, and single ones between steps, are of old copies.
    (0..9).for_each(|_| session.notice(&notice(2)));
    for step in 1..5 {
        (1..MAX_REFUSALS).for_each(|_| session.notice(&notice(3)));
        session.observation(&observation(3, step).encode_to_vec(), 0.1);
        answer(&mut session, step, 0.1);
    }
    (0..MAX_REFUSALS).for_each(|_| session.notice(&notice(3)));
    let [Output::Failed(failure)] = &outputs(&mut session)[..] else { panic!("no failure") };
    let message = failure.to_string();
    assert!(message.contains("step 4") && message.contains("NaN (field 'action'); send numbers"), "{message}");
}

#[test]
fn a_lost_session_is_told_from_a_lost_recording() {
    let lost = Notice { code: Code::Lost.into(), message: "gone".into(), ..Notice::default() }.encode_to_vec();
    // The recording alone: the server answers the query.
    let mut session = waiting(false);
    session.notice(&lost);
    assert_eq!(outputs(&mut session), [Output::AskObservation]);
    session.observation_answered();
    session.observation(&observation(3, 0).encode_to_vec(), 0.1);
    session.observation(&observation(3, 1).encode_to_vec(), 0.1);
    answer(&mut session, 1, 0.1);
    // The session: nobody answers, or with a refusal.
    let refusal = Refusal { message: "no episode runs".into(), ..Refusal::default() }.encode_to_vec();
    for error in [None, Some(&refusal[..])] {
        let mut session = waiting(false);
        session.notice(&lost);
        session.observation_refused(error);
        let found = outputs(&mut session);
        assert!(matches!(&found[..], [_, Output::Failed(SessionFailure::Lost { message, .. })] if message == "gone"));
    }
}

#[test]
fn a_reset_is_asked_again_only_when_the_last_one_has_ended() {
    let mut session = ClientSession::new(&info(2, false));
    session.start(0, 0.0);
    outputs(&mut session);
    session.tick(QUERY_TIMEOUT_S - 0.1);
    assert_eq!(session.poll(), None, "one is under way");
    session.reset_unanswered(1.0);
    session.tick(1.25);
    assert!(matches!(outputs(&mut session)[..], [Output::Reset(_)]));
    let refusal = Refusal { message: "the hand does not close".into(), ..Refusal::default() };
    session.reset_reply(&ResetReply { reply: Some(reset_reply::Reply::Refusal(refusal)) }.encode_to_vec(), 1.3);
    let [Output::Failed(failure)] = &outputs(&mut session)[..] else { panic!("no failure") };
    assert_eq!(failure.to_string(), "the server does not start episode 0: the hand does not close");
}

#[test]
fn the_last_observation_ends_the_episode() {
    let mut session = waiting(false);
    let end = EpisodeEnd { cause: "fall".into(), steps: 1, ..EpisodeEnd::default() };
    session.observation(&Observation { end: Some(end.clone()), ..observation(3, 1) }.encode_to_vec(), 0.1);
    assert_eq!(outputs(&mut session), [Output::Done(end)]);
    assert!(session.to_answer().is_none() && session.wake_s().is_none());
}

#[test]
fn a_server_that_is_ahead_is_an_error_in_lockstep_and_the_rule_in_real_time() {
    let mut session = waiting(false);
    session.observation(&observation(3, 2).encode_to_vec(), 0.1);
    assert!(matches!(outputs(&mut session)[..], [Output::Failed(SessionFailure::Order { expected: 1, found: 2 })]));
    let mut session = waiting(true);
    for step in [4, 5, 3] {
        session.observation(&observation(3, step).encode_to_vec(), 0.1);
    }
    answer(&mut session, 5, 0.1);
    // The clock runs: the action is not repeated, the server is asked.
    session.tick(0.4);
    assert_eq!(outputs(&mut session), [Output::AskObservation]);
}

#[test]
fn messages_that_cannot_be_read_are_passed_over_and_many_of_them_are_an_error() {
    let mut session = waiting(false);
    let short = Observation { last_action: vec![0.0; 7], ..observation(3, 1) }.encode_to_vec();
    session.observation(&[0xff; 30], 0.1);
    session.observation(&short, 0.1);
    assert!(session.poll().is_none() && session.to_answer().is_none());
    session.observation(&observation(3, 1).encode_to_vec(), 0.1);
    answer(&mut session, 1, 0.1);
    (0..MAX_REFUSALS).for_each(|_| session.observation(&short, 0.1));
    let [Output::Failed(failure)] = &outputs(&mut session)[..] else { panic!("no failure") };
    assert!(failure.to_string().contains("last_action has 7 numbers, not 2"), "{failure}");
}

#[test]
fn a_command_that_no_server_takes_is_the_policys_error() {
    let commands = [
        (Command::Action(vec![0.0; 3]), "action of 3 numbers, not 2, in step 0"),
        (Command::JointTarget(vec![0.0, f64::NAN]), "joint_target NaN for joint 1 in step 0"),
    ];
    for (command, part) in commands {
        let mut session = ClientSession::new(&info(2, false));
        session.start(0, 0.0);
        session.reset_reply(&reset_replied(observation(0, 0)), 0.0);
        outputs(&mut session);
        let error = session.act("test", command, 0.0).expect_err("refused").to_string();
        assert!(error.contains(part), "{error}");
        assert!(session.poll().is_none());
    }
}

/// Whatever comes, there is no panic.
#[test]
fn random_bytes_do_no_harm() {
    let mut random = fake::Dice::new(5);
    for round in 0..300 {
        let mut session = waiting(round % 2 == 0);
        for _ in 0..20 {
            let bytes: Vec<u8> = (0..random.below(60)).map(|_| random.below(256) as u8).collect();
            match random.below(4) {
                0 => session.observation(&bytes, 0.0),
                1 => session.notice(&bytes),
                2 => session.reset_reply(&bytes, 0.0),
                _ => session.observation_refused(Some(&bytes)),
            }
        }
    }
}
