//! A row goes through a message and its bytes without losing a bit, and a message of another shape is refused.

#[path = "../../rules/tests/common/mod.rs"]
mod common;

use common::{Draw, LAYOUT, room};
use fiatlux_proto::{Message, v3};
use fiatlux_rules::{Row, RowDigest};
use fiatlux_wire::{WireError, read_row, state_message};

/// Everything set to something of its own.
fn full(draw: &mut Draw, step: u64) -> Row {
    let mut row = draw.row(step);
    row.fixture = draw.pose(2.0);
    row.crate_ = draw.pose(2.0);
    row.world_from_palm = [draw.pose(1.0), draw.pose(1.0)];
    row.other_force_peak = [draw.unit().abs(), draw.unit().abs()];
    for load in row.floor_load.iter_mut().chain(&mut row.tread_load) {
        *load = draw.unit();
    }
    for number in
        row.joint_target.iter_mut().chain(&mut row.joint_effort).chain(row.hand_force_peak.iter_mut().flatten())
    {
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

fn bulb(bulb: &mut Option<v3::Bulb>) -> &mut v3::Bulb {
    bulb.as_mut().expect("a bulb")
}

#[test]
fn other_shapes_are_refused() {
    let spoils: &[Spoil] = &[
        ("joint_effort has a number that is not finite", |s| s.joint_effort[1] = f64::NAN),
        ("action has a number that is not finite", |s| s.action[2] = f64::NEG_INFINITY),
        ("robot has a number that is not finite", |s| body(&mut s.robot).position[0] = f64::INFINITY),
        ("ladder_force has a number that is not finite", |s| s.ladder_force[11] = f64::INFINITY),
        ("floor_force has a number that is not finite", |s| s.floor_force[0] = f64::NAN),
        ("joint_speed_peak is NaN; it must be zero or above", |s| s.joint_speed_peak = f64::NAN),
        ("joint_speed_peak is -1; it must be zero or above", |s| s.joint_speed_peak = -1.0),
        ("penetration is -0.5; it must be zero or above", |s| s.penetration = -0.5),
        ("penetration has a number that is not finite", |s| s.penetration = f64::INFINITY),
        ("robot is missing", |s| s.robot = None),
        ("ladder is missing", |s| s.ladder = None),
        ("old_bulb is missing", |s| s.old_bulb = None),
        ("fresh_bulb is missing", |s| s.fresh_bulb = None),
        ("fresh_bulb.body is missing", |s| bulb(&mut s.fresh_bulb).body = None),
        ("fixture is missing", |s| s.fixture = None),
        ("crate is missing", |s| s.crate_ = None),
        ("robot has 2 numbers instead of 3", |s| shorten(&mut body(&mut s.robot).position)),
        ("robot has 5 numbers instead of 4", |s| body(&mut s.robot).quaternion.push(0.0)),
        ("ladder has 4 numbers instead of 3", |s| body(&mut s.ladder).linear_velocity.push(0.0)),
        ("ladder has 0 numbers instead of 3", |s| body(&mut s.ladder).angular_velocity.clear()),
        ("fixture has 3 numbers instead of 4", |s| s.fixture.iter_mut().for_each(|pose| shorten(&mut pose.quaternion))),
        ("com_velocity has 2", |s| shorten(&mut s.com_velocity)),
        ("left_palm is missing", |s| s.left_palm = None),
        ("right_palm has 2", |s| s.right_palm.iter_mut().for_each(|pose| shorten(&mut pose.position))),
        ("floor_load has 3", |s| shorten(&mut s.floor_load)),
        ("tread_load has 5", |s| s.tread_load.push(0.0)),
        ("old_bulb.other_force_peak is -1", |s| bulb(&mut s.old_bulb).other_force_peak = -1.0),
        ("other_force_peak", |s| bulb(&mut s.fresh_bulb).other_force_peak = f64::INFINITY),
        ("joint_position has 52 numbers instead of 53", |s| shorten(&mut s.joint_position)),
        ("joint_velocity has 54", |s| s.joint_velocity.push(0.0)),
        ("joint_target has 0", |s| s.joint_target.clear()),
        ("joint_effort has 52", |s| shorten(&mut s.joint_effort)),
        ("action has 54", |s| s.action.push(0.0)),
        ("hand_force has 101 numbers instead of 102", |s| shorten(&mut bulb(&mut s.old_bulb).hand_force)),
        ("hand_force has 105", |s| bulb(&mut s.fresh_bulb).hand_force.extend([0.0; 3])),
        ("old_bulb.hand_force_peak has 33 numbers instead of 34", |s| {
            shorten(&mut bulb(&mut s.old_bulb).hand_force_peak);
        }),
        ("fresh_bulb.hand_force_peak has 35", |s| bulb(&mut s.fresh_bulb).hand_force_peak.push(0.0)),
        ("ladder_force has 11 numbers instead of 12", |s| shorten(&mut s.ladder_force)),
        ("floor_force has 11 numbers instead of 12", |s| shorten(&mut s.floor_force)),
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
