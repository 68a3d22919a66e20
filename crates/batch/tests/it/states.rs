//! Results depend on config and actions alone, and a saved state goes on exactly.

use fiatlux_batch::{
    Autoreset, Bank, Batch, BatchConfig, BatchError, Begin, Outputs, Ranges, Snapshot, Walking, WalkingOptions,
};

use crate::common::{actions, floor, play, simple, walkers};

#[test]
fn threads_change_nothing() {
    let mut said = [1, 3, 8].map(|threads| {
        let mut batch = walkers(9, threads, 5);
        let mut outputs = Outputs::new(&batch);
        batch.reset(&mut outputs.observation).unwrap();
        let said = play(&mut batch, &mut outputs, 0..80);
        let rows: Vec<_> = (0..9).map(|world| batch.row(world).unwrap()).collect();
        (said, rows)
    });
    let [alone, others @ ..] = &mut said;
    assert!(alone.1.iter().any(|row| row.step < 80), "some episode began anew");
    for other in others {
        assert_eq!(alone, other);
    }
}

/// The same with more banks than every thread can step.
#[test]
fn threads_change_nothing_with_many_banks() {
    let ranges = Ranges { mass: [0.8, 1.2], ..Ranges::NOMINAL };
    let standing = Bank::standing(floor());
    let banks: Vec<_> = (0..20).map(|seed| standing.clone().varied(&ranges, 1, seed)).collect();
    let task = Walking::new(&standing.scene, WalkingOptions::default()).unwrap();
    let rows = [1, 3, 7].map(|threads| {
        let config = BatchConfig { worlds: 27, threads, ..BatchConfig::new(banks.clone()) };
        let mut batch = Batch::new(config, &task).unwrap();
        let mut outputs = Outputs::new(&batch);
        let said = play(&mut batch, &mut outputs, 0..10);
        (said, (0..27).map(|world| batch.row(world).unwrap()).collect::<Vec<_>>())
    });
    assert_eq!(rows[0], rows[1]);
    assert_eq!(rows[0], rows[2]);
}

/// A world does the same in a smaller batch.
#[test]
fn worlds_do_not_know_of_each_other() {
    let rows = [4, 9].map(|worlds| {
        let mut batch = walkers(worlds, 2, 5);
        let mut outputs = Outputs::new(&batch);
        for step in 0..40 {
            let actions = actions(&batch, step);
            batch.step(&actions, &mut outputs.buffers()).unwrap();
        }
        (0..4).map(|world| batch.row(world).unwrap()).collect::<Vec<_>>()
    });
    assert_eq!(rows[0], rows[1]);
}

#[test]
fn seeds_begin_anew() {
    let mut batch = walkers(3, 2, 5);
    let mut outputs = Outputs::new(&batch);
    let first = play(&mut batch, &mut outputs, 0..30);
    // A reset by seed repeats the draws of a new batch before its first step.
    batch.reset_with_seed(5, &mut outputs.observation).unwrap();
    outputs = Outputs::new(&batch);
    assert_eq!(first, play(&mut batch, &mut outputs, 0..30));
    batch.reset_with_seed(6, &mut outputs.observation).unwrap();
    assert_ne!(first, play(&mut batch, &mut Outputs::new(&walkers(3, 1, 5)), 0..30));
}

#[test]
fn a_saved_state_goes_on_exactly() {
    let mut batch = walkers(6, 2, 1);
    let mut outputs = Outputs::new(&batch);
    play(&mut batch, &mut outputs, 0..37);
    let (saved, observed) = (batch.save().unwrap(), outputs.observation.clone());
    let mut again = outputs.clone();
    let went_on = play(&mut batch, &mut outputs, 37..90);

    batch.restore(&saved, &mut again.observation).unwrap();
    assert_eq!(again.observation, observed);
    assert_eq!(play(&mut batch, &mut again.clone(), 37..90), went_on);

    // Into a batch of other threads, seed and history.
    let mut other = walkers(6, 5, 2);
    play(&mut other, &mut Outputs::new(&walkers(6, 1, 2)), 0..3);
    other.restore(&saved, &mut again.observation).unwrap();
    assert_eq!(play(&mut other, &mut again, 37..90), went_on);

    let mut smaller = walkers(5, 1, 1);
    let refused = smaller.restore(&saved, &mut []).unwrap_err().to_string();
    assert!(refused.starts_with("snapshot: worlds is 6, but the batch has 5; "), "{refused}");
}

#[test]
fn a_world_begins_at_any_row() {
    let mut batch = walkers(3, 2, 4);
    let mut outputs = Outputs::new(&batch);
    play(&mut batch, &mut outputs, 0..12);
    let row = batch.row(0).unwrap();
    let others = [batch.row(0).unwrap(), batch.row(1).unwrap()];
    let mut observation = vec![0.0; outputs.observation.len()];
    let begin = |world| if world == 2 { Begin::AtRow(Box::new(row.clone())) } else { Begin::Stays };
    batch.reset_worlds(begin, None, &mut observation).unwrap();
    let begun = batch.row(2).unwrap();
    assert_eq!(begun.step, 0);
    // Walking draws posture and turn anew, and leaves the place.
    assert_eq!(begun.robot.pose.translation.vector.xy(), row.robot.pose.translation.vector.xy());
    assert!(observation.iter().all(|number| number.is_finite()) && observation.iter().any(|number| *number != 0.0));
    assert_eq!([batch.row(0).unwrap(), batch.row(1).unwrap()], others);
    assert!(matches!(batch.row(3), Err(BatchError::NoWorld { world: 3, worlds: 3 })));
}

/// Bytes are the snapshot, and damaged ones are refused.
#[test]
fn a_snapshot_is_its_bytes() {
    let mut batch = walkers(4, 2, 1);
    let mut outputs = Outputs::new(&batch);
    play(&mut batch, &mut outputs, 0..37);
    let saved = batch.save().unwrap();
    let bytes = saved.to_bytes();
    let went_on = play(&mut batch, &mut outputs.clone(), 37..90);
    let mut other = walkers(4, 1, 2);
    other.restore(&Snapshot::from_bytes(&bytes).unwrap(), &mut outputs.observation).unwrap();
    assert_eq!(play(&mut other, &mut outputs, 37..90), went_on);
    for cut in [0, 5, 19, 40, bytes.len() / 2, bytes.len() - 1] {
        let refused = Snapshot::from_bytes(&bytes[..cut]);
        assert!(matches!(refused, Err(BatchError::Damaged { .. })), "{cut} bytes: {refused:?}");
    }
    for changed in (0..bytes.len()).step_by(997) {
        let mut bytes = bytes.clone();
        bytes[changed] ^= 0x10;
        let refused = Snapshot::from_bytes(&bytes);
        assert!(matches!(refused, Err(BatchError::Damaged { .. })), "byte {changed}: {refused:?}");
    }
}

/// Where the next episode waits for the caller, only the marked worlds begin anew.
#[test]
fn marked_worlds_begin_anew() {
    let mut batch = walkers(3, 2, 5);
    let mut outputs = Outputs::new(&batch);
    play(&mut batch, &mut outputs, 0..9);
    let rows = [0, 1, 2].map(|world| batch.row(world).unwrap());
    let begin = |world| if world == 1 { Begin::AtStart } else { Begin::Stays };
    batch.reset_worlds(begin, Some(8), &mut outputs.observation).unwrap();
    assert_eq!([batch.row(0).unwrap(), batch.row(2).unwrap()], [rows[0].clone(), rows[2].clone()]);
    let mut fresh = walkers(3, 1, 8);
    fresh.reset_with_seed(8, &mut Outputs::new(&batch).observation).unwrap();
    assert_eq!(batch.row(1).unwrap(), fresh.row(1).unwrap());
}

/// Every copy does what its model does, to the last bit: rows, observations, rewards and ends, over episodes that end.
#[test]
fn copied_worlds_go_on_as_their_model() {
    for threads in [1, 3] {
        let mut batch = walkers(7, threads, 5);
        let mut outputs = Outputs::new(&batch);
        play(&mut batch, &mut outputs, 0..23);
        let (others, length) = ([batch.row(0).unwrap(), batch.row(4).unwrap()], batch.spec().observation_length());
        let marks = [false, true, true, false, false, true, true];
        batch.copy_world(3, &marks, &mut outputs.observation).unwrap();
        assert_eq!([batch.row(0).unwrap(), batch.row(4).unwrap()], others);
        let mut ended = 0;
        for step in 0..100 {
            let one = &actions(&batch, step)[..15];
            batch.step(&one.repeat(7), &mut outputs.buffers()).unwrap();
            let model = batch.row(3).unwrap();
            for copy in (0..7).filter(|world| marks[*world]) {
                assert!(batch.row(copy).unwrap() == model, "world {copy} step {step}");
                let of = |world: usize| &outputs.observation[world * length..][..length];
                assert_eq!(of(copy), of(3), "world {copy} step {step}");
                assert_eq!(outputs.reward[copy], outputs.reward[3]);
            }
            ended += usize::from(outputs.terminated[3]);
        }
        assert!(ended > 0, "no episode ended");
    }
}

/// The state of one world goes into a batch of any size with the same settings, by way of its bytes too.
#[test]
fn one_world_s_snapshot_fits_where_its_settings_do() {
    let mut batch = walkers(3, 2, 5);
    let mut outputs = Outputs::new(&batch);
    play(&mut batch, &mut outputs, 0..23);
    let bytes = batch.save_world(1).unwrap().to_bytes();
    let saved = Snapshot::from_bytes(&bytes).unwrap();
    let mut other = walkers(2, 1, 9);
    let mut observation = Outputs::new(&other).observation;
    other.restore_worlds(&saved, &[false, true], &mut observation).unwrap();
    assert_eq!(other.row(1).unwrap(), batch.row(1).unwrap());
    let refused = other.restore_worlds(&batch.save().unwrap(), &[true, true], &mut observation).unwrap_err();
    assert_eq!(refused.to_string(), "worlds of the snapshot has 3 numbers instead of 1");
    let refused = other.restore_worlds(&saved, &[true], &mut observation).unwrap_err();
    assert_eq!(refused.to_string(), "marks has 1 numbers instead of 2");

    let (scene, options) = (floor(), Default::default());
    let task = Walking::new(&scene, options).unwrap();
    let mut plain = simple(Bank::standing(scene), &task, 2, 1);
    let refused = plain.restore_worlds(&saved, &[true, true], &mut observation).unwrap_err().to_string();
    assert!(refused.starts_with("snapshot: disturbances is "), "{refused}");
}

/// Worlds that began together end one by one, once: the next episodes have their whole length.
#[test]
fn shortened_episodes_end_one_by_one() {
    let scene = floor();
    let options = WalkingOptions { horizon_steps: 4, ..Default::default() };
    let task = Walking::new(&scene, options).unwrap();
    let mut batch = simple(Bank::standing(scene), &task, 3, 2);
    let mut outputs = Outputs::new(&batch);
    batch.shorten_episodes(&[0, 1, 3]).unwrap();
    let ends: Vec<_> = (0..8)
        .map(|_| {
            batch.step(&[0.0; 45], &mut outputs.buffers()).unwrap();
            outputs.truncated.clone()
        })
        .collect();
    let of = |world: usize| (1..=8).filter(|step| ends[step - 1][world]).collect::<Vec<_>>();
    assert_eq!([of(0), of(1), of(2)], [vec![4, 8], vec![3, 7], vec![1, 5]]);
    assert_eq!(batch.shorten_episodes(&[0]).unwrap_err().to_string(), "steps has 1 numbers instead of 3");
}

#[test]
fn starts_are_drawn_by_weight() {
    let (scene, options) = (floor(), Default::default());
    let task = Walking::new(&scene, options).unwrap();
    let mut bank = Bank::standing(scene);
    for (x, weight) in [(1.0, 3.0), (2.0, 0.0)] {
        let mut start = bank.starts[0].clone();
        start.row.robot.pose.translation.x = x;
        start.weight = weight;
        bank.starts.push(start);
    }
    let batch = simple(bank.clone(), &task, 400, 1);
    let at = |x| (0..400).filter(|world| batch.row(*world).unwrap().robot.pose.translation.x == x).count();
    // Four standard deviations of a binomial count are 35.
    assert!((65..=135).contains(&at(0.0)) && at(2.0) == 0 && at(0.0) + at(1.0) == 400, "{} {}", at(0.0), at(1.0));
    bank.starts.iter_mut().for_each(|start| start.weight = 0.0);
    let refused = Batch::new(BatchConfig::new(vec![bank]), &task).unwrap_err().to_string();
    assert!(refused.starts_with("bank 0: the weights of starts must be"), "{refused}");
}

/// An end of the caller's own begins the next episode as the autoreset says.
#[test]
fn episodes_end_on_demand() {
    for autoreset in [Autoreset::SameStep, Autoreset::NextStep, Autoreset::Disabled] {
        let scene = floor();
        let task = Walking::new(&scene, Default::default()).unwrap();
        let config = BatchConfig { worlds: 2, autoreset, ..BatchConfig::new(vec![Bank::standing(scene)]) };
        let mut batch = Batch::new(config, &task).unwrap();
        let mut outputs = Outputs::new(&batch);
        batch.step(&[0.0; 30], &mut outputs.buffers()).unwrap();
        batch.end_episodes(&[true, false], &mut outputs.observation).unwrap();
        let steps = |batch: &Batch| [0, 1].map(|world| batch.row(world).unwrap().step);
        assert_eq!(steps(&batch), [u64::from(autoreset != Autoreset::SameStep), 1]);
        let stepped = batch.step(&[0.0; 30], &mut outputs.buffers());
        match autoreset {
            Autoreset::SameStep => assert_eq!(steps(&batch), [1, 2]),
            Autoreset::NextStep => assert_eq!(steps(&batch), [0, 2]),
            Autoreset::Disabled => assert!(matches!(stepped, Err(BatchError::Ended { world: 0 })), "{stepped:?}"),
        }
    }
}
