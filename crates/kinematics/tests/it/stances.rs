//! Forces of supports: exact on a plain stance, feasible where a linear program says so in 500 stances on the ladder.

use std::sync::Arc;

use fiatlux_dynamics::State;
use fiatlux_kinematics::{
    Acceleration, Goal, InverseKinematics, Mechanics, SearchOptions, Site, Support, SupportError, SupportSolver,
};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_world::{Scene, SceneConfig, SceneKind, SceneSpec};
use nalgebra::{DMatrix, DVector, Isometry3, UnitQuaternion, Vector3};

use crate::{Alone, Draws};

/// Phase one of the revised simplex method: whether some `x` has `row x = bound` for the first rows and `row x >= bound` for
/// the others.
pub fn is_feasible(n: usize, rows: &[f64], bounds: &[f64], equalities: usize) -> bool {
    let m = bounds.len();
    if m == 0 {
        return true;
    }
    // Columns: x as a difference of two, a surplus for each inequality, an artificial one for each row.
    let artificial = 2 * n + m - equalities;
    let (mut columns, mut right) = (DMatrix::zeros(m, artificial + m), DVector::zeros(m));
    for row in 0..m {
        let line = DVector::from_column_slice(&rows[row * n..][..n]);
        let scale = if bounds[row] < 0.0 { -1.0 } else { 1.0 } / line.norm().max(1e-12);
        for k in 0..n {
            (columns[(row, k)], columns[(row, n + k)]) = (scale * line[k], -scale * line[k]);
        }
        if row >= equalities {
            columns[(row, 2 * n + row - equalities)] = -scale;
        }
        (columns[(row, artificial + row)], right[row]) = (1.0, scale * bounds[row]);
    }
    let mut basis: Vec<usize> = (artificial..artificial + m).collect();
    for _ in 0..5000 {
        let inverse = columns.select_columns(&basis).try_inverse().unwrap();
        let values = &inverse * &right;
        let costs = DVector::from_fn(m, |row, _| if basis[row] >= artificial { 1.0 } else { 0.0 });
        let gains = columns.columns(0, artificial).tr_mul(&inverse.tr_mul(&costs));
        let (enters, gain) = gains.argmax();
        if gain < 1e-7 {
            return costs.dot(&values) < 1e-6;
        }
        let direction = &inverse * columns.column(enters);
        let ratio = |row: usize| values[row].max(0.0) / direction[row];
        let bound = (0..m).filter(|row| direction[*row] > 1e-7).map(ratio).fold(f64::INFINITY, f64::min);
        // Of nearly equal ones the largest pivot, for accuracy.
        let leaves = (0..m)
            .filter(|row| direction[*row] > 1e-7 && ratio(*row) <= bound + 1e-7)
            .max_by(|a, b| direction[*a].total_cmp(&direction[*b]));
        basis[leaves.unwrap()] = enters;
    }
    panic!("the linear program did not end");
}

pub fn soles(robot: &Robot, body_of: impl Fn(usize) -> Site, friction: f64, ranges: [[f64; 2]; 2]) -> Vec<Support> {
    let mut supports = Vec::new();
    for (sole, [rear, front]) in robot.soles().iter().zip(ranges) {
        let Site { body, body_from_site } = body_of(sole.site.link);
        for [x, y] in [[front, 1.0], [front, -1.0], [rear, 1.0], [rear, -1.0]] {
            let corner = sole.site.link_from_site * nalgebra::Point3::new(x, y * sole.half_extents[1], 0.0);
            let point = (body_from_site * corner).coords;
            supports.push(Support { body, point, normal: Vector3::z_axis(), friction, most: f64::INFINITY });
        }
    }
    supports
}

/// A leader's drive carries what loads its followers; their own have no effort.
#[test]
fn efforts_of_coupled_joints_are_those_of_their_leaders() {
    let alone = Alone::new("g1_inspire6");
    let (model, root) = (&alone.model, alone.ids.root);
    let link =
        |link: usize| Site { body: alone.ids.links[link].body, body_from_site: alone.ids.links[link].body_from_link };
    let supports = soles(&alone.robot, link, 0.8, [[-0.1, 0.1]; 2]);
    let (mut solver, mut mechanics) = (SupportSolver::new(model, root).unwrap(), Mechanics::new(model));
    let mut state = alone.standing();
    // Palms down, so that fingers have weight about their joints.
    for (joint, ids) in
        alone.robot.joints().iter().zip(&alone.ids.joints).filter(|(j, _)| j.name.contains("wrist_roll"))
    {
        state.qpos[ids.qpos] = if joint.name.starts_with("left") { -1.2 } else { 1.2 };
    }
    mechanics.update_equation(model, &state);
    solver.solve(model, &mut mechanics, &supports, &Acceleration::default()).unwrap();
    let bias = mechanics.bias_force();
    let mut loaded = 0;
    for (joint, ids) in alone.robot.joints().iter().zip(&alone.ids.joints) {
        let Some(follows) = joint.follows else { continue };
        let leader = alone.ids.joints[follows.leader];
        let followers = alone.robot.joints().iter().zip(&alone.ids.joints);
        let of_leader = followers.filter_map(|(joint, ids)| Some((joint.follows?, ids.dof)));
        let of_leader = of_leader.filter(|(follows, _)| alone.ids.joints[follows.leader].dof == leader.dof);
        let due = bias[leader.dof] + of_leader.map(|(follows, dof)| follows.ratio * bias[dof]).sum::<f64>();
        assert_eq!(solver.efforts()[ids.drive], 0.0, "{}", joint.name);
        assert!((solver.efforts()[leader.drive] - due).abs() < 1e-9, "{}", joint.name);
        loaded += usize::from((due - bias[leader.dof]).abs() > 1e-4);
    }
    assert!(loaded > 4, "weight pulls at followers");
    let mut targets = vec![f64::NAN; model.drives().len()];
    solver.targets(model, &mechanics, &vec![0.0; targets.len()], &mut targets);
    assert!(targets.iter().all(|target| target.is_finite()));
}

#[test]
fn forces_and_efforts_obey_the_equation_of_motion() {
    let alone = Alone::new("g1_bare");
    let (model, root) = (&alone.model, alone.ids.root);
    let link =
        |link: usize| Site { body: alone.ids.links[link].body, body_from_site: alone.ids.links[link].body_from_link };
    let supports = soles(&alone.robot, link, 0.8, [[-0.1, 0.1]; 2]);
    let mut solver = SupportSolver::new(model, root).unwrap();
    let mut mechanics = Mechanics::new(model);
    let state = alone.standing();
    mechanics.update_equation(model, &state);
    let wanted = Acceleration { com: Vector3::new(0.3, -0.2, 0.5), trunk: Vector3::new(0.1, 0.2, -0.3) };
    solver.solve(model, &mut mechanics, &supports, &wanted).unwrap();

    let sum: Vector3<f64> = solver.forces().iter().sum();
    let (mass, com) = mechanics.center_of_mass(model, root);
    assert!((sum - (wanted.com + Vector3::z() * 9.81) * mass).norm() < 1e-6, "{sum}");
    for force in solver.forces() {
        assert!(force.z >= -1e-9 && force.xy().norm() <= 0.8 * force.z + 1e-9, "{force}");
    }
    // Efforts and forces together give the acceleration of the whole as a rigid body, by inverse dynamics.
    let mut acceleration = vec![0.0; model.nv()];
    let arm = com - mechanics.world_from_body(root).translation.vector;
    acceleration[..3].copy_from_slice((wanted.com - wanted.trunk.cross(&arm)).as_slice());
    acceleration[3..6].copy_from_slice(wanted.trunk.as_slice());
    let mut needed = vec![0.0; model.nv()];
    mechanics.inverse_dynamics(model, &acceleration, &mut needed);
    for (support, force) in supports.iter().zip(solver.forces()) {
        let point = mechanics.world_point(support.body, &support.point);
        mechanics.add_force(model, support.body, &point, &-force, &mut needed);
    }
    assert!(needed[..6].iter().all(|rest| rest.abs() < 1e-6), "{:?}", &needed[..6]);
    for (dof, effort) in needed[6..].iter().zip(solver.efforts()) {
        assert!((dof - effort).abs() < 1e-9);
    }

    let lifted = Acceleration { com: Vector3::z() * 200.0, ..wanted };
    assert!(matches!(solver.solve(model, &mut mechanics, &supports, &lifted), Err(SupportError::Effort(_))));
    let aside = Acceleration { com: Vector3::y() * 12.0, ..Acceleration::default() };
    assert_eq!(solver.solve(model, &mut mechanics, &supports, &aside), Err(SupportError::Unsupported));
    assert_eq!(solver.solve(model, &mut mechanics, &[], &wanted), Err(SupportError::Unsupported));
    let slippery = [Support { friction: 0.0, ..supports[0] }];
    let refused = solver.solve(model, &mut mechanics, &slippery, &wanted).unwrap_err();
    assert!(refused.to_string().contains("support 0: its friction must be positive"), "{refused}");
}

pub fn ladder(seed: u64) -> Scene {
    let robot = Arc::new(Robot::by_name("g1_bare").unwrap());
    let spec = SceneSpec::new(SceneKind::CoupledLadder, seed, robot.gains(GainSet::default()));
    Scene::build(&SceneConfig::default(), robot, spec).unwrap()
}

/// The middle of a tread or the platform, turned as a foot that climbs.
pub fn world_from_tread(scene: &Scene, mechanics: &Mechanics, name: &str) -> Isometry3<f64> {
    let site = scene.site(name).unwrap();
    let facing = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
    mechanics.world_from_site(&site) * facing
}

#[test]
fn supports_bear_the_robot_where_a_linear_program_says_so() {
    let scene = ladder(5);
    let (model, robot, ids) = (&scene.model, &scene.robot, &scene.robot_ids);
    let (root, nv) = (ids.root, model.nv());
    let joints: Vec<_> = ids.joints.iter().map(|joint| joint.body).collect();
    let mut inverse = InverseKinematics::new(model, root, &joints, true).unwrap();
    inverse.options = SearchOptions { tries: 1, rest_pull: 0.1, ..SearchOptions::default() };
    inverse.set_rest(robot.q0()).unwrap();
    let mut mechanics = Mechanics::new(model);
    let mut solver = SupportSolver::new(model, root).unwrap();
    let link = |link: usize| Site { body: ids.links[link].body, body_from_site: ids.links[link].body_from_link };
    let (mut counts, mut draws) = ([0; 2], Draws(47));
    // All of them are a matter of half a minute, which the linear program takes.
    let stances = if std::env::var_os("FIATLUX_ALL_ROOMS").is_some() { 500 } else { 80 };
    for stance in 0..stances {
        let mut state = State { qpos: model.reference_state().qpos, qvel: vec![0.0; nv] };
        mechanics.update(model, &state);
        let (lower, tilt) = (stance % 4, draws.many(3, 1.0));
        let upper = (lower + stance / 4 % 2).min(3);
        let treads = if stance % 3 == 0 { [upper, lower] } else { [lower, upper] };
        // Distance of a sole's middle before that of its tread, m.
        let ahead = [0.05 * draws.one(), 0.05 * draws.one()];
        let places: [Isometry3<f64>; 2] = std::array::from_fn(|side| {
            let aside = if side == 0 { 0.1 } else { -0.1 };
            world_from_tread(&scene, &mechanics, &format!("ladder_tread_{}", treads[side]))
                * Isometry3::translation(-ahead[side], aside, 0.0)
        });
        let middle = (places[0].translation.vector + places[1].translation.vector) / 2.0;
        let pelvis = Isometry3::from_parts((middle + Vector3::z() * 0.75).into(), places[0].rotation);
        state.set_pose(model, root, &pelvis);
        ids.joints.iter().zip(robot.q0()).for_each(|(joint, q0)| state.qpos[joint.qpos] = *q0);
        let com = middle + Vector3::new(0.12 * tilt[0], 0.06 * tilt[1], 0.0);
        let goals = [
            Goal::pose(ids.site(&robot.soles()[0].site), places[0]),
            Goal::pose(ids.site(&robot.soles()[1].site), places[1]),
            Goal::com_over(com.x, com.y),
        ];
        inverse.solve(model, &mut state, &goals).unwrap();

        let ranges = ahead.map(|ahead| [ahead - 0.045, ahead + 0.045].map(|x| x.clamp(-0.101, 0.101)));
        let mut supports = soles(robot, link, 0.6, ranges);
        // On one foot at times.
        supports.truncate(if stance % 5 == 4 { 4 } else { 8 });
        mechanics.update_equation(model, &state);
        let wanted = Acceleration { com: Vector3::new(0.0, 0.0, 0.5 * tilt[2]), ..Acceleration::default() };
        let solved = solver.solve(model, &mut mechanics, &supports, &wanted);

        // The same as a linear program, from readings alone; forces in hundreds of newtons.
        let n = 3 * supports.len();
        let (mut jacobian, mut needed, mut acceleration) = (vec![0.0; 6 * nv], vec![0.0; nv], vec![0.0; nv]);
        let dof = model.bodies()[root.0].dof_start;
        acceleration[dof + 2] = wanted.com.z;
        mechanics.inverse_dynamics(model, &acceleration, &mut needed);
        let mut transposed = vec![0.0; nv * n];
        for (index, support) in supports.iter().enumerate() {
            let site = Site {
                body: support.body,
                body_from_site: Isometry3::from_parts(support.point.into(), UnitQuaternion::identity()),
            };
            mechanics.jacobian(model, &site, &mut jacobian);
            for axis in 0..3 {
                (0..nv).for_each(|dof| transposed[dof * n + 3 * index + axis] = 100.0 * jacobian[axis * nv + dof]);
            }
        }
        let mut rows = transposed[dof * n..(dof + 6) * n].to_vec();
        let mut bounds = needed[dof..dof + 6].to_vec();
        for index in 0..supports.len() {
            for (axis, sign) in [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)] {
                let mut row = vec![0.0; n];
                (row[3 * index + axis], row[3 * index + 2]) = (sign, 0.6 / 2.0_f64.sqrt());
                rows.extend(row);
                bounds.push(0.0);
            }
        }
        for (body, drive) in model.drives() {
            let dof = model.bodies()[body.0].dof_start;
            if transposed[dof * n..][..n].iter().all(|entry| *entry == 0.0) {
                assert!(needed[dof].abs() < drive.effort_limit, "an arm bears its own weight");
                continue;
            }
            for sign in [1.0, -1.0] {
                rows.extend(transposed[dof * n..][..n].iter().map(|entry| -sign * entry));
                bounds.push(-drive.effort_limit - sign * needed[dof]);
            }
        }
        assert_eq!(solved.is_ok(), is_feasible(n, &rows, &bounds, 6), "stance {stance}: {solved:?}");
        counts[usize::from(solved.is_ok())] += 1;
    }
    println!("{} of {stances} stances are borne", counts[1]);
    assert!(counts.iter().all(|count| *count > stances / 10), "{counts:?}");
}
