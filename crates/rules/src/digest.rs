//! The digest chain over rows: what "bit for bit the same" means.

use nalgebra::Isometry3;
use sha2::{Digest, Sha256};

use crate::row::{BodyRow, Row};

/// Name and version of the layout below; it is hashed first, so that digests of different layouts never meet.
pub const ROW_LAYOUT: &str = "fiatlux-row/4";

/// A SHA-256 chain: `digest(k) = SHA-256(digest(k - 1), row k)`, started by `SHA-256(ROW_LAYOUT, 0, context)`.
///
/// A row is a sequence of little-endian f64, counts and flags included, in this order: step; counts of joints and of hand
/// bodies; root pose and velocity; joint positions, velocities, targets, efforts; action; ladder; old bulb; fresh bulb
/// (each pose and velocity); poses of fixture and crate; forces of the old bulb, then of the fresh one, on the hand bodies;
/// their peaks in the same order; forces of the floor, then of the ladder, on the four limbs; per bulb seated and steps
/// beyond; unconverged steps; velocity of the centre of mass; poses of both palms; retried steps; peak joint speed;
/// penetration; peak force of other things on the old bulb, then on the fresh one; loads of the four limbs on the floor, then
/// on high treads. A pose is x, y, z, then the quaternion w, x, y, z; a velocity is linear, then angular.
#[derive(Debug, Clone)]
pub struct RowDigest {
    link: [u8; 32],
    numbers: Vec<[u8; 8]>,
}

impl RowDigest {
    /// Starts a chain; `context` is whatever else must be equal (task, seeds, config, gains, model).
    pub fn new(context: &[u8]) -> Self {
        let mut hash = Sha256::new();
        hash.update(ROW_LAYOUT);
        hash.update([0]);
        hash.update(context);
        Self { link: hash.finalize().into(), numbers: Vec::with_capacity(1024) }
    }

    /// Continues a chain from a link, such as its start, in the form of [`RowDigest::hex`]; `None` for any other text.
    pub fn from_hex(link: &str) -> Option<Self> {
        let digit = |byte: u8| char::from(byte).to_digit(16).map(|digit| digit as u8);
        let pair = |pair: &[u8]| Some(digit(*pair.first()?)? << 4 | digit(*pair.get(1)?)?);
        let bytes: Option<Vec<u8>> = link.as_bytes().chunks(2).map(pair).collect();
        Some(Self { link: bytes?.try_into().ok()?, numbers: Vec::with_capacity(1024) })
    }

    /// Continues the chain with the numbers of a row.
    pub fn push(&mut self, row: &Row) {
        self.numbers.clear();
        let numbers = &mut self.numbers;
        visit(row, &mut |list| numbers.extend(list.iter().map(|number| number.to_le_bytes())));
        self.link = Sha256::new().chain_update(self.link).chain_update(self.numbers.as_flattened()).finalize().into();
    }

    /// The digest of all rows so far.
    pub fn bytes(&self) -> [u8; 32] {
        self.link
    }

    /// The digest in hexadecimal.
    pub fn hex(&self) -> String {
        self.link.iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

fn visit(row: &Row, out: &mut impl FnMut(&[f64])) {
    let layout = row.layout();
    out(&[row.step as f64, layout.joints as f64, layout.hand_bodies() as f64]);
    visit_body(&row.robot, out);
    for joints in [&row.joint_position, &row.joint_velocity, &row.joint_target, &row.joint_effort, &row.action] {
        out(joints);
    }
    for body in [&row.ladder, &row.bulbs[0], &row.bulbs[1]] {
        visit_body(body, out);
    }
    visit_pose(&row.fixture, out);
    visit_pose(&row.crate_, out);
    row.hand_force.iter().flatten().for_each(|force| out(force.as_slice()));
    row.hand_force_peak.iter().for_each(|peaks| out(peaks));
    for force in row.floor_force.iter().chain(&row.ladder_force) {
        out(force.as_slice());
    }
    for attachment in &row.attachments {
        out(&[f64::from(u8::from(attachment.seated)), f64::from(attachment.steps_beyond)]);
    }
    out(&[f64::from(row.unconverged)]);
    out(row.com_velocity.as_slice());
    row.world_from_palm.iter().for_each(|pose| visit_pose(pose, out));
    out(&[f64::from(row.retried), row.joint_speed_peak, row.penetration]);
    [&row.other_force_peak[..], &row.floor_load, &row.tread_load].into_iter().for_each(out);
}

fn visit_body(body: &BodyRow, out: &mut impl FnMut(&[f64])) {
    visit_pose(&body.pose, out);
    out(body.linear_velocity.as_slice());
    out(body.angular_velocity.as_slice());
}

fn visit_pose(pose: &Isometry3<f64>, out: &mut impl FnMut(&[f64])) {
    let q = pose.rotation.quaternion();
    out(pose.translation.vector.as_slice());
    out(&[q.w, q.i, q.j, q.k]);
}
