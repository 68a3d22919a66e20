//! Inverse inertias of bodies and joints, which scale the compliance of contacts and joint limits (MuJoCo's `invweight0`).

use crate::equation_of_motion::EquationOfMotion;
use crate::factor::Factor;
use crate::kinematics::Kinematics;
use crate::model::Model;
use crate::parameters::{InverseWeights, Parameters};
use crate::row_set::{MAX_WORDS, RowSet};
use crate::spatial::{Force, V3};

/// Step for which the drives' share of the inverse inertia is taken, s.
const NOMINAL_DT: f64 = 0.005;

/// Inverse inertia in the reference pose: per body the mean over directions at its centre of mass (1/kg), and per degree
/// of freedom the diagonal. Drives count with what they add to the inertia in an implicit step: a finger link of 3 g behind
/// a stiff damper is not light to a contact, and a compliance scaled by its bare mass would creep.
pub(crate) fn inverse_weights(model: &Model, parameters: &Parameters) -> InverseWeights {
    let mut kin = Kinematics::new(model);
    kin.update(model, &model.reference_state());
    let mut equation = EquationOfMotion::new(model);
    equation.update(model, parameters, &kin, &[], &vec![0.0; model.nv], RowSet::<1>::EMPTY, &[]);
    equation.reduce(model);
    let mut factor = Factor::<MAX_WORDS>::new(model);
    let rows = RowSet::below(model.nv);
    factor.load(&equation.mass_matrix, rows);
    for (body, drive) in &parameters.drives {
        let dof = model.bodies[body.0].dof_start;
        factor.add(dof, NOMINAL_DT * (drive.damping + NOMINAL_DT * drive.stiffness));
    }
    factor.eliminate(rows);
    let solve = |rhs: Vec<f64>| {
        let mut x = rhs;
        factor.solve(&mut x, rows);
        x
    };
    let dofs = (0..model.nv)
        .map(|dof| {
            let mut unit = vec![0.0; model.nv];
            unit[dof] = 1.0;
            solve(unit)[dof]
        })
        .collect();
    let mut bodies = vec![0.0; model.bodies.len()];
    for index in 1..model.bodies.len() {
        let com = kin.position[index] - kin.origin[index] + kin.rotation[index] * parameters.bodies[index].com;
        for k in 0..3 {
            let direction = V3::ith(k, 1.0);
            let force = Force { torque: com.cross(&direction), force: direction };
            let mut row = vec![0.0; model.nv];
            for &dof in &model.chains[index] {
                row[usize::from(dof)] = kin.axes[usize::from(dof)].dot(&force);
            }
            model.reduce(&mut row);
            let x = solve(row.clone());
            bodies[index] += row.iter().zip(&x).map(|(a, b)| a * b).sum::<f64>() / 3.0;
        }
    }
    InverseWeights { bodies, dofs }
}
