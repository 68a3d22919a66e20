//! `M(q) a + c(q, v) = effort`: the mass matrix by composite rigid bodies and the bias force by recursive Newton-Euler,
//! about each tree's origin.

use nalgebra::Matrix3;

use crate::kinematics::Kinematics;
use crate::model::Model;
use crate::parameters::Parameters;
use crate::row_set::RowSet;
use crate::spatial::{Force, Inertia, Motion, Sym3, V3, Wrench};
use crate::spec::{BodyId, Joint};

#[derive(Debug, Clone)]
pub(crate) struct EquationOfMotion {
    /// Lower triangle of the mass matrix, packed ([`Model::row`]); armature included.
    pub mass_matrix: Vec<f64>,
    /// Coriolis, centrifugal, gravity and external forces: the generalised force that keeps accelerations at zero.
    pub bias: Vec<f64>,
    /// Momentum of the velocity that the bias force is taken at.
    pub momentum: Vec<f64>,
    /// Of a unit rate of each degree of freedom of a free twig: the momentum of the body with all that hangs on it.
    pub axis_momentum: Vec<Force>,
    /// Of each body, and of each body with all that hangs on it.
    own: Vec<Inertia>,
    inertia: Vec<Inertia>,
    motion: Vec<Motion>,
    acceleration: Vec<Motion>,
    force: Vec<Force>,
    body_momentum: Vec<Force>,
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
            mass_matrix: vec![0.0; model.row_start[model.nv]],
            bias: vec![0.0; model.nv],
            momentum: vec![0.0; model.nv],
            axis_momentum: vec![Force::ZERO; model.nv],
            own: vec![zero; bodies],
            inertia: vec![zero; bodies],
            motion: vec![Motion::ZERO; bodies],
            acceleration: vec![Motion::ZERO; bodies],
            force: vec![Force::ZERO; bodies],
            body_momentum: vec![Force::ZERO; bodies],
            armature,
        }
    }

    /// Computes all for a configuration and the velocity that it was given with. Rows of free twigs hold their diagonal
    /// alone. Bodies that are flagged as at rest keep what they had; without flags there are none.
    pub fn update<const W: usize>(
        &mut self,
        model: &Model,
        parameters: &Parameters,
        kin: &Kinematics,
        wrenches: &[(BodyId, Wrench)],
        velocity: &[f64],
        free_twigs: RowSet<W>,
        resting: &[bool],
    ) {
        for index in (1..model.bodies.len()).filter(|&index| !is_resting(resting, index)) {
            let (rotation, inertial) = (&kin.rotation[index], &parameters.bodies[index]);
            let com = kin.position[index] - kin.origin[index] + rotation * inertial.com;
            self.own[index] = Inertia::new(inertial.mass, &com, &Sym3::rotated(rotation, &inertial.inertia));
        }
        self.motion.copy_from_slice(&kin.motion);
        self.update_forces(model, parameters, kin, wrenches, velocity, resting);
        self.update_mass_matrix(model, kin, free_twigs, resting);
    }

    /// Computes the bias force for another velocity in the same configuration.
    pub fn update_bias(
        &mut self,
        model: &Model,
        parameters: &Parameters,
        kin: &Kinematics,
        wrenches: &[(BodyId, Wrench)],
        velocity: &[f64],
        resting: &[bool],
    ) {
        for (index, node) in model.nodes.iter().enumerate().skip(1) {
            let dof = node.dof;
            self.motion[index] = if node.is_free {
                let qvel = &velocity[dof..dof + 6];
                Motion { angular: V3::new(qvel[3], qvel[4], qvel[5]), linear: V3::new(qvel[0], qvel[1], qvel[2]) }
            } else {
                let mut motion = self.motion[node.parent];
                motion.add_scaled(&kin.axes[dof], velocity[dof]);
                motion
            };
        }
        self.update_forces(model, parameters, kin, wrenches, velocity, resting);
    }

    fn update_forces(
        &mut self,
        model: &Model,
        parameters: &Parameters,
        kin: &Kinematics,
        wrenches: &[(BodyId, Wrench)],
        velocity: &[f64],
        resting: &[bool],
    ) {
        // Gravity as an upward acceleration of the world.
        self.acceleration[0] = Motion { angular: V3::zeros(), linear: -parameters.gravity };
        for (index, node) in model.nodes.iter().enumerate().skip(1) {
            if is_resting(resting, index) {
                continue;
            }
            let motion = &self.motion[index];
            let mut acceleration = self.acceleration[node.parent];
            if node.is_free {
                // The origin is fixed in space while the root moves past it.
                acceleration.linear += motion.linear.cross(&motion.angular);
            } else {
                let parent = &self.motion[node.parent];
                let relative =
                    Motion { angular: motion.angular - parent.angular, linear: motion.linear - parent.linear };
                let drift = parent.cross_motion(&relative);
                acceleration.add_scaled(&drift, 1.0);
            }
            let inertia = &self.own[index];
            let mut force = inertia.apply(&acceleration);
            let momentum = inertia.apply(motion);
            force.add(&motion.cross_force(&momentum));
            self.body_momentum[index] = momentum;
            self.acceleration[index] = acceleration;
            self.force[index] = force;
        }
        for (body, wrench) in wrenches.iter().filter(|(body, _)| !is_resting(resting, body.0)) {
            let arm = kin.position[body.0] - kin.origin[body.0] + kin.rotation[body.0] * parameters.bodies[body.0].com;
            self.force[body.0].force -= wrench.force;
            self.force[body.0].torque -= wrench.torque + arm.cross(&wrench.force);
        }
        for index in (1..model.bodies.len()).rev().filter(|&index| !is_resting(resting, index)) {
            let node = &model.nodes[index];
            let (force, momentum, parent) = (self.force[index], self.body_momentum[index], node.parent);
            if parent != 0 {
                self.force[parent].add(&force);
                self.body_momentum[parent].add(&momentum);
            }
            for dof in node.dofs() {
                self.bias[dof] = kin.axes[dof].dot(&force);
                self.momentum[dof] = kin.axes[dof].dot(&momentum) + self.armature[dof] * velocity[dof];
            }
        }
    }

    fn update_mass_matrix<const W: usize>(
        &mut self,
        model: &Model,
        kin: &Kinematics,
        free_twigs: RowSet<W>,
        resting: &[bool],
    ) {
        self.inertia.copy_from_slice(&self.own);
        for index in (1..model.bodies.len()).rev().filter(|&index| !is_resting(resting, index)) {
            let node = &model.nodes[index];
            let (inertia, parent) = (self.inertia[index], node.parent);
            if parent != 0 {
                self.inertia[parent].add(&inertia);
            }
            let chain = &model.chains[index];
            let free_root = model.nodes[node.root].is_free;
            for dof in node.dofs() {
                let momentum = inertia.apply(&kin.axes[dof]);
                if free_twigs.contains(dof) {
                    self.axis_momentum[dof] = momentum;
                    self.mass_matrix[model.diagonal(dof)] = kin.axes[dof].dot(&momentum) + self.armature[dof];
                    continue;
                }
                let row = &mut self.mass_matrix[model.row(dof)];
                // The axes of a free root are unit vectors.
                let (f, t) = (&momentum.force, &momentum.torque);
                let of_root = [f.x, f.y, f.z, t.x, t.y, t.z];
                let known = if free_root { row.len().min(6) } else { 0 };
                row[..known].copy_from_slice(&of_root[..known]);
                for (entry, &other) in row.iter_mut().zip(chain).skip(known) {
                    *entry = kin.axes[usize::from(other)].dot(&momentum);
                }
                self.mass_matrix[model.diagonal(dof)] += self.armature[dof];
            }
        }
    }
}

#[inline(always)]
fn is_resting(flags: &[bool], body: usize) -> bool {
    flags.get(body).is_some_and(|&resting| resting)
}
