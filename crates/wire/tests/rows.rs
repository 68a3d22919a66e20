//! A row goes through a message and its bytes without losing a bit, and a message of another shape is refused.

#[path = "../../rules/tests/common/mod.rs"]
mod common;

use common::{Draw, LAYOUT, joint_groups, room};
use fiatlux_proto::{Message, v3};
use fiatlux_rules::{BodyRow, JointGroups, Row, RowDigest, errand, manifest};
use fiatlux_wire::{WireError, joint_groups_message, joint_groups_of, read_row, state_message};
use nalgebra::Isometry3;

/// Everything set to something of its own.
fn full(draw: &mut Draw, step: u64) -> Row {
    let mut row = draw.row(step);
    row.things[errand::FIXTURE].pose = draw.pose(2.0);
    row.things[errand::CRATE].pose = draw.pose(2.0);
    row.world_from_palm = [draw.pose(1.0), draw.pose(1.0)];
    row.forces.fill_with(|| draw.vector(3.0));
    row.loads.fill_with(|| draw.unit().abs());
    row.load_mut(errand::FLOOR_LOAD)[0] = -0.5;
    for number in row.joint_target.iter_mut().chain(&mut row.joint_effort) {
        *number = draw.unit();
    }
    row.attachments[0].steps_beyond = 3;
    row.attachments[1].steps_beyond = u32::MAX;
    row.unconverged = 2;
    (row.retried, row.joint_speed_peak, row.penetration) = (3, 12.5, 0.004);
    row
}

fn digest(row: &Row) -> [u8; 32] {
    let mut digest = RowDigest::new(b"wire");
    digest.push(row);
    digest.bytes()
}

/// The digest sees every number's bits.
#[test]
fn rows_come_back_bit_for_bit() {
    let mut draw = Draw(11);
    for step in (0..200).chain([u64::MAX]) {
        let row = full(&mut draw, step);
        let bytes = state_message(&row).encode_to_vec();
        let state = v3::State::decode(&bytes[..]).expect("decodes");
        let back = read_row(&state, LAYOUT).expect("a row");
        assert_eq!(back, row);
        assert_eq!(digest(&back), digest(&row));
        assert_eq!(state_message(&back).encode_to_vec(), bytes);
    }
}

/// Quaternions that are not quite of unit length, negative zero and the smallest numbers pass as they are.
#[test]
fn odd_numbers_come_back_bit_for_bit() {
    let mut row = full(&mut Draw(5), 7);
    row.robot.pose.rotation.as_mut_unchecked().coords *= 1.0 + 1e-9;
    row.joint_velocity[0] = -0.0;
    row.com_velocity.x = f64::MIN_POSITIVE / 2.0;
    let state = v3::State::decode(&state_message(&row).encode_to_vec()[..]).expect("decodes");
    let back = read_row(&state, LAYOUT).expect("a row");
    assert_eq!(digest(&back), digest(&row));
    assert_eq!(back.joint_velocity[0].to_bits(), (-0.0_f64).to_bits());
}

/// Where a world went no further, the state is finite and the peak speed is not.
#[test]
fn a_row_of_a_world_that_stopped_comes_back() {
    let mut row = full(&mut Draw(6), 8);
    row.joint_speed_peak = f64::INFINITY;
    let state = v3::State::decode(&state_message(&row).encode_to_vec()[..]).expect("decodes");
    assert_eq!(read_row(&state, LAYOUT), Ok(row));
}

/// A message with one list too short or too long, or a part missing.
type Spoil = (&'static str, fn(&mut v3::State));

fn shorten(list: &mut Vec<f64>) {
    list.pop();
}

fn body(body: &mut Option<v3::Body>) -> &mut v3::Body {
    body.as_mut().expect("a body")
}

/// Things that a scene lacks come back as absent.
#[test]
fn absent_things_stay_absent() {
    let mut row = full(&mut Draw(7), 9);
    let whole = digest(&row);
    for thing in [errand::LADDER, errand::CRATE] {
        row.present[thing] = false;
        row.things[thing] = BodyRow::at_rest(Isometry3::identity());
    }
    let state = v3::State::decode(&state_message(&row).encode_to_vec()[..]).expect("decodes");
    assert_eq!(state.things[errand::LADDER], v3::Body::default());
    let back = read_row(&state, LAYOUT).expect("a row");
    assert_eq!(digest(&back), digest(&row));
    assert_ne!(digest(&back), whole);
    assert_eq!(back, row);
}

/// Groups of joints come back as they were; those of joints that the robot lacks are refused.
#[test]
fn joint_groups_go_through_a_header() {
    let joint_names = vec![String::new(); LAYOUT.joints];
    let header =
        |groups| v3::EpisodeHeader { joint_names: joint_names.clone(), joint_groups: groups, ..Default::default() };
    let groups = joint_groups_message(&joint_groups());
    assert_eq!(joint_groups_of(&header(Some(groups.clone()))), Ok(joint_groups()));
    assert_eq!(joint_groups_of(&header(None)), Ok(JointGroups::default()));
    let refused = |change: fn(&mut v3::JointGroups)| {
        let mut groups = groups.clone();
        change(&mut groups);
        joint_groups_of(&header(Some(groups))).expect_err("a refusal").to_string()
    };
    let message = "joint_groups.fingers has index 53; the robot has 53 joints, counted from 0";
    assert_eq!(refused(|groups| groups.fingers.push(53)), message);
    let message = "joint_groups.ankle_limits has 7 numbers instead of 8";
    assert_eq!(refused(|groups| groups.ankle_limits.truncate(7)), message);
    let message = "joint_groups.ankle_limits has a number that is not finite";
    assert_eq!(refused(|groups| groups.ankle_limits[1] = f64::NAN), message);
}

/// First place of a measure in the loads.
fn place(name: &str) -> usize {
    let contact = manifest().contacts.iter().find(|contact| contact.name == name).expect("a measure");
    contact.range(LAYOUT).start
}

#[test]
fn other_shapes_are_refused() {
    let spoils: &[Spoil] = &[
        ("joint_effort has a number that is not finite", |s| s.joint_effort[1] = f64::NAN),
        ("action has a number that is not finite", |s| s.action[2] = f64::NEG_INFINITY),
        ("robot has a number that is not finite", |s| body(&mut s.robot).position[0] = f64::INFINITY),
        ("forces has a number that is not finite", |s| s.forces[11] = f64::INFINITY),
        ("loads has a number that is not finite", |s| s.loads[0] = f64::NAN),
        ("joint_speed_peak is NaN; it must be zero or above", |s| s.joint_speed_peak = f64::NAN),
        ("joint_speed_peak is -1; it must be zero or above", |s| s.joint_speed_peak = -1.0),
        ("penetration is -0.5; it must be zero or above", |s| s.penetration = -0.5),
        ("penetration has a number that is not finite", |s| s.penetration = f64::INFINITY),
        ("robot is missing", |s| s.robot = None),
        ("things has 4 numbers instead of 5", |s| drop(s.things.pop())),
        ("attachments has 3 numbers instead of 2", |s| s.attachments.push(v3::Attachment::default())),
        ("crate has a velocity", |s| s.things[errand::CRATE].linear_velocity = vec![0.0; 3]),
        ("ladder has a velocity", |s| {
            let velocity = s.things[errand::LADDER].linear_velocity.clone();
            s.things[errand::LADDER] = v3::Body { linear_velocity: velocity, ..v3::Body::default() };
        }),
        ("old_bulb has 0 numbers instead of 4", |s| s.things[errand::OLD_BULB].quaternion.clear()),
        ("robot has 2 numbers instead of 3", |s| shorten(&mut body(&mut s.robot).position)),
        ("robot has 5 numbers instead of 4", |s| body(&mut s.robot).quaternion.push(0.0)),
        ("ladder has 4 numbers instead of 3", |s| s.things[errand::LADDER].linear_velocity.push(0.0)),
        ("ladder has 0 numbers instead of 3", |s| s.things[errand::LADDER].angular_velocity.clear()),
        ("fixture has 3 numbers instead of 4", |s| shorten(&mut s.things[errand::FIXTURE].quaternion)),
        ("com_velocity has 2", |s| shorten(&mut s.com_velocity)),
        ("left_palm is missing", |s| s.left_palm = None),
        ("right_palm has 2", |s| s.right_palm.iter_mut().for_each(|pose| shorten(&mut pose.position))),
        ("old_bulb.other_force_peak is -1", |s| s.loads[place("old_bulb.other_force_peak")] = -1.0),
        ("fresh_bulb.hand_force_peak is -0.1", |s| s.loads[place("fresh_bulb.hand_force_peak")] = -0.1),
        ("joint_position has 52 numbers instead of 53", |s| shorten(&mut s.joint_position)),
        ("joint_velocity has 54", |s| s.joint_velocity.push(0.0)),
        ("joint_target has 0", |s| s.joint_target.clear()),
        ("joint_effort has 52", |s| shorten(&mut s.joint_effort)),
        ("action has 54", |s| s.action.push(0.0)),
        ("forces has 227 numbers instead of 228", |s| shorten(&mut s.forces)),
        ("loads has 79 numbers instead of 78", |s| s.loads.push(0.0)),
    ];
    for (expected, spoil) in spoils {
        let mut state = state_message(&room());
        spoil(&mut state);
        let error = read_row(&state, LAYOUT).expect_err(expected).to_string();
        assert!(error.contains(expected), "{expected}: {error}");
    }
    assert!(matches!(read_row(&v3::State::default(), LAYOUT), Err(WireError::Missing { .. })));
}

/// A grade starts the chain from the link in a bag's header.
#[test]
fn a_chain_goes_on_from_a_link() {
    let (row, mut chain) = (room(), RowDigest::new(b"wire"));
    let mut other = RowDigest::from_hex(&chain.hex()).expect("a link");
    chain.push(&row);
    other.push(&row);
    assert_eq!(chain.hex(), other.hex());
    for link in ["", "0", "zz", &"0".repeat(63), &"0".repeat(66), &"+1".repeat(32), &"\u{e9}".repeat(32)] {
        assert!(RowDigest::from_hex(link).is_none(), "{link}");
    }
}
