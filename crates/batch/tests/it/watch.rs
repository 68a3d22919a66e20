//! Readings of worlds besides the task's observation, and what was drawn for them.

use std::sync::Arc;

use fiatlux_batch::{
    Autoreset, Bank, Batch, BatchConfig, BatchError, Begin, Outputs, Ranges, Rulebook, RulebookOptions, Watch,
};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{Task, errand};
use fiatlux_sensing::{Sampler, Sensors};
use fiatlux_world::{EpisodeSpec, SceneConfig, ShapeOwner, World};
use nalgebra::Vector3;

fn bank(task: Task) -> Bank {
    let robot = Arc::new(Robot::by_name("g1_inspire").unwrap());
    let gains = robot.gains(GainSet::Fiatlux);
    let episodes = [EpisodeSpec::new(task, 1000, 0)];
    Bank::of_episodes(&SceneConfig::default(), &robot, &gains, &episodes).unwrap().remove(0)
}

fn rulebook(bank: &Bank, options: RulebookOptions) -> Rulebook {
    Rulebook::new(Task::S02, &bank.scene, options, None).unwrap()
}

fn numbers<'a>(batch: &Batch, observation: &'a [f32], world: usize, field: &str) -> &'a [f32] {
    let fields = &batch.spec().observation;
    let at = fields.iter().position(|other| other.name == field).unwrap_or_else(|| panic!("no field {field}"));
    let first: usize = fields[..at].iter().map(|field| field.length()).sum();
    &observation[world * batch.spec().observation_length() + first..][..fields[at].length()]
}

#[test]
fn links_and_forces_are_those_of_the_world() {
    let bank = bank(Task::S02);
    let links = ["left_palm", "pelvis", "ladder_tread_0", "right_ankle_roll_link"];
    let watch = Watch { links: links.map(str::to_owned).into(), forces: true, contacts: true };
    let task = rulebook(&bank, RulebookOptions::new(Task::S02));
    let config = BatchConfig { worlds: 3, threads: 2, watch, ..BatchConfig::new(vec![bank.clone()]) };
    let mut batch = Batch::new(config, &task).unwrap();
    let mut outputs = Outputs::new(&batch);
    let actions: Vec<f64> = (0..3 * batch.spec().actions.len()).map(|index| 0.1 * (index as f64).sin()).collect();
    for _ in 0..20 {
        batch.step(&actions, &mut outputs.buffers()).unwrap();
    }
    for world in 0..3 {
        let row = batch.row(world).unwrap();
        let mut reference = World::new(Arc::clone(&bank.scene));
        reference.reset_to(&row).unwrap();
        let found = numbers(&batch, &outputs.observation, world, "privileged.links");
        for (name, found) in links.iter().zip(found.chunks(13)) {
            // Another way to both: a body's frame displaced by its velocity for a microsecond.
            let site = bank.scene.site(name).unwrap();
            let pose = reference.dynamics().world_from_body(site.body) * site.body_from_site;
            assert!(pose.translation.vector.iter().zip(found).all(|(a, b)| (a - f64::from(*b)).abs() < 1e-6), "{name}");
            let velocity = reference.dynamics().velocity(site.body);
            let rotation = reference.dynamics().world_from_body(site.body).rotation;
            let dt = 1e-6;
            let turned = nalgebra::UnitQuaternion::from_scaled_axis(velocity.angular * dt) * rotation;
            let lever = site.body_from_site.translation.vector;
            let linear = velocity.linear + (turned * lever - rotation * lever) / dt;
            assert!(linear.iter().zip(&found[7..10]).all(|(a, b)| (a - f64::from(*b)).abs() < 1e-4), "{name}");
        }
        let close = |force: &[Vector3<f64>], found: &[f32]| {
            force.iter().flat_map(|f| f.iter().copied().collect::<Vec<_>>()).zip(found).all(|(a, b)| a as f32 == *b)
        };
        let floor = numbers(&batch, &outputs.observation, world, "privileged.floor_force");
        assert!(close(row.force(errand::FLOOR_FORCE), floor));
        let ladder = numbers(&batch, &outputs.observation, world, "privileged.ladder_force");
        assert!(close(row.force(errand::LADDER_FORCE), ladder));
        // The points' forces add up to those of the row.
        let feet = bank.scene.robot.feet();
        let of_feet = |id| matches!(bank.scene.owner(id), ShapeOwner::Robot(link) if feet.contains(&link));
        let is_floor = |id| matches!(bank.scene.owner(id), ShapeOwner::Floor);
        let mut sum = Vector3::zeros();
        for contact in batch.contacts(world).unwrap() {
            let sign = match (contact.shape_a, contact.shape_b) {
                (a, b) if is_floor(a) && of_feet(b) => 1.0,
                (a, b) if of_feet(a) && is_floor(b) => -1.0,
                _ => continue,
            };
            sum += sign * contact.force;
        }
        let both: Vector3<f64> = row.force(errand::FLOOR_FORCE)[..2].iter().sum();
        assert!(sum.z > 100.0 && (sum - both).norm() < 1e-6, "{sum:?}, {both:?}");
    }
    batch
        .reset_worlds(|world| if world == 1 { Begin::AtStart } else { Begin::Stays }, None, &mut outputs.observation)
        .unwrap();
    assert!(batch.contacts(1).unwrap().is_empty() && !batch.contacts(0).unwrap().is_empty());
    batch.copy_world(1, &[false, false, true], &mut outputs.observation).unwrap();
    assert!(batch.contacts(2).unwrap().is_empty() && !batch.contacts(0).unwrap().is_empty());
    assert!(matches!(batch.contacts(3), Err(BatchError::NoWorld { .. })));
    let watch = Watch { links: vec!["left_pam".into()], ..Watch::default() };
    let refused = Batch::new(BatchConfig { watch, ..BatchConfig::new(vec![bank]) }, &task).err().unwrap();
    assert!(refused.to_string().contains("left_pam"), "{refused}");
}

/// Gravity is of the start, noise of the episode; both are within their ranges, differ, and are named.
#[test]
fn gravity_and_noise_are_drawn_and_named() {
    let ranges = Ranges {
        gravity: Some([9.0, 10.5]),
        thing_mass: [("ladder".to_owned(), [0.9, 1.1])].into(),
        ..Ranges::NOMINAL
    };
    let nominal = bank(Task::S02);
    let varied = nominal.clone().varied(&ranges, 4, 3);
    let options = RulebookOptions { noise_scale: [0.5, 2.0], horizon_steps: 5, ..RulebookOptions::new(Task::S02) };
    let task = rulebook(&varied, options.clone());
    let make = |banks, options| {
        Batch::new(
            BatchConfig { worlds: 6, autoreset: Autoreset::SameStep, ..BatchConfig::new(banks) },
            &rulebook(&nominal, options),
        )
        .unwrap()
    };
    let mut batch = Batch::new(BatchConfig { worlds: 6, ..BatchConfig::new(vec![varied.clone()]) }, &task).unwrap();
    let mut outputs = Outputs::new(&batch);
    let actions = vec![0.0; 6 * batch.spec().actions.len()];
    let drawn =
        |batch: &Batch, name: &str| (0..6).map(|world| batch.drawn(world).unwrap()[name][0]).collect::<Vec<_>>();
    let first = drawn(&batch, "noise");
    assert!(first.iter().all(|noise| (0.5..2.0).contains(noise)) && first[0] != first[1], "{first:?}");
    let gravity = drawn(&batch, "gravity");
    assert!(gravity.iter().all(|g| (9.0..10.5).contains(g)) && gravity.iter().any(|g| *g != gravity[0]), "{gravity:?}");
    assert!(drawn(&batch, "thing_mass.ladder").iter().all(|mass| (0.9..1.1).contains(mass)));
    assert!(drawn(&batch, "light.dome")[0] > 0.0 && drawn(&batch, "episode") == [0.0; 6]);
    // A copy has the noise of the original, to the bit, and the next episode another one.
    batch.step(&actions, &mut outputs.buffers()).unwrap();
    batch.copy_world(0, &[false, true, false, false, false, false], &mut outputs.observation).unwrap();
    batch.step(&actions, &mut outputs.buffers()).unwrap();
    let each = batch.spec().observation_length();
    assert_eq!(outputs.observation[..each], outputs.observation[each..2 * each]);
    assert_eq!(drawn(&batch, "noise")[1], first[0]);
    for _ in 0..5 {
        batch.step(&actions, &mut outputs.buffers()).unwrap();
    }
    assert_ne!(drawn(&batch, "noise")[2], first[2]);
    // Twice the noise is twice as far from the exact reading.
    let apart = |scale: f64| {
        let seen = [true, false].map(|noise| {
            let options = RulebookOptions {
                noise,
                noise_scale: [scale; 2],
                sensors: Sampler::new(Sensors::of_body(Task::S02)),
                ..RulebookOptions::new(Task::S02)
            };
            let mut batch = make(vec![nominal.clone()], options);
            let mut outputs = Outputs::new(&batch);
            batch.reset(&mut outputs.observation).unwrap();
            outputs.observation
        });
        seen[0].iter().zip(&seen[1]).map(|(a, b)| f64::from((a - b).abs())).sum::<f64>()
    };
    let (once, twice) = (apart(1.0), apart(2.0));
    assert!(once > 0.1 && (twice / once - 2.0).abs() < 1e-3, "{once}, {twice}");
    // Less gravity, less weight.
    let weight = |gravity: f64| {
        let ranges = Ranges { gravity: Some([gravity; 2]), ..Ranges::NOMINAL };
        let mut batch = make(vec![nominal.clone().varied(&ranges, 1, 0)], RulebookOptions::new(Task::S02));
        let mut outputs = Outputs::new(&batch);
        for _ in 0..25 {
            batch.step(&actions, &mut outputs.buffers()).unwrap();
        }
        batch.row(0).unwrap().force(errand::FLOOR_FORCE)[..2].iter().map(|force| force.z).sum::<f64>()
    };
    let (light, heavy) = (weight(8.0), weight(10.0));
    assert!(light < 0.9 * heavy, "{light} N, {heavy} N");
    let ranges = Ranges { gravity: Some([2.0, 1.0]), ..Ranges::NOMINAL };
    let error = Batch::new(BatchConfig::new(vec![nominal.clone().varied(&ranges, 1, 0)]), &task).err().unwrap();
    assert!(error.to_string().contains("gravity"), "{error}");
    let wrong = RulebookOptions { noise_scale: [1.0, f64::NAN], ..options };
    assert!(Rulebook::new(Task::S02, &nominal.scene, wrong, None).err().unwrap().to_string().contains("noise"));
}
