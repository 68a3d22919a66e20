//! Parameters of the experts by hand: a file for each task and hand, in which a hand's file names another one as its base.

use fiatlux_client::PolicyError;
use fiatlux_proto::v3::SessionInfo;
use fiatlux_robot::Robot;
use fiatlux_skills::grip::{Angles, grasp_of};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use thiserror::Error;
use toml::{Table, Value};

use super::side::Side;

// `PARAMETERS`: name and text of each file of parameters; the build script writes the list.
include!(concat!(env!("OUT_DIR"), "/parameters.rs"));

/// A file of parameters: the values in which it differs from its base.
#[derive(Debug, Deserialize)]
struct Layer {
    /// Name of the file that it begins from.
    base: Option<String>,
    /// Values and tables of the base that are left out, such as `close.open`.
    #[serde(default)]
    without: Vec<String>,
    #[serde(flatten)]
    values: Table,
}

/// A file of parameters cannot be used.
#[derive(Debug, Error)]
enum LayerError {
    #[error("base = \"{0}\" is no file of parameters; use one of {known}", known = known())]
    Base(String),
    #[error("without names '{0}', which the base lacks; take it out of the list")]
    Without(String),
    #[error(transparent)]
    Toml(#[from] toml::de::Error),
}

/// Parameters of a skill: those of its file for the session's robot and the hand that works, but for those given. Joints that its grips leave out are as
/// in the robot's grasp of a bulb.
///
/// # Errors
/// They cannot be read, or there are none for the hands of this robot.
pub(super) fn parameters<P: DeserializeOwned>(
    given: Option<&str>,
    skill: &str,
    side: Side,
    info: &SessionInfo,
    grips: impl Fn(&mut P) -> Vec<&mut Angles>,
) -> Result<P, PolicyError> {
    let joints = &info.joints;
    let robot = robot_of(info);
    let own = robot.as_ref().and_then(|robot| {
        let of_robot = if robot.name() == Robot::NAMES[0] { String::new() } else { format!(".{}", robot.name()) };
        let of_side = if side == Side::Left { ".left" } else { "" };
        text_of(&format!("{skill}{of_robot}{of_side}"))
    });
    let is_known = |name: &String| joints.iter().any(|joint| joint.name == *name);
    let mut table = None;
    for text in [own, given].into_iter().flatten() {
        table = Some(layered(table, text).map_err(PolicyError::of("hands"))?);
    }
    let params: Option<P> = table.map(Table::try_into).transpose().map_err(PolicyError::of("hands"))?;
    let grasp = robot.as_ref().map(|robot| grasp_of(robot, side as usize)).unwrap_or_default();
    let completed = |mut params: P| {
        let are_known = grips(&mut params).into_iter().all(|grip| {
            for (name, angle) in &grasp {
                grip.entry(name.clone()).or_insert(*angle);
            }
            grip.keys().all(is_known)
        });
        are_known.then_some(params)
    };
    params.and_then(completed).ok_or_else(|| {
        let known = Robot::NAMES[0];
        let reason = format!("it has no parameters of this task for the robot's hands; use {known}");
        PolicyError::Unfit { policy: "hands", reason }
    })
}

/// Names of the files.
fn known() -> String {
    PARAMETERS.map(|(name, _)| name).join(", ")
}

/// The robot of a session, also of one that does not name it.
fn robot_of(info: &SessionInfo) -> Option<Robot> {
    Robot::of_session(&info.robot, info.joints.iter().map(|joint| joint.name.as_str())).ok()
}

/// Parameters that each robot has: those of the skill's file for the session's robot, else those of the skill.
///
/// # Errors
/// They cannot be read.
pub(crate) fn of_robot<P: DeserializeOwned>(skill: &'static str, info: &SessionInfo) -> Result<P, PolicyError> {
    let own = robot_of(info).and_then(|robot| text_of(&format!("{skill}.{}", robot.name())));
    let text = own.or_else(|| text_of(skill)).unwrap_or_default();
    let table = layered(None, text).map_err(PolicyError::of(skill))?;
    table.try_into().map_err(PolicyError::of(skill))
}

fn text_of(name: &str) -> Option<&'static str> {
    PARAMETERS.into_iter().find(|(known, _)| *known == name).map(|(_, text)| text)
}

/// The values of a file over those of its base; without one, over a table that is there already.
fn layered(under: Option<Table>, text: &str) -> Result<Table, LayerError> {
    let Layer { base, without, values } = toml::from_str(text)?;
    let mut under = match base {
        Some(name) => {
            let text = text_of(&name).ok_or(LayerError::Base(name))?;
            layered(None, text)?
        }
        None => under.unwrap_or_default(),
    };
    for path in without {
        if !has_taken(&mut under, &path) {
            return Err(LayerError::Without(path));
        }
    }
    Ok(changed(under, values))
}

/// Takes a value out of a table, by the names of the tables around it; false where it is not there.
fn has_taken(table: &mut Table, path: &str) -> bool {
    match path.split_once('.') {
        None => table.remove(path).is_some(),
        Some((outer, path)) => {
            table.get_mut(outer).and_then(Value::as_table_mut).is_some_and(|inner| has_taken(inner, path))
        }
    }
}

/// A table with the values of another one in place of its own; tables in both are changed in turn.
fn changed(mut own: Table, given: Table) -> Table {
    for (name, value) in given {
        let value = match (own.remove(&name), value) {
            (Some(Value::Table(own)), Value::Table(given)) => Value::Table(changed(own, given)),
            (_, value) => value,
        };
        own.insert(name, value);
    }
    own
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::walk::GRAB;

    fn of(name: &str) -> Table {
        layered(None, text_of(name).expect("a file")).expect("parameters")
    }

    /// Paths and values that are not tables.
    fn values(table: &Table, path: &str, all: &mut Vec<(String, Value)>) {
        for (name, value) in table {
            let path = format!("{path}.{name}");
            match value {
                Value::Table(inner) => values(inner, &path, all),
                value => all.push((path, value.clone())),
            }
        }
    }

    /// Guards that S07 ends where S08 then steps to.
    #[test]
    fn the_bulb_is_taken_from_where_the_hand_takes_it() {
        for name in ["grab", "grab.g1_dex3", "grab.g1_inspire6"] {
            let stand = ["ahead", "left"].map(|key| of(name)["stand"][key].as_float());
            assert_eq!(stand, GRAB.map(Some));
        }
    }

    /// A bulb is carried on as the starts have it in the hand, and each hand carries it where it took it.
    #[test]
    fn numbers_of_other_files_are_theirs() {
        let scene: Table = include_str!("../../../world/scene.toml").parse().expect("TOML");
        let carry = &scene["start"]["carry"];
        let joints =
            ["shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll", "wrist_pitch", "wrist_yaw"];
        let arm = joints.map(|joint| {
            let name = format!("right_{joint}_joint");
            let own = carry["platform_arm"].get(&name).or_else(|| carry["arm"].get(&name));
            own.cloned().unwrap_or(Value::from(0.0))
        });
        assert_eq!(of("remove")["leave"]["arm"].as_array().expect("an arm"), &arm);
        for hand in ["", ".g1_dex3", ".g1_inspire6"] {
            let glass = |skill: &str| of(&format!("{skill}{hand}"))["grasp"]["hand_from_glass"].clone();
            assert_eq!(glass("place"), glass("grab"));
        }
    }

    #[test]
    fn a_hands_file_has_a_base_and_repeats_nothing_of_it() {
        let mut number = 0;
        for (name, text) in PARAMETERS.into_iter().filter(|(name, _)| name.contains('.')) {
            let Layer { base, without, values: own } = toml::from_str(text).expect("a layer");
            let mut base: Table = toml::from_str(text_of(&base.expect("a base")).expect("a file")).expect("TOML");
            assert!(!base.contains_key("base"), "{name}: a base has no base");
            assert!(without.iter().all(|path| has_taken(&mut base, path)), "{name}");
            let (mut of_base, mut of_hand) = (Vec::new(), Vec::new());
            values(&base, "", &mut of_base);
            values(&own, "", &mut of_hand);
            let repeated: Vec<_> = of_hand.iter().filter(|value| of_base.contains(value)).collect();
            assert!(!of_hand.is_empty() && repeated.is_empty(), "{name} repeats {repeated:?}");
            number += 1;
        }
        assert_eq!(number, 10);
    }

    #[test]
    fn a_layer_changes_takes_out_and_adds() {
        let under = toml::from_str("[a]\nx = 1.0\ny = 2.0\n[a.b]\nz = 3.0\n[c]\nv = 4.0").expect("TOML");
        let layer = "without = ['a.b', 'c']\n[a]\ny = 5\n[a.b]\nw = 6.0";
        let expected: Table = toml::from_str("[a]\nx = 1.0\ny = 5\n[a.b]\nw = 6.0").expect("TOML");
        assert_eq!(layered(Some(under), layer).expect("parameters"), expected);
    }

    /// A base takes the place of the robot's own file, so that a hand's file can be given, and a file that begins from it.
    #[test]
    fn a_given_base_counts_and_not_the_robots_file() {
        let mut expected = of("insert.g1_dex3");
        expected["open"]["time"] = Value::from(2.0);
        let text = "base = 'insert.g1_dex3'\nopen.time = 2.0";
        assert_eq!(layered(Some(of("insert")), text).expect("parameters"), expected);
        let text = text_of("insert.g1_dex3").expect("a file");
        for own in ["insert", "insert.g1_dex3", "grab"] {
            assert_eq!(layered(Some(of(own)), text).expect("parameters"), of("insert.g1_dex3"));
        }
    }

    #[test]
    fn what_cannot_be_is_refused_by_name() {
        for (text, part) in [
            (
                "base = 'place.g2'",
                "base = \"place.g2\" is no file of parameters; use one of grab.g1_dex3, grab.g1_inspire6, grab, insert",
            ),
            ("without = ['open.shut']", "without names 'open.shut', which the base lacks"),
            ("without = ['open.time.now']", "without names 'open.time.now'"),
            ("without = ['']", "without names ''"),
            ("base = 1", "invalid type: integer `1`"),
            ("without = 'open'", "invalid type: string"),
            ("x = ", "TOML parse error"),
        ] {
            let error = layered(Some(of("insert")), text).expect_err(text).to_string();
            assert!(error.contains(part), "{text}: {error}");
        }
    }
}
