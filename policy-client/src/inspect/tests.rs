#![allow(clippy::unwrap_used)]

use std::collections::BTreeMap;

use fiatlux_client::Command;
use fiatlux_proto::v3::{
    EpisodeEnd, Joint, Notice, Observation, ObservationTerm, Proprioception, Sensor, SessionInfo, TaskInfo, Verdict,
};

use super::state::State;
use super::view::{Part, Style, draw};
use super::{document, files};

const PLAIN: Style = Style { width: 100, color: false };
const SUMMARY: Part = Part::Summary { joints: true };

fn info() -> SessionInfo {
    let task = TaskInfo {
        task: "S05".into(),
        name: "Carry".into(),
        instruction: "Carry the bulb.".into(),
        horizon_steps: 6000,
        criteria: vec!["near the crate".into(), "held".into()],
        ..TaskInfo::default()
    };
    let joint = |name: &str| Joint { name: name.into(), lower: -1.0, upper: 1.0, q0: 0.2, ..Joint::default() };
    let timed = |name: &str, rate_hz| Sensor { rate_hz, ..Sensor::from(name) };
    SessionInfo {
        task: Some(task),
        server: "lab".into(),
        joints: vec![joint("knee"), joint("elbow")],
        sensors: vec![
            timed("proprioception", 50.0),
            timed("lidar", 10.0),
            Sensor { on_request: true, ..Sensor::from("features") },
            timed("verdict", 50.0),
        ],
        control_dt: 0.02,
        action_scale: 0.5,
        terms: vec![ObservationTerm {
            sensor: "flat".into(),
            name: "gravity".into(),
            shape: vec![3],
            scale: 0.1,
            ..ObservationTerm::default()
        }],
        ..SessionInfo::default()
    }
}

fn observation(step: u64) -> Observation {
    let own = Proprioception {
        base_angular_velocity: vec![0.125, -0.5, 0.0],
        projected_gravity: vec![0.0, 0.0, -1.0],
        base_linear_velocity: vec![0.0; 3],
        base_height: 0.79,
        joint_position: vec![0.1, -0.1],
        joint_velocity: vec![0.0; 2],
    };
    let verdict = Verdict { criteria: vec![step >= 5, true], gate_progress: 0.5, reward: 0.25 };
    let lidar = if step.is_multiple_of(5) { vec![2.0; 5760] } else { Vec::new() };
    Observation { step, proprioception: Some(own), lidar, verdict: Some(verdict), ..Observation::default() }
}

/// Ten steps of 10 ms, of which the policy takes 2 ms.
fn state() -> State {
    let mut state = State::new(info(), "hold".into(), 3);
    for step in 0..10 {
        let now_s = 0.01 * step as f64;
        state.observed(&observation(step), now_s);
        state.acted(&Command::Action(vec![0.0, if step < 4 { 2.0 } else { 1.0 }]), 0.002, now_s + 0.002);
    }
    state
}

#[test]
fn steps_rates_and_holds_are_counted() {
    let state = state();
    assert_eq!((state.observations, state.seen["lidar"].count, state.seen["lidar"].step), (10, 2, 5));
    assert_eq!((state.held.as_slice(), state.verdicts, state.reward), ([5, 10].as_slice(), 10, 2.5));
    // The first observation does not answer an action.
    assert_eq!((state.steps.count(), state.acting.count()), (9, 10));
    assert!((state.steps.quantile_s(0.5).unwrap() - 0.008).abs() < 1e-6);
    assert_eq!(state.steps_with[&vec!["lidar"]].count(), 1);
    // q0 + 0.5 x 2 is beyond the elbow's limit.
    assert_eq!((state.out_of_limits.steps, state.out_of_limits.joints.as_slice()), (4, [0, 4].as_slice()));
    assert!((state.wall_s - 0.092).abs() < 1e-9);
    assert_eq!(state.latest.lidar.len(), 5760);
    let mut again = state;
    assert!(!again.observed(&observation(9), 1.0) && again.observations == 10 && again.reward == 2.5);
}

/// One large sensor in a step, three times each, and all that is missing in the last step.
#[test]
fn looks_take_turns() {
    let mut state = State::new(info(), "hold".into(), 0);
    let mut wanted = Vec::new();
    for step in 0..500 {
        wanted.extend(state.wanted(&observation(step), false).into_iter().map(|name| (step, name)));
    }
    let turns = [0, 50, 100].into_iter().flat_map(|start| [(start + 1, "lidar"), (start + 2, "features")]);
    assert_eq!(wanted, turns.collect::<Vec<_>>());
    assert_eq!(state.wanted(&observation(500), true), ["features"]);
    assert_eq!(state.wanted(&observation(501), true), ["lidar", "features"]);
    state.looked(&["lidar"], &observation(5), 0.004);
    assert_eq!((state.seen["lidar"].looks.count(), state.seen["lidar"].count), (1, 0));
}

/// A sensor that this program does not know is shown as the session describes it.
#[test]
fn an_unknown_sensor_is_shown() {
    let term = ObservationTerm {
        sensor: "weather".into(),
        field: "limb_contact_force".into(),
        shape: vec![3],
        unit: "hPa".into(),
        ..ObservationTerm::default()
    };
    let mut state = State::new(SessionInfo { terms: vec![term], ..info() }, "hold".into(), 0);
    assert!(draw(&state, SUMMARY, PLAIN).contains("not seen yet"));
    state.observed(&Observation { limb_contact_force: vec![1.0, 2.0, 4.0], ..observation(0) }, 0.0);
    let text = draw(&state, SUMMARY, PLAIN);
    assert!(text.contains("limb_contact_force     3          hPa                     1 2 4\n"), "{text}");
}

#[test]
fn the_view_says_what_a_policy_receives() {
    let text = draw(&state(), SUMMARY, PLAIN);
    for part in [
        "S05 Carry\n  \"Carry the bulb.\"\n  server lab, lockstep, seed 0, episode 3, policy hold",
        "step 9 of 6000 (0.18 s), 98 steps/s, 2.0 x real time",
        "Gate: 2 of 2 hold; progress 0.50; reward so far 2.50",
        "  [x] near the crate   50 % of the steps\n  [x] held            100 % of the steps\n",
        "proprioception                            50 Hz",
        " base_angular_velocity 3          rad/s                   0.12 -0.50 0\n",
        "lidar                  32x180     m       10 Hz  23.0 kB  2 2 2\n",
        "features               512                 look           not seen yet\n",
        "from an action to its observation     8.0 ms    8.0 ms       9",
        "targets beyond the limits in 4 of 10 steps\n    elbow 4\n",
        " 1 elbow                          0.20  -1.00   1.00   -2.40    1.60",
        "Flat vector: 3 numbers",
        "gravity                           0      3    0.1    exact",
    ] {
        assert!(text.contains(part), "{part}\nis not in\n{text}");
    }
    assert!(!text.contains('\x1b') && !text.contains("Notices"), "{text}");
}

#[test]
fn marks_follow_the_verdict() {
    let mut state = State::new(info(), "hold".into(), 0);
    assert!(
        draw(&state, Part::Live, PLAIN).contains("Gate: unknown without the sensor verdict\n  [?] near the crate\n")
    );
    state.observed(&observation(1), 0.0);
    let text = draw(&state, Part::Live, PLAIN);
    assert!(text.contains("Gate: 1 of 2 hold") && text.contains("  [ ] near the crate") && text.contains("  [x] held"));
    let color = draw(&state, Part::Live, Style { color: true, ..PLAIN });
    assert!(color.contains("\x1b[32m  [x] held") && !color.contains("\x1b[32m  [ ]"), "{color}");
}

#[test]
fn no_line_is_wider_than_the_terminal() {
    let mut state = state();
    let notice = Notice { step: 7, message: "word ".repeat(40), count: 2, ..Notice::default() };
    state.noticed(notice);
    for width in [20, 60, 80] {
        let text = draw(&state, SUMMARY, Style { width, color: false });
        let longest = text.lines().map(|line| line.chars().count()).max().unwrap();
        assert!(longest <= width, "{longest} of {width}");
        assert!(text.contains("Notices of the s"));
        // A narrow table has the numbers but no bytes.
        assert_eq!(text.contains("kB  2 2 2"), width == 80);
        assert!(width < 60 || text.contains("10 Hz  2"), "{text}");
    }
}

#[test]
fn the_document_has_what_the_view_has() {
    let mut state = state();
    state.end = Some(EpisodeEnd { cause: "fall".into(), causes: vec!["fall".into()], ..EpisodeEnd::default() });
    let report = document::report(&state, &BTreeMap::from([("camera", "x/camera.png".into())]));
    assert_eq!(report["sensors"][1]["name"], "lidar");
    assert_eq!(report["sensors"][1]["terms"][0]["shape"], serde_json::json!([32, 180]));
    assert_eq!(report["sensors"][2]["rate_hz"], serde_json::Value::Null);
    assert_eq!(report["gate"]["criteria"][0]["steps_held"], 5);
    assert_eq!((&report["end"]["cause"], &report["files"]["camera"]), (&"fall".into(), &"x/camera.png".into()));
    let one: serde_json::Value = serde_json::from_str(&document::observation(&state)).unwrap();
    assert_eq!((&one["step"], &one["sensors"]["lidar"]["step"]), (&9.into(), &5.into()));
    assert_eq!(one["sensors"]["lidar"]["terms"]["lidar"]["values"].as_array().unwrap().len(), 5760);
    // A single-precision number has the digits of one.
    let own = &one["sensors"]["proprioception"]["terms"];
    assert_eq!(own["base_height"]["values"][0].to_string(), "0.79");
    assert_eq!(one["sensors"]["verdict"]["terms"]["criteria"]["values"], serde_json::json!([true, true]));
}

#[test]
fn a_folder_that_holds_something_is_left_alone() {
    let folder = std::env::temp_dir().join(format!("fiatlux-inspect-{}", std::process::id()));
    assert!(files::check(&folder, false).is_ok());
    let written = files::write(&folder, &state()).unwrap();
    assert_eq!(written.keys().copied().collect::<Vec<_>>(), ["lidar", "observation"]);
    assert!(files::check(&folder, false).is_ok(), "its own files");
    std::fs::write(folder.join("notes.txt"), "mine").unwrap();
    assert!(files::check(&folder, false).is_err() && files::check(&folder, true).is_ok());
    assert!(files::check(&folder.join("lidar.png"), true).is_err());
    std::fs::remove_dir_all(folder).unwrap();
}
