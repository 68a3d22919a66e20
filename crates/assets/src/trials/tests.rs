#![allow(clippy::unwrap_used)]

use super::*;

/// A box as a list of its corners.
fn cuboid(low: [f64; 3], high: [f64; 3]) -> String {
    let corner = |k: usize| {
        let at = |axis: usize| if k >> axis & 1 == 0 { low[axis] } else { high[axis] };
        format!("[{:?}, {:?}, {:?}]", at(0), at(1), at(2))
    };
    format!("[{}]", (0..8).map(corner).collect::<Vec<_>>().join(", "))
}

fn link(name: &str, mass: f64, com: [f64; 3], inertia: [f64; 3], pieces: &[String]) -> String {
    let [xx, yy, zz] = inertia;
    format!(
        "[[links]]\nname = \"{name}\"\nmass = {mass:?}\ncom = {com:?}\ninertia = [{xx:?}, {yy:?}, {zz:?}, 0.0, 0.0, 0.0]\npieces = [{}]\n",
        pieces.join(", ")
    )
}

fn object(role: &str, rest: &str) -> Object {
    let head = format!(
        "format = 1\nname = \"thing\"\nrole = \"{role}\"\nfixed = false\nstatic_friction = 1.0\nfriction = 0.9\n"
    );
    Object::from_toml(&(head + rest)).unwrap()
}

fn passed(trials: &[Trial]) -> usize {
    trials.iter().filter(|trial| trial.passed).count()
}

#[test]
fn a_box_settles() {
    let config = SceneConfig::default();
    let block = [cuboid([-0.1, -0.1, 0.0], [0.1, 0.1, 0.1])];
    let stands = object("none", &link("a", 1.0, [0.0, 0.0, 0.05], [0.004, 0.004, 0.007], &block));
    let trials = settle::trials(&config, &stands).unwrap();
    assert_eq!(passed(&trials), 3, "{trials:?}");
}

fn table(height: f64, half: f64) -> Object {
    let legs = [[-half, -half], [half - 0.04, -half], [-half, half - 0.04], [half - 0.04, half - 0.04]];
    let mut pieces: Vec<String> =
        legs.iter().map(|[x, y]| cuboid([*x, *y, 0.0], [x + 0.04, y + 0.04, height - 0.03])).collect();
    pieces.push(cuboid([-half, -half, height - 0.03], [half, half, height]));
    object("ladder", &link("a", 10.0, [0.0, 0.0, height * 0.7], [1.0, 1.0, 0.8], &pieces))
}

#[test]
fn a_broad_ladder_bears_load_and_push_and_a_narrow_one_tips() {
    let config = SceneConfig::default();
    let broad = load::trials(&config, &table(1.0, 0.35)).unwrap();
    assert_eq!(passed(&broad), 8, "{broad:?}");
    let narrow = load::trials(&config, &table(1.6, 0.08)).unwrap();
    assert_eq!(passed(&narrow), 0, "{narrow:?}");
    let block = [cuboid([-0.05, -0.05, 0.0], [0.05, 0.05, 0.1])];
    let small = object("ladder", &link("a", 1.0, [0.0, 0.0, 0.05], [0.004, 0.004, 0.007], &block));
    let without = load::trials(&config, &small).unwrap();
    assert!(without.iter().all(|trial| trial.reason.contains("no level surface")), "{without:?}");
}

fn hinged(lower: f64, upper: f64, kind: &str) -> Object {
    let base = link("base", 2.0, [0.0, 0.0, 0.1], [0.02, 0.02, 0.02], &[cuboid([-0.2, -0.15, 0.0], [0.2, 0.15, 0.2])]);
    let lid =
        link("lid", 1.0, [0.0, 0.0, 0.21], [0.008, 0.013, 0.02], &[cuboid([-0.2, -0.15, 0.202], [0.2, 0.15, 0.216])]);
    let joint = format!(
        "[links.joint]\nname = \"hinge\"\nparent = \"base\"\nkind = \"{kind}\"\nanchor = [0.0, 0.15, 0.202]\naxis = [-1.0, 0.0, 0.0]\nlower = {lower:?}\nupper = {upper:?}\n"
    );
    object("none", &(base + &lid + &joint))
}

#[test]
fn a_lid_goes_from_limit_to_limit() {
    let config = SceneConfig::default();
    let trials = joint::trials(&config, &hinged(0.0, 1.9, "revolute")).unwrap();
    assert_eq!((trials.len(), passed(&trials)), (1, 1), "{trials:?}");
    // The whole object: its three falls, too.
    let trials = super::trials(&[hinged(0.0, 1.9, "revolute")]).unwrap();
    assert_eq!((trials.len(), passed(&trials)), (4, 4), "{trials:?}");
}

#[test]
fn links_of_fixed_joints_are_one_body_and_slides_are_refused() {
    let welded = trials(&[hinged(0.0, 0.0, "fixed")]).unwrap();
    assert_eq!((welded.len(), passed(&welded)), (3, 3), "{welded:?}");
    let error = trials(&[hinged(0.0, 0.1, "prismatic")]).unwrap_err();
    assert!(error.to_string().contains("joint 'hinge' is prismatic"), "{error}");
}

/// The bulb and the socket of the scene, as objects: a box for the glass, a slab for the housing.
fn pair() -> [Object; 2] {
    let glass = [cuboid([-0.03, -0.03, 0.08], [0.03, 0.03, 0.19])];
    let numbers = "[scene.bulb]\nmass = 0.035\naxial_inertia = 3e-5\ntransverse_inertia = 6e-5\ncom_z = 0.12\nseat_z = 0.036259\noutline = [[0.036259, 0.007], [0.1, 0.03], [0.19, 0.0]]\nlying_height = 0.04\n";
    let bulb = object("bulb", &(link("a", 0.035, [0.0, 0.0, 0.12], [6e-5, 6e-5, 3e-5], &glass) + numbers));
    let housing = [cuboid([-0.07, -0.07, 0.0], [0.07, 0.07, 0.0382])];
    let fixture = object("fixture", &link("a", 0.4, [0.0, 0.0, 0.02], [7e-4, 7e-4, 1.3e-3], &housing));
    [bulb, fixture]
}

#[test]
fn a_bulb_plugs_in_and_one_with_a_broad_neck_does_not() {
    let config = SceneConfig::default();
    let [bulb, fixture] = pair();
    let trials = socket::trials(&config, &bulb, &fixture).unwrap();
    assert_eq!(trials.len(), 16);
    let straight: Vec<&Trial> = trials.iter().filter(|trial| trial.case.contains("offset 0 m")).collect();
    assert!(straight.iter().all(|trial| trial.passed), "{straight:?}");
    // Its glass begins below the socket's mouth.
    let mut broad = bulb.clone();
    broad.links[0].pieces[0].iter_mut().filter(|corner| corner[2] < 0.1).for_each(|corner| corner[2] = 0.05);
    let stuck = socket::trials(&config, &broad, &fixture).unwrap();
    let inserted = stuck.iter().filter(|trial| trial.case.starts_with("insertion") && trial.passed).count();
    assert_eq!(inserted, 0, "{stuck:?}");
}

#[test]
fn a_bulb_falls_onto_the_plate() {
    let config = SceneConfig::default();
    let [bulb, _] = pair();
    let trials = drop::trials(&config, &bulb).unwrap();
    assert_eq!((trials.len(), passed(&trials)), (8, 8), "{trials:?}");
}

#[test]
fn rooms_have_place_for_a_ladder_of_the_usual_size() {
    let config = SceneConfig::default();
    let [bulb, fixture] = pair();
    let fits = fit::trials(&config, &table(1.18, 0.3), &bulb, &fixture).unwrap();
    assert_eq!(fits.len(), 9);
    assert!(fits.iter().filter(|trial| trial.case.ends_with("scale 1")).all(|trial| trial.passed), "{fits:?}");
    // As large as the room.
    let large = fit::trials(&config, &table(1.18, 3.0), &bulb, &fixture).unwrap();
    assert_eq!(passed(&large), 0);
}
