//! A hand that closes on a bulb, wrist held fixed, with gravity from six sides.

use fiatlux_rules::errand;
use std::f64::consts::{FRAC_PI_2, PI};

use fiatlux_robot::GainSet;
use fiatlux_tests::grasp::{close_hand, grip_targets};
use fiatlux_tests::{Rig, robot, scene};
use fiatlux_world::{PHYSICS_DT, SceneKind, ShapeOwner};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

const FINGERS: [&str; 5] = ["thumb", "index", "middle", "ring", "pinky"];
/// Those that hold the bulb; the others may touch it.
const GRASPING: [&str; 3] = ["thumb", "index", "middle"];

/// A bulb in the right hand of a robot that is locked but for that hand, turned so that gravity comes from one side.
struct Grip {
    rig: Rig,
    /// Largest force on any body of the hand so far, N.
    peak: f64,
}

impl Grip {
    fn new(world_from_pelvis: UnitQuaternion<f64>) -> Self {
        let mut rig = Rig::new(&scene(SceneKind::CoupledLadder, 0, robot().gains(GainSet::Fiatlux)));
        // High above everything, so that only the hand touches the bulb.
        rig.place_robot(&Isometry3::from_parts(Vector3::new(0.0, 0.0, 2.6).into(), world_from_pelvis));
        close_hand(&mut rig);
        Self { rig, peak: 0.0 }
    }

    /// Runs for a time; returns the lowest and highest force of each finger over its steps, N.
    fn run(&mut self, seconds: f64) -> [[f64; 2]; 5] {
        let mut ranges = [[f64::INFINITY, 0.0]; 5];
        for _ in 0..(seconds / PHYSICS_DT).round() as usize {
            self.rig.step();
            for (_, force) in self.forces() {
                self.peak = self.peak.max(force.norm());
            }
            for (range, force) in ranges.iter_mut().zip(self.finger_forces()) {
                *range = [range[0].min(force), range[1].max(force)];
            }
        }
        self.rig.update();
        ranges
    }

    /// Force of the bulb on each link that it touches, N.
    fn forces(&self) -> Vec<(String, Vector3<f64>)> {
        let mut forces: Vec<(String, Vector3<f64>)> = Vec::new();
        let touching = self.rig.contacts_between(|o| matches!(o, ShapeOwner::Robot(_)), |o| o == ShapeOwner::OLD_BULB);
        for (owner, contact) in touching {
            let ShapeOwner::Robot(link) = owner else { continue };
            let name = &self.rig.scene.robot.links()[link].name;
            match forces.iter_mut().find(|(known, _)| known == name) {
                Some((_, force)) => *force += contact.force,
                None => forces.push((name.clone(), contact.force)),
            }
        }
        forces
    }

    /// Magnitude of the sum over each finger's links, N.
    fn finger_forces(&self) -> [f64; 5] {
        let forces = self.forces();
        FINGERS.map(|finger| {
            let of_finger = forces.iter().filter(|(name, _)| name.starts_with("R_") && name.contains(finger));
            of_finger.map(|(_, force)| *force).sum::<Vector3<f64>>().norm()
        })
    }

    /// The bulb in the hand's frame.
    fn hand_from_bulb(&self) -> Isometry3<f64> {
        let hand = self.rig.link_pose(&self.rig.scene.config.start.carry.hand_link);
        hand.inverse() * self.rig.pose(self.rig.scene.body(errand::OLD_BULB).unwrap())
    }
}

#[test]
fn a_closed_hand_holds_a_bulb_against_gravity_from_six_sides_and_lets_go_of_it() {
    let about = |axis: Vector3<f64>, angle: f64| UnitQuaternion::from_scaled_axis(axis * angle);
    let sides = [
        about(Vector3::x(), 0.0),
        about(Vector3::x(), FRAC_PI_2),
        about(Vector3::x(), -FRAC_PI_2),
        about(Vector3::x(), PI),
        about(Vector3::y(), FRAC_PI_2),
        about(Vector3::y(), -FRAC_PI_2),
    ];
    for (side, turn) in sides.into_iter().enumerate() {
        let mut grip = Grip::new(turn);
        grip.run(0.5);
        let settled = grip.hand_from_bulb();
        grip.run(8.5);
        let ranges = grip.run(1.0);
        let held = grip.hand_from_bulb();
        let slip = (held.translation.vector - settled.translation.vector).norm();
        let printed: Vec<String> =
            FINGERS.iter().zip(&ranges).map(|(f, [low, high])| format!("{f} {low:.2}..{high:.2}")).collect();
        println!(
            "side {side}: {} N in the last second, peak of any body {:.1} N, slip in 9.5 s {:.2} mm",
            printed.join(", "),
            grip.peak,
            1e3 * slip
        );
        assert!(slip < 0.005, "side {side}: slipped {slip} m");
        for (finger, [low, high]) in FINGERS.iter().zip(ranges) {
            let ok = if GRASPING.contains(finger) { low >= 6.0 && high <= 18.0 } else { high < 1.0 };
            assert!(ok, "side {side}: {finger} presses with {low} to {high} N");
        }
        assert!(grip.peak < 35.0, "side {side}: peak {} N", grip.peak);
        assert_eq!(grip.rig.unconverged, 0);

        let scene = grip.rig.scene.clone();
        for (joint, _) in grip_targets(&scene) {
            grip.rig.targets[scene.robot_ids.joints[joint].drive] = 0.0;
        }
        grip.run(1.0);
        let left = grip.forces().iter().map(|(_, force)| force.norm()).fold(0.0, f64::max);
        assert!(left < 1.0, "side {side}: an open hand still presses with {left} N");
    }
}
