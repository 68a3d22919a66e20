//! The file of an object in place of a thing of the room: read, checked, put into each place, and written as a part of the scene.
#![no_main]

use std::fmt::Write as _;

use fiatlux_fuzz::{seeds_wanted, write_seeds};
use fiatlux_world::{Object, SceneConfig};
use libfuzzer_sys::fuzz_target;

const PLACES: [&str; 5] = ["bench", "crate", "fixture", "fresh_bulb", "old_bulb"];

/// An object of one box; `scene` has the numbers that rules read.
fn seed(role: &str, scene: &str) -> Vec<u8> {
    let mut corners = String::new();
    for corner in 0..8 {
        let at = |axis: i32| if corner >> axis & 1 == 0 { -0.1 } else { 0.1 };
        let _ = write!(corners, "[{:?}, {:?}, {:?}], ", at(0), at(1), at(2) + 0.1);
    }
    format!(
        "format = 1\nname = \"thing\"\nrole = \"{role}\"\nfixed = false\nstatic_friction = 1.0\nfriction = 0.9\n\n[[links]]\n\
         name = \"thing\"\nmass = 1.5\ncom = [0.0, 0.0, 0.05]\ninertia = [0.03, 0.06, 0.08, 0.0, 0.0, 0.0]\n\
         pieces = [[{corners}]]\n\n{scene}"
    )
    .into_bytes()
}

const CRATE: &str =
    "[scene.crate]\nouter_half = [0.1, 0.1]\ninterior_half = [0.09, 0.09]\nrim_height = 0.2\nfloor_height = 0.01\n";
const BULB: &str = "[scene.bulb]\nmass = 0.05\naxial_inertia = 3e-5\ntransverse_inertia = 7e-5\ncom_z = 0.12\n\
                    seat_z = 0.036259\noutline = [[0.036259, 0.007], [0.1, 0.03], [0.19, 0.0]]\nlying_height = 0.04\n";

fuzz_target!(init: if let Some((folder, _)) = seeds_wanted() {
    let seeds = [("crate", CRATE), ("bulb", BULB), ("fixture", "")];
    write_seeds(&folder, seeds.map(|(role, scene)| (role.to_owned(), seed(role, scene))));
}, |data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let Ok(object) = Object::from_toml(text) else { return };
    for place in PLACES {
        let Ok(config) = SceneConfig::default().with_asset(place, &object) else { continue };
        let _ = config.check();
        let _ = SceneConfig::from_toml(&config.to_toml());
    }
});
