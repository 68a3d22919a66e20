//! Objects from files.

use fiatlux_dynamics::{Geometry, Hull, Material, ModelError};
use nalgebra::Isometry3;

use super::{Part, bulb, fixture};
use crate::config::{AssetConfig, SceneConfig};
use crate::object::{Object, Role, hull};

/// The pieces of an object in a scene, times a factor.
pub(crate) fn asset(config: &AssetConfig, factor: f64) -> Result<Vec<Part>, ModelError> {
    Ok(pieces(config.hulls(factor)?, config.surface.material()))
}

fn pieces(hulls: Vec<Hull>, material: Material) -> Vec<Part> {
    let part = |(index, hull): (usize, Hull)| Part {
        name: format!("piece_{index}"),
        prop_from_part: Isometry3::identity(),
        geometry: Geometry::Hull(hull.into()),
        material,
    };
    hulls.into_iter().enumerate().map(part).collect()
}

impl Object {
    /// The shapes of a link in the object's frame. A bulb has the plug of the scene's own bulb, a fixture the collar and sleeve of
    /// the scene's own socket.
    ///
    /// # Errors
    /// [`ModelError`] for a piece that is no hull; a checked object has none.
    pub fn parts(&self, link: usize, config: &SceneConfig) -> Result<Vec<Part>, ModelError> {
        let Material { torsion, rolling, .. } = config.surfaces.levers(self.role).material();
        let material = Material { friction: self.friction, torsion, rolling, priority: 0 };
        let corners = self.links[link].pieces.iter().enumerate();
        let hulls = corners.map(|(index, corners)| hull(&format!("piece_{index}"), corners, 1.0));
        let mut parts = pieces(hulls.collect::<Result<_, _>>()?, material);
        match (self.role, &self.scene.bulb) {
            (Role::Bulb, Some(shape)) => {
                let with_plug = config.bulb.with_shape(shape);
                parts.extend(bulb(&with_plug, &config.surfaces));
            }
            (Role::Fixture, _) => {
                // The housing comes first.
                let stock = fixture(&config.fixture, config.bulb.seat_z, &config.surfaces, None);
                parts.extend(stock.into_iter().skip(1));
            }
            _ => {}
        }
        Ok(parts)
    }
}
