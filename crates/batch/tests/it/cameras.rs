//! Pictures that vary in a batch: drawn for each episode, noted, and the same again from a snapshot.

use std::sync::Arc;

use fiatlux_batch::{Bank, Batch, BatchConfig, Outputs, Rulebook, RulebookOptions, Snapshot};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::Task;
use fiatlux_sensing::{Cadence, Sampler, Sensor, Sensors};
use fiatlux_world::{EpisodeRanges, EpisodeSpec, SceneConfig};

use crate::common::bits;

const TASK: Task = Task::S05;

/// Two worlds of one start.
fn batch(ranges: &[(&str, [f64; 2])]) -> Batch {
    let robot = Arc::new(Robot::by_name("g1_inspire").unwrap());
    let gains = robot.gains(GainSet::Fiatlux);
    let banks = Bank::of_episodes(&SceneConfig::default(), &robot, &gains, &[EpisodeSpec::new(TASK, 0, 0)]).unwrap();
    let sensors =
        Sampler::new(Sensors::NONE).with(Sensor::Camera, Cadence::Every(2)).with(Sensor::Depth, Cadence::Every(1));
    let camera = EpisodeRanges::new(ranges.iter().map(|(name, range)| ((*name).to_owned(), *range))).unwrap();
    let options =
        RulebookOptions { sensors, camera, image_size: [16, 12], horizon_steps: 9, ..RulebookOptions::new(TASK) };
    let task = Rulebook::new(TASK, &banks[0].scene, options, None).unwrap();
    Batch::new(BatchConfig { worlds: 2, threads: 2, ..BatchConfig::new(banks) }, &task).unwrap()
}

/// The observations of some steps; the robots' arms move.
fn play(batch: &mut Batch, steps: std::ops::Range<u64>) -> Vec<Vec<u32>> {
    let mut outputs = Outputs::new(batch);
    let numbers = batch.worlds() * batch.spec().actions.len();
    let actions = |step: u64| (0..numbers).map(|index| 0.6 * ((index as f64 + step as f64).sin())).collect::<Vec<_>>();
    steps
        .map(|step| {
            batch.step(&actions(step), &mut outputs.buffers()).unwrap();
            bits(&outputs.observation)
        })
        .collect()
}

#[test]
fn varied_pictures_come_back_from_a_snapshot() {
    let ranges = [("camera.exposure", [-1.0, 1.0]), ("camera.noise", [2.0, 2.0]), ("camera.delay", [40.0, 40.0])];
    let mut played = batch(&ranges);
    let mut first = Outputs::new(&played).observation;
    played.reset(&mut first).unwrap();
    let half = first.len() / 2;
    assert_ne!(bits(&first[..half]), bits(&first[half..]), "each world draws its own");
    let drawn = [0, 1].map(|world| played.drawn(world).unwrap());
    assert_ne!(drawn[0]["camera.exposure"], drawn[1]["camera.exposure"]);
    assert_eq!((&drawn[0]["camera.noise"][..], drawn[0].get("camera.blur")), (&[2.0][..], None));
    // An odd number of steps: the kept picture and the rows of the next one are in the snapshot.
    play(&mut played, 0..5);
    let saved = Snapshot::from_bytes(&played.save().unwrap().to_bytes()).unwrap();
    let expected = play(&mut played, 5..13);
    let mut other = batch(&ranges);
    other.restore(&saved, &mut first).unwrap();
    assert_eq!(play(&mut other, 5..13), expected);
    // A copy goes on as the other one does, into the next episode.
    played.restore(&saved, &mut first).unwrap();
    played.copy_world(0, &[false, true], &mut first).unwrap();
    let copied = play(&mut played, 5..7);
    assert_eq!(played.drawn(0).unwrap(), played.drawn(1).unwrap());
    assert!(copied.iter().zip(&expected).all(|(copied, expected)| copied[..half] == expected[..half]));
}

/// Depth of a delayed camera is that of the row before; at the start, of the first row.
#[test]
fn a_delayed_picture_shows_an_earlier_row() {
    let of = |ms: f64| {
        let mut batch = batch(&[("camera.delay", [ms, ms])]);
        let mut first = Outputs::new(&batch).observation;
        batch.reset(&mut first).unwrap();
        // The last numbers of an observation are the distances.
        let depth = |seen: &Vec<u32>| seen[seen.len() - 16 * 12..].to_vec();
        let mut seen = vec![bits(&first)];
        seen.extend(play(&mut batch, 0..7));
        seen.iter().map(depth).collect::<Vec<_>>()
    };
    let (now, late) = (of(0.0), of(40.0));
    assert_ne!(now[0], now[6], "the robot moves");
    assert_eq!(late[2..], now[..6]);
    assert!(late[0] == now[0] && late[1] == now[0]);
}

#[test]
fn without_ranges_nothing_is_drawn() {
    let mut plain = batch(&[]);
    let mut seen = Outputs::new(&plain).observation;
    plain.reset(&mut seen).unwrap();
    let half = seen.len() / 2;
    assert_eq!(bits(&seen[..half]), bits(&seen[half..]));
    assert!(plain.drawn(0).unwrap().keys().all(|name| !name.starts_with("camera.")));
}
