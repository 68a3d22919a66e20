//! Mass matrix (composite rigid bodies) and bias forces (recursive Newton-Euler), about each tree's origin.

use nalgebra::Matrix3;

use crate::factor::Factor;
use crate::kinematics::Kinematics;
use crate::model::{BodyId, Joint, Model};
use crate::spatial::{Force, Inertia, Motion, Sym3, V3};
use crate::step::Wrench;

#[derive(Debug, Clone)]
pub(crate) struct Dynamical {
    /// Lower triangle of the mass matrix, row-major with `nv` columns; armature included.
    pub mass_matrix: Vec<f64>,
    /// Coriolis, centrifugal, gravity and external forces: the generalised force that keeps accelerations at zero.
    pub bias: Vec<f64>,
    inertia: Vec<Inertia>,
    acceleration: Vec<Motion>,
    force: Vec<Force>,
    armature: Vec<f64>,
}

impl Dynamical {
    pub fn new(model: &Model) -> Self {
        let bodies = model.bodies.len();
        let zero = Inertia::new(0.0, &V3::zeros(), &Sym3::rotated(&Matrix3::identity(), &Matrix3::zeros()));
        let mut armature = vec![0.0; model.nv];
        for body in &model.bodies[1..] {
            if let Joint::Hinge(hinge) = &body.spec.joint {
                armature[body.dof_start] = hinge.armature;
            }
        }
        Self {
            mass_matrix: vec![0.0; model.nv * model.nv],
            bias: vec![0.0; model.nv],
            inertia: vec![zero; bodies],
            acceleration: vec![Motion::ZERO; bodies],
            force: vec![Force::ZERO; bodies],
            armature,
        }
    }

    pub fn update(&mut self, model: &Model, kin: &Kinematics, wrenches: &[(BodyId, Wrench)]) {
        // Gravity as an upward acceleration of the world.
        self.acceleration[0] = Motion { angular: V3::zeros(), linear: -model.gravity };
        for (index, body) in model.bodies.iter().enumerate().skip(1) {
            let rotation = &kin.rotation[index];
            let com = kin.position[index] - kin.origin[index] + rotation * body.spec.com;
            let inertia = Inertia::new(body.spec.mass, &com, &Sym3::rotated(rotation, &body.spec.inertia));
            let motion = &kin.motion[index];
            let mut acceleration = self.acceleration[body.spec.parent.0];
            match body.spec.joint {
                // The origin is fixed in space while the root moves past it.
                Joint::Free => acceleration.linear += motion.linear.cross(&motion.angular),
                Joint::Hinge(_) => {
                    let parent = &kin.motion[body.spec.parent.0];
                    let relative =
                        Motion { angular: motion.angular - parent.angular, linear: motion.linear - parent.linear };
                    let drift = parent.cross_motion(&relative);
                    acceleration.add_scaled(&drift, 1.0);
                }
            }
            let mut force = inertia.apply(&acceleration);
            force.add(&motion.cross_force(&inertia.apply(motion)));
            self.inertia[index] = inertia;
            self.acceleration[index] = acceleration;
            self.force[index] = force;
        }
        for (body, wrench) in wrenches {
            let arm = kin.position[body.0] - kin.origin[body.0] + kin.rotation[body.0] * model.bodies[body.0].spec.com;
            self.force[body.0].force -= wrench.force;
            self.force[body.0].torque -= wrench.torque + arm.cross(&wrench.force);
        }
        let nv = model.nv;
        for index in (1..model.bodies.len()).rev() {
            let body = &model.bodies[index];
            let (inertia, force) = (self.inertia[index], self.force[index]);
            let parent = body.spec.parent.0;
            if parent != 0 {
                self.inertia[parent].add(&inertia);
                self.force[parent].add(&force);
            }
            let chain = &model.chains[index];
            let width = chain.len() - model.chains[parent].len();
            for dof in body.dof_start..body.dof_start + width {
                let axis = &kin.axes[dof];
                self.bias[dof] = axis.dot(&force);
                let momentum = inertia.apply(axis);
                let row = &mut self.mass_matrix[dof * nv..dof * nv + dof + 1];
                for &other in chain.iter().take_while(|&&d| usize::from(d) <= dof) {
                    row[usize::from(other)] = kin.axes[usize::from(other)].dot(&momentum);
                }
                row[dof] += self.armature[dof];
            }
        }
    }
}

/// Step for which the drives' share of the inverse inertia is taken, s.
const NOMINAL_DT: f64 = 0.005;

/// Inverse inertia in the reference pose: per body the mean over directions at its centre of mass (1/kg), and per degree
/// of freedom the diagonal. Drives count with what they add to the inertia in an implicit step: a finger link of 3 g behind
/// a stiff damper is not light to a contact, and a compliance scaled by its bare mass would creep.
pub(crate) fn inverse_weights(model: &Model) -> (Vec<f64>, Vec<f64>) {
    let mut kin = Kinematics::new(model);
    kin.update(model, &model.reference_state());
    let mut dynamical = Dynamical::new(model);
    dynamical.update(model, &kin, &[]);
    let mut factor = Factor::new(model);
    factor.load(&dynamical.mass_matrix);
    for (body, drive) in &model.drives {
        let dof = model.bodies[body.0].dof_start;
        factor.add(dof, dof, NOMINAL_DT * (drive.damping + NOMINAL_DT * drive.stiffness));
    }
    factor.eliminate_late();
    factor.eliminate_early();
    let solve = |rhs: Vec<f64>| {
        let mut x = rhs;
        factor.solve(&mut x);
        x
    };
    let dof_weights = (0..model.nv)
        .map(|dof| {
            let mut unit = vec![0.0; model.nv];
            unit[dof] = 1.0;
            solve(unit)[dof]
        })
        .collect();
    let mut body_weights = vec![0.0; model.bodies.len()];
    for index in 1..model.bodies.len() {
        let com = kin.position[index] - kin.origin[index] + kin.rotation[index] * model.bodies[index].spec.com;
        for k in 0..3 {
            let direction = V3::ith(k, 1.0);
            let force = Force { torque: com.cross(&direction), force: direction };
            let mut row = vec![0.0; model.nv];
            for &dof in &model.chains[index] {
                row[usize::from(dof)] = kin.axes[usize::from(dof)].dot(&force);
            }
            let x = solve(row.clone());
            body_weights[index] += row.iter().zip(&x).map(|(a, b)| a * b).sum::<f64>() / 3.0;
        }
    }
    (body_weights, dof_weights)
}
