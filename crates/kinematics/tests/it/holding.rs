//! The forces at work: the robot stands on the floor and on the ladder for 30 s at the published gains, by joint targets that
//! follow from its state every 20 ms.

use fiatlux_dynamics::{Dynamics, Input};
use fiatlux_kinematics::{
    Acceleration, Goal, InverseKinematics, Mechanics, Outcome, SearchOptions, Site, SupportSolver, driven_angles,
};
use fiatlux_world::{PHYSICS_DT, SUBSTEPS, Scene};
use nalgebra::{Isometry3, Rotation3, UnitQuaternion, Vector3};

use crate::stances::{ladder, soles, world_from_tread};

/// A stance: where both soles are, and how far their supports reach to the rear and ahead, m.
struct Stance {
    name: &'static str,
    soles: [Isometry3<f64>; 2],
    ranges: [[f64; 2]; 2],
}

/// Pulls of the centre of mass (1/s^2, 1/s) and of the trunk (the same) back to where they are wanted.
const COM: [f64; 2] = [15.0, 6.0];
const TRUNK: [f64; 2] = [30.0, 8.0];

/// How far the soles and the centre of mass moved in these seconds, m.
fn hold(scene: &Scene, stance: &Stance, seconds: f64) -> [f64; 2] {
    let (model, robot, ids) = (&scene.model, &scene.robot, &scene.robot_ids);
    let root = ids.root;
    let joints: Vec<_> = ids.joints.iter().map(|joint| joint.body).collect();
    let mut inverse = InverseKinematics::new(model, root, &joints, true).unwrap();
    inverse.options = SearchOptions { tries: 1, rest_pull: 0.1, limit_margin: 0.02, ..SearchOptions::default() };
    // Legs nearly straight, clear of the next tread, and the arms down.
    let angle = |name: &str| match name.split_once('_').map_or(name, |(_, joint)| joint) {
        "hip_pitch_joint" | "ankle_pitch_joint" => -0.03,
        "knee_joint" => 0.06,
        "shoulder_pitch_joint" => 0.2,
        "shoulder_roll_joint" => {
            if name.starts_with("left") {
                0.3
            } else {
                -0.3
            }
        }
        "elbow_joint" => 1.2,
        _ => 0.0,
    };
    let rest: Vec<f64> = robot.joints().iter().map(|joint| angle(&joint.name)).collect();
    inverse.set_rest(&rest).unwrap();
    let mut state = model.reference_state();
    let middle = (stance.soles[0].translation.vector + stance.soles[1].translation.vector) / 2.0;
    let upright = Isometry3::from_parts(middle.into(), stance.soles[0].rotation)
        * Isometry3::translation(-0.038, 0.0, robot.standing_height());
    state.set_pose(model, root, &upright);
    ids.joints.iter().zip(&rest).for_each(|(joint, angle)| state.qpos[joint.qpos] = *angle);
    // The middle of what bears.
    let bears = |side: usize| {
        stance.soles[side] * nalgebra::Point3::new((stance.ranges[side][0] + stance.ranges[side][1]) / 2.0, 0.0, 0.0)
    };
    let over = (bears(0).coords + bears(1).coords) / 2.0;
    let sites: Vec<Site> = robot.soles().iter().map(|sole| ids.site(&sole.site)).collect();
    let goals =
        [Goal::pose(sites[0], stance.soles[0]), Goal::pose(sites[1], stance.soles[1]), Goal::com_over(over.x, over.y)];
    let found = inverse.solve(model, &mut state, &goals).unwrap();
    assert_eq!(found.outcome, Outcome::Reached, "{}: {found:?}", stance.name);

    let link = |link: usize| Site { body: ids.links[link].body, body_from_site: ids.links[link].body_from_link };
    let supports = soles(robot, link, 0.6, stance.ranges);
    let (mut mechanics, mut dynamics) = (Mechanics::new(model), Dynamics::new(model));
    let mut solver = SupportSolver::new(model, root).unwrap();
    let mut posture = vec![0.0; model.drives().len()];
    driven_angles(model, &state, &mut posture);
    let mut targets = posture.clone();
    mechanics.update(model, &state);
    let (com, trunk) = (mechanics.center_of_mass(model, root).1, mechanics.world_from_body(root).rotation);
    let places: Vec<_> = sites.iter().map(|site| mechanics.world_from_site(site).translation.vector).collect();
    let mut moved = [0.0_f64; 2];
    for _ in 0..(seconds / (PHYSICS_DT * SUBSTEPS as f64)) as usize {
        mechanics.update_equation(model, &state);
        let (now, velocity) = (mechanics.center_of_mass(model, root).1, mechanics.com_velocity(model, root));
        let turn: UnitQuaternion<f64> = trunk * mechanics.world_from_body(root).rotation.inverse();
        let wanted = Acceleration {
            com: (com - now) * COM[0] - velocity * COM[1],
            trunk: turn.scaled_axis() * TRUNK[0] - mechanics.velocity(root).angular * TRUNK[1],
        };
        let solved = solver.solve(model, &mut mechanics, &supports, &wanted);
        solved.unwrap_or_else(|error| panic!("{}: {error}", stance.name));
        solver.targets(model, &mechanics, &posture, &mut targets);
        for _ in 0..SUBSTEPS {
            dynamics.step(model, &mut state, &Input { targets: &targets, ..Input::default() }, PHYSICS_DT);
        }
        mechanics.update(model, &state);
        moved[1] = moved[1].max((mechanics.center_of_mass(model, root).1 - com).norm());
        for (site, place) in sites.iter().zip(&places) {
            moved[0] = moved[0].max((mechanics.world_from_site(site).translation.vector - place).norm());
        }
    }
    moved
}

#[test]
fn stances_hold_for_30_s() {
    let scene = ladder();
    let mut mechanics = Mechanics::new(&scene.model);
    mechanics.update(&scene.model, &scene.model.reference_state());
    let whole = [[-0.101, 0.101]; 2];
    let aside = |side: usize| if side == 0 { 0.1 } else { -0.1 };
    let clear = Isometry3::from_parts(Vector3::new(1.0, 0.5, 0.0).into(), Rotation3::identity().into());
    let floor = std::array::from_fn(|side| clear * Isometry3::translation(0.0, aside(side), 0.0));
    let mut stances = vec![Stance { name: "floor", soles: floor, ranges: whole }];
    // The ankles are 5 cm before the middle of the tread, the soles' middles 3.8 cm before the ankles.
    let ahead = 0.05 - 0.038;
    let on_ladder = ["ladder_tread_0", "ladder_tread_1", "ladder_tread_2", "ladder_tread_3", "ladder_platform"];
    for name in on_ladder {
        let on =
            |side: usize| world_from_tread(&scene, &mechanics, name) * Isometry3::translation(-ahead, aside(side), 0.0);
        stances.push(Stance { name, soles: std::array::from_fn(on), ranges: [[ahead - 0.04, ahead + 0.04]; 2] });
    }
    for stance in &stances {
        let moved = hold(&scene, stance, 30.0);
        println!("{}: soles moved {:.2} mm, centre of mass {:.1} mm", stance.name, 1e3 * moved[0], 1e3 * moved[1]);
        assert!(moved[0] < 1e-3 && moved[1] < 5e-3, "{}: {moved:?}", stance.name);
    }
}
