//! Broken robot files are refused with the line, the part and the field at fault.

use fiatlux_robot::Robot;

const FILE: &str = include_str!("../../robots/g1_inspire.toml");

/// One broken file, made by replacing the first `old` after `after`, and what the refusal must say. The line it names
/// must hold `at`.
fn check_refused(after: &str, old: &str, new: &str, at: &str, expected: &[&str]) {
    let start = FILE.find(after).unwrap_or_else(|| panic!("the file has no '{after}'"));
    assert!(FILE[start..].contains(old), "the file has no '{old}' after '{after}'");
    let text = format!("{}{}", &FILE[..start], FILE[start..].replacen(old, new, 1));
    let message = match Robot::from_toml(&text) {
        Ok(_) => panic!("'{new}' after '{after}' is accepted"),
        Err(error) => error.to_string(),
    };
    for part in expected {
        assert!(message.contains(part), "'{new}' after '{after}': '{message}' lacks '{part}'");
    }
    let number: usize = message
        .strip_prefix("line ")
        .and_then(|m| m.split(':').next())
        .and_then(|n| n.parse().ok())
        .unwrap_or_else(|| panic!("'{message}' names no line"));
    let line = text.lines().nth(number - 1).unwrap_or_default();
    assert!(line.contains(at), "'{message}' points at '{line}', not at '{at}'");
}

#[test]
fn text_and_fields() {
    check_refused("[checks]", "joint_count = 53", "joint_count 53", "joint_count 53", &[]);
    check_refused("[checks]", "joint_count", "joint_cuont", "joint_cuont", &["unknown field `joint_cuont`"]);
    check_refused("name = \"pelvis\"", "mass = ", "mas = ", "mas = ", &["unknown field `mas`"]);
    check_refused("\"waist_yaw_joint\"\n", "axis", "axsi", "axsi", &["unknown field `axsi`"]);
    check_refused("\"waist_yaw_joint\"\nparent", "axis = [0, 0, 1]\n", "", "[[joint]]", &["missing field `axis`"]);
    check_refused("name = \"pelvis\"", "mass = 3.813", "mass = \"3.813\"", "mass", &["invalid type", "3.813"]);
    check_refused("name = \"pelvis\"", "com = [0, 0, ", "com = [0, ", "com", &["array of length 3"]);
    check_refused("kind = \"sphere\"", "\"sphere\"", "\"mesh\"", "mesh", &["unknown variant `mesh`"]);
}

#[test]
fn joint_groups() {
    let groups = "\n[joint_groups]";
    check_refused(groups, "waist = ", "wiast = ", "wiast", &["unknown field `wiast`"]);
    check_refused(
        groups,
        "waist = [\"",
        "waist = [\"left_",
        "waist",
        &["joint_groups names joint 'left_waist_yaw_joint'"],
    );
    // Whatever stands below would move without a trace in the digest.
    let below = format!("{FILE}\n[[shape]]\nname = \"knob\"\nlink = \"pelvis\"\nkind = \"sphere\"\nradius = 0.1\n");
    let message = Robot::from_toml(&below).unwrap_err().to_string();
    assert!(message.contains("joint_groups must be the last table"), "{message}");
}

/// The digest covers all that moves; joint groups only have names.
#[test]
fn the_digest_leaves_out_joint_groups() {
    let digest = |text: &str| Robot::from_toml(text).unwrap().digest().to_owned();
    assert_eq!(digest(FILE), digest(&FILE.replace("waist = [\"waist_yaw_joint\", ", "waist = [")));
    assert_ne!(digest(FILE), digest(&FILE.replace("\n[joint_groups]\n", "# Another file.\n\n[joint_groups]\n")));
}

#[test]
fn numbers() {
    let pelvis = "name = \"pelvis\"";
    check_refused(pelvis, "mass = 3.813", "mass = -3.813", "mass", &["link 'pelvis': mass is -3.813", "positive"]);
    check_refused(pelvis, "mass = 3.813", "mass = 0", "mass", &["link 'pelvis': mass is 0"]);
    check_refused(pelvis, "mass = 3.813", "mass = nan", "mass", &["link 'pelvis': mass", "NaN", "finite"]);
    check_refused(pelvis, "com = [0,", "com = [inf,", "com", &["link 'pelvis': com", "inf", "finite"]);
    check_refused(pelvis, "com = [0,", "com = [1e300,", "com", &["link 'pelvis': com", "1e6"]);
    check_refused(pelvis, "[0.010549", "[1.010549", "inertia", &["link 'pelvis': inertia", "solid"]);
    check_refused(pelvis, "mass = 3.813\n", "", "[[link]]", &["link 'pelvis': mass", "com and inertia"]);
    let knee = "name = \"left_knee_joint\"";
    check_refused(
        knee,
        "lower = -0.087267",
        "lower = 3",
        "lower",
        &["joint 'left_knee_joint': lower is 3", "below upper"],
    );
    check_refused(knee, "upper = 2.8798", "upper = nan", "upper", &["joint 'left_knee_joint': upper", "finite"]);
    check_refused(
        knee,
        "axis = [0, 1, 0]",
        "axis = [0, 0, 0]",
        "axis",
        &["'left_knee_joint': axis has length 0", "unit"],
    );
    check_refused(knee, "stiffness = 200", "stiffness = -1", "stiffness", &["stiffness is -1", "negative"]);
    check_refused(knee, "effort_limit = 139", "effort_limit = 0", "effort_limit", &["effort_limit is 0", "positive"]);
    check_refused(
        "[posture]",
        "left_knee_joint = 0.2",
        "left_knee_joint = -0.2",
        "left_knee_joint = -0.2",
        &["posture", "outside its limits"],
    );
    check_refused(
        "[posture]",
        "left_knee_joint = 0.2",
        "left_knee_joint = nan",
        "left_knee_joint = nan",
        &["posture", "NaN"],
    );
    check_refused(
        "name = \"hand\"",
        "friction = 0.9",
        "friction = -1",
        "friction = -1",
        &["material 'hand': friction"],
    );
    check_refused("kind = \"sphere\"", "radius = 0.04", "radius = 0", "radius = 0", &["radius is 0", "positive"]);
}

#[test]
fn sensors_name_links() {
    check_refused("[sensors]", "mid360_link", "mid36_link", "lidar = ", &["sensors.lidar", "'mid36_link'"]);
    let camera = "[[camera]]";
    check_refused(camera, "\"d435_link", "\"d43_link", "link = ", &["camera 'head_camera': link", "'d43_link'"]);
    check_refused(camera, "\"head_link\"", "\"hat\"", "hidden_link", &["camera 'head_camera': hidden_link", "'hat'"]);
    check_refused(
        camera,
        "focal_length = 15.13",
        "focal_length = 0",
        "focal_length",
        &["camera 'head_camera'", "positive"],
    );
    check_refused(camera, "near = 0.05", "near = -1", "near", &["camera 'head_camera': near is -1"]);
    check_refused("[sensors]", "lidar = ", "microphone = ", "microphone", &["unknown field `microphone`"]);
}

#[test]
fn names_and_tree() {
    let waist = "name = \"waist_yaw_joint\"\n";
    check_refused(
        waist,
        "parent = \"pelvis\"",
        "parent = \"torso_link\"",
        "parent",
        &["parent closes a cycle", "tree"],
    );
    check_refused(
        waist,
        "parent = \"pelvis\"",
        "parent = \"waist_yaw_link\"",
        "parent",
        &["cycle through link 'waist_yaw_link'"],
    );
    check_refused(
        waist,
        "parent = \"pelvis\"",
        "parent = \"hip\"",
        "parent",
        &["'waist_yaw_joint': parent names link 'hip'"],
    );
    check_refused(waist, "child = \"waist_yaw_link\"", "child = \"waist\"", "child", &["child names link 'waist'"]);
    check_refused(
        waist,
        "child = \"waist_yaw_link\"",
        "child = \"head_link\"",
        "child",
        &["'head_link'", "one parent"],
    );
    check_refused(
        "[[fixed]]\nname = \"left_palm_joint\"",
        "child = \"left_palm\"",
        "child = \"right_palm\"",
        "child",
        &["one parent"],
    );
    check_refused(
        "name = \"imu_in_pelvis\"",
        "[[fixed]]\nname = \"imu_in_pelvis_joint\"\nparent = \"pelvis\"\nchild = \"imu_in_pelvis\"\nxyz = [0.04525, 0, -0.08339]\n",
        "",
        "imu_in_pelvis",
        &["link 'imu_in_pelvis'", "second root"],
    );
    check_refused(
        "name = \"logo_joint\"",
        "parent = \"torso_link\"",
        "parent = \"left_elbow_link\"",
        "logo_link",
        &["link 'logo_link'", "above its parent 'left_elbow_link'"],
    );
    check_refused(
        "name = \"waist_yaw_link\"",
        "mass = 0.214\ncom = [0.003494, 0.000233, 0.018034]\ninertia = [0.00010673, 0.00010422, 0.0001625, 2.703e-06, -7.631e-06, -2.01e-07]\n",
        "",
        "[[link]]",
        &["link 'waist_yaw_link': mass", "moves"],
    );
    check_refused("[[link]]\nname = \"logo_link\"", "logo_link", "pelvis", "pelvis", &["link 'pelvis': name is taken"]);
    check_refused("name = \"logo_joint\"", "logo_joint", "head_joint", "head_joint", &["name is taken"]);
    check_refused(
        "[[shape]]\nname = \"head\"",
        "name = \"head\"",
        "name = \"pelvis\"",
        "pelvis",
        &["shape 'pelvis': name is taken"],
    );
    check_refused(
        "joint_order",
        "\"left_knee_joint\"",
        "\"left_nee_joint\"",
        "left_nee_joint",
        &["joint_order names joint 'left_nee_joint'"],
    );
    check_refused("joint_order", "\"left_knee_joint\"", "\"left_hip_yaw_joint\"", "left_hip_yaw_joint", &["twice"]);
    check_refused(
        "joint_order",
        "\"left_knee_joint\", ",
        "",
        "left_knee_joint",
        &["joint 'left_knee_joint'", "missing in joint_order"],
    );
    check_refused(
        "hand_links",
        "\"right_palm\"",
        "\"right_plam\"",
        "right_plam",
        &["hand_links names link 'right_plam'"],
    );
    check_refused("exclude", "\"left_palm\"", "\"plam\"", "plam", &["exclude names link 'plam'"]);
    check_refused(
        "exclude",
        "[\"left_palm\", \"L_thumb_proximal\"]",
        "[\"left_palm\"]",
        "left_palm",
        &["fewer than two"],
    );
    check_refused(
        "[posture]",
        "left_knee_joint",
        "left_nee_joint",
        "left_nee_joint",
        &["posture names joint 'left_nee_joint'"],
    );
    check_refused("[gains.sonic]", "\"waist_yaw_joint\"", "\"waist\"", "waist", &["gains.sonic names joint 'waist'"]);
    check_refused(
        "[[shape]]\nname = \"head\"",
        "link = \"head_link\"",
        "link = \"skull\"",
        "skull",
        &["shape 'head': link names link 'skull'"],
    );
    check_refused(
        "name = \"left_palm\"",
        "material = \"hand\"",
        "material = \"glove\"",
        "glove",
        &["link 'left_palm': material"],
    );
    check_refused(
        "name = \"left_palm\"",
        "group = \"left_hand\"\n",
        "",
        "[[link]]",
        &["link 'left_palm': group is missing"],
    );
    check_refused("kind = \"sphere\"", "radius = 0.04\n", "", "[[shape]]", &["radius is missing"]);
    check_refused(
        "kind = \"sphere\"",
        "radius = 0.04\n",
        "radius = 0.04\nto = [0, 0, 1]\n",
        "to = ",
        &["to does not belong"],
    );
    check_refused("kind = \"capsule\"", "to = [0.001, 0, -0.06]", "to = [0.001, 0, -0.092]", "to = ", &["same point"]);
}

#[test]
fn sums() {
    check_refused(
        "[checks]",
        "joint_count = 53",
        "joint_count = 54",
        "joint_count",
        &["joint_count is 54", "53 joints"],
    );
    check_refused(
        "[checks]",
        "total_mass = 34.58",
        "total_mass = 33.58",
        "total_mass",
        &["total_mass is 33.5811", "34.5811"],
    );
    check_refused("[checks]", "standing_height = 0.7881", "standing_height = nan", "standing_height", &["0.7881"]);
    check_refused(
        "[posture]",
        "left_knee_joint = 0.2",
        "left_knee_joint = 0.5",
        "standing_height",
        &["standing_height"],
    );
    check_refused(
        "feet = ",
        "feet = [\"left_ankle_roll_link\", \"right_ankle_roll_link\"]",
        "feet = []",
        "standing_height",
        &["standing_height"],
    );
}

/// Whatever is cut off, the loader answers instead of panicking.
#[test]
fn cut_files_are_refused() {
    // Joint groups may be left out.
    let groups = FILE.find("\n[joint_groups]").expect("the file has groups");
    for end in (0..FILE.len()).step_by(997) {
        assert!(Robot::from_toml(&FILE[..end]).is_err() || end > groups);
    }
    for empty in ["link = []", "joint = []", "shape = []"] {
        let head = FILE.find("[[link]]").expect("the file has links");
        assert!(Robot::from_toml(&format!("{empty}\n{}", &FILE[..head])).is_err());
    }
}
