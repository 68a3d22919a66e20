//! The file format of a mapping, and the checks that turn a file into a [`Mapping`].

use fiatlux_robot::Robot;
use fiatlux_robot::lidar::COLUMNS;
use fiatlux_wbc::{BODY, CONTROL_DT, MOVED};
use serde::Deserialize;

use super::{Body, Camera, Key, KeyPart, Mapping, Representation, WAIST};
use crate::hands::{Hands, Side};
use crate::image::Resize;
use crate::{BridgeError, Dialect};

const MAX_ROWS: usize = 400;
const MAX_VALUES: usize = 512;
const MAX_FRAMES: usize = 8;
/// Largest limit of a contact force, N.
const MAX_FORCE: f32 = 1000.0;
/// Allowed width and height of a picture, pixels.
const SIDES: std::ops::RangeInclusive<u32> = 16..=640;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    name: String,
    dialects: Vec<String>,
    #[serde(default = "wbc")]
    body: String,
    #[serde(default)]
    hold_arms: bool,
    #[serde(default)]
    bend_low: bool,
    #[serde(default = "picture")]
    picture: [u32; 2],
    #[serde(default)]
    lidar_sees_room: bool,
    hands: Option<String>,
    horizon: usize,
    prefix: usize,
    #[serde(default = "rate")]
    rate_hz: f64,
    #[serde(default)]
    language: String,
    #[serde(default)]
    action_space: String,
    #[serde(default)]
    camera: Vec<FileCamera>,
    #[serde(default)]
    state: Vec<FileKey>,
    #[serde(default)]
    action: Vec<FileKey>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileCamera {
    key: String,
    sensor: String,
    size: [u32; 2],
    #[serde(default = "exact")]
    resize: String,
    #[serde(default = "present")]
    delta: Vec<i64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileKey {
    key: String,
    parts: Vec<FilePart>,
    representation: Option<String>,
    declared: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct FilePart {
    joints: Option<Vec<String>>,
    group: Option<String>,
    hand: Option<String>,
    grip: Option<String>,
    range: Option<[f64; 2]>,
    wrist: Option<String>,
    term: Option<String>,
    contact: Option<f32>,
    lidar: Option<usize>,
    token: Option<usize>,
    skip: Option<usize>,
}

fn wbc() -> String {
    "wbc".into()
}

fn picture() -> [u32; 2] {
    [640, 480]
}

fn rate() -> f64 {
    1.0 / CONTROL_DT
}

fn exact() -> String {
    "exact".into()
}

fn present() -> Vec<i64> {
    vec![0]
}

/// Parses one file, and names it in errors.
struct Reader<'a> {
    name: &'a str,
    robot: &'a Robot,
    hands: Option<Hands>,
}

pub(super) fn read(name: &str, text: &str, robot: &Robot) -> Result<Mapping, BridgeError> {
    let mut reader = Reader { name, robot, hands: None };
    let file: File = toml::from_str(text).map_err(|error| reader.wrong("file", error.message().to_owned()))?;
    let dialects = file.dialects.iter().map(|dialect| dialect.parse::<Dialect>()).collect::<Result<Vec<_>, _>>();
    let dialects = dialects.map_err(|problem| reader.wrong("dialects", problem))?;
    let body = match file.body.as_str() {
        "wbc" => Body::Wbc,
        "tokens" => Body::Tokens,
        "direct" => Body::Direct,
        other => return Err(reader.wrong("body", format!("'{other}' is not known; use wbc, tokens or direct"))),
    };
    for (field, wants, does) in [("hold_arms", file.hold_arms, "hold arms"), ("bend_low", file.bend_low, "bend low")] {
        if wants && body != Body::Wbc {
            return Err(reader.wrong(field, format!("only body = \"wbc\" can {does}; leave it out")));
        }
    }
    reader.hands = file.hands.as_deref().map(|hands| Hands::open(hands, robot)).transpose()?;
    let name_fits = |char: char| char.is_ascii_alphanumeric() || "_-.".contains(char);
    if file.name.is_empty() || file.name.len() > 64 || !file.name.chars().all(name_fits) {
        return Err(reader.wrong("name", "use 1 to 64 letters, digits, '_', '-' or '.'".into()));
    }
    reader.range("horizon", file.horizon, MAX_ROWS)?;
    reader.range("prefix", file.prefix, file.horizon)?;
    let steps = 1.0 / (file.rate_hz * CONTROL_DT);
    if !(1.0..=50.0).contains(&file.rate_hz) || (steps - steps.round()).abs() > 1e-9 {
        return Err(reader.wrong("rate_hz", format!("{} is not 50 divided by a whole number", file.rate_hz)));
    }
    if !file.picture.iter().all(|side| SIDES.contains(side)) {
        return Err(reader.wrong("picture", format!("use sides of {SIDES:?} pixels")));
    }
    let cameras =
        file.camera.into_iter().map(|camera| reader.camera(camera, file.picture)).collect::<Result<_, _>>()?;
    let states: Vec<Key> = file.state.into_iter().map(|key| reader.key("state", key)).collect::<Result<_, _>>()?;
    let actions: Vec<Key> = file.action.into_iter().map(|key| reader.key("action", key)).collect::<Result<_, _>>()?;
    reader.uses(&actions, body)?;
    let mut parts = states.iter().flat_map(|key| &key.parts);
    if file.lidar_sees_room && !parts.any(|part| matches!(part, KeyPart::Lidar { .. })) {
        return Err(reader.wrong("lidar_sees_room", "no state has a part lidar; leave it out".into()));
    }
    let mapping = Mapping {
        name: file.name,
        dialects,
        body,
        hold_arms: file.hold_arms,
        bend_low: file.bend_low,
        picture: file.picture,
        lidar_sees_room: file.lidar_sees_room,
        horizon: file.horizon,
        prefix: file.prefix,
        rate_hz: file.rate_hz,
        language: file.language,
        action_space: file.action_space,
        cameras,
        states,
        actions,
        hands: reader.hands.clone(),
    };
    for (group, keys) in
        [("camera", mapping.cameras.iter().map(|camera| &camera.key).collect::<Vec<_>>())].into_iter().chain(
            [("state", &mapping.states), ("action", &mapping.actions)]
                .map(|(group, keys)| (group, keys.iter().map(|key| &key.key).collect())),
        )
    {
        if let Some(twice) = keys.iter().enumerate().find(|(at, key)| keys[..*at].contains(key)) {
            return Err(reader.wrong(group, format!("the key '{}' appears twice", twice.1)));
        }
    }
    Ok(mapping)
}

impl Reader<'_> {
    fn wrong(&self, field: &str, problem: String) -> BridgeError {
        BridgeError::Mapping { name: self.name.into(), field: field.into(), problem }
    }

    fn range(&self, field: &str, value: usize, most: usize) -> Result<(), BridgeError> {
        if (1..=most).contains(&value) {
            Ok(())
        } else {
            Err(self.wrong(field, format!("it is {value}; use 1 to {most}")))
        }
    }

    fn camera(&self, camera: FileCamera, picture: [u32; 2]) -> Result<Camera, BridgeError> {
        let field = format!("camera '{}'", camera.key);
        let sensor = match camera.sensor.as_str() {
            "none" => None,
            "camera" | "chest_camera" => Some(camera.sensor.clone()),
            other => {
                let problem = format!("sensor '{other}' is not known; use camera, chest_camera, or none for black");
                return Err(self.wrong(&field, problem));
            }
        };
        let resize = Resize::by_name(&camera.resize).ok_or_else(|| {
            self.wrong(&field, format!("resize '{}' is not known; use exact, stretch, pad or crop", camera.resize))
        })?;
        if !camera.size.iter().all(|side| SIDES.contains(side)) {
            return Err(self.wrong(&field, format!("size: use sides of {SIDES:?} pixels")));
        }
        if resize == Resize::Exact && sensor.is_some() && camera.size != picture {
            let problem = format!("size {:?} is not the picture's {picture:?}; name a resize rule", camera.size);
            return Err(self.wrong(&field, problem));
        }
        let is_ordered = camera.delta.is_sorted() && camera.delta.iter().all(|delta| (-200..=0).contains(delta));
        if !is_ordered || !(1..=MAX_FRAMES).contains(&camera.delta.len()) {
            return Err(self.wrong(&field, format!("delta: use 1 to {MAX_FRAMES} rising numbers from -200 to 0")));
        }
        Ok(Camera { key: camera.key, sensor, size: camera.size, resize, delta: camera.delta })
    }

    fn key(&self, group: &str, key: FileKey) -> Result<Key, BridgeError> {
        let field = format!("{group} '{}'", key.key);
        let is_state = group == "state";
        let named = |given: &Option<String>, otherwise| match given {
            None => Ok(otherwise),
            Some(name) => Representation::by_name(name).ok_or_else(|| {
                self.wrong(&field, format!("representation '{name}' is not known; use absolute, delta or relative"))
            }),
        };
        if is_state && (key.representation.is_some() || key.declared.is_some()) {
            return Err(self.wrong(&field, "a state has no representation; leave it out".into()));
        }
        let representation = named(&key.representation, Representation::Absolute)?;
        let declared = named(&key.declared, representation)?;
        let parts: Vec<KeyPart> = key.parts.iter().map(|part| self.part(&field, part)).collect::<Result<_, _>>()?;
        let width: usize = parts.iter().map(|part| part.width(self.hands.as_ref())).sum();
        self.range(&field, width, MAX_VALUES)?;
        for part in &parts {
            let fits = match part {
                KeyPart::Gravity
                | KeyPart::AngularVelocity
                | KeyPart::LinearVelocity
                | KeyPart::Turned(_)
                | KeyPart::Velocities(_)
                | KeyPart::Contact { .. }
                | KeyPart::Lidar { .. } => is_state,
                KeyPart::Token(_) | KeyPart::Navigate | KeyPart::Torso => !is_state,
                _ => true,
            };
            if !fits {
                return Err(self.wrong(&field, format!("{part:?} does not belong in the {group}")));
            }
            let is_command = matches!(
                part,
                KeyPart::Navigate | KeyPart::Height | KeyPart::Torso | KeyPart::Token(_) | KeyPart::Grip { .. }
            );
            if is_command && representation != Representation::Absolute {
                return Err(self.wrong(&field, format!("{part:?} is always absolute; give it a separate key")));
            }
        }
        Ok(Key { key: key.key, parts, representation, declared })
    }

    fn part(&self, field: &str, part: &FilePart) -> Result<KeyPart, BridgeError> {
        let wrong = |problem: String| self.wrong(field, problem);
        let side = |name: &str| Side::by_name(name).ok_or_else(|| wrong(format!("'{name}' is not left or right")));
        if part.range.is_some() && part.grip.is_none() {
            return Err(wrong("range belongs to grip".into()));
        }
        let joints = |names: Vec<&str>| {
            let find = |name: &str| {
                let found = self.robot.joint_index(name);
                found.ok_or_else(|| wrong(format!("robot {} has no joint '{name}'", self.robot.name())))
            };
            names.into_iter().map(find).collect::<Result<_, _>>().map(KeyPart::Joints)
        };
        match part {
            FilePart { joints: Some(names), .. } if part.count() == 1 => {
                joints(names.iter().map(String::as_str).collect())
            }
            FilePart { group: Some(group), .. } if part.count() == 1 => {
                let names = self.robot.joints().iter().map(|joint| joint.name.as_str());
                if let Some((_, side)) = FINGERS.iter().find(|(known, _)| known == group) {
                    let fingers: Vec<&str> =
                        names.skip(BODY).filter(|name| side.iter().any(|side| name.starts_with(side))).collect();
                    if fingers.is_empty() {
                        return Err(wrong(format!("robot {} has no joints in its {group}", self.robot.name())));
                    }
                    return joints(fingers);
                }
                let members = group_of(group).ok_or_else(|| {
                    let known = GROUPS.iter().map(|(name, _)| *name).chain(FINGERS.map(|(name, _)| name));
                    wrong(format!("group '{group}' is not known; use {}", known.collect::<Vec<_>>().join(", ")))
                })?;
                joints(
                    names.take(BODY).enumerate().filter(|(at, _)| members.contains(at)).map(|(_, name)| name).collect(),
                )
            }
            FilePart { hand: Some(name), .. } if part.count() == 1 => {
                if self.hands.is_none() {
                    return Err(wrong("hand needs a retargeting; name one as 'hands'".into()));
                }
                Ok(KeyPart::Hand(side(name)?))
            }
            FilePart { grip: Some(name), .. } if part.count() == 1 => {
                let [open, closed] = part.range.unwrap_or([0.0, 1.0]);
                if self.hands.is_none() {
                    return Err(wrong("grip needs a retargeting; name one as 'hands'".into()));
                }
                if !(open.is_finite() && closed.is_finite()) || open == closed {
                    return Err(wrong("range needs two different numbers: open and closed".into()));
                }
                Ok(KeyPart::Grip { side: side(name)?, open, closed })
            }
            FilePart { wrist: Some(name), .. } if part.count() == 1 => Ok(KeyPart::Wrist(side(name)?)),
            FilePart { contact: Some(limit), .. } if part.count() == 1 => {
                if !(*limit > 0.0 && *limit <= MAX_FORCE) {
                    return Err(wrong(format!(
                        "contact is {limit}; give a limit of forces above 0, at most {MAX_FORCE} N"
                    )));
                }
                Ok(KeyPart::Contact { width: 3 * self.robot.hand_links().len(), limit: *limit })
            }
            FilePart { lidar: Some(sectors), .. } if part.count() == 1 => {
                if *sectors == 0 || !COLUMNS.is_multiple_of(*sectors) {
                    return Err(wrong(format!("lidar is {sectors}; give a number of sectors that divides {COLUMNS}")));
                }
                Ok(KeyPart::Lidar { sectors: *sectors })
            }
            FilePart { token: Some(width), .. } if part.count() == 1 => Ok(KeyPart::Token(*width)),
            FilePart { skip: Some(width), .. } if part.count() == 1 => Ok(KeyPart::Skip(*width)),
            FilePart { term: Some(term), .. } if part.count() == 1 => match term.as_str() {
                "projected_gravity" => Ok(KeyPart::Gravity),
                "base_angular_velocity" => Ok(KeyPart::AngularVelocity),
                "base_linear_velocity" => Ok(KeyPart::LinearVelocity),
                "joint_position" => Ok(KeyPart::Turned(self.robot.joints().len())),
                "joint_velocity" => Ok(KeyPart::Velocities(self.robot.joints().len())),
                "navigate" => Ok(KeyPart::Navigate),
                "height" => Ok(KeyPart::Height),
                "torso" => Ok(KeyPart::Torso),
                other => {
                    let known = "projected_gravity, base_angular_velocity, base_linear_velocity, joint_position, \
                                 joint_velocity, navigate, height or torso";
                    Err(wrong(format!("term '{other}' is not known; use {known}")))
                }
            },
            _ => Err(wrong(
                "a part needs exactly one of joints, group, hand, grip, wrist, term, contact, lidar, token or skip"
                    .into(),
            )),
        }
    }

    /// Refuses joints with two commands, joints of the whole-body controller, and tokens without a decoder.
    fn uses(&self, actions: &[Key], body: Body) -> Result<(), BridgeError> {
        let mut used = vec![false; self.robot.joints().len()];
        let tokens = actions.iter().flat_map(|key| &key.parts).filter(|part| matches!(part, KeyPart::Token(_))).count();
        match (body, tokens) {
            (Body::Tokens, 1) | (Body::Wbc | Body::Direct, 0) => {}
            (Body::Tokens, _) => {
                return Err(self.wrong("body", format!("tokens needs one token in the actions, which have {tokens}")));
            }
            _ => return Err(self.wrong("body", "the actions have a motion token; set body = \"tokens\"".into())),
        }
        for key in actions {
            for part in &key.parts {
                let field = format!("action '{}'", key.key);
                let joints = match part {
                    KeyPart::Joints(joints) => joints.clone(),
                    KeyPart::Hand(side) | KeyPart::Grip { side, .. } => {
                        self.hands.as_ref().map(|hands| hands.joints(*side)).unwrap_or_default()
                    }
                    KeyPart::Wrist(side) => side.arm().collect(),
                    KeyPart::Navigate | KeyPart::Height | KeyPart::Torso if body != Body::Wbc => {
                        return Err(
                            self.wrong(&field, "it commands the whole-body controller; set body = \"wbc\"".into())
                        );
                    }
                    KeyPart::Torso => WAIST.collect(),
                    _ => Vec::new(),
                };
                for joint in joints {
                    let name = &self.robot.joints()[joint].name;
                    let owner = match body {
                        Body::Wbc if joint < MOVED && !WAIST.contains(&joint) => "the whole-body controller",
                        Body::Tokens if joint < BODY => "the decoder of the tokens",
                        _ => "",
                    };
                    if !owner.is_empty() {
                        let problem = format!("{name} belongs to {owner}; leave it out, or set body = \"direct\"");
                        return Err(self.wrong(&field, problem));
                    }
                    if std::mem::replace(&mut used[joint], true) {
                        return Err(self.wrong(&field, format!("{name} is commanded twice; skip one of the two")));
                    }
                }
            }
        }
        Ok(())
    }
}

impl FilePart {
    fn count(&self) -> usize {
        let Self { joints, group, hand, grip, wrist, term, contact, lidar, token, skip, range: _ } = self;
        let texts = [group, hand, grip, wrist, term].iter().filter(|text| text.is_some()).count();
        let numbers = [lidar, token, skip].iter().filter(|number| number.is_some()).count();
        texts + numbers + usize::from(joints.is_some()) + usize::from(contact.is_some())
    }
}

/// Named groups of consecutive joints; GR00T uses the same names.
const GROUPS: [(&str, std::ops::Range<usize>); 5] =
    [("left_leg", 0..6), ("right_leg", 6..12), ("waist", 12..15), ("left_arm", 15..22), ("right_arm", 22..29)];

/// Groups of the robot's own finger joints, and how the names of these joints begin.
const FINGERS: [(&str, [&str; 2]); 2] = [("left_hand", ["L_", "left_"]), ("right_hand", ["R_", "right_"])];

fn group_of(name: &str) -> Option<std::ops::Range<usize>> {
    GROUPS.iter().find(|(known, _)| *known == name).map(|(_, joints)| joints.clone())
}
