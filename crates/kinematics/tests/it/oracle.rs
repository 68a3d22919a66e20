//! 1,000 random states of the robot, written by `tests/oracle/kinematics.py`.

use fiatlux_dynamics::{Joint, State};
use fiatlux_kinematics::Mechanics;
use nalgebra::Vector3;
use serde::Deserialize;

use crate::{Alone, Draws};

/// Relative to the largest value of a quantity in all states.
const TOLERANCE: f64 = 1e-9;
const LOADED: [&str; 4] = ["left_palm", "right_palm", "left_sole", "right_sole"];

#[derive(Deserialize)]
struct Fixture {
    quantities: Vec<String>,
    sites: Vec<String>,
    largest: Vec<f64>,
    by_mujoco: Vec<Vec<f64>>,
    by_pinocchio: Vec<Vec<f64>>,
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn times(rows: &[f64], v: &[f64]) -> Vec<f64> {
    rows.chunks(v.len()).map(|row| dot(row, v)).collect()
}

/// A vector as the script has it.
fn probe(count: usize) -> Vec<f64> {
    Draws(2026).many(count, 1.0)
}

/// The state, accelerations and forces of a seed.
fn draw(alone: &Alone, seed: u64) -> (State, Vec<f64>, Vec<Vector3<f64>>) {
    let (model, mut draws) = (&alone.model, Draws(seed));
    let quaternion = draws.many(4, 1.0);
    let norm = quaternion.iter().map(|part| part * part).sum::<f64>().sqrt();
    let mut qpos = draws.many(3, 1.0);
    qpos.extend(quaternion.iter().map(|part| part / norm));
    for body in &model.bodies()[2..] {
        let Joint::Hinge(hinge) = &body.spec.joint else { panic!("a second root") };
        qpos.push(hinge.lower + (hinge.upper - hinge.lower) * (draws.one() + 1.0) / 2.0);
    }
    let hinges = model.nv() - 6;
    let qvel = [draws.many(3, 2.0), draws.many(3, 4.0), draws.many(hinges, 5.0)].concat();
    let acceleration = draws.many(model.nv(), 10.0);
    let forces = LOADED.map(|_| Vector3::from_vec(draws.many(3, 100.0)));
    (State { qpos, qvel }, acceleration, forces.to_vec())
}

#[test]
fn poses_jacobians_and_dynamics_are_those_of_mujoco_and_pinocchio() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/oracle/fixtures/kinematics.json");
    let fixture: Fixture = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    assert_eq!(fixture.by_mujoco.len(), 1000);
    let alone = Alone::new("g1_inspire");
    let (model, root, nv) = (&alone.model, alone.ids.root, alone.model.nv());
    assert_eq!(fixture.sites.len(), alone.robot.sites().len());
    let sites: Vec<_> = fixture.sites.iter().map(|name| alone.site(name)).collect();
    let mut mechanics = Mechanics::new(model);
    let (mut jacobian, mut of_com) = (vec![0.0; 6 * nv], vec![0.0; 3 * nv]);
    let (mut matrix, mut forces) = (vec![0.0; nv * nv], vec![0.0; nv]);
    let (p, other) = (probe(nv), &probe(2 * nv)[nv..]);
    let mut worst = vec![0.0_f64; fixture.quantities.len()];
    for (seed, by_both) in fixture.by_mujoco.iter().zip(&fixture.by_pinocchio).enumerate() {
        let (state, acceleration, loads) = draw(&alone, seed as u64);
        mechanics.update_equation(model, &state);
        let (mut poses, mut velocities, mut spatial) = (Vec::new(), Vec::new(), Vec::new());
        for index in 1..model.bodies().len() {
            let body = fiatlux_dynamics::BodyId(index);
            let (pose, velocity) = (mechanics.world_from_body(body), mechanics.velocity(body));
            poses.extend(pose.translation.vector.iter());
            poses.extend(pose.rotation.to_rotation_matrix().matrix().transpose().iter());
            velocities.extend(velocity.linear.iter().chain(velocity.angular.iter()));
        }
        for site in &sites {
            mechanics.jacobian(model, site, &mut jacobian);
            spatial.extend(times(&jacobian, &p));
        }
        let mut com = mechanics.center_of_mass(model, root).1.as_slice().to_vec();
        mechanics.com_jacobian(model, root, &mut of_com);
        com.extend(times(&of_com, &p));
        mechanics.mass_matrix(model, &mut matrix);
        mechanics.inverse_dynamics(model, &acceleration, &mut forces);
        let mut ours: Vec<f64> =
            [poses, velocities, spatial, com, times(&matrix, other)].map(|v| dot(&probe(v.len()), &v)).to_vec();
        ours.extend([dot(&p, mechanics.bias_force()), dot(&p, &forces)]);
        for (name, load) in LOADED.iter().zip(&loads) {
            let site = alone.site(name);
            let point = mechanics.world_from_site(&site).translation.vector;
            mechanics.add_force(model, site.body, &point, &-load, &mut forces);
        }
        ours.push(dot(&p, &forces));
        for theirs in [by_both.0, by_both.1] {
            for (k, largest) in fixture.largest.iter().enumerate() {
                worst[k] = worst[k].max((ours[k] - theirs[k]).abs() / largest);
            }
        }
    }
    println!(
        "largest differences, relative to the largest value: {:?}",
        fixture.quantities.iter().zip(&worst).collect::<Vec<_>>()
    );
    assert!(worst.iter().all(|error| *error < TOLERANCE), "{worst:?}");
}
