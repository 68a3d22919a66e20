//! Static parts of a scene, as messages.

use fiatlux_proto::v3;
use fiatlux_world::Scene;

/// The footprints of all that never moves in a scene.
pub fn footprint_messages(scene: &Scene) -> Vec<v3::Footprint> {
    let footprints = scene.footprints().into_iter();
    let message = |footprint: fiatlux_world::Footprint| v3::Footprint {
        name: footprint.name,
        outline: footprint.outline.iter().flat_map(|corner| [corner.x, corner.y]).collect(),
        bottom: footprint.bottom,
        top: footprint.top,
    };
    footprints.map(message).collect()
}
