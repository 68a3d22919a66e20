//! The sessions that a controller accepts or refuses.

use fiatlux_foreign::{ForeignError, GainsRule, Plant, Reading};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_wbc::{CONTROL_DT, Joint};

fn joints(robot: &str, set: GainSet) -> Vec<Joint> {
    let robot = Robot::by_name(robot).unwrap();
    Joint::all(&robot, &robot.gains(set)).collect()
}

fn plants() -> [Plant; 3] {
    [Plant::gear(Reading::Nvidia).unwrap(), Plant::gear(Reading::Lerobot).unwrap(), Plant::sonic().unwrap()]
}

#[test]
fn each_fits_its_own_gains_on_both_robots() {
    for plant in plants() {
        for robot in Robot::NAMES {
            let joints = joints(robot, plant.gains());
            assert_eq!(plant.fits(&joints, CONTROL_DT, GainsRule::Own).unwrap(), None, "{robot} {}", plant.gains());
        }
    }
}

/// Legs and waist of the benchmark have GEAR's gains; the arms differ, but GEAR does not move them.
#[test]
fn gear_plays_on_the_benchmarks_gains() {
    let joints = joints("g1_inspire", GainSet::Fiatlux);
    let [nvidia, lerobot, sonic] = plants();
    let note = nvidia.fits(&joints, CONTROL_DT, GainsRule::Own).unwrap().unwrap();
    assert_eq!(note, "damping of left_shoulder_pitch_joint is 2.000 instead of 5.000");
    for (plant, gains, joint) in
        [(lerobot, "gear-lerobot", "left_knee_joint"), (sonic, "sonic", "left_hip_pitch_joint")]
    {
        let message = plant.fits(&joints, CONTROL_DT, GainsRule::Own).unwrap_err().to_string();
        for word in [joint, &format!("--gains {gains}"), "gains=any"] {
            assert!(message.contains(word), "{message}");
        }
        let note = plant.fits(&joints, CONTROL_DT, GainsRule::Any).unwrap().unwrap();
        assert!(note.contains(joint), "{note}");
    }
}

#[test]
fn other_sessions_are_refused_by_name() {
    let [gear, _, sonic] = plants();
    let own = joints("g1_inspire", GainSet::Gear);
    let refused = |joints: &[Joint], dt: f64| {
        let error = gear.fits(joints, dt, GainsRule::Any).unwrap_err();
        assert!(matches!(error, ForeignError::Unfit { controller: "gear", .. }));
        error.to_string()
    };
    assert!(refused(&own[..20], CONTROL_DT).contains("joint 20 left_wrist_pitch_joint"));
    let mut swapped = own.clone();
    swapped.swap(3, 4);
    assert!(refused(&swapped, CONTROL_DT).contains("joint 3 left_knee_joint, but the session has left_ankle_pitch"));
    assert!(refused(&own, 0.01).contains("a control step of 0.02 s, but the session has 0.01 s"));
    let mut unknown = joints("g1_bare", GainSet::Sonic);
    unknown[28].stiffness = f64::NAN;
    let message = sonic.fits(&unknown, CONTROL_DT, GainsRule::Own).unwrap_err().to_string();
    assert!(message.contains("stiffness of right_wrist_yaw_joint"), "{message}");
}
