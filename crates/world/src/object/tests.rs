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

/// A bulb whose glass is a block of 4 cm.
fn bulb() -> String {
    let numbers = "[scene.bulb]\nmass = 0.05\naxial_inertia = 3e-5\ntransverse_inertia = 7e-5\ncom_z = 0.12\nseat_z = 0.036259\noutline = [[0.036259, 0.0076], [0.05, 0.02], [0.075, 0.028284], [0.19, 0.028284]]\nlying_height = 0.028284\n";
    let text = object("bulb", &[cuboid([-0.02, -0.02, 0.075], [0.02, 0.02, 0.19])], numbers);
    let text = text.replacen("mass = 1.5", "mass = 0.05", 1).replacen("[0.0, 0.0, 0.05]", "[0.0, 0.0, 0.12]", 1);
    text.replacen("[0.03, 0.06, 0.08,", "[7e-5, 7e-5, 3e-5,", 1)
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
        ("inertia = [0.03", "inertia = [-0.03", "links[0].inertia"),
        ("inertia = [0.03", "inertia = [0.3", "links[0].inertia"),
        ("0.06, 0.08, 0.0", "0.06, 0.13, 0.0", "links[0].inertia"),
        ("com = [0.0, 0.0, 0.05]", "com = [0.0, 0.0, 5.0]", "links[0].com"),
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
    let without = crate_text().split("[scene.crate]").next().unwrap().to_owned();
    let without = Object::from_toml(&without).unwrap();
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

/// Each number that the rules read, as a cheat would like it: refused by its name, in the object and in the text of a scene.
#[test]
fn numbers_that_the_pieces_do_not_have_are_refused_by_name() {
    let refused = |place: &str, text: &str| {
        let error = SceneConfig::default().with_asset(place, &Object::from_toml(text).unwrap()).unwrap_err();
        let reason = std::error::Error::source(&error).unwrap().to_string();
        // A bag's header has no object, but the same numbers and pieces.
        reason
    };
    let good = crate_text();
    for (from, to, field) in [
        ("interior_half = [0.23, 0.18]", "interior_half = [0.24, 0.18]", "crate.interior_half"),
        ("interior_half = [0.23, 0.18]", "interior_half = [0.1, 0.18]", "crate.interior_half"),
        ("outer_half = [0.25, 0.2]", "outer_half = [0.5, 0.2]", "crate.outer_half"),
        ("rim_height = 0.2", "rim_height = 1.8", "crate.rim_height"),
        ("floor_height = 0.01", "floor_height = 0.1", "crate.floor_height"),
        ("\nfriction = 0.9", "\nfriction = 4.0", "assets.PLACE.surface"),
    ] {
        assert!(good.contains(from), "{from}");
        let reason = refused("crate", &good.replacen(from, to, 1));
        assert!(reason.contains(field), "{field}: {reason}");
    }
    // A plate of 2 cm whose inside is 49 m.
    let numbers = "[scene.crate]\nouter_half = [50.0, 50.0]\ninterior_half = [49.0, 49.0]\nrim_height = 0.02\nfloor_height = 0.01\n";
    let plate = object("crate", &[cuboid([-0.01, -0.01, 0.0], [0.01, 0.01, 0.02])], numbers);
    let plate = plate.replacen("[0.03, 0.06, 0.08,", "[3e-4, 3e-4, 3e-4,", 1).replacen("0.0, 0.05]", "0.0, 0.01]", 1);
    assert!(refused("crate", &plate).contains("crate.rim_height"));
    // Honest numbers of a crate as wide as the room, and of one without a wall.
    let wide = good.replace("0.25", "2.5").replace("0.23", "2.3").replace("-0.25", "-2.5");
    assert!(refused("crate", &wide).contains("assets.PLACE.pieces"));
    let open = good.replacen(&format!(", {}", cuboid([0.23, -0.2, 0.01], [0.25, 0.2, 0.2])), "", 1);
    assert!(refused("crate", &open).contains("no wall"));

    let good = bulb();
    SceneConfig::default().with_asset("fresh_bulb", &Object::from_toml(&good).unwrap()).unwrap();
    let heavy = |text: &str, mass: &str| text.replace("mass = 0.05", &format!("mass = {mass}"));
    for (text, field) in [
        (heavy(&good, "5.0"), "bulb.mass"),
        (good.replacen("com_z = 0.12", "com_z = 0.19", 1), "bulb.com_z"),
        (good.replacen("lying_height = 0.028284", "lying_height = 0.5", 1), "bulb.lying_height"),
        (good.replacen("[0.19, 0.028284]]", "[0.9, 0.028284]]", 1), "bulb.outline"),
        (good.replacen("[0.19, 0.028284]]", "[0.189, 0.001]]", 1), "bulb.outline"),
        (good.replace("0.028284", "0.09"), "bulb.outline"),
        (good.replacen("[0.05, 0.02]", "[0.05, 0.0]", 1), "bulb.outline"),
        (good.replace("3e-5", "1e-7"), "bulb.axial_inertia"),
        (good.replace("7e-5", "7e-4"), "bulb.transverse_inertia"),
    ] {
        let reason = refused("fresh_bulb", &text);
        assert!(reason.contains(field), "{field}: {reason}");
    }
    // The link and the section disagree.
    let error = Object::from_toml(&good.replacen("mass = 0.05", "mass = 0.5", 1)).unwrap_err().to_string();
    assert!(error.contains("scene.bulb.mass"), "{error}");

    // A fixture that catches what falls.
    let block = cuboid([-0.1, -0.1, -0.1], [0.1, 0.1, 0.03]);
    let fixture = object("fixture", &[block], "").replacen("0.03, 0.06, 0.08", "0.005, 0.005, 0.005", 1);
    SceneConfig::default().with_asset("fixture", &Object::from_toml(&fixture).unwrap()).unwrap();
    assert!(refused("fixture", &fixture.replace("0.03]", "0.1]")).contains("above its mouth"));
    assert!(refused("fixture", &fixture.replace("-0.1]", "-0.9]")).contains("assets.PLACE.pieces"));

    let top = cuboid([-1.2, -0.4, 0.9], [1.2, 0.4, 1.0]);
    let numbers = "[scene.bench]\nsurface_height = 1.0\nfootprint_half = [1.2, 0.4]\n";
    let bench = object("bench", &[top], numbers).replacen("0.0, 0.05]", "0.0, 0.95]", 1);
    SceneConfig::default().with_asset("bench", &Object::from_toml(&bench).unwrap()).unwrap();
    for (from, to, field) in [
        ("surface_height = 1.0", "surface_height = 0.5", "bench.surface_height"),
        ("footprint_half = [1.2, 0.4]", "footprint_half = [1.3, 0.4]", "bench.footprint_half"),
    ] {
        let reason = refused("bench", &bench.replacen(from, to, 1));
        assert!(reason.contains(field), "{field}: {reason}");
    }
}

/// The text of a scene, as a bag's header has it, is held against the pieces as an object is.
#[test]
fn a_scene_with_other_numbers_than_its_objects_is_refused() {
    let config = SceneConfig::default().with_asset("crate", &Object::from_toml(&crate_text()).unwrap()).unwrap();
    let text = config.to_toml();
    assert!(text.contains("interior_half = [0.23, 0.18]"), "{text}");
    let error = SceneConfig::from_toml(&text.replacen("[0.23, 0.18]", "[0.24, 0.18]", 1)).unwrap_err().to_string();
    assert!(error.contains("crate.interior_half"), "{error}");
}

#[test]
fn a_device_or_pipe_is_not_read() {
    for path in ["/dev/zero", "/dev/stdin", "/dev"] {
        let error = Object::read(Path::new(path)).unwrap_err();
        assert!(matches!(error, ObjectError::Read { .. }), "{path}: {error}");
    }
}

/// Objects that `python -m fiatlux.assets examples` builds are accepted.
#[test]
fn objects_of_the_builder_pass() {
    for (place, text) in [
        ("bench", include_str!("built/bench.toml")),
        ("crate", include_str!("built/crate.toml")),
        ("fresh_bulb", include_str!("built/bulb.toml")),
        ("fixture", include_str!("built/socket.toml")),
    ] {
        let made = SceneConfig::default().with_asset(place, &Object::from_toml(text).unwrap());
        let problem = made.err().map(|error| format!("{error}: {:?}", std::error::Error::source(&error)));
        assert_eq!(problem, None, "{place}");
    }
}
