//! The scene and the rows of a recorded episode, from nothing but what its bag holds.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeMap;
use std::sync::Arc;

use fiatlux_proto::Message;
use fiatlux_proto::v3::{EpisodeHeader, Layout, OpenRequest, PropScale, Randomization, Range, State};
use fiatlux_robot::Robot;
use fiatlux_rules::Row;
use fiatlux_wire::{layout_of, light_of, read_row, scene_of, state_message};
use fiatlux_world::{ACTION_SCALE, Episode, Light, Object, Scene, SceneConfig, ShapeOwner, World};

use crate::server::recorded_header;

/// The G1 with Inspire hands.
const JOINTS: usize = 53;

/// An episode of a request in a config: its header and its rows, as messages.
fn recorded(request: OpenRequest, config: &SceneConfig, steps: usize) -> (Vec<u8>, Vec<Vec<u8>>) {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let (header, mut episode): (EpisodeHeader, Episode) = recorded_header(&request, config, robot, 5);
    let mut rows = vec![state_message(episode.row()).encode_to_vec()];
    let staged = episode.row().action.clone();
    for step in 0..steps {
        let action: [f64; JOINTS] =
            std::array::from_fn(|joint| staged[joint] + 0.1 * libm::sin(0.3 * step as f64 + joint as f64));
        episode.step(&action).unwrap();
        rows.push(state_message(episode.row()).encode_to_vec());
    }
    (header.encode_to_vec(), rows)
}

/// A bag is enough: its header gives the scene, row 0 the state, and each row the action that led to it.
/// Nothing is drawn again: another layout than the seed's is followed too.
#[test]
fn an_episode_is_rebuilt_from_what_was_recorded() {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let other_room = SceneConfig::from_toml("[bench]\nsurface_height = 0.98\n").unwrap();
    let own = Object::from_toml(include_str!("../tests/data/crate.toml")).unwrap();
    let own_crate = SceneConfig::default().with_asset("crate", &own).unwrap();
    let random = Randomization { prop_scale: true, ..Randomization::default() };
    let larger = PropScale { ladder_z: 1.08, fresh_bulb: 0.93, ..PropScale::default() };
    for (task, randomization, prop_scale, config) in [
        ("S01", None, None, SceneConfig::default()),
        ("S06", Some(random), None, SceneConfig::default()),
        ("S10", None, Some(larger), SceneConfig::default()),
        ("S08", Some(Randomization { fixed_hand_friction: true, fixed_layout: true, ..random }), None, other_room),
        ("S06", None, None, own_crate.clone()),
        ("climb", None, None, SceneConfig::default()),
    ] {
        let request = OpenRequest { task: task.into(), seed: 3, randomization, prop_scale, ..OpenRequest::default() };
        let (header, rows) = recorded(request, &config, 40);
        let header = EpisodeHeader::decode(header.as_slice()).unwrap();
        let layout = layout_of(&header).unwrap();
        let rows = rows.iter().map(|row| read_row(&State::decode(row.as_slice()).unwrap(), layout).unwrap());
        let rows: Vec<Row> = rows.collect();
        let scene = Arc::new(scene_of(&header, Arc::clone(&robot)).unwrap());
        assert_eq!(scene.config, config, "{task}");
        let places: Vec<&str> = header.assets.iter().map(|asset| asset.place.as_str()).collect();
        assert_eq!(places.is_empty(), config.assets.is_empty());
        if let [asset] = &header.assets[..] {
            assert_eq!((places[0], &asset.digest), ("crate", &own.digest));
            assert_eq!(header.base_scene_digest, SceneConfig::default().digest());
        }
        let mut world = World::new(Arc::clone(&scene));
        world.reset_to(&rows[0]).unwrap();
        for row in &rows[1..] {
            let target: [f64; JOINTS] = std::array::from_fn(|j| robot.q0()[j] + ACTION_SCALE * row.action[j]);
            assert_eq!(world.step(&row.action, &target).unwrap(), row, "{task} row {}", row.step);
        }
    }
}

/// So is one whose gravity, friction and masses were drawn from ranges; its delay and the width of its noise are in the header too.
#[test]
fn what_varies_is_rebuilt() {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let ranges = [
        ("gravity", 9.0, 9.5),
        ("noise", 2.0, 3.0),
        ("action_delay", 20.0, 40.0),
        ("floor_friction", 0.3, 0.4),
        ("friction.bench", 0.2, 0.2),
        ("thing_mass.ladder", 1.5, 2.0),
    ];
    let given = ranges.map(|(name, least, most)| (name.to_owned(), Range { least, most }));
    let request = OpenRequest { task: "S01".into(), seed: 3, ranges: given.into(), ..OpenRequest::default() };
    let (header, rows) = recorded(request, &SceneConfig::default(), 30);
    let header = EpisodeHeader::decode(header.as_slice()).unwrap();
    let varied = &header.domain_sample.as_ref().unwrap().varied;
    assert_eq!(varied.len(), ranges.len());
    for (name, least, most) in ranges {
        assert!((least..=most).contains(&varied[name]), "{name}: {varied:?}");
    }
    assert_eq!(varied["action_delay"] % 20.0, 0.0);
    let scene = Arc::new(scene_of(&header, Arc::clone(&robot)).unwrap());
    assert_eq!(scene.model.gravity().z, -varied["gravity"]);
    let mass = |scene: &Scene| scene.model.bodies()[scene.model.body("ladder").unwrap().0].spec.mass;
    let nominal = Scene::build(&SceneConfig::default(), Arc::clone(&robot), {
        let varied = BTreeMap::new();
        fiatlux_world::SceneSpec { varied, ..scene.spec.clone() }
    });
    assert_eq!(mass(&scene), mass(&nominal.unwrap()) * varied["thing_mass.ladder"]);
    for (shape, drawn) in [(ShapeOwner::Floor, "floor_friction"), (ShapeOwner::Bench, "friction.bench")] {
        let of = scene.model.shapes().iter().filter(|of| of.label == shape.label()).collect::<Vec<_>>();
        assert!(!of.is_empty() && of.iter().all(|of| of.material.friction == varied[drawn]), "{drawn}");
    }
    let layout = layout_of(&header).unwrap();
    let rows = rows.iter().map(|row| read_row(&State::decode(row.as_slice()).unwrap(), layout).unwrap());
    let rows: Vec<Row> = rows.collect();
    let mut world = World::new(Arc::clone(&scene));
    world.reset_to(&rows[0]).unwrap();
    for row in &rows[1..] {
        let target: [f64; JOINTS] = std::array::from_fn(|j| robot.q0()[j] + ACTION_SCALE * row.action[j]);
        assert_eq!(world.step(&row.action, &target).unwrap(), row, "row {}", row.step);
    }
    let mut wrong = header.clone();
    wrong.domain_sample.as_mut().unwrap().varied.insert("gravity".into(), f64::NAN);
    let text = fiatlux_cli::in_full(&scene_of(&wrong, robot).unwrap_err());
    assert!(text.contains("gravity is from NaN"), "{text}");
}

#[test]
fn light_reads_back() {
    let request = OpenRequest { task: "S05".into(), seed: 1, ..OpenRequest::default() };
    let (header, _) = recorded(request.clone(), &SceneConfig::default(), 0);
    let light = light_of(&EpisodeHeader::decode(header.as_slice()).unwrap());
    assert_eq!(light, Light::draw(1, 5, &fiatlux_world::Randomization::default()));
    assert_ne!(light, Light::default());
    assert_eq!(light_of(&EpisodeHeader::default()), Light::default());
}

/// A header from elsewhere gives an error that names the field.
#[test]
fn damaged_headers_are_refused() {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let request = OpenRequest { task: "S05".into(), ..OpenRequest::default() };
    let (header, _) = recorded(request, &SceneConfig::default(), 0);
    let header = EpisodeHeader::decode(header.as_slice()).unwrap();
    type Spoil = fn(&mut EpisodeHeader);
    let spoils: [(&str, Spoil); 9] = [
        ("task", |header| header.task = "S99".into()),
        ("gains", |header| header.gains = "soft".into()),
        ("domain_sample is missing", |header| header.domain_sample = None),
        ("domain_sample.layout is missing", |header| header.domain_sample.as_mut().unwrap().layout = None),
        ("domain_sample.layout.mount", |header| drawn_layout(header).mount = "floor".into()),
        ("domain_sample.layout.bench", |header| drawn_layout(header).bench = vec![1.0]),
        ("domain_sample.layout.anchor is missing", |header| drawn_layout(header).anchor = None),
        ("socket", |header| {
            let scale = PropScale { socket: 7.0, ..PropScale::default() };
            header.domain_sample.as_mut().unwrap().prop_scale = Some(scale);
        }),
        ("line 1", |header| header.scene_config = "crate = 7".into()),
    ];
    for (words, spoil) in spoils {
        let mut spoilt = header.clone();
        spoil(&mut spoilt);
        let error = scene_of(&spoilt, Arc::clone(&robot)).unwrap_err();
        let text = fiatlux_cli::in_full(&error);
        assert!(text.contains(words), "{words}: {text}");
    }
    let mut far = header.clone();
    drawn_layout(&mut far).ladder.as_mut().unwrap().position[0] = f64::NAN;
    assert!(scene_of(&far, robot).is_err());
}

fn drawn_layout(header: &mut EpisodeHeader) -> &mut Layout {
    header.domain_sample.as_mut().unwrap().layout.as_mut().unwrap()
}
