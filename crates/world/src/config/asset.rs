//! Objects from files in place of the scene's own things.

use std::collections::BTreeMap;

use fiatlux_dynamics::{Hull, ModelError};
use serde::{Deserialize, Serialize};

use super::{BenchConfig, BulbConfig, CrateConfig, SceneConfig, Surface};
use crate::object::{ASSET_PLACES, AssetArg, BenchNumbers, BulbShape, CrateNumbers, Object, ObjectError, Role, hull};

/// `[assets.PLACE]`: the shapes of an object that stands in for a thing of the scene. The numbers of crate and bench are in
/// the scene's own sections.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AssetConfig {
    /// The object's own name.
    pub name: String,
    /// SHA-256 of its `object.toml`, hexadecimal.
    pub digest: String,
    /// Friction of its surface.
    pub surface: Surface,
    /// Size and mass of a bulb.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bulb: Option<BulbShape>,
    /// Corners of its convex pieces in the frame of the thing, m.
    pub pieces: Vec<Vec<[f64; 3]>>,
}

impl BulbConfig {
    /// A bulb of another shape, with the plug of this one: it looks no thicker there than what collides.
    pub(crate) fn with_shape(&self, shape: &BulbShape) -> Self {
        let mut outline = shape.outline.clone();
        if let Some([_, end, radius]) = self.solids.first() {
            let is_plug = |z: f64| z - shape.seat_z <= end - self.seat_z;
            outline.iter_mut().filter(|point| is_plug(point[0])).for_each(|point| point[1] = point[1].min(*radius));
        }
        Self {
            mass: shape.mass,
            axial_inertia: shape.axial_inertia,
            transverse_inertia: shape.transverse_inertia,
            com_z: shape.com_z,
            seat_z: shape.seat_z,
            outline,
            solids: self.solids[..1].to_vec(),
            lying_height: shape.lying_height,
            ..self.clone()
        }
    }
}

/// A bulb that a start state puts into the crate has its cap this far above the floor there, m.
const PLACING_GAP: f64 = 0.05;

impl CrateNumbers {
    fn in_config(&self, of: &CrateConfig) -> CrateConfig {
        CrateConfig {
            outer_half: self.outer_half,
            interior_half: self.interior_half,
            rim_height: self.rim_height,
            floor_height: self.floor_height,
            placing_height: of.placing_height.max(self.floor_height + PLACING_GAP),
        }
    }
}

impl BenchNumbers {
    fn in_config(&self, of: &BenchConfig) -> BenchConfig {
        BenchConfig {
            surface_height: self.surface_height,
            frame_height: self.surface_height - (of.surface_height - of.frame_height),
            footprint_half: self.footprint_half,
            slab_half: self.footprint_half,
            ..of.clone()
        }
    }
}

impl AssetConfig {
    /// Its pieces, times a factor.
    ///
    /// # Errors
    /// [`ModelError`] for a piece that is no hull; [`SceneConfig::check`] refuses it before.
    pub(crate) fn hulls(&self, factor: f64) -> Result<Vec<Hull>, ModelError> {
        let pieces = self.pieces.iter().enumerate();
        pieces.map(|(index, corners)| hull(&format!("piece_{index}"), corners, factor)).collect()
    }
}

impl SceneConfig {
    /// The config with an object in place of a thing of the scene.
    ///
    /// # Errors
    /// [`ObjectError`]: an unknown place, an object of another role, or one that makes no scene.
    pub fn with_asset(mut self, place: &str, object: &Object) -> Result<Self, ObjectError> {
        let Some((_, role)) = ASSET_PLACES.into_iter().find(|(name, _)| *name == place) else {
            return Err(ObjectError::Place { place: place.into() });
        };
        let refuse = |reason: String| ObjectError::Role { name: object.name.clone(), place: place.into(), reason };
        if object.role != role {
            return Err(refuse(format!("its role is {}; build it with --role {}", object.role.name(), role.name())));
        }
        let [link] = object.links.as_slice() else {
            return Err(refuse(format!("it has {} links; a thing of the room has one", object.links.len())));
        };
        let numbers = &object.scene;
        let missing = || refuse(format!("its file has no [scene.{}]; build it anew", role.name()));
        match role {
            Role::Crate => {
                let own = numbers.crate_.as_ref().ok_or_else(missing)?;
                self.crate_ = own.in_config(&self.crate_);
            }
            Role::Bench => {
                let own = numbers.bench.as_ref().ok_or_else(missing)?;
                self.bench = own.in_config(&self.bench);
            }
            Role::Bulb => _ = numbers.bulb.as_ref().ok_or_else(missing)?,
            Role::Fixture | Role::Ladder | Role::None => {}
        }
        let levers = self.surfaces.levers(role);
        let asset = AssetConfig {
            name: object.name.clone(),
            digest: object.digest.clone(),
            surface: Surface {
                static_friction: object.static_friction,
                friction: object.friction,
                priority: 0,
                torsion: levers.torsion,
                rolling: levers.rolling,
            },
            bulb: numbers.bulb.clone().filter(|_| role == Role::Bulb),
            pieces: link.pieces.clone(),
        };
        self.assets.insert(place.into(), asset);
        self.check().map_err(|source| ObjectError::Scene {
            name: object.name.clone(),
            place: place.into(),
            source: source.into(),
        })?;
        Ok(self)
    }

    /// The config with objects from folders.
    ///
    /// # Errors
    /// [`ObjectError`]; a place that two objects take.
    pub fn with_assets(self, assets: &[AssetArg]) -> Result<Self, ObjectError> {
        assets.iter().try_fold(self, |config, AssetArg { place, path }| {
            if config.assets.contains_key(place) {
                return Err(ObjectError::Taken { place: place.clone() });
            }
            config.with_asset(place, &Object::read(path)?)
        })
    }

    /// The object in a place, if it is not the scene's own thing.
    pub fn asset(&self, place: &str) -> Option<&AssetConfig> {
        self.assets.get(place)
    }

    /// Digest of the config without its objects and without the numbers that came with them; none if it has no objects. A
    /// number that does not come from an object stays, and shows in the digest.
    pub fn base_digest(&self) -> Option<String> {
        if self.assets.is_empty() {
            return None;
        }
        let mut base = Self { assets: BTreeMap::new(), ..self.clone() };
        let published = Self::default();
        if self.assets.contains_key("crate") {
            let crate_ = CrateNumbers {
                outer_half: self.crate_.outer_half,
                interior_half: self.crate_.interior_half,
                rim_height: self.crate_.rim_height,
                floor_height: self.crate_.floor_height,
            };
            if crate_.in_config(&published.crate_) == self.crate_ {
                base.crate_ = published.crate_;
            }
        }
        if self.assets.contains_key("bench") {
            let (surface_height, footprint_half) = (self.bench.surface_height, self.bench.footprint_half);
            if (BenchNumbers { surface_height, footprint_half }).in_config(&published.bench) == self.bench {
                base.bench = published.bench;
            }
        }
        Some(base.digest())
    }
}
