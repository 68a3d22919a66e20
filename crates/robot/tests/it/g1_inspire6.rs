//! The G1 with six motors a hand against the one it is made from, and joints that follow others in robot files.

use fiatlux_dynamics::ModelBuilder;
use fiatlux_robot::{BuildOptions, Follows, GainSet, Robot, RobotError};

const FILE: &str = include_str!("../../robots/g1_inspire6.toml");
const BASE: &str = include_str!("../../robots/g1_inspire.toml");

fn pair() -> (Robot, Robot) {
    (Robot::by_name("g1_inspire").unwrap(), Robot::by_name("g1_inspire6").unwrap())
}

/// Name, index and coupling of each follower.
fn followers(robot: &Robot) -> Vec<(&str, usize, Follows)> {
    let joints = robot.joints().iter().enumerate();
    joints.filter_map(|(index, joint)| Some((joint.name.as_str(), index, joint.follows?))).collect()
}

/// The ratios and torques are those of the maker's description.
#[test]
fn it_has_the_makers_linkages_and_torques() {
    let (base, robot) = pair();
    assert_eq!((robot.hand(), robot.joints().len(), robot.hand_links()), ("inspire6", 53, base.hand_links()));
    assert_eq!((robot.total_mass(), robot.standing_height()), (base.total_mass(), base.standing_height()));
    let found = followers(&robot);
    assert_eq!(found.len(), 12);
    for (name, _, Follows { leader, ratio, offset }) in found {
        let leader = robot.joints()[leader].name.as_str();
        let (expected, of) = match name[2..].trim_end_matches("_joint") {
            "thumb_intermediate" => (1.6, "thumb_proximal_pitch"),
            "thumb_distal" => (2.4, "thumb_proximal_pitch"),
            finger => (1.0, finger.trim_end_matches("_intermediate")),
        };
        assert_eq!((ratio, offset), (expected, 0.0), "{name}");
        assert!(
            leader[..2] == name[..2] && leader[2..].starts_with(of) && !leader.contains("inter"),
            "{name}: {leader}"
        );
    }
    for side in ["L", "R"] {
        let thumb = &robot.joints()[robot.joint_index(&format!("{side}_thumb_proximal_pitch_joint")).unwrap()];
        assert_eq!((thumb.lower, thumb.upper), (0.0, 0.5), "as far as the last joint turns");
    }
    for set in GainSet::ALL {
        let (own, of_base) = (robot.gains(set), base.gains(set));
        for (joint, (own, of_base)) in robot.joints().iter().zip(own.0.iter().zip(&of_base.0)) {
            let limit = match joint.name.trim_start_matches("left_").trim_start_matches("right_") {
                "hip_pitch_joint" => 88.0,
                "ankle_pitch_joint" | "ankle_roll_joint" | "waist_roll_joint" | "waist_pitch_joint" => 35.0,
                name if name.starts_with("L_") || name.starts_with("R_") => 1.0,
                _ => of_base.effort_limit,
            };
            if joint.follows.is_some() {
                assert_eq!([own.stiffness, own.damping], [0.0; 2], "{} {set}", joint.name);
            } else {
                assert_eq!((own.stiffness, own.damping), (of_base.stiffness, of_base.damping), "{} {set}", joint.name);
                assert_eq!(own.effort_limit, limit, "{} {set}", joint.name);
            }
        }
    }
}

#[test]
fn its_model_couples_what_the_file_couples() {
    let (_, robot) = pair();
    let mut builder = ModelBuilder::new();
    let placed = robot.add_to(&mut builder, &BuildOptions::new(&robot)).unwrap();
    let model = builder.build().unwrap();
    assert_eq!((model.couplings().count(), model.drives().len()), (12, 53));
    let ids = placed.ids(&model).unwrap();
    for (name, index, follows) in followers(&robot) {
        let coupling = model.couplings().find(|coupling| coupling.follower == ids.joints[index].body).unwrap();
        assert_eq!((coupling.leader, coupling.ratio), (ids.joints[follows.leader].body, follows.ratio), "{name}");
    }
    let mut q: Vec<f64> = (0..53).map(|joint| 0.01 * f64::from(joint)).collect();
    robot.follow(&mut q);
    let mut state = model.reference_state();
    ids.joints.iter().zip(&q).for_each(|(joint, q)| state.qpos[joint.qpos] = *q);
    let before = state.clone();
    model.follow(&mut state);
    assert_eq!(state, before, "robot and engine agree on where followers are");
}

/// Robots whose joints have the same names are told apart by their own name; names of joints check it.
#[test]
fn a_session_names_its_robot() {
    for name in Robot::NAMES {
        let robot = Robot::by_name(name).unwrap();
        let joints = || robot.joints().iter().map(|joint| joint.name.as_str());
        assert_eq!(Robot::of_session(name, joints()).unwrap(), robot);
        let unnamed = if name == "g1_inspire6" { "g1_inspire" } else { name };
        assert_eq!(Robot::of_session("", joints()).unwrap().name(), unnamed);
        let other = if name == "g1_dex3" { "g1_bare" } else { "g1_dex3" };
        assert!(matches!(Robot::of_session(other, joints()), Err(RobotError::OtherJoints { .. })), "{name}");
    }
    assert_eq!(Robot::of_session("h1", ["knee"].into_iter()), Err(RobotError::Name("h1".into())));
}

/// A refusal of a changed text, and the line that it names.
fn refused(text: &str) -> (String, String) {
    let message = Robot::from_toml(text).unwrap_err().to_string();
    let number: usize = message.strip_prefix("line ").unwrap().split(':').next().unwrap().parse().unwrap();
    (message, text.lines().nth(number - 1).unwrap().to_owned())
}

#[test]
fn couplings_that_cannot_be_are_refused_with_the_line_at_fault() {
    let first = "follower = \"L_thumb_intermediate_joint\"\nleader = \"L_thumb_proximal_pitch_joint\"\nratio = 1.6\n";
    assert!(FILE.contains(first));
    for (old, new, at, expected) in [
        ("ratio = 1.6", "ratio = 0", "ratio", "ratio is 0; give the follower's angle by rad of the leader, or weld it"),
        ("ratio = 1.6", "ratio = nan", "ratio", "ratio holds NaN"),
        ("ratio = 1.6", "ratio = 1.6\noffset = inf", "offset", "offset holds inf"),
        (
            "ratio = 1.6",
            "ratio = -1.6\noffset = -1",
            "ratio",
            "ratio with this offset leaves 'L_thumb_proximal_pitch_joint' no range",
        ),
        ("ratio = 1.6", "ratoi = 1.6", "ratoi", "unknown field `ratoi`"),
        ("leader = \"L_thumb_proximal_pitch_joint\"", "", "[[couple]]", "missing field `leader`"),
        (
            "proximal_pitch_joint\"\nratio = 1.6",
            "proximal_joint\"\nratio = 1.6",
            "leader",
            "leader names joint 'L_thumb_proximal_joint', which the robot does not have",
        ),
        (
            "L_thumb_proximal_pitch_joint",
            "R_thumb_proximal_pitch_joint",
            "leader",
            "leader is 'R_thumb_proximal_pitch_joint', which does not carry the follower",
        ),
        ("L_thumb_proximal_pitch_joint", "L_thumb_intermediate_joint", "leader", "does not carry the follower"),
        (
            "follower = \"L_thumb_intermediate_joint\"",
            "follower = \"L_thumb_joint\"",
            "follower",
            "follower names joint 'L_thumb_joint'",
        ),
    ] {
        let start = FILE.find(first).unwrap();
        let text = format!("{}{}", &FILE[..start], FILE[start..].replacen(old, new, 1));
        let (message, line) = refused(&text);
        assert!(message.contains(expected), "'{message}' lacks '{expected}'");
        assert!(line.contains(at), "'{message}' points at '{line}'");
    }
    let distal = "follower = \"L_thumb_distal_joint\"\nleader = \"L_thumb_proximal_pitch_joint\"";
    for (new, expected) in [
        (first.rsplit_once("ratio").unwrap().0.trim_end(), "follower follows a joint already"),
        (
            "follower = \"L_thumb_distal_joint\"\nleader = \"L_thumb_intermediate_joint\"",
            "leader is 'L_thumb_intermediate_joint', which follows 'L_thumb_proximal_pitch_joint'; name that one",
        ),
        (
            "follower = \"L_thumb_proximal_pitch_joint\"\nleader = \"L_thumb_proximal_yaw_joint\"",
            "follower leads 'L_thumb_intermediate_joint'",
        ),
    ] {
        let (message, _) = refused(&FILE.replace(distal, new));
        assert!(message.contains(expected), "'{message}' lacks '{expected}'");
    }
    for (old, new, expected) in [
        ("waist_roll_joint = 35", "waist_rol_joint = 35", "effort_limits names joint 'waist_rol_joint'"),
        ("waist_roll_joint = 35", "waist_roll_joint = 0", "effort_limits gives joint 'waist_roll_joint' 0 N m"),
        (
            "waist_roll_joint = 35",
            "L_index_intermediate_joint = 1",
            "which follows 'L_index_proximal_joint'; remove it",
        ),
        ("followers = 12", "followers = 11", "followers is 11, the rules leave 12"),
    ] {
        let (message, line) = refused(&FILE.replace(old, new));
        assert!(message.contains(expected) && line.contains(new), "'{message}' at '{line}' lacks '{expected}'");
    }
}

/// A whole file states that its followers have no drive, and gives them no angle.
#[test]
fn a_whole_file_can_couple() {
    let couple = "\n[[couple]]\nfollower = \"left_ankle_roll_joint\"\nleader = \"left_ankle_pitch_joint\"\nratio = -0.5\noffset = -0.075\n";
    let groups = BASE.find("\n[joint_groups]").unwrap();
    let with = |text: &str| text.replacen("\n[joint_groups]", &format!("{couple}\n[joint_groups]"), 1);
    let (message, line) = refused(&with(BASE));
    assert!(message.contains("joint 'left_ankle_roll_joint': stiffness is 40"), "{message}");
    assert!(line.starts_with("stiffness"), "{line}");
    let at = BASE[..groups].find("name = \"left_ankle_roll_joint\"").unwrap();
    let released = BASE[at..].replacen("stiffness = 40\ndamping = 2\n", "stiffness = 0\ndamping = 0\n", 1);
    let released = format!("{}{released}", &BASE[..at]);
    // The gains of the second set are those of a drive.
    let (message, _) = refused(&with(&released));
    assert!(message.contains("gains.sonic names joint 'left_ankle_roll_joint', which follows"), "{message}");
    let whole = with(&released.replacen(
        "    \"left_ankle_roll_joint\",\n    \"right_hip_pitch_joint\"",
        "    \"right_hip_pitch_joint\"",
        2,
    ));
    let whole =
        whole.replacen("    \"right_hip_pitch_joint\"", "    \"left_ankle_roll_joint\", \"right_hip_pitch_joint\"", 1);
    let robot = Robot::from_toml(&whole).unwrap_or_else(|error| panic!("{error}"));
    let [pitch, roll] = ["pitch", "roll"].map(|part| robot.joint_index(&format!("left_ankle_{part}_joint")).unwrap());
    // The roll's limits of 0.2618 rad are reached before those of the pitch.
    let (low, high) = (robot.joints()[pitch].lower, robot.joints()[pitch].upper);
    let expected = [0.2618, -0.2618].map(|roll| (roll + 0.075) / -0.5);
    assert!((low - expected[0]).abs() < 1e-12 && (high - expected[1]).abs() < 1e-12, "{low} to {high}");
    assert_eq!(robot.q0()[roll], -0.5 * robot.q0()[pitch] - 0.075);
    let posed = whole.replacen("left_knee_joint = 0.2", "left_knee_joint = 0.2\nleft_ankle_roll_joint = 0.1", 1);
    let (message, _) = refused(&posed);
    assert!(
        message.contains("posture names joint 'left_ankle_roll_joint', which follows 'left_ankle_pitch_joint'"),
        "{message}"
    );
}
