//! Resets, closes, silence, and the recorder that lockstep waits for.

use super::*;

#[test]
fn resets() {
    let mut harness = harness(OpenRequest::default());
    harness.reset(0);
    let first = harness.reset_reply();
    assert_eq!(harness.reset(0), [Reply(1)], "the same observation again");
    assert_eq!(harness.reset_reply(), first);
    harness.act(0, 0);
    assert_eq!(harness.reset(1), [record(2), Reply(1), record(3)], "abort, then row 0");
    harness.act(1, 0);
    assert_eq!(harness.reset(1).len(), 3, "a running episode starts over");
    assert_eq!(harness.act(0, 1), [notice_of(notice::Code::Step)], "of the episode before");
    let steps = harness.finish(1, 0);
    assert_eq!(harness.result().end.unwrap().steps, steps);
    assert_eq!(harness.reset(2).len(), 2, "an episode that has ended is not aborted");
    harness.give(Input::Reset(vec![0xff; 3].into(), 1));
    assert!(matches!(harness.reset_reply(), reset_reply::Reply::Refusal(_)));
}

#[test]
fn the_last_observation_says_how_it_ended() {
    let mut harness = harness(OpenRequest::default());
    harness.reset(0);
    let steps = harness.finish(0, 0);
    let end = harness.result().end.unwrap();
    assert_eq!((end.cause.as_str(), end.steps, end.success), ("fall", steps, false));
    let seen = Observation::decode(&*harness.record().observation).unwrap();
    assert_eq!(seen.end, Some(end));
    assert_eq!(harness.give(Input::Observation(4)), [Reply(4)]);
}

#[test]
fn closing_aborts_and_drains() {
    let mut harness = harness(OpenRequest::default());
    assert_eq!(harness.give(Input::Observation(4)), [Refused(4)]);
    harness.reset(0);
    harness.act(0, 0);
    assert_eq!(harness.close(), [record(2), Closed, Reply(2)]);
    let aborted = harness.record();
    assert!(aborted.state.is_empty());
    assert_eq!((harness.result().end.unwrap().cause.as_str(), aborted.step), ("aborted", 1));
    assert_eq!(harness.close(), [Reply(2)]);
    harness.reset(1);
    assert!(matches!(harness.reset_reply(), reset_reply::Reply::Refusal(r) if r.code() == Code::Closed));
    assert_eq!(harness.act(0, 1), [notice_of(notice::Code::Step)]);
    let request = StepRecordRequest { from_seq: 1, count: 9 };
    assert_eq!(harness.give(Input::StepRecords(request.encode_to_vec().into(), 3)), [Reply(3)]);
    assert_eq!(harness.ack(2), []);
    assert_eq!(harness.ack(3), [Done], "all is acknowledged");
    assert_eq!(harness.session.wake_at(), None);
}

#[test]
fn a_closed_session_does_not_wait_for_ever() {
    let mut harness = harness(OpenRequest::default());
    harness.reset(0);
    harness.close();
    harness.now += 3000 * MS;
    harness.ack(1);
    assert_eq!(harness.session.wake_at(), Some(harness.now + TIMEOUTS.recorder));
    assert_eq!(harness.sleep(), [Done]);
}

#[test]
fn a_client_without_a_token_is_let_go() {
    let mut harness = harness(OpenRequest::default());
    harness.reset(0);
    harness.give(Input::ClientGone);
    harness.now += TIMEOUTS.grace - MS;
    assert_eq!(harness.give(Input::ClientSeen), [], "it came back in time");
    assert_eq!(harness.act(0, 0), [observation(1), record(1)], "and goes on where it was");
    harness.give(Input::ClientGone);
    assert_eq!(harness.sleep(), [notice_of(notice::Code::Lost), record(2), Closed]);

    let mut never = without_client(OpenRequest::default());
    assert_eq!(never.sleep(), [notice_of(notice::Code::Lost), Closed, Done], "nor one that never came");
}

#[test]
fn a_silent_client_is_let_go() {
    let mut harness = harness(OpenRequest::default());
    harness.reset(0);
    harness.now += TIMEOUTS.action - MS;
    harness.act(0, 0);
    let since = harness.now;
    harness.now += 1000 * MS;
    // Neither of these is an action that the server waits for.
    harness.act(0, 0);
    harness.act(0, 7);
    assert_eq!(harness.session.wake_at(), Some(since + TIMEOUTS.action));
    assert_eq!(harness.sleep(), [notice_of(notice::Code::Lost), record(2), Closed]);
}

#[test]
fn lockstep_waits_for_its_recorder() {
    let window = limits::RECORDING_WINDOW;
    let ends = vec!["time-out".to_owned()];
    let mut harness = harness(OpenRequest { recorded: true, end_on: ends, ..OpenRequest::default() });
    harness.reset(0);
    for step in 0..window - 1 {
        assert_eq!(harness.act(0, step).len(), 2, "{step}");
    }
    let next = window - 1;
    assert_eq!(harness.act(0, next), [], "512 rows are not on disk");
    assert_eq!(harness.act(0, next), [], "asked again, it still waits");
    harness.now += 5000 * MS;
    assert_eq!(harness.ack(1), [observation(next + 1), record(next + 1)]);
    assert_eq!(harness.act(0, next + 1), []);
    // The recorder is silent: the session goes on without it, and says so.
    assert_eq!(harness.sleep(), [notice_of(notice::Code::Lost), observation(next + 2), record(next + 2)]);
    assert_eq!(harness.record().events.len(), 1);
    assert_eq!(harness.act(0, next + 2).len(), 2, "no wait without a recorder");
    let mut first_from = |from_seq| harness.records(from_seq, 1);
    assert!(first_from(0) == first_from(3) && first_from(3) != first_from(4), "0 to 2 are lost");
    harness.ack(3);
    assert_eq!(harness.act(0, next + 3), [], "it is back, and the window is full");
    assert_eq!(harness.reset(1), [], "a reset waits too");
    assert_eq!(harness.ack(10), [record(next + 4), Reply(1), record(next + 5)]);
}

/// The client hears why its episode has no bag, the session does not wait for a recorder that cannot write, and the next
/// episode is recorded again.
#[test]
fn a_recorder_that_cannot_write_says_why() {
    let window = limits::RECORDING_WINDOW;
    let ends = vec!["time-out".to_owned()];
    let mut harness = harness(OpenRequest { recorded: true, end_on: ends, ..OpenRequest::default() });
    harness.reset(0);
    (0..window - 1).for_each(|step| drop(harness.act(0, step)));
    assert_eq!(harness.act(0, window - 1), [], "512 rows are not on disk");
    let full = |lost_episode| StepRecordAck {
        recorder: "r".into(),
        next_seq: 0,
        problem: "No space left on device".into(),
        lost_episode,
    };
    let first = harness.hear(&full(0));
    assert_eq!(first, [notice_of(notice::Code::Lost), observation(window), record(window)]);
    let notice = harness.notice();
    let message = "the recorder cannot write the bag of episode 0: No space left on device: the episode goes on, but its \
                   recording is cut";
    assert_eq!((notice.field.as_str(), notice.message.as_str(), notice.episode), ("recorded", message, 0));
    assert!(notice.remedy.contains("disk"), "{}", notice.remedy);
    assert_eq!(harness.hear(&full(0)), [], "it is said once");
    assert_eq!(harness.act(0, window).len(), 2, "no wait");
    harness.reset(1);
    assert!(matches!(harness.reset_reply(), reset_reply::Reply::Observation(_)));
    assert_eq!(harness.hear(&full(0)), [], "this was said of the episode before");
    harness.ack(window + 3);
    (0..window - 1).for_each(|step| drop(harness.act(1, step)));
    assert_eq!(harness.act(1, window - 1), [], "it is waited for again");
}

/// A recording that fails after the last step is known before the client has closed.
#[test]
fn the_end_waits_for_the_disk() {
    let recorded = || harness(OpenRequest { recorded: true, ..OpenRequest::default() });
    let mut kept = recorded();
    kept.reset(0);
    assert_eq!(kept.close(), [record(1), Closed]);
    assert_eq!(kept.ack(2), [Reply(2), Done]);

    let mut lost = recorded();
    lost.reset(0);
    lost.close();
    let full = StepRecordAck { problem: "No space left on device".into(), ..StepRecordAck::default() };
    assert_eq!(lost.hear(&full), [notice_of(notice::Code::Lost), Reply(2), Done]);

    let mut slow = recorded();
    slow.reset(0);
    slow.close();
    assert_eq!(slow.sleep(), [Reply(2)], "a client does not wait for ever");
    assert_eq!(slow.sleep(), [Done]);
}

#[test]
fn without_a_recorder_nothing_waits() {
    let ends = vec!["time-out".to_owned()];
    let mut harness = harness(OpenRequest { end_on: ends, ..OpenRequest::default() });
    harness.reset(0);
    for step in 0..limits::RECORDING_WINDOW + 5 {
        assert_eq!(harness.act(0, step).len(), 2, "{step}");
    }
}

#[test]
fn shutdown_aborts() {
    let mut harness = harness(OpenRequest::default());
    harness.reset(0);
    assert!(!harness.session.is_settled());
    assert_eq!(
        harness.give(Input::Terminate("the server shuts down")),
        [notice_of(notice::Code::Lost), record(1), Closed]
    );
    assert!(harness.session.is_settled(), "nobody records it");
}
