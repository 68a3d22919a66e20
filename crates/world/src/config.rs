//! Every number of the scene. `scene.toml` holds the published values with their sources and the meaning of each field.

mod asset;
mod asset_check;
mod check;
mod parts;
mod rule;

use std::collections::BTreeMap;

use data_encoding::HEXLOWER;
use fiatlux_rules::manifest;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use toml::de::{DeTable, DeValue};

pub use asset::AssetConfig;
pub use parts::{
    AttachmentConfig, BenchConfig, BulbConfig, CarryConfig, ClimbConfig, CrateConfig, FixtureConfig, LadderConfig,
    LayoutConfig, RobotStartConfig, RoomConfig, StartConfig, StartNoise, Surface, Surfaces, ThingAnchor, ThingConfig,
};

use crate::SceneError;

/// The published scene, as text that a person can read and copy from.
pub const PUBLISHED_SCENE: &str = include_str!("../scene.toml");

/// All numbers of a scene. Units are SI and radians.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneConfig {
    /// Floor, walls and ceiling.
    pub room: RoomConfig,
    /// Work bench with tray.
    pub bench: BenchConfig,
    /// Crate that the spent bulb is thrown into.
    #[serde(rename = "crate")]
    pub crate_: CrateConfig,
    /// Lamp socket and its mount.
    pub fixture: FixtureConfig,
    /// Shape, mass and inertia of both bulbs, which are alike.
    pub bulb: BulbConfig,
    /// Step ladder with its treads, platform and guard rail.
    pub ladder: LadderConfig,
    /// The socket's hold on a bulb.
    pub attachment: AttachmentConfig,
    /// Friction of all surfaces but the robot's.
    pub surfaces: Surfaces,
    /// Draw of the room.
    pub layout: LayoutConfig,
    /// The fixed scene of `climb`.
    pub climb: ClimbConfig,
    /// Where the robot starts.
    pub robot: RobotStartConfig,
    /// Start states of the tasks.
    pub start: StartConfig,
    /// Things of the manifest that have no section of their own, by name; they are where there is furniture.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub things: BTreeMap<String, ThingConfig>,
    /// Objects from files in place of the scene's own things, by place ([`ASSET_PLACES`](crate::ASSET_PLACES)).
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub assets: BTreeMap<String, AssetConfig>,
}

impl Default for SceneConfig {
    fn default() -> Self {
        Self::from_toml("").expect("the embedded scene is valid")
    }
}

impl SceneConfig {
    /// Parses and checks a config. Fields that the text omits keep their published values.
    ///
    /// # Errors
    /// [`SceneError::Toml`] if the text cannot be parsed or a field does not exist, [`SceneError::Value`] for the first
    /// invalid value.
    pub fn from_toml(text: &str) -> Result<Self, SceneError> {
        let mut merged = DeTable::parse(PUBLISHED_SCENE).map_err(|e| toml_error(PUBLISHED_SCENE, &e))?;
        let changes = DeTable::parse(text).map_err(|e| toml_error(text, &e))?.into_inner();
        // Every value keeps its place in the text it came from; only values from `text` can be at fault.
        merge(merged.get_mut(), changes.clone());
        let config = Self::deserialize(toml::de::Deserializer::from(merged)).map_err(|e| toml_error(text, &e))?;
        match config.check() {
            Err(SceneError::Value { field, value, rule, .. }) => {
                Err(SceneError::Value { field, line: line_of(text, &changes, field), value, rule })
            }
            result => result.map(|()| config),
        }
    }

    /// All numbers as TOML, which [`SceneConfig::from_toml`] reads back.
    pub fn to_toml(&self) -> String {
        // A struct of numbers, texts and lists always has a form in TOML.
        toml::to_string(self).unwrap_or_default()
    }

    /// SHA-256 of the config as TOML with every value written out, hexadecimal.
    pub fn digest(&self) -> String {
        HEXLOWER.encode(&Sha256::digest(self.to_toml()))
    }

    /// Those of [`SceneConfig::things`] in the order of the manifest; `None` for what has a section of its own.
    pub(crate) fn thing_configs(&self) -> impl Iterator<Item = Option<&ThingConfig>> {
        manifest().things.iter().map(|thing| self.things.get(&thing.name))
    }

    /// Checks that the numbers make a scene. Needed only after changing a config in place; [`SceneConfig::from_toml`]
    /// checks too.
    ///
    /// # Errors
    /// [`SceneError::Value`] for the first value at fault.
    pub fn check(&self) -> Result<(), SceneError> {
        check::check(self)
    }
}

fn toml_error(text: &str, error: &toml::de::Error) -> SceneError {
    let line = error.span().map(|span| line_at(text, span.start));
    let quoted = line.and_then(|line| text.lines().nth(line - 1)).unwrap_or_default();
    SceneError::Toml { line, reason: format!("{} in `{}`", error.message(), quoted.trim()) }
}

fn merge<'a>(base: &mut DeTable<'a>, changes: DeTable<'a>) {
    for (key, value) in changes {
        if let DeValue::Table(_) = value.get_ref()
            && let Some(old) = base.get_mut(key.get_ref().as_ref())
            && let DeValue::Table(old_table) = old.get_mut()
        {
            if let DeValue::Table(new_table) = value.into_inner() {
                merge(old_table, new_table);
            }
        } else {
            base.insert(key, value);
        }
    }
}

fn line_of(text: &str, table: &DeTable<'_>, field: &str) -> Option<usize> {
    let mut keys = field.split('.');
    let mut value = table.get(keys.next()?)?;
    for key in keys {
        value = value.get_ref().get(key)?;
    }
    Some(line_at(text, value.span().start))
}

fn line_at(text: &str, offset: usize) -> usize {
    1 + text.bytes().take(offset).filter(|&b| b == b'\n').count()
}

#[cfg(test)]
mod tests;
