//! Which things a row has besides the robot, and what it measures where they touch: `manifest.toml`, parsed once and checked.

use std::fmt::Write;

use nalgebra::Isometry3;
use serde::Deserialize;
use sha2::{Digest, Sha256};
use thiserror::Error;

use crate::parts::{BodyRow, LIMBS, RobotLayout};

/// Largest number of things, and of contact measures: sets of them are bits.
pub const MAX_PARTS: usize = 64;

/// Distance at which rules see absent things from the origin and from each other, m.
const NOWHERE: f64 = 1000.0;

/// Why a manifest is refused.
#[derive(Debug, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum ManifestError {
    #[error("cannot read the manifest")]
    Toml(#[from] toml::de::Error),
    #[error("{list}, entry '{name}': {problem}")]
    Entry { list: &'static str, name: String, problem: String },
}

/// The parts of a row that do not belong to the robot, in the order of the row.
#[derive(Debug)]
pub struct Manifest {
    /// The things in the room that have a place in the row.
    pub things: Vec<Thing>,
    /// Contact measures, and other numbers of parts.
    pub contacts: Vec<Contact>,
    /// Name and version of the layout of a row, with the first digits of the digest over the manifest: what the digest chain of an
    /// episode starts from.
    pub layout: String,
    forces: Size,
    loads: Size,
    nowhere: Vec<BodyRow>,
}

/// A thing in the room, with its pose in each row.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Thing {
    /// Name, as in messages, scenes and pictures.
    pub name: String,
    /// Free or fixed.
    pub motion: Motion,
    /// The lamp's socket can hold it.
    #[serde(default)]
    pub socket: bool,
}

/// Free or fixed, as the manifest declares it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Motion {
    /// It has a velocity. In some scenes it may be fixed nevertheless.
    Free,
    /// It stays where the scene has it.
    Fixed,
}

/// A force that is measured where two parts touch.
#[derive(Debug, Clone, PartialEq)]
pub struct Contact {
    /// Name, as in differences and Python.
    pub name: String,
    /// The parts on which the force acts, each with its own numbers.
    pub of: Group,
    /// The other side of the contact.
    pub with: Partner,
    /// The quantity.
    pub measure: Measure,
    /// First place in the row's forces or loads.
    first: Size,
}

/// Sensed parts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Group {
    /// The robot as a whole.
    Robot,
    /// Bodies of both hands: the right hand's, then the left hand's.
    HandBodies,
    /// Feet and palms, by [`Limb`](crate::Limb).
    Limbs,
    /// Feet and arms, by [`Support`](crate::Support).
    Supports,
    /// A thing, by index.
    Thing(usize),
}

/// The other side of a measured force.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Partner {
    /// Nothing: the measure is no force.
    Nothing,
    /// The floor.
    Floor,
    /// Everything but the sensed hand bodies.
    Others,
    /// A thing.
    Thing {
        /// Its index.
        thing: usize,
        /// Only its boxes whose top is at this height or above, m, in nominal size.
        boxes_from: Option<f64>,
    },
}

/// The quantity derived from a force, as `manifest.toml` defines it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Measure {
    /// A vector for each part.
    Force,
    /// The largest magnitude of another measure's force, by index.
    ForcePeak(usize),
    /// The mean upward force.
    Load,
    /// The hardest press of one thing.
    PressPeak,
    /// A number that the world computes by itself.
    Number,
}

/// A count that depends on the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Size {
    fixed: usize,
    by_hand_body: usize,
}

impl Size {
    fn of(self, robot: RobotLayout) -> usize {
        self.fixed + self.by_hand_body * robot.hand_bodies()
    }

    fn grow(&mut self, group: Group) {
        match group {
            Group::HandBodies => self.by_hand_body += 1,
            Group::Limbs | Group::Supports => self.fixed += LIMBS,
            Group::Robot | Group::Thing(_) => self.fixed += 1,
        }
    }
}

impl Contact {
    /// Its places in the row's forces or loads.
    pub fn range(&self, robot: RobotLayout) -> std::ops::Range<usize> {
        let mut end = self.first;
        end.grow(self.of);
        self.first.of(robot)..end.of(robot)
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    things: Vec<Thing>,
    contacts: Vec<Entry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    name: String,
    of: String,
    #[serde(default)]
    with: String,
    boxes_from: Option<f64>,
    measure: String,
}

impl Manifest {
    /// Parses and checks a manifest.
    ///
    /// # Errors
    /// [`ManifestError`], with the entry and the field at fault.
    pub fn from_toml(text: &str) -> Result<Self, ManifestError> {
        let File { things, contacts: entries } = toml::from_str(text)?;
        check_names("things", things.iter().map(|thing| &thing.name))?;
        check_names("contacts", entries.iter().map(|entry| &entry.name))?;
        let mut manifest = Self {
            nowhere: (0..things.len()).map(nowhere).collect(),
            things,
            contacts: Vec::new(),
            layout: String::new(),
            forces: Size::default(),
            loads: Size::default(),
        };
        for entry in &entries {
            let contact = manifest.read(entry).map_err(|problem| refuse("contacts", &entry.name, problem))?;
            manifest.contacts.push(contact);
        }
        manifest.layout = manifest.layout_name();
        Ok(manifest)
    }

    fn read(&mut self, entry: &Entry) -> Result<Contact, String> {
        let names = || self.things.iter().map(|thing| thing.name.as_str()).collect::<Vec<_>>().join(", ");
        let of = match entry.of.as_str() {
            "hand_bodies" => Group::HandBodies,
            "limbs" => Group::Limbs,
            "supports" => Group::Supports,
            "robot" => Group::Robot,
            name => Group::Thing(self.thing(name).ok_or_else(|| {
                format!("of is '{name}'; use hand_bodies, limbs, supports, robot or a thing: {}", names())
            })?),
        };
        let with = match entry.with.as_str() {
            "" => Partner::Nothing,
            "floor" => Partner::Floor,
            "others" => Partner::Others,
            name => {
                let thing = self.thing(name);
                let thing =
                    thing.ok_or_else(|| format!("with is '{name}'; use floor, others or a thing: {}", names()))?;
                Partner::Thing { thing, boxes_from: entry.boxes_from }
            }
        };
        if entry.boxes_from.is_some_and(|height| !height.is_finite() || !matches!(with, Partner::Thing { .. })) {
            return Err("boxes_from must be a height, and `with` a thing".into());
        }
        let measure = match entry.measure.as_str() {
            "force" => Measure::Force,
            "load" => Measure::Load,
            "press_peak" => Measure::PressPeak,
            "number" => Measure::Number,
            "force_peak" => {
                let mut forces = self.contacts.iter().enumerate();
                let is_source = |c: &Contact| c.measure == Measure::Force && (c.of, c.with) == (of, with);
                let source = forces.find(|(_, contact)| is_source(contact)).map(|(index, _)| index);
                Measure::ForcePeak(source.ok_or(
                    "measure is force_peak; add an entry before it with the same `of` and `with` and the measure force",
                )?)
            }
            name => return Err(format!("measure is '{name}'; use force, force_peak, load, press_peak or number")),
        };
        if (measure == Measure::Number) != (with == Partner::Nothing) {
            return Err("a measure of a force has `with`, and a number has none; add it, or leave it out".into());
        }
        let size = if measure == Measure::Force { &mut self.forces } else { &mut self.loads };
        let first = *size;
        size.grow(of);
        Ok(Contact { name: entry.name.clone(), of, with, measure, first })
    }

    /// Index of the thing of that name.
    pub fn thing(&self, name: &str) -> Option<usize> {
        self.things.iter().position(|thing| thing.name == name)
    }

    /// Things that the socket can hold, by index, in the order of the row's attachments.
    pub fn held_by_socket(&self) -> impl Iterator<Item = usize> + '_ {
        self.things.iter().enumerate().filter(|(_, thing)| thing.socket).map(|(index, _)| index)
    }

    /// Number of the row's vectors of force.
    pub(crate) fn forces(&self, robot: RobotLayout) -> usize {
        self.forces.of(robot)
    }

    /// Number of the row's other contact measures.
    pub(crate) fn loads(&self, robot: RobotLayout) -> usize {
        self.loads.of(robot)
    }

    /// Where rules see an absent thing: upright and at rest, far from the robot and from all other absent things, so that no
    /// criterion that needs it holds and no condition ends an episode.
    pub(crate) fn nowhere(&self, thing: usize) -> &BodyRow {
        &self.nowhere[thing]
    }

    fn layout_name(&self) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        for Thing { name, motion, socket } in &self.things {
            let _ = writeln!(text, "thing {name} {motion:?} {socket}");
        }
        for Contact { name, of, with, measure, .. } in &self.contacts {
            let _ = writeln!(text, "contact {name} {of:?} {with:?} {measure:?}");
        }
        let digest = Sha256::digest(text);
        let digits: String = digest.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
        format!("fiatlux-row/5 {digits}")
    }
}

fn nowhere(thing: usize) -> BodyRow {
    BodyRow::at_rest(Isometry3::translation(NOWHERE * (thing + 1) as f64, 0.0, NOWHERE))
}

fn refuse(list: &'static str, name: &str, problem: impl Into<String>) -> ManifestError {
    ManifestError::Entry { list, name: name.into(), problem: problem.into() }
}

fn check_names<'a>(list: &'static str, names: impl Iterator<Item = &'a String>) -> Result<(), ManifestError> {
    let mut seen: Vec<&str> = Vec::new();
    for name in names {
        let is_plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_' || c == '.';
        if name.is_empty() || !name.chars().all(is_plain) {
            return Err(refuse(list, name, "name must have lower-case letters, digits and underscores"));
        }
        if seen.contains(&name.as_str()) {
            return Err(refuse(list, name, "name is taken by an earlier entry; choose another one"));
        }
        seen.push(name);
    }
    if seen.len() > MAX_PARTS {
        return Err(refuse(list, seen[MAX_PARTS], format!("there are more than {MAX_PARTS} entries; remove some")));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A number is one of the loads, and another layout.
    #[test]
    fn numbers_are_no_contacts() {
        let with = |entry: &str| Manifest::from_toml(&format!("{THING}\ncontacts = [{entry}]"));
        let floor = r#"{ name = "floor_load", of = "limbs", with = "floor", measure = "load" },"#;
        let [bare, full] = ["", r#"{ name = "power", of = "robot", measure = "number" }"#]
            .map(|number| with(&format!("{floor} {number}")).expect("a manifest"));
        let robot = RobotLayout { joints: 29, hand_bodies_per_side: 3 };
        assert_eq!((full.contacts[1].range(robot), full.loads(robot), full.forces(robot)), (4..5, 5, 0));
        assert_ne!(full.layout, bare.layout);
        for entry in [
            r#"{ name = "power", of = "robot", with = "floor", measure = "number" }"#,
            r#"{ name = "power", of = "robot", measure = "load" }"#,
        ] {
            let error = with(entry).expect_err("a refusal").to_string();
            assert!(error.contains("entry 'power': a measure of a force has `with`"), "{error}");
        }
    }

    const THING: &str = r#"things = [{ name = "ladder", motion = "free" }]"#;

    #[test]
    fn refusals_name_the_entry_and_the_remedy() {
        let contact = |fields: &str| format!("{THING}\ncontacts = [{{ name = \"c\", {fields} }}]");
        for (text, expected) in [
            (
                contact(r#"of = "feet", with = "floor", measure = "force""#),
                "contacts, entry 'c': of is 'feet'; use hand_bodies",
            ),
            (
                contact(r#"of = "limbs", with = "wall", measure = "force""#),
                "with is 'wall'; use floor, others or a thing: ladder",
            ),
            (contact(r#"of = "limbs", with = "floor", measure = "heat""#), "measure is 'heat'; use force"),
            (contact(r#"of = "limbs", with = "floor", measure = "force_peak""#), "add an entry before it"),
            (
                contact(r#"of = "limbs", with = "floor", boxes_from = 0.1, measure = "load""#),
                "boxes_from must be a height",
            ),
            (
                r#"things = [{ name = "Ladder", motion = "free" }]
                contacts = []"#
                    .into(),
                "things, entry 'Ladder': name must have lower-case letters",
            ),
            (
                r#"things = [{ name = "a", motion = "free" }, { name = "a", motion = "fixed" }]
                contacts = []"#
                    .into(),
                "things, entry 'a': name is taken",
            ),
        ] {
            let error = Manifest::from_toml(&text).expect_err("refused").to_string();
            assert!(error.contains(expected), "{error}");
        }
        assert!(matches!(Manifest::from_toml("things = 1"), Err(ManifestError::Toml(_))));
    }

    #[test]
    fn measures_follow_each_other_without_gaps() {
        let robot = RobotLayout { joints: 29, hand_bodies_per_side: 3 };
        let manifest = crate::errand::manifest();
        let (mut forces, mut loads) = (0, 0);
        for contact in &manifest.contacts {
            let end = if contact.measure == Measure::Force { &mut forces } else { &mut loads };
            let range = contact.range(robot);
            assert_eq!(range.start, *end, "{}", contact.name);
            *end = range.end;
        }
        assert_eq!((forces, loads), (manifest.forces(robot), manifest.loads(robot)));
    }
}
