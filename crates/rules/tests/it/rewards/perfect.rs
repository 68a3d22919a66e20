//! Runs without a flaw that a robot could make, played row by row in the time they take. Each term is its closed form.

use fiatlux_rules::{BodyRow, Cause, Limb};
use nalgebra::{UnitQuaternion, Vector3};

use super::*;

const LEFT_ANKLE_ROLL: usize = 5;
const LEFT_KNEE: usize = 3;
const WAIST_PITCH: usize = 14;
const RIGHT_FINGERS: std::ops::Range<usize> = 41..53;

/// Rows of a run, written stage by stage.
struct Script {
    rows: Vec<Row>,
    /// Where the next stage starts: all at rest.
    now: Row,
    carried: Option<usize>,
}

impl Script {
    fn from(start: Row) -> Self {
        Self { rows: vec![start.clone()], now: start, carried: None }
    }

    /// A stage: `change` gets the state in which it starts and the part of it that is over.
    fn play(&mut self, seconds: f64, change: impl Fn(&mut Row, f64)) {
        let count = (50.0 * seconds).round();
        for k in 1..=count as u64 {
            let mut row = row_at(self.rows.len() as u64, &self.now);
            change(&mut row, k as f64 / count);
            if let Some(bulb) = self.carried {
                row.things[errand::BULBS[bulb]] = in_hand(&row);
            }
            self.rows.push(row);
        }
        self.now = self.rows.last().expect("row 0").clone();
        self.now.com_velocity = Vector3::zeros();
        for body in [&mut self.now.robot].into_iter().chain(&mut self.now.things[..errand::FIXTURE]) {
            *body = crate::common::body(body.pose);
        }
        self.now.joint_velocity.fill(0.0);
        self.now.joint_position[LEFT_ANKLE_ROLL] = 0.0;
        self.now.joint_position[WAIST_PITCH] = 0.0;
    }

    /// Straight to a place, at one speed.
    fn walk(&mut self, to: [f64; 3], seconds: f64) {
        self.play(seconds, go(self.now.robot, to, seconds));
    }

    fn face(&mut self, yaw: f64) {
        let before = yaw_of(&self.now);
        self.play(1.0, |row, part| {
            row.robot.pose.rotation = heading(before + part * (yaw - before));
            row.robot.angular_velocity.z = yaw - before;
        });
    }

    /// Up or down the ladder in 8 s: leans forward at 0.2 rad/s for 2 s and back for the last 2 s, and bends a knee at
    /// 0.5 rad/s for 4 s and stretches it again.
    fn climb(&mut self, to: [f64; 3]) {
        let (from, upright) = (self.now.robot, self.now.robot.pose.rotation);
        self.play(8.0, |row, part| {
            go(from, to, 8.0)(row, part);
            let time = 8.0 * part;
            let (lean, rate) = match time {
                t if t < 2.001 => (0.2 * t, 0.2),
                t if t < 6.001 => (0.4, 0.0),
                t => (0.2 * (8.0 - t), -0.2),
            };
            row.robot.pose.rotation = upright * UnitQuaternion::from_scaled_axis(Vector3::y() * lean);
            row.robot.angular_velocity = upright * Vector3::y() * rate;
            row.joint_position[LEFT_KNEE] = 2.0 - 0.5 * (time - 4.0).abs();
            row.joint_velocity[LEFT_KNEE] = if time < 4.001 { 0.5 } else { -0.5 };
        });
    }

    /// Moves a bulb, leaning on one ankle at its limit and bent at the waist.
    fn work(&mut self, bulb: usize, to: nalgebra::Isometry3<f64>, seconds: f64) {
        self.carried = None;
        let from = self.now.things[errand::BULBS[bulb]].pose;
        self.play(seconds, |row, part| {
            row.things[errand::BULBS[bulb]].pose = from.lerp_slerp(&to, part);
            row.joint_position[LEFT_ANKLE_ROLL] = 0.2618;
            row.joint_position[WAIST_PITCH] = 0.3;
        });
    }

    /// Twelve joints of the right hand close by half a radian; two of its bodies press by 6 N.
    fn grip(&mut self, bulb: usize) {
        self.now.joint_position[RIGHT_FINGERS].fill(0.5);
        self.now.action[RIGHT_FINGERS].fill(1.0);
        RIGHT.into_iter().for_each(|hand_body| touch(&mut self.now, bulb, hand_body, 6.0));
    }

    fn release(&mut self, bulb: usize) {
        self.carried = None;
        self.now.joint_position[RIGHT_FINGERS].fill(0.0);
        self.now.action[RIGHT_FINGERS].fill(0.0);
        let_go(&mut self.now, bulb);
    }
}

fn go(from: BodyRow, to: [f64; 3], seconds: f64) -> impl Fn(&mut Row, f64) {
    let way = Vector3::from(to) - from.pose.translation.vector;
    move |row, part| {
        row.robot.pose.translation.vector = from.pose.translation.vector + way * part;
        row.robot.linear_velocity = way / seconds;
        row.com_velocity = way / seconds;
    }
}

fn heading(yaw: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(Vector3::z() * yaw)
}

fn yaw_of(row: &Row) -> f64 {
    fiatlux_rules::measure::yaw(&row.robot.pose.rotation)
}

fn in_hand(row: &Row) -> BodyRow {
    let pose = row.robot.pose * rotated([0.35, -0.1, 0.2], Vector3::x(), 1.2);
    BodyRow { pose, ..row.robot }
}

/// The whole errand in 78.7 s.
fn errand() -> Vec<Row> {
    const NORTH: f64 = std::f64::consts::FRAC_PI_2;
    let platform = [2.0, 1.1, 1.967];
    let mut script = Script::from(start_of(Task::Replace));
    let s = &mut script;
    // To the ladder and with it under the fixture.
    s.walk([-1.2, 1.6, 0.79], 4.0);
    let (robot, ladder) = (s.now.robot, s.now.things[errand::LADDER].pose);
    s.play(10.0, |row, part| {
        go(robot, [1.8, -0.4, 0.79], 10.0)(row, part);
        row.things[errand::LADDER].pose = ladder.lerp_slerp(&at(LADDER), part);
        row.things[errand::LADDER].linear_velocity = row.robot.linear_velocity;
    });
    s.face(NORTH);
    s.walk([2.0, 0.15, 0.79], 2.0);
    s.climb(platform);
    // The old bulb out of the socket and into the hand.
    s.grip(OLD);
    s.work(OLD, fixture(), 0.5);
    s.now.attachments[OLD].seated = false;
    s.work(OLD, fixture() * at([0.0, 0.0, 0.2]), 2.0);
    s.work(OLD, in_hand(&s.now).pose, 1.0);
    s.carried = Some(OLD);
    s.climb([2.0, 0.15, 0.79]);
    s.walk([-1.2, 1.0, 0.79], 10.0);
    // Over the crate, and let go.
    let mut resting = room();
    put_in_crate(&mut resting, OLD);
    let resting = resting.things[errand::BULBS[OLD]].pose;
    s.work(OLD, at([0.0, 0.0, 0.2]) * resting, 2.0);
    s.release(OLD);
    let falling = s.now.things[errand::BULBS[OLD]].pose;
    s.play(0.2, |row, part| row.things[errand::BULBS[OLD]].pose = falling.lerp_slerp(&resting, part * part));
    // The fresh bulb from the bench into the socket.
    s.walk([-1.8, -1.17, 0.79], 5.0);
    s.grip(NEW);
    s.work(NEW, in_hand(&s.now).pose, 2.0);
    s.carried = Some(NEW);
    s.walk([2.0, 0.15, 0.79], 12.0);
    s.climb(platform);
    s.work(NEW, fixture() * at([0.0, 0.0, 0.2]), 1.0);
    s.work(NEW, fixture(), 2.0);
    let last = script.rows.last_mut().expect("row 0");
    last.things[errand::FRESH_BULB] = body(fixture());
    last.attachments[NEW].seated = true;
    script.rows
}

#[test]
fn perfect_errand() {
    let rows = errand();
    let mut meter = Meter::new(Task::Replace, Variant::Benchmark, &rows[0]);
    for row in &rows[1..] {
        assert_eq!(meter.judge.verdict().end, None);
        meter.show(row);
    }
    let end = meter.judge.verdict().end.expect("ended");
    assert_eq!((end.causes, end.step), (Causes::of(&[Cause::Success]), 3_935));

    // The ladder's top point ends 0.38 m to the side of the seat and 0.983741 m below it; the old bulb 0.11 m to the
    // side of the crate's origin and 0.0436 m above it. The start is (-3 - 0.1 sin 0.7, 1.52 + 0.1 cos 0.7, -0.983741)
    // from the seat, and a seated bulb (4, 0.48, 2.2) from the crate.
    let ladder = 5.0 * (1.0 - length(&[0.38, 0.983741]) / length(&[3.0644217687, 1.5964842187, 0.983741]));
    let disposal = 10.0 * (1.0 - length(&[0.11, 0.0436]) / length(&[4.0, 0.48, 2.2]));
    let gripping = 0.5 + 2.0 + 1.0 + 8.0 + 10.0 + 2.0 + (2.0 + 12.0 + 8.0 + 1.0 + 2.0);
    let working = 0.5 + 2.0 + 1.0 + 2.0 + 2.0 + 1.0 + 2.0;
    // Each way is walked at one speed: length^2 / time.
    let ways = [
        (4.0, 4.0),
        (13.0, 10.0),
        (0.3425, 2.0),
        (0.9025, 8.0),
        (0.9025, 8.0),
        (10.9625, 10.0),
        (5.0689, 5.0),
        (16.1824, 12.0),
        (0.9025, 8.0),
    ];
    let sway: f64 = ways.iter().map(|(squared_length, time)| squared_length / time).sum();
    let expected = [
        ("ladder_progress", ladder),
        ("fresh_bulb_progress", 10.0),
        ("old_bulb_removal", 5.0),
        ("old_bulb_disposal_progress", disposal),
        ("ladder_ready", 2.0),
        ("fresh_bulb_inserted", 5.0),
        ("old_bulb_removed", 3.0),
        ("old_bulb_disposed", 5.0),
        ("success_bonus", 10.0),
        ("robot_fall", 0.0),
        ("ladder_tipped", 0.0),
        ("fresh_bulb_dropped", 0.0),
        ("old_bulb_dropped", 0.0),
        // Two bodies at 6 N.
        ("contact_penalty", -1e-3 * 72.0 * gripping),
        ("diverged", 0.0),
        ("com_sway", -0.1 * sway),
        // Three climbs, each with 4 s at 0.2 rad/s.
        ("ang_vel_xy", -0.05 * 3.0 * 4.0 * 0.04),
        // The hand closes, opens and closes.
        ("action_rate", -0.005 * 0.02 * 3.0 * 12.0),
        // Three climbs, each with jumps of a knee's speed by 0.5, 1 and 0.5 rad/s in one step.
        ("joint_acceleration", -1.25e-7 * 0.02 * 3.0 * 1.5 / 0.0004),
        ("ankle_limits", -0.02618 * working),
        ("waist_deviation", -0.1 * 0.3 * working),
        ("finger_deviation", -0.05 * 6.0 * gripping),
    ];
    check(&meter, &expected);
    let earned: f64 = meter.paid[..9].iter().map(|(_, paid)| paid).sum();
    assert!((earned - 53.274531254).abs() < 1e-9, "{earned}");
    // A closed hand is dear: 14.55 of the 19.29 that the penalties take are the fingers' deviation.
    assert!((meter.total() - 33.988188046).abs() < 1e-9, "{}", meter.total());
}

/// Climbs, slips by a tenth of a metre, climbs on and arrives, three limbs on the ladder at all times.
#[test]
fn perfect_climb() {
    let mut start = start_of(Task::Climb);
    for limb in [Limb::LeftFoot, Limb::RightFoot, Limb::LeftPalm] {
        start.force_mut(errand::LADDER_FORCE)[limb as usize].z = 80.0;
    }
    let mut script = Script::from(start);
    script.walk([1.0, 0.0, 1.3], 4.0);
    script.walk([1.0, 0.0, 1.2], 0.5);
    script.walk([1.5, 0.0, 1.81], 4.0);
    script.walk([1.5, 0.0, 1.83], 0.02);
    let mut meter = Meter::new(Task::Climb, Variant::Benchmark, &script.rows[0]);
    script.rows[1..].iter().for_each(|row| meter.show(row));
    let end = meter.judge.verdict().end.expect("ended");
    assert_eq!((end.causes, end.step), (Causes::of(&[Cause::Success]), 426));
    check(
        &meter,
        &[
            // The loss of the slip is not paid again.
            ("height_gain", 10.0 * (1.83 - 0.79)),
            ("limb_contact", 0.25 * 0.75 * 8.52),
            ("success_bonus", 10.0),
            ("robot_fall", 0.0),
            ("diverged", 0.0),
            ("com_sway", -0.5 * (0.0625 / 4.0 + 0.25 / 4.0)),
            ("ang_vel_xy", 0.0),
            ("action_rate", 0.0),
            ("joint_acceleration", 0.0),
            ("ankle_limits", 0.0),
            ("waist_deviation", 0.0),
            ("finger_deviation", 0.0),
        ],
    );
    assert!(close(meter.total(), 21.9584375), "{}", meter.total());
}

fn length(components: &[f64]) -> f64 {
    components.iter().map(|c| c * c).sum::<f64>().sqrt()
}

/// All terms, in their order, and what each has paid.
fn check(meter: &Meter, expected: &[(&str, f64)]) {
    assert!(meter.paid.iter().map(|(name, _)| *name).eq(expected.iter().map(|(name, _)| *name)), "{:?}", meter.paid);
    for (name, pays) in expected {
        assert!(close(meter.paid(name), *pays), "{name}: {} for {pays}", meter.paid(name));
    }
}
