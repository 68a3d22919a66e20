//! Options of a session: real time, looks, sensors, robot and room.

use fiatlux_proto::v3::Source;
use fiatlux_robot::Robot;

use super::*;

#[test]
fn real_time_steps_by_the_clock() {
    let mut harness = harness(OpenRequest { mode: 2, ..OpenRequest::default() });
    harness.reset(0);
    assert_eq!(harness.act(0, 0), [observation(1), record(1)], "the first action starts the clock");
    assert_eq!(harness.session.wake_at(), Some(harness.now + 20 * MS));
    assert_eq!(harness.sleep(), [observation(2), record(2)]);
    let taken = |harness: &Harness| ActionRecord::decode(&*harness.record().action).unwrap();
    assert!(taken(&harness).held);
    harness.now += 5 * MS;
    assert_eq!(harness.act(0, 1), [notice_of(notice::Code::Step)], "late");
    assert_eq!(harness.act(0, 52), [notice_of(notice::Code::Step)], "more than a second ahead");
    assert_eq!(harness.act(0, 2), []);
    harness.now += 15 * MS;
    assert_eq!(harness.give(Input::Tick), [observation(3), record(3)]);
    assert_eq!((taken(&harness).held, taken(&harness).lateness_s), (false, 0.005));
    // A server that cannot keep up goes on from now.
    harness.now += 95 * MS;
    let sent = harness.give(Input::Tick);
    assert_eq!(sent, [notice_of(notice::Code::Late), observation(4), record(4)]);
    assert_eq!(harness.session.wake_at(), Some(harness.now + 20 * MS));
    harness.close();
    assert_eq!(harness.result().missed_steps, 2);
}

/// A client that falls silent: its command walks for half a second, then the robot stands at the height that was commanded. A
/// replay of the recorded targets repeats every row.
#[test]
fn a_whole_body_command_expires_in_real_time() {
    let walk = WholeBodyCommand { vx: 0.5, height: 0.7, ..WholeBodyCommand::default() };
    let stand = WholeBodyCommand { vx: 0.0, ..walk };
    let row = |harness: &Harness| harness.session.host().run.as_ref().unwrap().play.episode().row().clone();
    let digest = |harness: &Harness| harness.session.host().run.as_ref().unwrap().play.episode().digest().hex();
    // Steps that follow the command, for the default time and another one.
    for (command_timeout_ms, steps) in [(0, 25), (200, 10)] {
        let mut harness = harness(OpenRequest { mode: 2, command_timeout_ms, ..OpenRequest::default() });
        assert_eq!(harness.session.info().command_timeout_s, steps as f64 * 0.02);
        harness.reset(0);
        let mut targets = Vec::new();
        // The controller stands without its network a few seconds after the last step.
        for step in 0..steps + 350 {
            match step {
                0 => harness.send(&Action { whole_body: Some(walk), ..Action::default() }),
                _ => harness.sleep(),
            };
            let record = harness.record();
            let action = ActionRecord::decode(&*record.action).unwrap().action.unwrap();
            assert_eq!(action.whole_body, Some(if step < steps { walk } else { stand }), "step {step}");
            let events = record.events.iter().map(|event| Event::decode(&**event).unwrap().kind);
            assert_eq!(events.filter(|kind| kind == "expired").count(), usize::from(step == steps), "step {step}");
            targets.push(action.joint_target);
        }
        let (played, before) = (digest(&harness), row(&harness).robot);
        assert!(before.pose.translation.z > 0.6, "it stands");
        (0..50).for_each(|_| drop(harness.sleep()));
        let way = row(&harness).robot.pose.translation.vector - before.pose.translation.vector;
        assert!(way.xy().norm() < 0.03, "it still moves: {way}");
        // The next command is followed again.
        let step = row(&harness).step;
        harness.send(&Action { step, whole_body: Some(walk), ..Action::default() });
        harness.sleep();
        assert_eq!(ActionRecord::decode(&*harness.record().action).unwrap().action.unwrap().whole_body, Some(walk));

        let mut replay = self::harness(OpenRequest::default());
        replay.reset(0);
        for (step, joint_target) in (0..).zip(targets) {
            replay.send(&Action { step, joint_target, ..Action::default() });
        }
        assert_eq!(digest(&replay), played);
    }
    // Joint targets hold.
    let mut held = harness(OpenRequest { mode: 2, ..OpenRequest::default() });
    held.reset(0);
    held.act(0, 0);
    for _ in 0..40 {
        held.sleep();
        let record = held.record();
        let events = record.events.iter().map(|event| Event::decode(&**event).unwrap().kind);
        assert_eq!(events.filter(|kind| kind == "expired").count(), 0);
        assert!(ActionRecord::decode(&*record.action).unwrap().held, "step {}", record.step);
    }
}

fn look(harness: &mut Harness, episode: u64, step: u64, sensors: &[&str]) -> look_reply::Reply {
    let sensors = sensors.iter().map(|name| (*name).to_owned()).collect();
    let bytes = LookRequest { episode, step, sensors }.encode_to_vec();
    assert_eq!(harness.give(Input::Look(bytes.into(), 9)), [Reply(9)]);
    let Some(Output::Reply(9, "LookReply", replies)) = harness.sent.last() else { panic!("{:?}", harness.sent.last()) };
    LookReply::decode(replies[0].clone()).unwrap().reply.unwrap()
}

#[test]
fn a_look_shows_the_present_step() {
    let on_request = |name: &str| Sensor { on_request: true, ..Sensor::from(name) };
    let sensors = vec![on_request("camera"), on_request("privileged"), Sensor::from("last_action")];
    let mut harness = harness(OpenRequest { sensors, image_width: 32, image_height: 16, ..OpenRequest::default() });
    harness.reset(0);
    harness.act(0, 0);
    let recorded = Observation::decode(harness.record().observation.as_slice()).unwrap();
    let look_reply::Reply::Observation(seen) = look(&mut harness, 0, 1, &["camera"]) else { panic!("refused") };
    assert_eq!((seen.episode, seen.step), (0, 1));
    assert_eq!(seen.camera.map(|image| image.rgb.len()), Some(3 * 32 * 16));
    assert_eq!((seen.privileged, seen.last_action.len()), (None, 0), "not asked for");
    // The bag has the last action alone: the others are only looked at.
    assert_eq!((recorded.camera, recorded.last_action.len()), (None, JOINTS));

    let refused = |harness: &mut Harness, episode, step, sensor| match look(harness, episode, step, &[sensor]) {
        look_reply::Reply::Refusal(refusal) => refusal,
        look_reply::Reply::Observation(_) => panic!("not refused"),
    };
    for (episode, step, sensor, field, message) in [
        (0, 0, "camera", "step", "step 0 is not the present one, 1"),
        (0, 2, "camera", "step", "step 2"),
        (1, 1, "camera", "episode", "episode 1"),
        (0, 1, "lidar", "sensors", "no sensor 'lidar' but last_action, camera, privileged"),
        (0, 1, "smell", "sensors", "no sensor 'smell'"),
    ] {
        let refusal = refused(&mut harness, episode, step, sensor);
        assert_eq!(refusal.field, field);
        assert!(refusal.message.contains(message), "{refusal:?}");
    }
    harness.close();
    assert_eq!(refused(&mut harness, 0, 1, "camera").code(), Code::Closed);
}

/// Large sensors are in the bag at the rate that was asked for, apart from the observation; small ones as published.
#[test]
fn bags_have_large_sensors_at_their_own_rate() {
    let camera = Sensor { rate_hz: 10.0, recorded: true, record_hz: 25.0, ..Sensor::from("camera") };
    let lidar = Sensor { rate_hz: 25.0, ..Sensor::from("lidar") };
    let sensors = vec![camera, lidar, Sensor::from("proprioception")];
    let asked = OpenRequest { sensors, image_width: 16, image_height: 16, recorded: true, ..OpenRequest::default() };
    let mut unrecorded = harness(OpenRequest { recorded: false, ..asked.clone() });
    unrecorded.reset(0);
    assert!(unrecorded.record().camera.is_empty(), "nobody would take it");
    let mut harness = harness(asked);
    harness.reset(0);
    for step in 0..7 {
        let row = harness.record();
        let published = if step == 0 {
            let reset_reply::Reply::Observation(first) = harness.reset_reply() else { panic!("refused") };
            first
        } else {
            harness.observed()
        };
        assert_eq!((row.step, published.step), (step, step));
        assert_eq!(published.camera.is_some(), step % 5 == 0, "{step}");
        assert_eq!(published.lidar.is_empty(), step % 2 == 1, "{step}");
        assert_eq!(row.camera.is_empty(), step % 2 == 1, "{step}");
        assert!(row.lidar.is_empty(), "not recorded");
        let recorded = Observation::decode(row.observation.as_slice()).unwrap();
        assert_eq!(recorded, Observation { camera: None, lidar: Vec::new(), ..published });
        harness.act(0, step);
    }
}

/// A session has the robot that was asked for by name; what stands still is told with it.
#[test]
fn a_session_says_which_robot_and_room_it_has() {
    for (robot, joints, bodies) in
        [("", 53, 34), ("g1_inspire", 53, 34), ("g1_dex3", 43, 24), ("g1_bare", 29, 10), ("inspire6", 53, 34)]
    {
        let harness = without_client(OpenRequest { robot: robot.into(), ..OpenRequest::default() });
        let info = harness.session.info();
        assert_eq!((info.joints.len(), info.hand_bodies.len()), (joints, bodies), "robot '{robot}'");
        let followers = info.joints.iter().filter(|joint| joint.follows.is_some()).count();
        assert_eq!(Robot::known(robot), Ok(info.robot.as_str()));
        assert_eq!(followers, if robot == "inspire6" { 12 } else { 0 }, "robot '{robot}'");
        let names: Vec<&str> = info.footprints.iter().map(|footprint| footprint.name.as_str()).collect();
        for name in ["bench", "crate", "fixture", "wall_west"] {
            assert!(names.contains(&name), "{name} in {names:?}");
        }
        for footprint in &info.footprints {
            assert!(footprint.outline.len() == 8 && footprint.bottom < footprint.top, "{footprint:?}");
        }
    }
}

/// Guards that the server, from the request, says whose actions these are: in the session's description, and in the header,
/// which the result's digest covers.
#[test]
fn a_persons_actions_are_marked() {
    let person = i32::from(Source::Person);
    let take = OpenRequest { take: true, end_on: vec!["success".into()], ..OpenRequest::default() };
    for (request, expected) in [
        (OpenRequest::default(), 0),
        (OpenRequest { source: person, ..OpenRequest::default() }, person),
        (OpenRequest { source: 7, ..OpenRequest::default() }, person),
        (take, person),
    ] {
        let mut harness = harness(request);
        assert_eq!(harness.session.info().source, expected);
        harness.reset(0);
        assert_eq!(harness.record().header.unwrap().source, expected);
    }
}
