//! Nothing allocates once the buffers have their size: readings, inverse kinematics, forces of supports.
#![allow(clippy::unwrap_used, missing_docs)]

use fiatlux_dynamics::{ModelBuilder, ShapeId};
use fiatlux_kinematics::{Acceleration, Clearance, Goal, InverseKinematics, Mechanics, Support, SupportSolver};
use fiatlux_robot::{BuildOptions, Robot};
use nalgebra::Vector3;

#[test]
fn repeated_calls_allocate_nothing() {
    let robot = Robot::by_name("g1_inspire").unwrap();
    let mut builder = ModelBuilder::new();
    let placed = robot.add_to(&mut builder, &BuildOptions::new(&robot)).unwrap();
    let model = builder.build().unwrap();
    let (ids, nv) = (placed.ids(&model).unwrap(), model.nv());
    let joints: Vec<_> = ids.joints.iter().map(|joint| joint.body).collect();
    let palm = ids.site(&robot.sites()[0]);
    let mut supports = Vec::new();
    for sole in robot.soles() {
        let body = ids.site(&sole.site).body;
        let support = |point| Support { body, point, normal: Vector3::z_axis(), friction: 1.0, most: 300.0 };
        supports.extend(sole.corners().map(support));
    }
    let (mut mechanics, reference) = (Mechanics::new(&model), model.reference_state());
    let mut state = reference.clone();
    let mut inverse = InverseKinematics::new(&model, ids.root, &joints, true).unwrap();
    let shape = |name: &str| ShapeId(model.shapes().iter().position(|shape| shape.name == name).unwrap());
    let shapes = (shape("left_elbow"), shape("torso_chest"));
    inverse.set_clearances(&model, &[Clearance { shapes, margin: 0.02 }]).unwrap();
    let mut solver = SupportSolver::new(&model, ids.root).unwrap();
    let (mut jacobian, mut matrix, mut forces) = (vec![0.0; 6 * nv], vec![0.0; nv * nv], vec![0.0; nv]);
    let mut targets = vec![0.0; model.drives().len()];
    let posture = targets.clone();
    let mut work = |x: f64| {
        state.qpos.copy_from_slice(&reference.qpos);
        mechanics.update_equation(&model, &state);
        mechanics.jacobian(&model, &palm, &mut jacobian);
        mechanics.com_jacobian(&model, ids.root, &mut jacobian[..3 * nv]);
        mechanics.mass_matrix(&model, &mut matrix);
        mechanics.inverse_dynamics(&model, &reference.qvel, &mut forces);
        solver.solve(&model, &mut mechanics, &supports, &Acceleration::default()).unwrap();
        solver.targets(&model, &mechanics, &posture, &mut targets);
        inverse
            .solve(&model, &mut state, &[Goal::position(palm, Vector3::new(x, 0.3, 1.0)), Goal::com_over(0.0, 0.0)])
            .unwrap()
    };
    work(0.3);
    let mut steps = 0;
    assert_eq!(fiatlux_allocations::count(|| (), |()| steps = work(0.4).steps), 0);
    assert!(steps > 2, "{steps}");
}
