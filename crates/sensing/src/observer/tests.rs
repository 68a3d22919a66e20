#![allow(clippy::unwrap_used)]

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

use fiatlux_robot::{GainSet, Robot};
use nalgebra::UnitQuaternion;

use super::*;
use fiatlux_world::{Random, Scene, SceneConfig, SceneKind, SceneSpec, Stream, World};

/// The G1 with Inspire hands.
const JOINTS: usize = 53;

const SEED: Option<NoiseSeed> = Some(NoiseSeed { seed: 3, episode: 1 });

fn row_and_q0() -> (Row, Vec<f64>) {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let gains = robot.gains(GainSet::default());
    let spec = SceneSpec::new(SceneKind::FreeLadder, 0, gains);
    let q0 = robot.q0().to_vec();
    let scene = Scene::build(&SceneConfig::default(), robot, spec).unwrap();
    (World::new(Arc::new(scene)).row().clone(), q0)
}

/// Proprioception of a row, in a buffer that held other numbers.
fn sensed(observer: &mut Observer, row: &Row) -> Proprioception {
    let mut sensed = Proprioception::zeros(2);
    sensed.base_height = f64::NAN;
    observer.observe(row, &mut sensed);
    sensed
}

/// All terms as one list, with the half-width of each number.
fn flat(sensed: &Proprioception) -> Vec<(f64, f64)> {
    let terms: [(&[f64], f64); 6] = [
        (&sensed.base_angular_velocity, 0.2),
        (&sensed.projected_gravity, 0.05),
        (&sensed.base_linear_velocity, 0.1),
        (&[sensed.base_height], 0.05),
        (&sensed.joint_position, 0.01),
        (&sensed.joint_velocity, 1.5),
    ];
    terms.iter().flat_map(|(values, half)| values.iter().map(|value| (*value, *half))).collect()
}

#[test]
fn noise_fills_its_bounds_and_repeats() {
    let (mut row, q0) = row_and_q0();
    let exact = flat(&sensed(&mut Observer::new(q0.clone(), None), &row));
    let (mut observer, mut again) = (Observer::new(q0.clone(), SEED), Observer::new(q0, SEED));
    let mut most = vec![0.0_f64; exact.len()];
    for _ in 0..200 {
        let noisy = sensed(&mut observer, &row);
        assert_eq!(noisy, sensed(&mut again, &row));
        for (most, (noisy, (value, half))) in most.iter_mut().zip(flat(&noisy).into_iter().zip(&exact)) {
            *most = most.max((noisy.0 - value).abs() / half);
        }
        row.step += 1;
    }
    assert!(most.iter().all(|most| (0.9..=1.0 + 1e-9).contains(most)), "{most:?}");
}

#[test]
fn noise_does_not_depend_on_the_rows() {
    let (row, q0) = row_and_q0();
    let mut next = row.clone();
    next.step += 1;
    let mut other = row.clone();
    other.robot.linear_velocity.x = 1.0;
    let second = |first: &Row| {
        let mut observer = Observer::new(q0.clone(), SEED);
        sensed(&mut observer, first);
        sensed(&mut observer, &next)
    };
    assert_eq!(second(&row), second(&other));
}

/// A term's noise is what its own stream gives, whatever was drawn for the other terms.
#[test]
fn terms_are_independent() {
    let (mut row, q0) = row_and_q0();
    let exact = sensed(&mut Observer::new(q0.clone(), None), &row);
    let mut observer = Observer::new(q0, SEED);
    let mut height = Random::of_term(Stream::Noise, "base_height", 3, 1);
    for _ in 0..10 {
        let noise = sensed(&mut observer, &row).base_height - exact.base_height;
        assert!((noise - height.uniform(-0.05, 0.05)).abs() < 1e-12);
        row.step += 1;
    }
}

/// Without noise, for a pelvis that lies on its left side after a quarter turn to the left.
#[test]
fn vectors_are_in_the_pelvis_frame() {
    let (mut row, q0) = row_and_q0();
    let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), FRAC_PI_2);
    let rolled = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -FRAC_PI_2);
    row.robot.pose.rotation = turned * rolled;
    row.robot.pose.translation.z = 0.5;
    // Forward is now world y, the pelvis's left is down, its up is world -x.
    row.robot.linear_velocity = Vector3::new(0.0, 2.0, 1.0);
    row.robot.angular_velocity = Vector3::new(-3.0, 0.0, 0.0);
    row.joint_position = q0.iter().map(|q| q + 0.25).collect();
    row.joint_velocity.fill(0.75);
    let sensed = sensed(&mut Observer::new(q0, None), &row);
    let near = |found: [f64; 3], expected: [f64; 3]| {
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?}, not {expected:?}");
    };
    near(sensed.projected_gravity, [0.0, 1.0, 0.0]);
    near(sensed.base_linear_velocity, [2.0, -1.0, 0.0]);
    near(sensed.base_angular_velocity, [0.0, 0.0, 3.0]);
    assert_eq!((sensed.base_height, sensed.joint_velocity), (0.5, vec![0.75; JOINTS]));
    assert!(sensed.joint_position.iter().all(|q| (q - 0.25).abs() < 1e-12));
}
