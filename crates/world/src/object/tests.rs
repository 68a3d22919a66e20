#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{Bulb, errand};

use super::*;
use crate::{Scene, SceneConfig, SceneKind, SceneSpec};

/// A box as a list of its corners.
fn cuboid(low: [f64; 3], high: [f64; 3]) -> String {
    let corner = |k: usize| {
        let at = |axis: usize| if k >> axis & 1 == 0 { low[axis] } else { high[axis] };
        format!("[{:?}, {:?}, {:?}]", at(0), at(1), at(2))
    };
    format!("[{}]", (0..8).map(corner).collect::<Vec<_>>().join(", "))
}

fn object(role: &str, pieces: &[String], scene: &str) -> String {
    format!(
        "format = 1\nname = \"thing\"\nrole = \"{role}\"\nfixed = false\nstatic_friction = 1.0\nfriction = 0.9\n\n[[links]]\nname = \"thing\"\nmass = 1.5\ncom = [0.0, 0.0, 0.05]\ninertia = [0.03, 0.06, 0.08, 0.0, 0.0, 0.0]\npieces = [{}]\n\n{scene}",
        pieces.join(", ")
    )
}

/// A crate of 0.5 x 0.4 x 0.2 m with walls of 2 cm and a floor of 1 cm.
fn crate_text() -> String {
    let pieces = [
        cuboid([-0.25, -0.2, 0.0], [0.25, 0.2, 0.01]),
        cuboid([-0.25, -0.2, 0.01], [-0.23, 0.2, 0.2]),
        cuboid([0.23, -0.2, 0.01], [0.25, 0.2, 0.2]),
        cuboid([-0.23, -0.2, 0.01], [0.23, -0.18, 0.2]),
        cuboid([-0.23, 0.18, 0.01], [0.23, 0.2, 0.2]),
    ];
    let numbers = "[scene.crate]\nouter_half = [0.25, 0.2]\ninterior_half = [0.23, 0.18]\nrim_height = 0.2\nfloor_height = 0.01\n";
    object("crate", &pieces, numbers)
}

fn bulb() -> String {
    let numbers = "[scene.bulb]\nmass = 0.05\naxial_inertia = 3e-5\ntransverse_inertia = 7e-5\ncom_z = 0.12\nseat_z = 0.036259\noutline = [[0.036259, 0.007], [0.1, 0.03], [0.19, 0.0]]\nlying_height = 0.04\n";
    object("bulb", &[cuboid([-0.03, -0.03, 0.08], [0.03, 0.03, 0.19])], numbers)
}

fn scene(config: &SceneConfig) -> Scene {
    let robot = Arc::new(Robot::by_name("g1_inspire").unwrap());
    let spec = SceneSpec::new(SceneKind::CoupledLadder, 3, robot.gains(GainSet::default()));
    Scene::build(config, robot, spec).unwrap()
}

#[test]
fn a_crate_from_a_file_has_its_own_shapes_and_numbers() {
    let config = SceneConfig::default().with_asset("crate", &Object::from_toml(&crate_text()).unwrap()).unwrap();
    let scene = scene(&config);
    let names: Vec<&str> = scene.model.shapes().iter().map(|shape| shape.name.as_str()).collect();
    let own: Vec<&&str> = names.iter().filter(|name| name.starts_with("crate_")).collect();
    assert_eq!(
        own,
        ["crate_piece_0", "crate_piece_1", "crate_piece_2", "crate_piece_3", "crate_piece_4"]
            .iter()
            .collect::<Vec<_>>()
    );
    let geometry = scene.geometry();
    assert_eq!((geometry.crate_rim, geometry.crate_interior_half), (0.2, [0.23, 0.18]));
    let footprint = scene.footprints().into_iter().find(|footprint| footprint.name == "crate").unwrap();
    assert!((footprint.top - 0.2).abs() < 1e-9 && (footprint.outline[2].x - footprint.outline[0].x - 0.5).abs() < 1e-9);
}

#[test]
fn a_bulb_from_a_file_keeps_the_stock_plug() {
    let config = SceneConfig::default().with_asset("fresh_bulb", &Object::from_toml(&bulb()).unwrap()).unwrap();
    let scene = scene(&config);
    let stock = &SceneConfig::default().bulb;
    let [old, fresh] = &scene.sizes.bulbs;
    assert_eq!((old, fresh.mass, &fresh.solids[..]), (stock, 0.05, &stock.solids[..1]));
    let body = scene.body(errand::BULBS[Bulb::Fresh as usize]).unwrap();
    assert_eq!(scene.model.bodies()[body.0].spec.mass, 0.05);
    let count = |prefix: &str| scene.model.shapes().iter().filter(|shape| shape.name.starts_with(prefix)).count();
    assert_eq!((count("fresh_bulb_piece_"), count("fresh_bulb_solid_"), count("fresh_bulb_cap_")), (1, 1, 6));
    assert_eq!(count("old_bulb_piece_"), 0);
}

/// The bag's header has the config as text: from it the same scene is built again.
#[test]
fn a_config_with_objects_reads_back() {
    let config = SceneConfig::default();
    let config = config.with_asset("crate", &Object::from_toml(&crate_text()).unwrap()).unwrap();
    let config = config.with_asset("old_bulb", &Object::from_toml(&bulb()).unwrap()).unwrap();
    let again = SceneConfig::from_toml(&config.to_toml()).unwrap();
    assert_eq!((again.digest(), again), (config.digest(), config));
}

/// A run with objects is ranked only if nothing else of its scene differs from the published one.
#[test]
fn the_digest_without_objects_is_that_of_the_scene() {
    let published = SceneConfig::default();
    assert_eq!(published.base_digest(), None);
    let crate_ = Object::from_toml(&crate_text()).unwrap();
    let config = published.clone().with_asset("crate", &crate_).unwrap();
    assert_eq!(config.base_digest(), Some(published.digest()));
    assert_ne!(config.digest(), published.digest());
    for change in ["[crate]\nplacing_height = 0.2", "[bulb]\nmass = 0.05", "[attachment]\nhold_force = 2.0"] {
        let other = SceneConfig::from_toml(change).unwrap().with_asset("crate", &crate_).unwrap();
        assert_ne!(other.base_digest(), Some(published.digest()), "{change}");
    }
    // Another file is another scene, and says so.
    let heavier = Object::from_toml(&crate_text().replace("friction = 0.9", "friction = 0.8")).unwrap();
    let other = published.clone().with_asset("crate", &heavier).unwrap();
    assert_ne!((&other.assets["crate"].digest, other.digest()), (&config.assets["crate"].digest, config.digest()));
}

#[test]
fn bad_files_are_refused_by_name() {
    let replaced = |from: &str, to: &str| {
        let text = crate_text();
        assert!(text.contains(from), "{from}");
        Object::from_toml(&text.replacen(from, to, 1)).unwrap_err().to_string()
    };
    for (from, to, field) in [
        ("format = 1", "format = 2", "format"),
        ("name = \"thing\"", "name = \"../thing\"", "name"),
        ("mass = 1.5", "mass = 0.0", "links[0].mass"),
        ("mass = 1.5", "mass = nan", "links[0].mass"),
        ("inertia = [0.03", "inertia = [inf", "links[0].inertia"),
        ("\nfriction = 0.9", "\nfriction = -1.0", "friction"),
        ("[-0.25, -0.2, 0.0]", "[-250.0, -0.2, 0.0]", "links[0].pieces[0]"),
        ("role = \"crate\"", "role = \"boat\"", "boat"),
        ("fixed = false", "fixed = false\nspeed = 1", "speed"),
    ] {
        let message = replaced(from, to);
        assert!(message.contains(field), "{field}: {message}");
    }
    let flat = object("none", &[cuboid([0.0; 3], [0.1, 0.1, 0.0])], "");
    let error = Object::from_toml(&flat).unwrap_err();
    let reason = std::error::Error::source(&error).unwrap().to_string();
    assert!(reason.contains("links[0].pieces[0]"), "{reason}");
}

#[test]
fn objects_take_only_places_of_their_role() {
    let crate_ = Object::from_toml(&crate_text()).unwrap();
    let refused =
        |place: &str, object: &Object| SceneConfig::default().with_asset(place, object).unwrap_err().to_string();
    assert!(refused("sofa", &crate_).contains("fresh_bulb"));
    assert!(refused("fresh_bulb", &crate_).contains("--role bulb"));
    let without = Object::from_toml(&object("crate", &[cuboid([0.0; 3], [0.1, 0.1, 0.1])], "")).unwrap();
    assert!(refused("crate", &without).contains("[scene.crate]"));
    let narrow = crate_text().replace("interior_half = [0.23, 0.18]", "interior_half = [0.26, 0.18]");
    let error = SceneConfig::default().with_asset("crate", &Object::from_toml(&narrow).unwrap()).unwrap_err();
    let reason = std::error::Error::source(&error).unwrap().to_string();
    assert!(reason.contains("crate.interior_half"), "{reason}");
    assert!("crate".parse::<AssetArg>().is_err() && "sofa=x".parse::<AssetArg>().is_err());
    assert_eq!("crate=a=b".parse::<AssetArg>().unwrap().path, PathBuf::from("a=b"));
    let taken = SceneConfig::default().with_asset("crate", &crate_).unwrap();
    let again = taken.with_assets(&["crate=a".parse().unwrap()]).unwrap_err();
    assert!(matches!(again, ObjectError::Taken { .. }));
    let missing = SceneConfig::default().with_assets(&["crate=a".parse().unwrap()]).unwrap_err();
    assert!(matches!(missing, ObjectError::Read { .. }));
}
