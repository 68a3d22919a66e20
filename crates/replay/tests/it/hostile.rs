//! Bags that are cut, damaged or made up: complete rows are shown, and nothing panics.

use fiatlux_bag::{Bag, BagWriter, topic};
use fiatlux_proto::Message;
use fiatlux_proto::v3::{Event, State};
use fiatlux_replay::{Bags, Replay, ReplayError, standalone};
use fiatlux_rules::{Task, errand};
use fiatlux_wire::state_message;

use crate::common::{Random, folder, play, read_track};

#[test]
fn a_cut_bag_gives_its_rows_and_says_so() {
    let played = play("cut", Task::S05, 4);
    let bytes = std::fs::read(&played.bag).unwrap();
    let whole = read_track(&Replay::open(&played.bag).unwrap());
    let path = played.folder.join("cut.mcap");
    let mut shown = 0;
    for part in 1..40 {
        std::fs::write(&path, &bytes[..bytes.len() * part / 40]).unwrap();
        let Ok(replay) = Replay::open(&path) else { continue };
        shown += 1;
        let track = read_track(&replay);
        assert_eq!(track.steps, whole.steps[..track.steps.len()]);
        assert_eq!(track.numbers, whole.numbers[..track.numbers.len()]);
        assert!(replay.document().notes.iter().any(|note| note.contains("The bag is cut")), "{part}");
    }
    assert!(shown > 5, "{shown}");
}

#[test]
fn mutated_bags_never_panic() {
    let played = play("mutated", Task::S09, 4);
    let bytes = std::fs::read(&played.bag).unwrap();
    let path = played.folder.join("mutated.mcap");
    let mut random = Random(11);
    let (mut shown, mut refused) = (0, 0);
    for _ in 0..300 {
        let mut mutated = bytes.clone();
        for _ in 0..=random.below(4) {
            // Half of the changes go to the start of the file, with header and first chunk.
            let reach = if random.below(2) == 0 { bytes.len() } else { bytes.len().min(6000) };
            let at = random.below(reach);
            match random.below(3) {
                0 => mutated[at] ^= 1 << random.below(8),
                1 => mutated[at] = random.below(256) as u8,
                _ => mutated.truncate(at.max(8)),
            }
            if mutated.len() < reach {
                break;
            }
        }
        std::fs::write(&path, &mutated).unwrap();
        match Replay::open(&path) {
            Ok(replay) => {
                read_track(&replay);
                shown += 1;
            }
            Err(error) => {
                assert!(!error.to_string().is_empty());
                refused += 1;
            }
        }
    }
    assert!(shown > 20 && refused > 20, "{shown} shown, {refused} refused");
}

/// Guards that invalid rows of a bag in a valid format are left out.
#[test]
fn rows_that_are_none_are_left_out() {
    let played = play("made_up", Task::S05, 6);
    let header = Bag::open(&played.bag).unwrap().header().clone();
    let write = |name: &str, states: Vec<State>, events: u64| {
        let mut writer = BagWriter::create(&played.folder.join(name), &header).unwrap();
        for (step, state) in states.into_iter().enumerate() {
            writer.message(topic::STATE, step as u64, &state.encode_to_vec()).unwrap();
        }
        for step in 0..events {
            let event = Event { step: u64::MAX - step, kind: "<b>\u{202e}".repeat(200), ..Event::default() };
            writer.message(topic::EVENT, 0, &event.encode_to_vec()).unwrap();
        }
        writer.finish_cut("made up").unwrap()
    };
    let good = |step: usize| state_message(&played.rows[step]);
    let empty = Replay::open(write("none.mcap", vec![State::default(); 5], 0));
    assert!(matches!(empty, Err(ReplayError::Empty { .. })));

    let mut far = good(1);
    far.robot.as_mut().unwrap().position[0] = 1e9;
    let mut flat = good(2);
    flat.things[errand::LADDER].quaternion = vec![0.0; 4];
    let mut late = good(4);
    late.step = u64::MAX;
    let path = write("some.mcap", vec![good(0), far, flat, good(3), good(3), late], 2000);
    let replay = Replay::open(&path).unwrap();
    let notes = replay.document().notes.join("\n");
    for phrase in [
        "2 rows that cannot be drawn",
        "1 row out of order",
        "rows missing between",
        "Rows from step 200000",
        "Events after the first 1000",
    ] {
        assert!(notes.contains(phrase), "{phrase}: {notes}");
    }
    let kinds = &replay.document().events[0].kind;
    assert!(kinds.chars().count() <= 301 && !kinds.contains('\u{202e}'));
    // Text from a bag is data of the page, never markup.
    assert!(!standalone(&replay).contains("<b>"));
}

#[test]
fn what_is_missing_is_said_with_the_remedy() {
    let folder = folder("missing");
    let said = Bags::find(&folder.join("none.mcap")).unwrap_err().to_string();
    assert!(said.contains("none.mcap; check that it exists"), "{said}");
    let said = Bags::find(&folder).unwrap_err().to_string();
    assert!(said.contains("there is no bag in"), "{said}");
    std::fs::write(folder.join("notes.mcap"), "no bag").unwrap();
    let bags = Bags::find(&folder).unwrap();
    let said = Replay::open(bags.file(0).unwrap()).unwrap_err().to_string();
    assert!(said.contains("notes.mcap"), "{said}");
    assert!(bags.list().entries[0].error.is_some());
}
