//! Objects as data: the `object.toml` that the Python package's `fiatlux.assets` writes.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use data_encoding::HEXLOWER;
use fiatlux_dynamics::{Hull, MAX_VERTICES, ModelError};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use thiserror::Error;

use crate::SceneError;

/// Version of the format.
const FORMAT: u32 = 1;
/// Largest file, bytes: a header of a bag carries the pieces.
const MAX_BYTES: u64 = 1 << 18;
/// Most links of an object.
const MAX_LINKS: usize = 64;
/// Most convex pieces of a link.
const MAX_PIECES: usize = 64;
/// Masses, kg.
const MASSES: [f64; 2] = [1e-3, 500.0];

/// Places of a scene that take an object, and its role.
pub const ASSET_PLACES: [(&str, Role); 5] = [
    ("bench", Role::Bench),
    ("crate", Role::Crate),
    ("fixture", Role::Fixture),
    ("fresh_bulb", Role::Bulb),
    ("old_bulb", Role::Bulb),
];

/// Why an object is refused.
#[derive(Debug, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum ObjectError {
    #[error("cannot read {path}; name a folder that `python -m fiatlux.assets build` wrote")]
    Read { path: String, source: std::io::Error },
    #[error("{path} has more than {MAX_BYTES} bytes; build the object with a higher --threshold")]
    Size { path: String },
    #[error("object: {reason}; build it anew")]
    Toml { reason: String },
    #[error("object '{name}': {field} {rule}; build it anew")]
    Value { name: String, field: String, rule: String },
    #[error("object '{name}'")]
    Piece { name: String, source: Box<ModelError> },
    #[error("'{place}' takes no object; places are {}", ASSET_PLACES.map(|(name, _)| name).join(", "))]
    Place { place: String },
    #[error("two objects are to be the {place}; name one")]
    Taken { place: String },
    #[error("object '{name}' cannot be the {place}: {reason}")]
    Role { name: String, place: String, reason: String },
    #[error("object '{name}' cannot be the {place}")]
    Scene { name: String, place: String, source: Box<SceneError> },
}

/// An object in place of a thing of the scene, as a command line gives it: `PLACE=DIR`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AssetArg {
    /// The place, such as `crate`.
    pub place: String,
    /// The object's folder, or its `object.toml`.
    pub path: PathBuf,
}

impl FromStr for AssetArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text.split_once('=') {
            Some((place, path)) if ASSET_PLACES.iter().any(|(name, _)| *name == place) && !path.is_empty() => {
                Ok(Self { place: place.into(), path: path.into() })
            }
            _ => Err(format!("use PLACE=DIR, where PLACE is one of {}", ASSET_PLACES.map(|(name, _)| name).join(", "))),
        }
    }
}

/// Role of an object in the room.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Only itself.
    None,
    /// The crate for spent bulbs.
    Crate,
    /// A bulb.
    Bulb,
    /// A step ladder.
    Ladder,
    /// The work bench.
    Bench,
    /// The lamp's socket.
    Fixture,
}

impl Role {
    /// As files name it.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Crate => "crate",
            Self::Bulb => "bulb",
            Self::Ladder => "ladder",
            Self::Bench => "bench",
            Self::Fixture => "fixture",
        }
    }
}

/// An object: links of convex pieces, joints between them, and the numbers of the scene that it brings along.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Object {
    format: u32,
    /// Its name.
    pub name: String,
    /// Its role in the room.
    pub role: Role,
    /// Its root cannot move.
    pub fixed: bool,
    /// Static friction; recorded, not used.
    pub static_friction: f64,
    /// Friction of its surface.
    pub friction: f64,
    /// Its links; each one after the link that its joint hangs on.
    pub links: Vec<Link>,
    /// Numbers of the scene.
    #[serde(default)]
    pub scene: SceneNumbers,
    /// SHA-256 of the text, hexadecimal.
    #[serde(skip)]
    pub digest: String,
}

/// A rigid link, in the object's frame.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Link {
    /// Its name.
    pub name: String,
    /// kg.
    pub mass: f64,
    /// Centre of mass, m.
    pub com: [f64; 3],
    /// About the centre of mass: xx, yy, zz, xy, xz, yz, kg m^2.
    pub inertia: [f64; 6],
    /// Corners of its convex pieces, m.
    pub pieces: Vec<Vec<[f64; 3]>>,
    /// The joint that it hangs on; none for the root.
    pub joint: Option<LinkJoint>,
}

impl Link {
    /// Inertia about the centre of mass, kg m^2.
    pub fn inertia_matrix(&self) -> Matrix3<f64> {
        let [xx, yy, zz, xy, xz, yz] = self.inertia;
        Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
    }

    /// Checks that its mass distribution fits its pieces: the centre of mass between them, moments of a body within them.
    fn check_mass(&self) -> Result<(), (&'static str, String)> {
        let ensure = |ok: bool, field, rule: &str| if ok { Ok(()) } else { Err((field, rule.to_owned())) };
        let finite = self.com.iter().chain(&self.inertia).all(|value| value.is_finite());
        ensure(finite, "inertia", "has a number that is NaN or infinite")?;
        let corners = || self.pieces.iter().flatten();
        for axis in 0..3 {
            let (low, high) = corners().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), corner| {
                (low.min(corner[axis]), high.max(corner[axis]))
            });
            // A bulb's pieces begin above its plug.
            let slack = 0.5 * (high - low) + 0.05;
            let inside = (low - slack..=high + slack).contains(&self.com[axis]);
            ensure(inside, "com", &format!("lies outside of the pieces, which reach from {low} to {high} m"))?;
        }
        let com = Vector3::from(self.com);
        let radius = corners().map(|corner| (Vector3::from(*corner) - com).norm()).fold(0.0, f64::max) + 0.05;
        let moments = self.inertia_matrix().symmetric_eigenvalues();
        let (least, most) = (moments.min(), moments.max());
        ensure(least > 0.0, "inertia", &format!("has a principal moment of {least}; it must be above 0"))?;
        let limit = self.mass * radius * radius;
        ensure(most <= limit, "inertia", &format!("has a moment of {most}; within its pieces it is at most {limit}"))?;
        let others = moments.sum() - most;
        ensure(most <= others * (1.0 + 1e-6), "inertia", "has a moment larger than the sum of the other two")
    }
}

/// Kinds of joints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JointKind {
    /// Turns about an axis.
    Revolute,
    /// Slides along an axis.
    Prismatic,
    /// Does not move.
    Fixed,
}

/// The joint above a link, in the object's frame.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinkJoint {
    /// Its name.
    pub name: String,
    /// The link above.
    pub parent: String,
    /// Kind of its motion.
    pub kind: JointKind,
    /// A point of its axis, m.
    pub anchor: [f64; 3],
    /// Direction of its axis.
    pub axis: [f64; 3],
    /// Lower limit, rad or m; may be minus infinity.
    pub lower: f64,
    /// Upper limit, rad or m; may be infinite.
    pub upper: f64,
}

/// Sections of the scene config that an object brings along.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneNumbers {
    /// Of a crate.
    #[serde(rename = "crate")]
    pub crate_: Option<CrateNumbers>,
    /// Of a bench.
    pub bench: Option<BenchNumbers>,
    /// Of a bulb.
    pub bulb: Option<BulbShape>,
}

/// Sizes of a crate that rules read, m.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)] // As in `CrateConfig`.
pub struct CrateNumbers {
    pub outer_half: [f64; 2],
    pub interior_half: [f64; 2],
    pub rim_height: f64,
    pub floor_height: f64,
}

/// Sizes of a bench that rules read, m.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)] // As in `BenchConfig`.
pub struct BenchNumbers {
    pub surface_height: f64,
    pub footprint_half: [f64; 2],
}

/// Shape of a bulb from a file. Its plug and the balls around its cap are those of the scene's bulb, since the
/// socket fits no other ones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BulbShape {
    /// kg.
    pub mass: f64,
    /// About the axis, kg m^2.
    pub axial_inertia: f64,
    /// About an axis across it through the centre of mass, kg m^2.
    pub transverse_inertia: f64,
    /// Centre of mass on the axis, m.
    pub com_z: f64,
    /// The cap's bottom on the axis, m; that of the scene's bulb.
    pub seat_z: f64,
    /// Outline as (z, radius), ascending in z, m.
    pub outline: Vec<[f64; 2]>,
    /// Height of the axis when the bulb lies on its side, m.
    pub lying_height: f64,
}

/// The hull of corners, times a factor.
///
/// # Errors
/// [`ModelError`] for corners that are no hull.
pub(crate) fn hull(name: &str, corners: &[[f64; 3]], factor: f64) -> Result<Hull, ModelError> {
    let corners: Vec<Vector3<f64>> = corners.iter().map(|corner| Vector3::from(*corner) * factor).collect();
    Hull::new(name, &corners)
}

impl Object {
    /// Reads the `object.toml` of a folder, or a file by its own name.
    ///
    /// # Errors
    /// [`ObjectError`]
    pub fn read(path: &Path) -> Result<Self, ObjectError> {
        let file = if path.is_dir() { path.join("object.toml") } else { path.to_owned() };
        let shown = file.display().to_string();
        Self::from_toml(&fiatlux_files::read_text(&file, MAX_BYTES).map_err(|source| match source.kind() {
            std::io::ErrorKind::FileTooLarge => ObjectError::Size { path: shown.clone() },
            _ => ObjectError::Read { path: shown.clone(), source },
        })?)
    }

    /// Reads and checks an object.
    ///
    /// # Errors
    /// [`ObjectError`]: text that is no object, or a value with which the engine cannot work.
    pub fn from_toml(text: &str) -> Result<Self, ObjectError> {
        let parsed: Result<Self, _> = toml::from_str(text);
        let mut object = parsed.map_err(|error| ObjectError::Toml { reason: error.message().to_owned() })?;
        object.digest = HEXLOWER.encode(&Sha256::digest(text));
        object.check()?;
        Ok(object)
    }

    fn check(&self) -> Result<(), ObjectError> {
        let ensure = |ok: bool, field: &str, rule: String| {
            let error = || ObjectError::Value { name: self.name.clone(), field: field.into(), rule };
            if ok { Ok(()) } else { Err(error()) }
        };
        ensure(self.format == FORMAT, "format", format!("is {}; this version reads {FORMAT}", self.format))?;
        let is_name = |name: &str| {
            (1..=64).contains(&name.len()) && name.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
        };
        ensure(is_name(&self.name), "name", "must be 1 to 64 letters, digits and _".into())?;
        for (field, friction) in [("friction", self.friction), ("static_friction", self.static_friction)] {
            ensure((0.0..=5.0).contains(&friction), field, format!("is {friction}; it must be 0 to 5"))?;
        }
        let count = self.links.len();
        ensure(
            (1..=MAX_LINKS).contains(&count),
            "links",
            format!("has {count} entries; 1 to {MAX_LINKS} are allowed"),
        )?;
        for (index, link) in self.links.iter().enumerate() {
            let field = |what: &str| format!("links[{index}].{what}");
            let before = &self.links[..index];
            ensure(is_name(&link.name), &field("name"), "must be 1 to 64 letters, digits and _".into())?;
            let is_new = before.iter().all(|other| other.name != link.name);
            ensure(is_new, &field("name"), format!("'{}' is the name of another link", link.name))?;
            let mass_fits = (MASSES[0]..=MASSES[1]).contains(&link.mass);
            ensure(
                mass_fits,
                &field("mass"),
                format!("is {}; it must be {} to {} kg", link.mass, MASSES[0], MASSES[1]),
            )?;
            let pieces = link.pieces.len();
            let rule = format!("has {pieces} entries; 1 to {MAX_PIECES} are allowed");
            ensure((1..=MAX_PIECES).contains(&pieces), &field("pieces"), rule)?;
            for (piece, corners) in link.pieces.iter().enumerate() {
                let place = field(&format!("pieces[{piece}]"));
                let few = corners.len() <= MAX_VERTICES;
                ensure(few, &place, format!("has {} corners; the limit is {MAX_VERTICES}", corners.len()))?;
                let near = corners.iter().flatten().all(|at| at.abs() <= 20.0);
                ensure(near, &place, "lies farther than 20 m from the object's origin".into())?;
                hull(&place, corners, 1.0)
                    .map_err(|source| ObjectError::Piece { name: self.name.clone(), source: source.into() })?;
            }
            link.check_mass().map_err(|(what, rule)| ObjectError::Value {
                name: self.name.clone(),
                field: field(what),
                rule,
            })?;
            let Some(joint) = &link.joint else {
                ensure(index == 0, &field("joint"), "is missing; only the first link has none".into())?;
                continue;
            };
            let hangs = index > 0 && before.iter().any(|other| other.name == joint.parent);
            ensure(hangs, &field("joint.parent"), format!("'{}' is not an earlier link", joint.parent))?;
            let length = Vector3::from(joint.axis).norm();
            ensure((length - 1.0).abs() < 1e-6, &field("joint.axis"), format!("has length {length} instead of 1"))?;
            let finite = joint.anchor.iter().all(|value| value.abs() <= 20.0);
            ensure(finite, &field("joint.anchor"), "lies farther than 20 m from the object's origin".into())?;
            let ordered = joint.lower <= joint.upper;
            ensure(ordered, &field("joint"), format!("has limits {} to {}", joint.lower, joint.upper))?;
        }
        if let (Some(shape), [link]) = (&self.scene.bulb, self.links.as_slice()) {
            let [xx, yy, zz, ..] = link.inertia;
            let across = 0.5 * (xx + yy);
            let pairs = [
                ("mass", shape.mass, link.mass),
                ("axial_inertia", shape.axial_inertia, zz.min(1.999 * across)),
                ("transverse_inertia", shape.transverse_inertia, across),
            ];
            for (what, number, of_link) in pairs {
                let equal = (number - of_link).abs() <= 1e-6 * of_link.abs();
                ensure(equal, &format!("scene.bulb.{what}"), format!("is {number}; its link has {of_link}"))?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
