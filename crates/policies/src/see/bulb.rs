//! Where the bulb is that the robot works at: in the hand, or in the socket.

use fiatlux_room::bulb::SEAT_Z;
use fiatlux_room::fixture::MOUTH_HEIGHT;
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};

/// Force by which a hand feels a bulb, N, and for how many control steps it feels none before it has lost it.
const TOUCHED_N: f64 = 0.1;
const LOOSE: u32 = 25;
/// The socket no longer holds a bulb that has come out by this much, m.
const OUT_M: f64 = 0.02;
/// A plug is seated that is so near to its seat, m, and has not come nearer by a step, m, for so many control steps.
const SEATED_M: f64 = 0.010;
const NEARER_M: f64 = 1e-3;
const STOPS: u64 = 40;
/// A plug nearer to its seat than this, m, is inside the socket's mouth, and the share by which it is moved onto the axis in a control step.
const INSIDE_M: f64 = 0.027;
const _: () = assert!(SEATED_M < INSIDE_M && INSIDE_M < MOUTH_HEIGHT);
const GUIDED: f64 = 0.1;

/// A bulb, and whether the socket holds it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bulb {
    pub pose: Isometry3<f64>,
    pub is_seated: bool,
}

/// The old bulb: in the socket, and once the hand that feels it pulls, in the hand.
#[derive(Debug, Default)]
pub(super) struct Old {
    hand_from_bulb: Option<Isometry3<f64>>,
    loose: u32,
}

impl Old {
    /// Goes on by a control step, with the largest force on the hand, N.
    pub fn step(&mut self, pulls: bool, force: f64, hand: &Isometry3<f64>, socket: &Isometry3<f64>) -> Bulb {
        self.loose = if force > TOUCHED_N { 0 } else { self.loose + 1 };
        if !pulls || self.loose > LOOSE {
            self.hand_from_bulb = None;
            return Bulb { pose: *socket, is_seated: true };
        }
        let pose = hand * *self.hand_from_bulb.get_or_insert_with(|| hand.inv_mul(socket));
        Bulb { pose, is_seated: socket.inv_mul(&pose).translation.vector.norm() < OUT_M }
    }
}

/// The fresh bulb: in the hand, and once it went in as far as it goes, in the socket.
#[derive(Debug)]
pub(super) struct Fresh {
    is_seated: bool,
    /// Least distance of the plug from the seat, m, and the control step of it.
    deepest: (f64, u64),
    /// By how much it is taken to be elsewhere than the hand has it, across the socket's axis, m: found where the socket guides it.
    off: Vector3<f64>,
}

impl Fresh {
    pub fn new() -> Self {
        Self { is_seated: false, deepest: (f64::INFINITY, 0), off: Vector3::zeros() }
    }

    /// Goes on by a control step.
    pub fn step(&mut self, step: u64, inserts: bool, hand: &Isometry3<f64>, socket: &Isometry3<f64>) -> Bulb {
        if self.is_seated {
            return Bulb { pose: *socket, is_seated: true };
        }
        let plug = |bulb: &Isometry3<f64>| (bulb * Point3::new(0.0, 0.0, SEAT_Z)).coords;
        let in_hand = hand * hand_from_bulb();
        let axis = socket.rotation * Vector3::z();
        let from_seat = plug(&in_hand) - plug(socket);
        let gap = from_seat.dot(&axis);
        if inserts && gap < INSIDE_M {
            // The socket guides it: it is on the axis.
            self.off += GUIDED * (gap * axis - from_seat - self.off);
        }
        if !inserts || gap < self.deepest.0 - NEARER_M {
            self.deepest = (gap, step);
        }
        self.is_seated = inserts && gap < SEATED_M && step > self.deepest.1 + STOPS;
        Bulb { pose: Translation3::from(self.off) * in_hand, is_seated: false }
    }
}

/// The bulb in the right hand where a task begins with it there, once the fingers have closed on it and it has settled: the mean of 64 rooms,
/// which differ by 1 mm and 0.01 rad at most.
fn hand_from_bulb() -> Isometry3<f64> {
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(0.1539, -0.9699, -0.1324, -0.1318));
    Isometry3::from_parts(Vector3::new(-0.1020, -0.1727, 0.1066).into(), turn)
}
