//! `M(q) a + c(q, v) = effort`: the mass matrix by composite rigid bodies and the bias force by recursive Newton-Euler,
//! about each tree's origin.

use nalgebra::Matrix3;

use crate::kinematics::Kinematics;
use crate::model::Model;
use crate::parameters::Parameters;
use crate::spatial::{Force, Inertia, Motion, Sym3, V3, Wrench};
use crate::spec::{BodyId, Joint};

#[derive(Debug, Clone)]
pub(crate) struct EquationOfMotion {
    /// Lower triangle of the mass matrix, row-major with `nv` columns; armature included.
    pub mass_matrix: Vec<f64>,
    /// Coriolis, centrifugal, gravity and external forces: the generalised force that keeps accelerations at zero.
    pub bias: Vec<f64>,
    inertia: Vec<Inertia>,
    acceleration: Vec<Motion>,
    force: Vec<Force>,
    armature: Vec<f64>,
}

impl EquationOfMotion {
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

    pub fn update(&mut self, model: &Model, parameters: &Parameters, kin: &Kinematics, wrenches: &[(BodyId, Wrench)]) {
        // Gravity as an upward acceleration of the world.
        self.acceleration[0] = Motion { angular: V3::zeros(), linear: -model.gravity };
        for (index, body) in model.bodies.iter().enumerate().skip(1) {
            let (rotation, inertial) = (&kin.rotation[index], &parameters.bodies[index]);
            let com = kin.position[index] - kin.origin[index] + rotation * inertial.com;
            let inertia = Inertia::new(inertial.mass, &com, &Sym3::rotated(rotation, &inertial.inertia));
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
            let arm = kin.position[body.0] - kin.origin[body.0] + kin.rotation[body.0] * parameters.bodies[body.0].com;
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
