//! From a robot file to a checked robot.

use fiatlux_dynamics::Material;

use crate::digest::{digested, sha256_hex};
use crate::file::{CameraDef, CameraFile, JointGroupsTable, RobotFile};
use crate::gains::Gains;
use crate::kinematics::pose;
use crate::locate::{Step, line_at};
use crate::refuse::Refuse;
use crate::shape::Surface;
use crate::{BulbGrasp, CameraMount, Joint, JointGroups, Robot, RobotError};

/// Cameras that are not of the benchmark.
const CAMERAS: &str = include_str!("../cameras.toml");

/// Mass may differ from that of the file by this, kg.
const MASS_TOLERANCE: f64 = 1e-3;
/// Height may differ from that of the file by this, m.
const HEIGHT_TOLERANCE: f64 = 5e-4;

pub(crate) fn load(text: &str) -> Result<Robot, RobotError> {
    let file: RobotFile = toml::from_str(text).map_err(|error| RobotError::Syntax {
        line: error.span().map_or(1, |span| line_at(text, span.start)),
        problem: error.message().trim_end().into(),
    })?;
    let refuse = Refuse { text, robot: &file.name };
    let undigested = &text[digested(text).len()..];
    if !undigested.is_empty() && toml::from_str::<JointGroupsTable>(undigested).is_err() {
        let problem = "must be the last table of the file, whose digest ends above it; move it there".into();
        return Err(refuse.at(&[Step::Key("joint_groups")], "joint_groups", problem));
    }
    let links = crate::tree::links(&file, &refuse)?;
    let (mut joints, links) = crate::tree::joints(&file, links, &refuse)?;
    crate::couple::couple(&mut joints, &links, &file.couple, &refuse)?;
    let joint_names: Vec<&str> = file.joint.iter().map(|joint| joint.name.as_str()).collect();
    crate::couple::check_drives(&joints, &joint_names, &refuse)?;
    let surfaces = surfaces(&file, &refuse)?;
    let (shapes, groups) = crate::load_shapes::shapes(&file, &surfaces, &refuse)?;

    let link_names: Vec<&str> = links.iter().map(|l| l.name.as_str()).collect();
    let link_list = |key: &'static str, names: &[String]| {
        names
            .iter()
            .enumerate()
            .map(|(i, name)| refuse.find(&link_names, name, "link", key, &[Step::Key(key), Step::Index(i)]))
            .collect::<Result<Vec<usize>, RobotError>>()
    };
    let mount = |key: &'static str, field: &'static str, name: &Option<String>| {
        let path = [Step::Key("sensors"), Step::Key(key)];
        name.as_ref().map(|name| refuse.find(&link_names, name, "link", field, &path)).transpose()
    };
    let mut robot = Robot {
        hand_links: link_list("hand_links", &file.hand_links)?,
        feet: link_list("feet", &file.feet)?,
        palms: link_list("palms", &file.palms)?,
        lidar: mount("lidar", "sensors.lidar", &file.sensors.lidar)?,
        cameras: cameras(&file, &link_names, &refuse)?,
        excluded: excluded(&file, &link_names, &refuse)?,
        bulb_grasp: bulb_grasp(&file, &link_names, &joints, &refuse)?,
        q0: vec![0.0; joints.len()],
        sonic: Gains(joints.iter().map(|j| j.gains).collect()),
        name: file.name.clone(),
        hand: file.hand.clone(),
        digest: sha256_hex(&[digested(text)]),
        joint_groups: joint_groups(&file, &joints, &refuse)?,
        links,
        joints,
        shapes,
        surfaces,
        groups,
    };
    read_posture(&file, &mut robot, &refuse)?;
    read_sonic(&file, &mut robot, &refuse)?;
    check_sums(&file, &robot, &refuse)?;
    Ok(robot)
}

fn joint_groups(file: &RobotFile, joints: &[Joint], refuse: &Refuse<'_>) -> Result<JointGroups, RobotError> {
    let all: Vec<&str> = joints.iter().map(|joint| joint.name.as_str()).collect();
    let group = |key: &'static str, names: &[String]| {
        let path = |index| [Step::Key("joint_groups"), Step::Key(key), Step::Index(index)];
        let found =
            names.iter().enumerate().map(|(i, name)| refuse.find(&all, name, "joint", "joint_groups", &path(i)));
        let mut group = found.collect::<Result<Vec<_>, RobotError>>()?;
        group.sort_unstable();
        group.dedup();
        Ok::<_, RobotError>(group)
    };
    let def = &file.joint_groups;
    Ok(JointGroups {
        legs: group("legs", &def.legs)?,
        ankles: group("ankles", &def.ankles)?,
        waist: group("waist", &def.waist)?,
        fingers: group("fingers", &def.fingers)?,
    })
}

fn cameras(file: &RobotFile, link_names: &[&str], refuse: &Refuse<'_>) -> Result<Vec<CameraMount>, RobotError> {
    let mut cameras: Vec<CameraMount> = Vec::new();
    for (index, def) in file.camera.iter().enumerate() {
        let part = refuse.part("camera", index, &def.name);
        if cameras.iter().any(|camera| camera.name == def.name) {
            return Err(part.refuse("name", "is taken; names must be unique"));
        }
        part.finite("xyz", &def.xyz)?;
        part.finite("rpy", &def.rpy)?;
        part.positive("aperture", def.aperture)?;
        part.positive("focal_length", def.focal_length)?;
        part.positive("near", def.near)?;
        let link = |field: &'static str, name: &str| {
            let found = link_names.iter().position(|link| *link == name);
            let problem = || format!("names link '{name}', which the file does not have; correct or remove it");
            found.ok_or_else(|| part.refuse(field, problem()))
        };
        let hidden_link = def.hidden_link.as_ref().map(|name| link("hidden_link", name)).transpose()?;
        cameras.push(camera(def, link("link", &def.link)?, hidden_link));
    }
    let others: CameraFile = toml::from_str(CAMERAS).map_err(|error| RobotError::Syntax {
        line: error.span().map_or(1, |span| line_at(CAMERAS, span.start)),
        problem: format!("cameras.toml: {}", error.message().trim_end()),
    })?;
    for def in &others.camera {
        let link = link_names.iter().position(|link| *link == def.link);
        if let Some(link) = link.filter(|_| cameras.iter().all(|camera| camera.name != def.name)) {
            cameras.push(camera(def, link, None));
        }
    }
    Ok(cameras)
}

fn camera(def: &CameraDef, link: usize, hidden_link: Option<usize>) -> CameraMount {
    CameraMount {
        name: def.name.clone(),
        link,
        link_from_camera: pose(def.xyz, def.rpy),
        horizontal_fov: 2.0 * libm::atan(def.aperture / (2.0 * def.focal_length)),
        near: def.near,
        hidden_link,
    }
}

fn bulb_grasp(
    file: &RobotFile,
    link_names: &[&str],
    joints: &[Joint],
    refuse: &Refuse<'_>,
) -> Result<Option<BulbGrasp>, RobotError> {
    const TABLE: &str = "bulb_grasp";
    let Some(def) = &file.bulb_grasp else { return Ok(None) };
    let path = |key| [Step::Key(TABLE), Step::Key(key)];
    let within = |key: &'static str, values: &[f64], range: [f64; 2]| {
        let fits = values.iter().all(|value| (range[0]..=range[1]).contains(value));
        let [low, high] = range;
        let problem = || format!("has a {key} outside {low} to {high}; correct it");
        if fits { Ok(()) } else { Err(refuse.at(&path(key), TABLE, problem())) }
    };
    within("glass_center", &def.glass_center, [-1.0, 1.0])?;
    within("glass_height", &[def.glass_height], [0.0, 1.0])?;
    within("glass_tilt", &def.glass_tilt, [-3.2, 3.2])?;
    let names: Vec<&str> = joints.iter().map(|joint| joint.name.as_str()).collect();
    let mut grip = Vec::new();
    for (name, &angle) in &def.grip {
        let path = [Step::Key(TABLE), Step::Key("grip"), Step::Key(name)];
        let joint = refuse.find(&names, name, "joint", TABLE, &path)?;
        refuse.follower(joints, joint, TABLE, &path)?;
        let Joint { lower, upper, .. } = joints[joint];
        if !(lower..=upper).contains(&angle) {
            let problem = format!("sets joint '{name}' to {angle}, beyond its limits {lower} to {upper}; correct it");
            return Err(refuse.at(&path, TABLE, problem));
        }
        grip.push((joint, angle));
    }
    Ok(Some(BulbGrasp {
        link: refuse.find(link_names, &def.link, "link", TABLE, &path("link"))?,
        glass_center: def.glass_center,
        glass_height: def.glass_height,
        glass_tilt: def.glass_tilt,
        grip,
    }))
}

fn surfaces(file: &RobotFile, refuse: &Refuse<'_>) -> Result<Vec<Surface>, RobotError> {
    let mut surfaces: Vec<Surface> = Vec::new();
    for (index, def) in file.material.iter().enumerate() {
        let part = refuse.part("material", index, &def.name);
        if surfaces.iter().any(|s| s.name == def.name) {
            return Err(part.refuse("name", "is taken; names must be unique"));
        }
        part.not_negative("friction", def.friction)?;
        part.not_negative("static_friction", def.static_friction)?;
        surfaces.push(Surface {
            name: def.name.clone(),
            material: Material::new(def.friction, def.priority),
            static_friction: def.static_friction,
        });
    }
    Ok(surfaces)
}

fn excluded(file: &RobotFile, link_names: &[&str], refuse: &Refuse<'_>) -> Result<Vec<(usize, usize)>, RobotError> {
    let mut pairs = Vec::new();
    for (row, names) in file.exclude.iter().enumerate() {
        let path = [Step::Key("exclude"), Step::Index(row)];
        if names.len() < 2 {
            return Err(refuse.at(&path, "exclude", "has a row with fewer than two links; name at least two".into()));
        }
        let mut links = Vec::new();
        for (i, name) in names.iter().enumerate() {
            links.push(refuse.find(link_names, name, "link", "exclude", &[path[0], path[1], Step::Index(i)])?);
        }
        for (i, &a) in links.iter().enumerate() {
            pairs.extend(links[i + 1..].iter().map(|&b| (a.min(b), a.max(b))));
        }
    }
    pairs.sort_unstable();
    pairs.dedup();
    Ok(pairs)
}

fn read_posture(file: &RobotFile, robot: &mut Robot, refuse: &Refuse<'_>) -> Result<(), RobotError> {
    let names: Vec<&str> = robot.joints.iter().map(|j| j.name.as_str()).collect();
    for (name, &angle) in &file.posture {
        let path = [Step::Key("posture"), Step::Key(name)];
        let index = refuse.find(&names, name, "joint", "posture", &path)?;
        refuse.follower(&robot.joints, index, "posture", &path)?;
        robot.q0[index] = angle;
    }
    let mut q0 = std::mem::take(&mut robot.q0);
    robot.follow(&mut q0);
    robot.q0 = q0;
    for (joint, &angle) in robot.joints.iter().zip(&robot.q0) {
        if !(joint.lower <= angle && angle <= joint.upper) {
            let problem = format!(
                "puts {} at {angle}, outside its limits {} to {}; change one of them",
                joint.name, joint.lower, joint.upper
            );
            return Err(refuse.at(&[Step::Key("posture"), Step::Key(&joint.name)], "posture", problem));
        }
    }
    Ok(())
}

fn read_sonic(file: &RobotFile, robot: &mut Robot, refuse: &Refuse<'_>) -> Result<(), RobotError> {
    let def = &file.gains.sonic;
    for (key, value) in [("natural_frequency_hz", def.natural_frequency_hz), ("damping_ratio", def.damping_ratio)] {
        if !(0.0..=1e6).contains(&value) {
            let path = [Step::Key("gains"), Step::Key("sonic"), Step::Key(key)];
            return Err(refuse.at(&path, "gains.sonic", format!("has {key} {value}; it must be from 0 to 1e6")));
        }
    }
    let frequency = 2.0 * std::f64::consts::PI * def.natural_frequency_hz;
    let names: Vec<&str> = robot.joints.iter().map(|j| j.name.as_str()).collect();
    for (i, name) in def.joints.iter().enumerate() {
        let path = [Step::Key("gains"), Step::Key("sonic"), Step::Key("joints"), Step::Index(i)];
        let index = refuse.find(&names, name, "joint", "gains.sonic", &path)?;
        refuse.follower(&robot.joints, index, "gains.sonic", &path)?;
        robot.sonic.0[index] = robot.joints[index].gains.tuned(frequency, def.damping_ratio);
    }
    Ok(())
}

/// Compares what the file states about the whole robot with what its parts add up to.
fn check_sums(file: &RobotFile, robot: &Robot, refuse: &Refuse<'_>) -> Result<(), RobotError> {
    let checks = &file.checks;
    let differs =
        |key: &'static str, problem: String| Err(refuse.at(&[Step::Key("checks"), Step::Key(key)], key, problem));
    if checks.joint_count != robot.joints.len() {
        let problem =
            format!("is {}, the file has {} joints; correct one of them", checks.joint_count, robot.joints.len());
        return differs("joint_count", problem);
    }
    let near = |a: f64, b: f64, tolerance: f64| (a - b).abs() <= tolerance;
    let mass = robot.total_mass();
    if !near(mass, checks.total_mass, MASS_TOLERANCE) {
        let problem = format!("is {} kg, the links add up to {mass:.4} kg; correct one of them", checks.total_mass);
        return differs("total_mass", problem);
    }
    let height = robot.standing_height();
    if !near(height, checks.standing_height, HEIGHT_TOLERANCE) {
        let problem = format!(
            "is {} m, the posture and the shapes of the feet make it {height:.4} m; correct one of them",
            checks.standing_height
        );
        return differs("standing_height", problem);
    }
    Ok(())
}
