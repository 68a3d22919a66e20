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
    /// Of each body, and of each body with all that hangs on it.
    own: Vec<Inertia>,
    inertia: Vec<Inertia>,
    motion: Vec<Motion>,
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
            own: vec![zero; bodies],
            inertia: vec![zero; bodies],
            motion: vec![Motion::ZERO; bodies],
            acceleration: vec![Motion::ZERO; bodies],
            force: vec![Force::ZERO; bodies],
            armature,
        }
    }

    /// Computes both for a configuration and the velocity that it was given with.
    pub fn update(&mut self, model: &Model, parameters: &Parameters, kin: &Kinematics, wrenches: &[(BodyId, Wrench)]) {
        for index in 1..model.bodies.len() {
            let (rotation, inertial) = (&kin.rotation[index], &parameters.bodies[index]);
            let com = kin.position[index] - kin.origin[index] + rotation * inertial.com;
            self.own[index] = Inertia::new(inertial.mass, &com, &Sym3::rotated(rotation, &inertial.inertia));
        }
        self.motion.copy_from_slice(&kin.motion);
        self.update_forces(model, parameters, kin, wrenches);
        self.update_mass_matrix(model, kin);
    }

    /// Computes the bias force for another velocity in the same configuration.
    pub fn update_bias(
        &mut self,
        model: &Model,
        parameters: &Parameters,
        kin: &Kinematics,
        wrenches: &[(BodyId, Wrench)],
        velocity: &[f64],
    ) {
        for (index, body) in model.bodies.iter().enumerate().skip(1) {
            let dof = body.dof_start;
            self.motion[index] = match body.spec.joint {
                Joint::Free => {
                    let qvel = &velocity[dof..dof + 6];
                    Motion { angular: V3::new(qvel[3], qvel[4], qvel[5]), linear: V3::new(qvel[0], qvel[1], qvel[2]) }
                }
                Joint::Hinge(_) => {
                    let mut motion = self.motion[body.spec.parent.0];
                    motion.add_scaled(&kin.axes[dof], velocity[dof]);
                    motion
                }
            };
        }
        self.update_forces(model, parameters, kin, wrenches);
    }

    fn update_forces(
        &mut self,
        model: &Model,
        parameters: &Parameters,
        kin: &Kinematics,
        wrenches: &[(BodyId, Wrench)],
    ) {
        // Gravity as an upward acceleration of the world.
        self.acceleration[0] = Motion { angular: V3::zeros(), linear: -model.gravity };
        for (index, body) in model.bodies.iter().enumerate().skip(1) {
            let motion = &self.motion[index];
            let mut acceleration = self.acceleration[body.spec.parent.0];
            match body.spec.joint {
                // The origin is fixed in space while the root moves past it.
                Joint::Free => acceleration.linear += motion.linear.cross(&motion.angular),
                Joint::Hinge(_) => {
                    let parent = &self.motion[body.spec.parent.0];
                    let relative =
                        Motion { angular: motion.angular - parent.angular, linear: motion.linear - parent.linear };
                    let drift = parent.cross_motion(&relative);
                    acceleration.add_scaled(&drift, 1.0);
                }
            }
            let inertia = &self.own[index];
            let mut force = inertia.apply(&acceleration);
            force.add(&motion.cross_force(&inertia.apply(motion)));
            self.acceleration[index] = acceleration;
            self.force[index] = force;
        }
        for (body, wrench) in wrenches {
            let arm = kin.position[body.0] - kin.origin[body.0] + kin.rotation[body.0] * parameters.bodies[body.0].com;
            self.force[body.0].force -= wrench.force;
            self.force[body.0].torque -= wrench.torque + arm.cross(&wrench.force);
        }
        for index in (1..model.bodies.len()).rev() {
            let body = &model.bodies[index];
            let (force, parent) = (self.force[index], body.spec.parent.0);
            if parent != 0 {
                self.force[parent].add(&force);
            }
            let width = model.chains[index].len() - model.chains[parent].len();
            for dof in body.dof_start..body.dof_start + width {
                self.bias[dof] = kin.axes[dof].dot(&force);
            }
        }
    }

    fn update_mass_matrix(&mut self, model: &Model, kin: &Kinematics) {
        let nv = model.nv;
        self.inertia.copy_from_slice(&self.own);
        for index in (1..model.bodies.len()).rev() {
            let body = &model.bodies[index];
            let (inertia, parent) = (self.inertia[index], body.spec.parent.0);
            if parent != 0 {
                self.inertia[parent].add(&inertia);
            }
            let chain = &model.chains[index];
            let width = chain.len() - model.chains[parent].len();
            for dof in body.dof_start..body.dof_start + width {
                let momentum = inertia.apply(&kin.axes[dof]);
                let row = &mut self.mass_matrix[dof * nv..dof * nv + dof + 1];
                for &other in chain.iter().take_while(|&&d| usize::from(d) <= dof) {
                    row[usize::from(other)] = kin.axes[usize::from(other)].dot(&momentum);
                }
                row[dof] += self.armature[dof];
            }
        }
    }
}
