//! Compares replays with the rows that were recorded.

use std::collections::BTreeMap;
use std::io::Read;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use fiatlux_bag::{Bag, BagError, BagWriter, Patience, Unsimulated, convert, simulate_with, topic};
use fiatlux_proto::Message;
use fiatlux_proto::foxglove::CompressedImage;
use fiatlux_proto::v3::{DepthImage, EpisodeHeader, Image, LabelImage, Observation, Sensor};
use fiatlux_replay::{POSE, Poster, Replay, ReplayError, flag, standalone};
use fiatlux_rules::{Row, Task, errand};
use fiatlux_wire::{state_message, time_of};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

use crate::common::{Random, play, pose, read_track, unplaned};

/// A tenth of a millimetre, and of a thousandth for a unit quaternion: the grid's error along a whole arm or leg.
const CLOSE: f32 = 1e-4;

/// True for equal poses, up to [`CLOSE`].
fn is_near(found: &[f32], expected: &[f32]) -> bool {
    // A quaternion and its negative are the same rotation.
    let sign = (3..7).map(|i| found[i] * expected[i]).sum::<f32>().signum();
    (0..7).all(|i| (found[i] - if i < 3 { 1.0 } else { sign } * expected[i]).abs() < CLOSE)
}

/// Guards what is seen: every frame is where the robot's kinematics on the unrounded rows have it.
#[test]
fn poses_are_those_of_the_robots_kinematics() {
    let played = play("kinematics", Task::S05, 3);
    let replay = Replay::open(&played.bag).unwrap();
    let (document, track) = (replay.document(), read_track(&replay));
    assert_eq!(document.notes, Vec::<String>::new());
    assert_eq!((track.steps.len(), track.kept_steps.len()), (played.rows.len(), played.rows.len()));
    let robot = &played.scene.robot;
    for (index, row) in played.rows.iter().enumerate() {
        assert_eq!((track.steps[index], track.kept_steps[index]), (row.step as u32, row.step as u32));
        let links = robot.forward_kinematics(&row.joint_position, &row.robot.pose).unwrap();
        let props =
            [row.things[errand::LADDER].pose, row.things[errand::OLD_BULB].pose, row.things[errand::FRESH_BULB].pose];
        let expected: Vec<f32> = links.iter().chain(&props).flat_map(pose).collect();
        let found = &track.numbers[index * track.width..][..expected.len()];
        let frames = found.chunks(POSE).zip(expected.chunks(POSE));
        frames
            .enumerate()
            .for_each(|(frame, (found, expected))| assert!(is_near(found, expected), "row {index}, {frame}"));
        assert_eq!(document.stage.frames.len() * POSE, expected.len());
    }
}

/// Two outside references: the poses of the palms from the engine, and the frames that the bag holds for Foxglove, each
/// relative to its parent and multiplied out here.
#[test]
fn poses_are_those_of_the_engine_and_of_the_bags_frames() {
    let played = play("engine", Task::S09, 5);
    let replay = Replay::open(&played.bag).unwrap();
    let (frames, track) = (&replay.document().stage.frames, read_track(&replay));
    let pose_of = |row: usize, frame: usize| -> [f32; POSE] {
        track.numbers[row * track.width + frame * POSE..][..POSE].try_into().unwrap()
    };
    let near = |found: [f32; POSE], expected: [f32; POSE], what: &str| {
        assert!(is_near(&found, &expected), "{what}: {found:?} is not {expected:?}");
    };
    for (index, row) in played.rows.iter().enumerate() {
        for (side, palm) in played.scene.robot.palms().iter().enumerate() {
            near(pose_of(index, *palm), pose(&row.world_from_palm[side]), "palm");
        }
    }
    let bag = Bag::open(&played.bag).unwrap();
    for (index, transforms) in bag.frames().enumerate() {
        let mut world_from: BTreeMap<String, Isometry3<f64>> = BTreeMap::new();
        world_from.insert("world".into(), Isometry3::identity());
        for transform in transforms.unwrap().transforms {
            let (t, q) = (transform.translation.unwrap(), transform.rotation.unwrap());
            let turn = UnitQuaternion::from_quaternion(Quaternion::new(q.w, q.x, q.y, q.z));
            let here = Isometry3::from_parts(Translation3::from(Vector3::new(t.x, t.y, t.z)), turn);
            let pose = world_from[&transform.parent_frame_id] * here;
            world_from.insert(transform.child_frame_id, pose);
        }
        for (frame, named) in frames.iter().enumerate() {
            near(pose_of(index, frame), pose(&world_from[&named.name]), &named.name);
        }
    }
}

#[test]
fn conditions_and_forces_are_those_of_the_rows() {
    let played = play("conditions", Task::S11, 2);
    let replay = Replay::open(&played.bag).unwrap();
    let (document, track) = (replay.document(), read_track(&replay));
    let conditions = document.conditions.as_ref().unwrap();
    assert_eq!(conditions.in_force, "strict");
    for (index, row) in played.rows.iter().enumerate() {
        let held = &played.criteria[index];
        assert_eq!(held.len(), conditions.criteria.len());
        for (criterion, held) in held.iter().enumerate() {
            assert_eq!(track.flags[index] >> criterion & 1 == 1, *held, "row {index}, {criterion}");
        }
        assert_eq!(track.flags[index] & flag::OLD_SEATED != 0, row.attachments[0].seated);
        assert_eq!(track.flags[index] & flag::FRESH_SEATED != 0, row.attachments[1].seated);
        let force =
            errand::HAND_FORCE.iter().flat_map(|force| row.force(*force)).map(|force| force.norm()).fold(0.0, f64::max);
        assert_eq!(track.hand_force[index], force as f32);
        let floor = document.track.forces.iter().position(|force| force.by == "floor").unwrap();
        let forces = &track.numbers[(index + 1) * track.width - 3 * (document.track.forces.len() - floor)..][..3];
        let left_foot = row.force(errand::FLOOR_FORCE)[0];
        assert!(forces.iter().zip(&left_foot).all(|(found, newtons)| (f64::from(*found) - newtons).abs() < 0.01));
    }
    let force_frames: Vec<&str> =
        document.track.forces.iter().map(|force| document.stage.frames[force.frame].name.as_str()).collect();
    let by: Vec<&str> = document.track.forces.iter().map(|force| force.by).collect();
    assert_eq!(by.iter().filter(|by| **by == "floor").count(), 4);
    assert!(force_frames[4].starts_with("left_ankle") && force_frames[1].contains("left"), "{force_frames:?}");
    assert_eq!(document.rulings.len(), 2);
    assert_eq!(document.rulings[0].protocol, "strict");
    assert_eq!(document.rulings[0].end.unwrap_or("aborted"), played.cause);
    assert_eq!(document.recorded_end.as_deref(), Some(played.cause));
}

/// Guards the plots: targets and efforts are those of the rows, and the angles next to them.
#[test]
fn joints_are_those_of_the_rows() {
    let played = play("joints", Task::S09, 4);
    let replay = Replay::open(&played.bag).unwrap();
    let track = &replay.document().track;
    let count = track.joints.len();
    let stored = unplaned(replay.joints(), 2 * count);
    assert_eq!(stored.len(), 2 * count * played.rows.len());
    for (row, stored) in played.rows.iter().zip(stored.chunks(2 * count)) {
        for joint in 0..count {
            let (target, effort) = (stored[joint], stored[count + joint]);
            assert!((f64::from(target) * track.grid.pose - row.joint_target[joint]).abs() < 1e-5);
            assert!((f64::from(effort) * track.grid.effort - row.joint_effort[joint]).abs() < 1e-3);
        }
    }
}

/// Guards the size of a file: an episode of 120 s is one of at most 8 MB, also with joints as restless as here, and an episode of no time
/// one of 1.2.
#[test]
fn a_file_is_small_and_the_same_each_time() {
    let played = play("size", Task::S05, 6);
    let replay = Replay::open(&played.bag).unwrap();
    let file = standalone(&replay);
    assert_eq!(standalone(&Replay::open(&played.bag).unwrap()), file);
    let block = |name: &str| {
        let start = format!("id=\"block-{name}\">");
        let text = file.split_once(&start).unwrap().1.split_once('<').unwrap().0;
        let bytes = STANDARD.decode(text).unwrap();
        let mut unpacked = Vec::new();
        flate2::read::GzDecoder::new(&bytes[..]).read_to_end(&mut unpacked).unwrap();
        (text.len(), unpacked)
    };
    assert_eq!(block("track.bin").1, replay.track());
    assert_eq!(block("joints.bin").1, replay.joints());
    let (planes, count) = (block("meshes.bin").1, replay.meshes().len() / 4);
    assert!(replay.meshes().iter().enumerate().all(|(at, byte)| planes[at % 4 * count + at / 4] == *byte));
    let rows = ["track.bin", "joints.bin"].map(|name| block(name).0).iter().sum::<usize>();
    let whole = (file.len() - rows) + rows * 6_001 / played.rows.len();
    assert!(whole < 8_000_000, "{whole} bytes for 120 s, {rows} for {} rows", played.rows.len());
    assert!(file.len() - rows < 1_200_000, "{} bytes without rows", file.len() - rows);
}

/// Guards that memory is limited: in a long episode only some rows have poses, but all have their conditions.
#[test]
fn long_episodes_are_thinned_out() {
    let played = play("long", Task::S07, 1);
    let whole = Replay::open(&played.bag).unwrap();
    let thin = Replay::open_with(&played.bag, 15, None).unwrap();
    let (all, kept) = (read_track(&whole), read_track(&thin));
    let rows = played.rows.len();
    let stride = (0..).map(|power| 1 << power).find(|stride| rows.div_ceil(*stride) <= 15).unwrap();
    assert!(stride > 2 && thin.document().track.stride == stride);
    assert_eq!((&kept.steps, &kept.flags, &kept.hand_force), (&all.steps, &all.flags, &all.hand_force));
    assert_eq!(kept.kept_steps, (0..rows as u32).step_by(stride).collect::<Vec<u32>>());
    for (index, step) in kept.kept_steps.iter().enumerate() {
        let (here, there) = (index * kept.width, *step as usize * all.width);
        assert_eq!(kept.numbers[here..here + kept.width], all.numbers[there..there + all.width]);
    }
    assert!(thin.document().notes.iter().any(|note| note.contains("poses stand 0.")));
}

/// Guards that the shapes are those of clips, each in an existing frame and with valid indices, and that the head
/// camera's pictures are at their steps. Pictures out of order or not in PNG are left out, and too many are thinned.
#[test]
fn pictures_are_those_of_the_bag() {
    let played = play("pictures", Task::S05, 8);
    let header = Bag::open(&played.bag).unwrap().header().clone();
    let mut random = Random(1);
    let mut record = |name: &str, sensors: Vec<Sensor>, pictures: &[(u64, &str, usize)]| {
        let bag = played.folder.join(name);
        let mut writer = BagWriter::create(&bag, &EpisodeHeader { sensors, ..header.clone() }).unwrap();
        writer.message(topic::STATE, 0, &state_message(&played.rows[0]).encode_to_vec()).unwrap();
        for (step, format, length) in pictures {
            // Data that compresses well would be refused as a bomb.
            let data = (0..*length).map(|_| random.below(256) as u8).collect();
            let timestamp = Some(time_of(*step));
            let image = CompressedImage { timestamp, data, format: (*format).into(), ..CompressedImage::default() };
            writer.message(topic::CAMERA, *step, &image.encode_to_vec()).unwrap();
        }
        writer.finish_cut("enough").unwrap();
        Replay::open(&bag).unwrap()
    };
    let camera = || vec![Sensor { name: "camera".into(), recorded: true, ..Sensor::default() }];
    let few = record("few.mcap", camera(), &[(0, "png", 3), (5, "jpeg", 3), (10, "png", 2), (10, "png", 9)]);
    let counts =
        |replay: &Replay| replay.document().pictures.iter().map(|seen| (seen.sensor, seen.count)).collect::<Vec<_>>();
    assert_eq!(counts(&few), [("camera", 2)]);
    assert_eq!(
        (&few.pictures()[..8], &few.pictures()[11..19]),
        (&[0, 0, 0, 0, 3, 0, 0, 0][..], &[10, 0, 0, 0, 2, 0, 0, 0][..])
    );
    assert_eq!(few.pictures().len(), 8 + 3 + 8 + 2);
    let large: Vec<_> = (0..300).map(|step| (step, "png", 100_000)).collect();
    let many = record("many.mcap", camera(), &large);
    assert_eq!((counts(&many), many.pictures().len()), (vec![("camera", 150)], 150 * 100_008));
    assert_eq!(counts(&record("none.mcap", Vec::new(), &[])), []);
}

/// Guards that the other cameras' pictures, distances and labels are shown, sensor by sensor, and that those which are not of
/// their size, or in an earlier step, are left out.
#[test]
fn channels_are_shown_as_pictures() {
    let played = play("channels", Task::S05, 8);
    let header = Bag::open(&played.bag).unwrap().header().clone();
    let names = ["segmentation", "depth", "chest_camera"];
    let sensors = names.map(|name| Sensor { name: name.into(), recorded: true, ..Sensor::default() }).to_vec();
    let bag = played.folder.join("channels.mcap");
    let mut writer = BagWriter::create(&bag, &EpisodeHeader { sensors, ..header }).unwrap();
    writer.message(topic::STATE, 0, &state_message(&played.rows[0]).encode_to_vec()).unwrap();
    let mut say = |step: u64, observation: Observation| {
        writer.message(topic::OBSERVATION, step, &Observation { step, ..observation }.encode_to_vec()).unwrap();
    };
    let rgb = |width, height, bytes: usize| Some(Image { width, height, rgb: vec![7; bytes] });
    let metres = vec![0.0, 0.1, 1.0, f32::NAN, 50.0, f32::INFINITY];
    let depth = Some(DepthImage { width: 3, height: 2, metres });
    let labels = Some(LabelImage { width: 2, height: 1, labels: vec![0, 255] });
    say(0, Observation { chest_camera: rgb(2, 2, 12), depth, segmentation: labels, ..Observation::default() });
    for (step, picture) in [
        (1, rgb(2, 2, 11)),
        (2, rgb(u32::MAX, u32::MAX, 12)),
        (3, rgb(0, 0, 0)),
        (4, rgb(2, 2, 12)),
        (3, rgb(2, 2, 12)),
    ] {
        say(step, Observation { chest_camera: picture, ..Observation::default() });
    }
    writer.finish_cut("enough").unwrap();
    let replay = Replay::open(&bag).unwrap();
    let counts: Vec<_> = replay.document().pictures.iter().map(|seen| (seen.sensor, seen.count)).collect();
    assert_eq!(counts, [("chest_camera", 2), ("depth", 1), ("segmentation", 1)]);
    let (mut bytes, mut steps) = (replay.pictures(), Vec::new());
    let mut drawn = Vec::new();
    while !bytes.is_empty() {
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        steps.push(word(0));
        let (png, rest) = bytes[8..].split_at(word(4) as usize);
        let mut reader = png::Decoder::new(std::io::Cursor::new(png)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        drawn.push(pixels);
        bytes = rest;
    }
    assert_eq!(steps, [0, 4, 0, 0]);
    assert_eq!(drawn[0], [7; 12]);
    let greys: Vec<u8> = drawn[2].chunks(3).map(|pixel| pixel[0]).collect();
    // Nothing is black, what is near is white, and what is far can be told from nothing.
    assert_eq!((greys[0], greys[1], greys[3], greys[4], greys[5]), (0, 255, 0, 20, 20));
    assert!(greys[2] > 60 && greys[2] < 200, "{greys:?}");
    assert_eq!(drawn[3][..3], [0; 3]);
    assert_ne!(drawn[3][3..], [0; 3]);
}

#[test]
fn shapes_fit_their_description() {
    let played = play("shapes", Task::S05, 0);
    let replay = Replay::open(&played.bag).unwrap();
    let (stage, bytes) = (&replay.document().stage, replay.meshes());
    assert_eq!(bytes.len(), 4 * (6 * stage.vertices + stage.indices));
    let word = |at: usize| u32::from_le_bytes(bytes[4 * at..4 * at + 4].try_into().unwrap());
    let (mut next, mut vertices) = (0, 0);
    for mesh in &stage.meshes {
        assert_eq!(mesh.first_vertex, vertices);
        vertices += mesh.vertices;
        assert!(mesh.frame.is_none_or(|frame| frame < stage.frames.len()));
        for group in &mesh.groups {
            assert_eq!(group.first, next);
            assert!(group.count > 0 && group.count.is_multiple_of(3) && group.material < stage.materials.len());
            for index in 0..group.count {
                assert!((word(6 * stage.vertices + group.first + index) as usize) < mesh.vertices);
            }
            next += group.count;
        }
    }
    assert_eq!((vertices, next), (stage.vertices, stage.indices));
    for part in ["robot", "ladder", "old_bulb", "fresh_bulb", "fixture", "crate", "bench", "floor", "room"] {
        assert!(stage.meshes.iter().any(|mesh| mesh.part == part), "{part}");
    }
    // The same bag gives the same replay each time, and its document reads back.
    assert_eq!(Replay::open(&played.bag).unwrap(), replay);
    let json: serde_json::Value = serde_json::from_str(&replay.document_json()).unwrap();
    assert_eq!(json["episode"]["policy"], "restless");
    assert_eq!(json["stage"]["frames"][0]["name"], "pelvis");
}

/// Guards a thin bag against a machine without room for its rows: it is not called a damaged one.
#[test]
fn a_machine_without_room_says_nothing_against_a_bag() {
    simulate_with(|_, _, _| Err(Unsimulated::NoRoom("No space left on device".into())));
    let played = play("full", Task::S05, 2);
    assert!(convert(&played.bag, true).unwrap());
    let error = Replay::open(&played.bag).unwrap_err();
    assert!(matches!(&error, ReplayError::Bag(BagError::NoRoom { .. })), "{error}");
}

/// Guards that an episode becomes a still and a moving picture, and that drawing can be stopped.
#[test]
fn a_poster_is_drawn_and_can_be_stopped() {
    let played = play("poster", Task::S05, 8);
    let poster = Poster::draw(&played.bag, &Patience::new(|| true)).unwrap();
    let has = |bytes: &[u8], chunk: &[u8]| bytes.windows(4).any(|window| window == chunk);
    assert!(poster.still.starts_with(b"\x89PNG") && !has(&poster.still, b"acTL"));
    assert!(poster.clip.starts_with(b"\x89PNG") && has(&poster.clip, b"acTL") && has(&poster.clip, b"fdAT"));
    assert!(matches!(Poster::draw(&played.bag, &Patience::new(|| false)), Err(ReplayError::Stopped { .. })));
    // The still is of the end, where a goal is reached: of no other row.
    let of_row = |name: &str, row: &Row| {
        let bag = played.folder.join(name);
        let mut writer = BagWriter::create(&bag, Bag::open(&played.bag).unwrap().header()).unwrap();
        writer.message(topic::STATE, 0, &state_message(row).encode_to_vec()).unwrap();
        writer.finish_cut("enough").unwrap();
        Poster::draw(&bag, &Patience::new(|| true)).unwrap().still
    };
    let rows = &played.rows;
    assert_eq!(of_row("end.mcap", rows.last().unwrap()), poster.still);
    assert_ne!(of_row("earlier.mcap", &rows[rows.len() * 7 / 10]), poster.still);
    let small = Poster::draw_still(&played.bag, &Patience::new(|| true)).unwrap();
    assert!(small.starts_with(b"\x89PNG") && small.len() < poster.still.len());
}
