//! Actions: order, refusals, floods, delay.

use super::*;

#[test]
fn lockstep_answers_each_action_once() {
    let mut harness = harness(OpenRequest::default());
    assert_eq!(harness.reset(5), [Reply(1), record(0)]);
    let header = harness.record();
    assert_eq!(header.header.unwrap().episode, 5);
    assert!(header.scene == harness.session.host().built.shapes.to_vec());
    for step in 0..3 {
        assert_eq!(harness.act(5, step), [observation(step + 1), record(step + 1)]);
    }
    let recorded = harness.record();
    assert_eq!((recorded.step, State::decode(&*recorded.state).unwrap().step), (3, 3));
    assert_eq!(ActionRecord::decode(&*recorded.action).unwrap().action.unwrap().step, 2);
}

#[test]
fn the_action_before_the_present_one_brings_the_observation_again() {
    let mut harness = harness(OpenRequest::default());
    harness.reset(0);
    harness.act(0, 0);
    for _ in 0..3 {
        assert_eq!(harness.act(0, 0), [observation(1)]);
    }
    let last = harness.finish(0, 1);
    assert_eq!(harness.act(0, last - 1), [observation(last)], "after the end too");
    assert_eq!(harness.act(0, last), [notice_of(notice::Code::Step)]);
}

#[test]
fn wrong_actions_are_refused_and_recorded() {
    use notice::Code::{Malformed, Step, Value};
    let mut harness = harness(OpenRequest::default());
    assert_eq!(harness.act(0, 0), [notice_of(Step)], "no episode yet");
    harness.reset(3);
    let good = Action { episode: 3, step: 0, action: vec![0.0; JOINTS], ..Action::default() };
    let nan = |mut numbers: Vec<f64>| {
        numbers[5] = f64::NAN;
        numbers
    };
    let zeros = || vec![0.0; JOINTS];
    let cases = [
        (Action { episode: 2, ..good.clone() }, Step, "episode"),
        (Action { step: 1, ..good.clone() }, Step, "step"),
        (Action { step: u64::MAX, ..good.clone() }, Step, "step"),
        (Action { action: vec![], ..good.clone() }, Value, "action"),
        (Action { joint_target: zeros(), ..good.clone() }, Value, "action"),
        (Action { action: vec![0.0; JOINTS - 1], ..good.clone() }, Value, "action"),
        (Action { action: nan(zeros()), ..good.clone() }, Value, "action"),
        (Action { action: vec![], joint_target: nan(zeros()), ..good.clone() }, Value, "joint_target"),
        (Action { action: vec![], joint_target: vec![f64::MAX; JOINTS], ..good.clone() }, Value, "joint_target"),
        (Action { action: vec![1e155; JOINTS], ..good.clone() }, Value, "action"),
        (Action { action: vec![-1000.1; JOINTS], ..good.clone() }, Value, "action"),
    ];
    let count = cases.len();
    for (action, code, field) in cases {
        harness.now += Duration::from_secs(1);
        assert_eq!(harness.send(&action), [notice_of(code)], "{field}");
        let notice = harness.notice();
        assert_eq!((notice.field.as_str(), notice.episode, notice.step), (field, 3, 0));
        assert!(!notice.message.is_empty() && !notice.remedy.is_empty());
    }
    assert_eq!(harness.give(Input::Action(vec![0xff; 9].into())), [notice_of(Malformed)]);
    assert_eq!(harness.send(&good), [observation(1), record(1)], "the server went on waiting");
    assert_eq!(harness.record().events.len(), count + 1);
    harness.send(&Action { step: 1, ..good });
    assert!(harness.record().events.is_empty());
}

/// Whatever is sent, the bag of the episode can be closed and read.
#[test]
fn the_wildest_actions_leave_a_whole_bag() {
    let mut harness = harness(OpenRequest::default());
    harness.reset(0);
    let first = harness.record();
    let path = std::env::temp_dir().join(format!("fiatlux-wild-{}.mcap", std::process::id()));
    let mut writer = BagWriter::create(&path, first.header.as_ref().unwrap()).unwrap();
    writer.push(&first).unwrap();
    let result = loop {
        let step = writer.next_step() - 1;
        let of_size = |size: f64| Action { step, action: vec![size; JOINTS], ..Action::default() };
        harness.now += Duration::from_secs(1);
        assert_eq!(harness.send(&of_size(1e155)), [notice_of(notice::Code::Value)]);
        let notice = harness.notice();
        assert!(notice.message.contains("is 1e155; it must be from -1000 to 1000"), "{}", notice.message);
        harness.send(&of_size(if step.is_multiple_of(2) { 1e3 } else { -1e3 }));
        let record = harness.record();
        writer.push(&record).unwrap();
        if let Some(result) = record.result {
            break result;
        }
    };
    assert_eq!(result.strict.as_ref().expect("played by strict").control_effort, JOINTS as f64 * 1e6);
    let path = writer.finish(&result).unwrap();
    let bag = Bag::open(&path).unwrap();
    assert_eq!((bag.completeness(), bag.result()), (&Completeness::Whole, Some(&result)));
    let layout = harness.session.host().built.scene.robot_layout();
    let rows: Vec<_> = bag.states().map(|state| read_row(&state.unwrap(), layout).unwrap()).collect();
    assert_eq!(rows.len() as u64, result.end.unwrap().steps + 1);
    std::fs::remove_file(path).unwrap();
}

#[test]
fn joint_targets_are_recorded_in_action_units() {
    let mut harness = harness(OpenRequest::default());
    harness.reset(0);
    let target = vec![0.1; JOINTS];
    harness.send(&Action { joint_target: target.clone(), ..Action::default() });
    let row = State::decode(&*harness.record().state).unwrap();
    let q0 = harness.session.host().built.scene.robot.q0().to_vec();
    for joint in 0..JOINTS {
        assert_eq!(row.action[joint], (target[joint] - q0[joint]) / 0.5, "{joint}");
    }
}

/// Legs and waist follow the controller; the bag has the joint targets that came of it, which alone repeat the rows.
#[test]
fn whole_body_commands_walk_and_are_recorded_as_joint_targets() {
    let mut harness = harness(OpenRequest::default());
    harness.reset(0);
    let row = |harness: &Harness| harness.session.host().run.as_ref().unwrap().play.episode().row().clone();
    let first = row(&harness).robot.pose;
    let walk = WholeBodyCommand { vx: 0.5, height: 0.75, ..WholeBodyCommand::default() };
    let mut named = harness.session.host().built.scene.robot.q0().to_vec();
    // Of legs and waist: ignored.
    named[..15].fill(9.0);
    let mut targets = Vec::new();
    for step in 0..120 {
        // The arms are named later; until then they keep the staged posture.
        let joint_target = if step < 40 { Vec::new() } else { named.clone() };
        harness.send(&Action { step, joint_target, whole_body: Some(walk), ..Action::default() });
        let received = ActionRecord::decode(&*harness.record().action).unwrap().action.unwrap();
        assert_eq!(received.whole_body, Some(walk));
        targets.push(received.joint_target);
    }
    let last = row(&harness).robot.pose;
    let way = first.rotation.inverse_transform_vector(&(last.translation.vector - first.translation.vector));
    assert!(way.x > 0.5 && way.y.abs() < 0.3 && last.translation.z > 0.7, "{way}");
    let digest = |harness: &Harness| harness.session.host().run.as_ref().unwrap().play.episode().digest().hex();
    let played = digest(&harness);
    harness.reset(0);
    for (step, joint_target) in (0..).zip(targets) {
        harness.send(&Action { step, joint_target, ..Action::default() });
    }
    assert_eq!(digest(&harness), played);
}

#[test]
fn whole_body_commands_are_refused_by_field() {
    let stand = WholeBodyCommand { height: 0.75, ..WholeBodyCommand::default() };
    let good = Action { whole_body: Some(stand), ..Action::default() };
    let command = |command| Action { whole_body: Some(command), ..Action::default() };
    let cases = [
        (Action { action: vec![0.0; JOINTS], ..good.clone() }, "whole_body"),
        (Action { joint_target: vec![0.0; 3], ..good.clone() }, "joint_target"),
        (Action { joint_target: vec![f64::NAN; JOINTS], ..good.clone() }, "joint_target"),
        (command(WholeBodyCommand { vx: 1.1, ..stand }), "whole_body.vx"),
        (command(WholeBodyCommand { wz: f64::NAN, ..stand }), "whole_body.wz"),
        (command(WholeBodyCommand { pitch: f64::INFINITY, ..stand }), "whole_body.pitch"),
        (command(WholeBodyCommand::default()), "whole_body.height"),
    ];
    let harness_of = |request: OpenRequest, cases: &[(Action, &str)]| {
        let mut harness = harness(request);
        harness.reset(0);
        for (action, field) in cases {
            harness.now += Duration::from_secs(1);
            assert_eq!(harness.send(action), [notice_of(notice::Code::Value)], "{field}");
            let notice = harness.notice();
            assert_eq!(notice.field, *field, "{}", notice.message);
            assert!(!notice.remedy.is_empty());
        }
        harness
    };
    assert_eq!(harness_of(OpenRequest::default(), &cases).send(&good), [observation(1), record(1)]);
    // Other gains, and a session without what the controller senses.
    let none = [(good, "whole_body")];
    harness_of(OpenRequest { gains: "sonic".into(), ..OpenRequest::default() }, &none);
    harness_of(OpenRequest { sensors: vec!["last_action".into()], ..OpenRequest::default() }, &none);
}

/// A delay of 40 ms is the actions of two steps before, and the staged posture until they come; none is what it always was.
#[test]
fn delayed_actions_act_later() {
    let action =
        |step: u64| -> Vec<f64> { (0..JOINTS).map(|joint| 0.02 * libm::sin(step as f64 + joint as f64)).collect() };
    let digest = |delay_ms: u32, action: &dyn Fn(u64) -> Vec<f64>| {
        let mut harness = harness(OpenRequest { action_delay_ms: delay_ms, ..OpenRequest::default() });
        harness.reset(0);
        let mut rows = Vec::new();
        for step in 0..12 {
            harness.send(&Action { step, action: action(step), ..Action::default() });
            let record = harness.record();
            let received = ActionRecord::decode(&*record.action).unwrap().action.unwrap();
            assert_eq!(received.action, action(step), "recorded as it arrived");
            rows.push(State::decode(&*record.state).unwrap().action);
        }
        let digest = harness.session.host().run.as_ref().unwrap().play.episode().digest().hex();
        (digest, rows)
    };
    let staged = {
        let mut harness = harness(OpenRequest::default());
        harness.reset(0);
        State::decode(&*harness.record().state).unwrap().action
    };
    let (shifted, rows) = digest(0, &|step| if step < 2 { staged.clone() } else { action(step - 2) });
    assert_eq!(digest(40, &action), (shifted, rows), "shifted by hand");
    assert_ne!(digest(40, &action).0, digest(0, &action).0);
}

/// The recorded actions in a session of the recorded request give the recorded rows, whatever delay there was.
#[test]
fn a_delayed_episode_plays_again_from_its_records() {
    let play = |request: OpenRequest, actions: &[Action]| -> (OpenRequest, Vec<Action>, Vec<Vec<u8>>) {
        let mut harness = harness(request);
        harness.reset(0);
        let header = harness.record().header.unwrap();
        let played = actions.iter().map(|action| {
            harness.send(action);
            let record = harness.record();
            (ActionRecord::decode(&*record.action).unwrap().action.unwrap(), record.state)
        });
        let (received, rows) = played.unzip();
        (header.request.unwrap(), received, rows)
    };
    let actions: Vec<Action> = (0..10)
        .map(|step| {
            let numbers: Vec<f64> =
                (0..JOINTS).map(|joint| 0.1 * libm::sin(0.7 * step as f64 + joint as f64)).collect();
            let (action, joint_target) = if step % 2 == 0 { (numbers, vec![]) } else { (vec![], numbers) };
            Action { step, action, joint_target, ..Action::default() }
        })
        .collect();
    let (request, received, rows) = play(OpenRequest { action_delay_ms: 100, ..OpenRequest::default() }, &actions);
    assert_eq!(request.action_delay_ms, 100);
    assert_eq!(play(request, &received).2, rows);
}

#[test]
fn a_flood_gets_a_bounded_answer_and_a_bounded_record() {
    let mut harness = harness(OpenRequest::default());
    harness.reset(0);
    let answers: usize = (0..1000).map(|_| harness.act(9, 9).len()).sum();
    assert_eq!(answers, limits::MAX_NOTICES_PER_S as usize);
    assert_eq!(harness.sleep(), [notice_of(notice::Code::Step)]);
    assert_eq!(harness.notice().count, 1000 - u64::from(limits::MAX_NOTICES_PER_S));
    harness.act(0, 0);
    assert_eq!(harness.record().events.len(), MAX_EVENTS + 1);
    assert_eq!(harness.give(Input::Dropped(40)), [notice_of(notice::Code::Rate)]);
    assert_eq!(harness.notice().count, 40);
    assert_eq!(harness.give(Input::TooLarge(1 << 20)), [notice_of(notice::Code::Size)]);
}

/// A client that adds up the counts of its notices knows of every message that was refused, and why the session is closed.
#[test]
fn the_notices_of_a_flood_add_up() {
    let mut harness = harness(OpenRequest::default());
    harness.reset(0);
    let mut counted = 0;
    let mut count = |harness: &Harness| counted += harness.notice().count;
    for _ in 0..50 {
        if !harness.act(9, 9).is_empty() {
            count(&harness);
        }
    }
    harness.give(Input::Dropped(40));
    harness.give(Input::Terminate("the server shuts down"));
    assert!(harness.notice().message.contains("the server shuts down"), "{:?}", harness.notice());
    count(&harness);
    assert_eq!(counted, 50 + 40 + 1);
}
