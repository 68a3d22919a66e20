//! Named frames of a scene, for planners and controllers: those of the robot, and what it steps on, grasps and aims at.

use fiatlux_dynamics::{BodyId, Model, Site};
use fiatlux_rules::{errand, manifest};
use nalgebra::Isometry3;

use crate::Scene;

impl Scene {
    /// All sites by name, robot first ([`Robot::sites`](fiatlux_robot::Robot::sites)); those of missing parts are left out:
    ///
    /// - `ladder_tread_0` (the lowest) to `ladder_tread_3`, `ladder_platform`: middle of the top, z up;
    /// - `ladder_rail_left`, `ladder_rail_right`, `ladder_guard_bar`: middle of the bar, z along it;
    /// - `old_bulb_plug`, `fresh_bulb_plug`: the plug's end, z from the plug to the glass;
    /// - `socket_seat`: where the plug's end rests, z out of the socket.
    pub fn sites(&self) -> Vec<(String, Site)> {
        let mut sites: Vec<(String, Site)> =
            self.robot.sites().into_iter().map(|site| (site.name.clone(), self.robot_ids.site(&site))).collect();
        let parts = ["tread_", "platform", "rail_", "guard_bar"];
        let is_site =
            |name: &str| name.strip_prefix("ladder_").is_some_and(|name| parts.iter().any(|p| name.starts_with(p)));
        sites.extend(shape_sites(&self.model).filter(|(name, _)| is_site(name)));
        for (thing, sizes) in errand::BULBS.into_iter().zip(&self.sizes.bulbs) {
            let name = format!("{}_plug", manifest().things[thing].name);
            let body_from_site = Isometry3::translation(0.0, 0.0, sizes.seat_z);
            sites.extend(self.body(thing).map(|body| (name, Site { body, body_from_site })));
        }
        if self.spec.parts.fixture {
            let body_from_site = self.world_from(errand::FIXTURE) * Isometry3::translation(0.0, 0.0, self.sizes.seat_z);
            sites.push(("socket_seat".into(), Site { body: BodyId::WORLD, body_from_site }));
        }
        sites
    }

    /// The site of that name; for the name of a link of the robot, the link's frame.
    pub fn site(&self, name: &str) -> Option<Site> {
        let named = self.sites().into_iter().find(|(site, _)| site == name).map(|(_, site)| site);
        named.or_else(|| {
            let link = &self.robot_ids.links[self.robot.link_index(name)?];
            Some(Site { body: link.body, body_from_site: link.body_from_link })
        })
    }
}

/// Boxes by the middle of their tops, bars by their middles.
fn shape_sites(model: &Model) -> impl Iterator<Item = (String, Site)> + '_ {
    model.shapes().iter().map(|shape| {
        let up = shape.geometry.as_cuboid().map_or(0.0, |half| half.z);
        let body_from_site = shape.body_from_shape * Isometry3::translation(0.0, 0.0, up);
        (shape.name.clone(), Site { body: shape.body, body_from_site })
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::sync::Arc;

    use fiatlux_dynamics::Mechanics;
    use fiatlux_robot::{GainSet, Robot};

    use super::*;
    use crate::{SceneConfig, SceneKind, SceneSpec};

    /// Sites stand where the scene's own numbers say.
    #[test]
    fn treads_plugs_and_the_seat_are_in_their_places() {
        let robot = Arc::new(Robot::by_name("g1_inspire").unwrap());
        let spec = SceneSpec::new(SceneKind::CoupledLadder, 3, robot.gains(GainSet::default()));
        let scene = Scene::build(&SceneConfig::default(), robot, spec).unwrap();
        let mut mechanics = Mechanics::new(&scene.model);
        mechanics.update(&scene.model, &scene.model.reference_state());
        let place = |name: &str| mechanics.world_from_site(&scene.site(name).unwrap());
        for (tread, height) in scene.config.ladder.tread_heights.iter().enumerate() {
            assert!((place(&format!("ladder_tread_{tread}")).translation.z - height).abs() < 1e-9);
        }
        assert!((place("ladder_platform").translation.z - scene.config.ladder.platform_height).abs() < 1e-9);
        let seat_from_plug = place("socket_seat").inverse() * place("old_bulb_plug");
        let expected = nalgebra::Vector3::z() * scene.config.fixture.stop_height;
        assert!((seat_from_plug.translation.vector - expected).norm() < 1e-9, "{seat_from_plug}");
        let bench = scene.config.bench.surface_height;
        assert!((place("fresh_bulb_plug").translation.z - bench).abs() < 1e-9);

        let names: Vec<String> = scene.sites().into_iter().map(|(name, _)| name).collect();
        assert_eq!(names.len(), 25, "{names:?}");
        assert!((1..names.len()).all(|at| !names[..at].contains(&names[at])), "{names:?}");
        let link = scene.robot.link_index("torso_link").unwrap();
        assert_eq!(scene.site("torso_link").unwrap().body, scene.robot_ids.links[link].body);
        assert_eq!(scene.site("left_horn"), None);
    }
}
